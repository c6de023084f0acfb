"""Tables straight onto a rig: what they do not say is stated, what they say twice refused."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.edited_weights import read_weights
from tests.usdio.driven_rig import driven_rig
from tests.usdio.small_creature import write_human
from usdface.cli import main
from usdface.core.deformer import Deformer
from usdface.core.provenance import Provenance
from usdface.model.review.verdict import judge_solve
from usdface.publish.collect import collect_performance
from usdface.steps.inputs.source_motion import (
    read_source_motion,
    source_transfer,
    unmatched_moving,
)
from usdface.steps.review.shot import open_shot
from usdface.usdio.retarget.sequences import read_sequence, write_sequence
from usdface.usdio.rig.read import read_rig
from usdface.usdio.rig.write import write_rig
from usdface.usdio.validation import validate

WEIGHTS = np.round(0.5 + 0.4 * np.sin(np.arange(1, 41) / 5), 4)


def usdface(*arguments: object) -> int:
    with pytest.raises(SystemExit) as stopped:
        main([str(each) for each in arguments])
    return int(stopped.value.code or 0)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    write_human(tmp_path / "human.usda")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def write(name: str, header: str, row: str) -> None:
    lines = [header, *(row.format(n=n, w=w) for n, w in enumerate(WEIGHTS, start=1))]
    Path(name).write_text("\n".join(lines), encoding="utf-8")


def test_rate_unit_and_take_are_stated_and_the_table_is_reviewed(folder: Path) -> None:
    lines = ["take;Frame;JawOpen;smile"]
    for take, factor in (("a", 50), ("b", 100)):
        lines += [f"{take};{n};{factor * w:.2f};10" for n, w in enumerate(WEIGHTS, start=1)]
    Path("t.csv").write_text("\n".join(lines), encoding="utf-8")
    stated = ("--rate", 24, "--weight-unit", "percent", "--take", "b")
    out = folder / "p.usda"
    assert usdface("retarget", "t.csv", "--rig", "human.usda", *stated, "--out", out) == 0
    clip = read_weights(out)
    assert float(clip.rate) == 24
    np.testing.assert_allclose(clip.values[:, clip.names.index("jawOpen")], WEIGHTS, atol=1e-5)
    shot = open_shot(out)
    assert shot.take.source is not None
    np.testing.assert_allclose(shot.take.source.values[:, 0], WEIGHTS, atol=1e-5)
    assert collect_performance(out).take is None


@pytest.mark.parametrize(
    ("header", "row", "options", "words"),
    [
        (
            "time,JawOpen,jaw_open,smile",
            "{n},{w},.1,.1",
            (),
            "JawOpen and jaw_open are two spellings",
        ),
        (
            "time,jawOpen,jaw_open,smile",
            "{n},{w},.1,.1",
            (),
            "jawOpen and jaw_open are two spellings",
        ),
        ("frame,jawOpen,smile", "{n},{w},.1", (), "frames per second with --rate"),
        ("frame,time,jawOpen,smile", "{n},{n},{w},.1", ("--rate", 24), "two frame rates"),
        ("time,jawOpen,smile", "{n},{w}x,.1", (), "where a number is expected"),
        ("time,jawOpen,smile", "{n},{w}7,44", (), "--weight-unit percent"),
        ("time,a1,b1", "{n},{w},.1", (), "none of its 2 shapes"),
    ],
)
def test_what_is_wrong_is_named_and_nothing_written(
    folder: Path,
    capsys: pytest.CaptureFixture[str],
    header: str,
    row: str,
    options: tuple[object, ...],
    words: str,
) -> None:
    write("t.csv", header, row)
    code = usdface("retarget", "t.csv", "--rig", "human.usda", *options, "--out", "p.usda")
    assert code == 2
    assert words in capsys.readouterr().err
    assert not (folder / "p.usda").exists()


def test_names_are_listed_of_tables_that_say_no_rate_or_are_in_percent(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write("t.csv", "take,frame,JawOpen,smile", "a,{n},{w}7,44")
    assert usdface("names", "human.usda", "t.csv") == 0
    assert "2 of 2 shapes of t.csv" in capsys.readouterr().out
    line = ("pairs", "propose", "--source", "t.csv", "--target", "human.usda")
    assert usdface(*line, "--out", "p.pairs.usda") == 0


def test_what_a_recorder_left_out_is_told(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write("t.csv", "frame,jawOpen,smile", "{n},{w},.1")
    rows = Path("t.csv").read_text(encoding="utf-8").splitlines()
    Path("t.csv").write_text("\n".join(rows[:7] + rows[9:]), encoding="utf-8")
    line = ("retarget", "t.csv", "--rate", 24, "--rig", "human.usda", "--out", "p.usda")
    assert usdface(*line) == 0
    assert "t.csv: 2 of 40 frames were dropped" in capsys.readouterr().out


def test_a_tongue_that_rolls_is_no_angle(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write("t.csv", "time,jawOpen,smile,TongueRoll,head_yaw,HeadRoll", "{n},{w},.1,{w},{w},.3")
    assert usdface("retarget", "t.csv", "--rig", "human.usda", "--out", "p.usda") == 0
    assert (
        "no counterpart for 1 moving shape (49% of the motion): TongueRoll;"
        in capsys.readouterr().out
    )


def test_what_is_named_alike_and_is_not_on_the_rig_is_left_out(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """FACEGOOD's tongue: `Scale__X` is no second `Scale_X`, and the rig has neither."""
    write("t.csv", "time,jawOpen,tongue_Scale_X,tongue_Scale__X,ear_up,earUp", "{n},{w},.1,.2,1,1")
    assert usdface("retarget", "t.csv", "--rig", "human.usda", "--out", "p.usda") == 0
    assert "no counterpart for 4 moving shapes" in capsys.readouterr().out


def test_what_moves_most_is_named_first_and_gaze_is_no_motion_of_the_face(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    names = "eyeLookInLeft,browDownLeft,mouthPucker,jawOpen,smile"
    write("t.csv", f"time,{names}", "{n},1,.2,{w},{w},.1")
    line = ("retarget", "t.csv", "--rig", "human.usda", "--out", "p.usda")
    assert usdface(*line) == 0
    told = capsys.readouterr().out
    weights = np.stack([np.full(40, 0.2), WEIGHTS, WEIGHTS, np.full(40, 0.1)])
    brow, pucker, jaw, smile = (weights**2).mean(axis=1)
    share = (brow + pucker) / (brow + pucker + jaw + smile)
    assert f"({share:.0%} of the motion): mouthPucker, browDownLeft, eyeLookInLeft;" in told
    assert "Do not use: a retarget by names; mouthPucker, browDownLeft, eyeLookInLeft" in told
    assert f"{share:.0%} of the source's motion (40 frames" in told
    assert "to do: give these shapes counterparts, in a table (`usdface names`, --names)" in told
    shot = open_shot(Path("p.usda"))
    assert judge_solve(shot.evidence()).level == "bad"  # sheets and reports say so too
    assert usdface("validate", "p.usda") == 1
    capsys.readouterr()
    Path("pairs.csv").write_text("source,target,weight\njawOpen,jawOpen,1\n", encoding="utf-8")
    assert usdface(*line, "--names", "pairs.csv", "--overwrite") == 0  # by a person's choice
    assert "Do not use" not in capsys.readouterr().out
    write("t.csv", f"time,{names}", "{n},1,.2,.1,{w},.1")
    assert usdface(*line, "--overwrite") == 0
    assert "Do not use" not in capsys.readouterr().out


def test_shapes_count_by_how_far_they_move_the_source_rig(folder: Path) -> None:
    write("t.csv", "time,jawOpen,smile", "{n},{w},{w}")
    assert usdface("retarget", "t.csv", "--rig", "human.usda", "--out", "p.usda") == 0
    motion = read_source_motion(folder / "p.usda")
    offsets = Deformer(read_rig(folder / "human.usda")).shapes.target_offsets().toarray()
    squares = dict(zip(motion.names, (offsets**2).sum(axis=1), strict=True))
    moved = squares["jawOpen"] + squares["smile"]
    assert motion.shares == pytest.approx(
        {name: squares[name] / moved for name in ("jawOpen", "smile")}
    )
    assert abs(motion.shares["jawOpen"] - 0.5) > 0.05  # by weights alone it is a half


def test_what_a_rig_drives_itself_is_not_missed_elsewhere(folder: Path) -> None:
    write_rig(folder / "logic.usda", driven_rig())
    write("t.csv", "time,jawOpen,smile", "{n},{w},{w}")
    line = ("retarget", "t.csv", "--rig", "logic.usda", "--out", "driven.usda")
    assert usdface(*line) == 0
    motion = read_source_motion(folder / "driven.usda")
    assert motion.weights[:, motion.names.index("jaw_smile")].max() > 0.1
    assert set(motion.moving) == {"jawOpen", "smile"}
    transfer, _ = source_transfer(folder / "driven.usda", motion, ("jawOpen", "smile"))
    assert not unmatched_moving(transfer, motion)
    write("u.csv", "time,jawOpen,smile,jaw_smile,ear_up", "{n},{w},{w},{w},{w}")
    assert usdface("retarget", "u.csv", "--rig", "logic.usda", "--out", "again.usda") == 0
    faults = [each.message for each in validate(folder / "again.usda")]
    assert any("1 shapes of the source move" in each and "ear_up" in each for each in faults)


def test_what_a_take_says_itself_is_not_stated(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write("t.csv", "frame,jawOpen,smile", "{n},{w},.1")
    assert usdface("ingest", "t.csv", "--rate", 24, "--out", "t.take.usda") == 0
    line = ("retarget", "t.take.usda", "--rate", 24, "--rig", "human.usda", "--out", "p.usda")
    assert usdface(*line) == 2
    assert "--rate is for tables of weights" in capsys.readouterr().err


def test_sequences_compare_free_shapes_and_say_who_has_the_options(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_rig(folder / "logic.usda", driven_rig())
    write("t.csv", "frame,jawOpen,smile,HeadYaw", "{n},{w},{w},{w}")
    line = ("retarget", "t.csv", "--rate", 24, "--rig", "logic.usda", "--out", "p.usda")
    assert usdface(*line) == 0
    assert usdface("ingest", "t.csv", "--rate", 24, "--out", "t.take.usda") == 0
    make = ("make-sequence", "--target", "p.usda", "--label", "joy", "--source-frames", "1-20")
    for name, source in (("a", "p.usda"), ("b", "t.take.usda")):
        assert usdface(*make, "--source", source, "--out", f"{name}.sequence.usda") == 0
    assert not {"jaw_smile", "smile50", "all"} & {
        *read_sequence(Path("a.sequence.usda")).source_shapes
    }
    assert read_sequence(Path("b.sequence.usda")).source_shapes == ("jawOpen", "smile")

    sequence = read_sequence(Path("a.sequence.usda"))  # as an earlier version wrote it
    motion = read_source_motion(Path("p.usda"))
    whole = replace(sequence, source_shapes=motion.names, source=motion.weights[:20])
    rate = motion.rate
    write_sequence(Path("old.sequence.usda"), whole, rate=rate, provenance=Provenance())
    find = ("find-sequences", "p.usda", "--out", "m.usda", "--overwrite", "--sequence")
    asked = ("--by", "threshold", "--threshold", 0.2, "--json")
    found = []
    for name in ("a", "old"):
        capsys.readouterr()
        assert usdface(*find, f"{name}.sequence.usda", *asked) == 0
        found.append(json.loads(capsys.readouterr().out)["figures"]["matches"])
    for each, other in zip(*found, strict=True):
        assert each["distance"] == pytest.approx(other["distance"])
    capsys.readouterr()
    assert usdface(*find, "b.sequence.usda", "--shapes", "HeadYaw") == 2
    assert "that no others drive matches HeadYaw" in capsys.readouterr().err

    assert (
        usdface("find-sequences", "t.csv", "--sequence", "b.sequence.usda", "--out", "n.usda") == 2
    )
    assert "with --rate, or give a take, ingested with it" in capsys.readouterr().err
