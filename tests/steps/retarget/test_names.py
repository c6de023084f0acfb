"""From a phone straight to a rig whose names are understood, and the table of names."""

import csv
import json
import os
import re
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from pxr import Usd

from tests.regenerate import REPOSITORY
from tests.test_docs import commands, run
from tests.usdio.small_rig import small_rig
from usdface.cli.app import main
from usdface.core.assets import MeshShape, Rig, RigMesh
from usdface.model.retarget.name_matching import Transfer
from usdface.model.retarget.shape_matching import ShapeMatch
from usdface.publish.collect import collect_performance, validate_performance
from usdface.publish.extract import ReviewOptions, extract_performance
from usdface.steps.inputs.solve_verdict import describe_retarget, judge_performance
from usdface.steps.inputs.source_motion import transfer_by_table, write_name_table
from usdface.steps.retarget.pairs_propose import match_rigs
from usdface.usdio.performance.read import PerformanceReader
from usdface.usdio.rig.write import write_rig
from usdface.usdio.take.read import TakeReader
from usdface.usdio.validation import validate

SHAPES = ("JawOpen", "EyeBlinkLeft", "EyeBlinkRight", "MouthSmileLeft", "CheekPuff", "HeadYaw")


def usdface(*arguments: object) -> int:
    with pytest.raises(SystemExit) as stop:
        main([str(each) for each in arguments])
    return int(stop.value.code or 0)


def phone_csv(path: Path, weights: np.ndarray, shapes: tuple[str, ...] = SHAPES) -> Path:
    lines = [",".join(("Timecode", "BlendShapeCount", *shapes))]
    for frame, row in enumerate(weights):
        timecode = f"10:00:{frame // 60:02}:{frame % 60:02}.000"
        lines.append(",".join((timecode, str(len(shapes)), *(f"{each:.9g}" for each in row))))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def named_rig(path: Path, names: dict[str, str], extra: str = "") -> Rig:
    """Write the small rig with other names, and a shape of its own before them."""
    rig = small_rig()

    def renamed(mesh: RigMesh) -> RigMesh:
        shapes = [replace(shape, name=names[shape.name]) for shape in mesh.shapes]
        first = [MeshShape(extra, mesh.shapes[0].keys)] if extra else []
        return replace(mesh, shapes=(*first, *shapes))

    order = (*([extra] if extra else []), *(names[each] for each in rig.shapes))
    made = replace(
        rig,
        file=path,
        shapes=order,
        meshes=tuple(map(renamed, rig.meshes)),
        ranges=np.tile([0.0, 1.0], (len(order), 1)),
    )
    write_rig(path, made)
    return made


@pytest.fixture
def take(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> np.ndarray:
    """Weights of 40 frames in a phone's CSV, beside a rig with a prefix."""
    monkeypatch.chdir(tmp_path)
    weights = np.random.default_rng(0).random((40, len(SHAPES))).astype(np.float32)
    phone_csv(Path("phone.csv"), weights)
    names = {"jawOpen": "hero_bs_jawOpen", "eyeBlink": "hero_bs_eyeBlink", "smile": "hero_bs_smile"}
    named_rig(Path("hero.usda"), names, extra="hero_bs_aCorrective")
    return weights


def test_a_phone_drives_a_rig_by_names_and_every_shape_is_written(take: np.ndarray, capsys) -> None:
    assert usdface("retarget", "phone.csv", "--rig", "hero.usda", "--out", "shot.usda") == 0
    reader = PerformanceReader(Path("shot.usda"))
    solved = dict(zip(reader.names, reader.solved().T, strict=True))
    assert reader.names == tuple(
        f"hero_bs_{n}" for n in ("aCorrective", "jawOpen", "eyeBlink", "smile")
    )
    assert np.array_equal(solved["hero_bs_jawOpen"], take[:, 0])
    np.testing.assert_allclose(solved["hero_bs_eyeBlink"], take[:, 1:3].mean(axis=1), atol=1e-7)
    np.testing.assert_allclose(solved["hero_bs_smile"], take[:, 3] / 2, atol=1e-7)
    assert not solved["hero_bs_aCorrective"].any()
    assert "% of the motion): CheekPuff; pair them" in capsys.readouterr().out
    found = [each.message for each in validate(Path("shot.usda")) if each.check == "usdface:Names"]
    assert len(found) == 1
    assert "CheekPuff" in found[0]


def test_the_table_of_names_comes_back_edited(take: np.ndarray, capsys) -> None:
    assert usdface("names", "hero.usda", "phone.csv", "--json") == 0
    listed = json.loads(capsys.readouterr().out)
    pairs = {(row["source"], row["target"], row["weight"]) for row in listed["pairs"]}
    assert ("JawOpen", "hero_bs_jawOpen", 1.0) in pairs
    rows = [row for row in listed["pairs"] if row["source"] != "JawOpen"]
    rows.append({"source": "CheekPuff", "target": "hero_bs_jawOpen", "weight": 0.5})
    Path("edited.json").write_text(json.dumps({"pairs": rows}))
    line = "retarget phone.csv --rig hero.usda --names edited.json --out shot.usda"
    assert usdface(*line.split()) == 0
    reader = PerformanceReader(Path("shot.usda"))
    column = reader.solved()[:, reader.names.index("hero_bs_jawOpen")]
    np.testing.assert_allclose(column, 0.5 * take[:, 4], atol=1e-7)


def test_a_table_that_was_written_says_the_same_as_the_names(take: np.ndarray) -> None:
    for suffix in ("csv", "json"):
        assert usdface("names", "hero.usda", "phone.csv", "--out", f"t.{suffix}") == 0
        line = f"retarget phone.csv --rig hero.usda --names t.{suffix} --out {suffix}.usda"
        assert usdface(*line.split()) == 0
    assert usdface("retarget", "phone.csv", "--rig", "hero.usda", "--out", "plain.usda") == 0
    one, other, plain = (
        PerformanceReader(Path(f"{name}.usda")).solved() for name in ("csv", "json", "plain")
    )
    assert np.array_equal(one, plain)
    assert np.array_equal(other, plain)


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        (
            "source,target,weight\nJawOpen,hero_bs_jawOpn,1\n",
            "line 2: 'hero_bs_jawOpn' is no shape",
        ),
        ("source,target,weight\nJawOpen,hero_bs_jawOpen,half\n", "weight 'half' of JawOpen"),
        ("source,target\nA,hero_bs_smile\nA,hero_bs_smile\n", "line 3: A and hero_bs_smile are"),
        ("source,target\nSmirk,hero_bs_smile\n", "none of its 1 row names a shape of the source"),
        ("from,to\nA,B\n", "has no `source` column"),
        ("source,target\n,hero_bs_smile\n", "line 2: a pair needs a source and a target"),
    ],
)
def test_a_table_with_faults_is_refused(take: np.ndarray, capsys, rows: str, message: str) -> None:
    Path("t.csv").write_text(rows)
    line = "retarget phone.csv --rig hero.usda --names t.csv --out shot.usda"
    assert usdface(*line.split()) == 2
    assert message in capsys.readouterr().err
    assert not Path("shot.usda").exists()


def test_a_stream_without_a_rig_is_a_source_of_pairs(take: np.ndarray, capsys) -> None:
    for line in (
        "pairs propose --source phone.csv --target hero.usda --out x.pairs.usda",
        "train-retarget x.pairs.usda --method additive --out x.retarget.usdc",
        "retarget phone.csv --retargeting x.retarget.usdc --out shot.usda",
    ):
        assert usdface(*line.split()) == 0, capsys.readouterr().err
    reader = PerformanceReader(Path("shot.usda"))
    jaw = reader.solved()[:, reader.names.index("hero_bs_jawOpen")]
    np.testing.assert_allclose(jaw, take[:, 0], atol=1e-5)


def test_a_face_that_would_not_move_is_refused(tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    weights = np.zeros((30, 2))
    weights[:, 1] = np.linspace(0, 1, 30)
    phone_csv(Path("phone.csv"), weights, ("JawOpen", "CheekPuff"))
    named_rig(Path("hero.usda"), {"jawOpen": "jawOpen", "eyeBlink": "blink", "smile": "smile"})
    assert usdface("retarget", "phone.csv", "--rig", "hero.usda", "--out", "shot.usda") == 2
    assert "none of its 1 moving shape (CheekPuff) has a counterpart" in capsys.readouterr().err
    assert not Path("shot.usda").exists()


def test_the_page_from_a_phone_to_a_rig_runs(tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    weights = np.random.default_rng(0).random((40, len(SHAPES)))
    phone_csv(Path("phone.csv"), weights)
    names = {"jawOpen": "mouth_open", "eyeBlink": "AU45", "smile": "happy_smile"}
    named_rig(Path("hero.usdc"), names)
    page = REPOSITORY / "docs" / "howto" / "live_link_to_my_rig.md"
    Path("day1").mkdir()
    for take in ("one", "two"):
        phone_csv(Path(f"day1/{take}.csv"), weights)
    folder = re.findall(r"`(usdface retarget day1 [^`]*)`", page.read_text("utf-8"))
    for line in [*commands(page), *folder]:
        assert run(line) == 0, f"{line}\n{capsys.readouterr()}"
    plain = PerformanceReader(Path("phone.hero.usda")).solved()
    for other in ("phone.hero2.usda", "phone.hero3.usda", "performances/two.hero.usda"):
        assert np.array_equal(PerformanceReader(Path(other)).solved(), plain), other
    assert sorted(path.name for path in Path("performances").glob("*.hero.usda")) == [
        "one.hero.usda",
        "two.hero.usda",
    ]


def test_a_take_of_a_folder_that_fails_does_not_stop_the_others(take: np.ndarray, capsys) -> None:
    Path("day").mkdir()
    phone_csv(Path("day/good.csv"), take)
    phone_csv(Path("day/bad.csv"), take[:, 4:5], ("CheekPuff",))
    assert usdface("retarget", "day", "--rig", "hero.usda", "--out", "made") == 1
    assert "1 take of day retargeted, 1 failed" in capsys.readouterr().err
    assert Path("made/good.hero.usda").exists()
    assert not Path("made/bad.hero.usda").exists()


def test_what_is_stated_of_a_folder_counts_for_its_tables(take: np.ndarray, capsys) -> None:
    """A recorder's file beside them says its rate itself."""
    Path("day").mkdir()
    phone_csv(Path("day/phone.csv"), take)
    rows = [f"{n},{100 * each[0]:.6g},0" for n, each in enumerate(take, start=1)]
    Path("day/table.csv").write_text("\n".join(["frame,JawOpen,smile", *rows]), encoding="utf-8")
    line = ("retarget", "day", "--rig", "hero.usda", "--rate", 24, "--weight-unit", "percent")
    assert usdface(*line, "--out", "made") == 0, capsys.readouterr().err
    table, phone = (PerformanceReader(Path(f"made/{n}.hero.usda")) for n in ("table", "phone"))
    assert (table.rate, phone.rate == table.rate) == (24, False)
    Path("day/table.csv").unlink()
    assert usdface(*line, "--out", "other") == 1
    assert "by their own times its samples come at 48 frames per second" in capsys.readouterr().err


def test_what_a_phone_did_not_capture_is_named_down_to_the_verdict(take, capsys) -> None:
    rows = Path("phone.csv").read_text("utf-8").splitlines()
    Path("phone.csv").write_text("\n".join(rows[:11] + rows[21:30] + rows[31:]), "utf-8")
    assert usdface("ingest", "phone.csv", "--out", "phone.take.usda") == 0
    for source in ("phone.csv", "phone.take.usda"):
        assert usdface("retarget", source, "--rig", "hero.usda", "--out", f"{source}.usda") == 0
        words = "nothing was captured in frames 11-20"  # 30 alone hides nothing
        assert f"{source}: {words}; weights are interpolated there" in capsys.readouterr().out
        verdict = judge_performance(PerformanceReader(Path(f"{source}.usda")))
        assert f"{words}, which are filled" in verdict.sentence
        assert any(words in each.message for each in validate(Path(f"{source}.usda")))
    for frames, out in (("1-14", "b1.usda"), ("15-40", "b2.usda")):
        line = f"retarget phone.take.usda --rig hero.usda --frames {frames} --out {out}"
        assert usdface(*line.split()) == 0
    assert usdface("join", "b1.usda", "b2.usda", "--out", "joined.usda") == 0
    whole, joined = (PerformanceReader(Path(n)) for n in ("phone.take.usda.usda", "joined.usda"))
    assert joined.header.gaps == whole.header.gaps
    capsys.readouterr()
    line = "retarget phone.take.usda --rig hero.usda --frames 22-40 --out part.usda"
    assert usdface(*line.split()) == 0
    assert "nothing was captured" not in capsys.readouterr().out


def test_a_retargeting_is_published_with_the_sheet_of_its_sources_take(take, tmp_path) -> None:
    assert usdface("ingest", "phone.csv", "--out", "phone.take.usda") == 0
    for source in ("phone.csv", "phone.take.usda"):
        out = f"{source}.shot.usda"
        assert usdface("retarget", source, "--rig", "hero.usda", "--out", out) == 0
    item = collect_performance(Path("phone.csv.shot.usda"))
    (finding,) = (each for each in validate_performance(item) if each.check == "usdface:take")
    assert "retarget a take again" in finding.message
    item = collect_performance(Path("phone.take.usda.shot.usda"))
    assert item.take.resolve() == (tmp_path / "phone.take.usda").resolve()
    assert not any(each.check == "usdface:take" for each in validate_performance(item))
    made = extract_performance(item, tmp_path, review=ReviewOptions(rows=1, quality="draft"))
    assert made.path("sheet").is_file()
    assert describe_retarget(made.path("performance")).startswith("a retarget by names")


def test_the_rate_that_a_phones_clock_means_can_be_stated(take, capsys) -> None:
    phone_csv(Path("phone.csv"), np.tile(take, (2, 1)))  # more than a second tells the base
    ntsc = Fraction(60_000, 1001)
    for source in ("phone.csv", "phone.take.usda"):
        assert usdface("ingest", source, "--rate", 59.94, "--out", f"{source}.take.usda") == 0
        assert TakeReader(Path(f"{source}.take.usda")).rate == ntsc
        assert usdface("ingest", "phone.csv", "--out", "phone.take.usda", "--overwrite") == 0
    line = "retarget phone.csv --rate 59.94 --rig hero.usda --out shot.usda"
    assert usdface(*line.split()) == 0
    assert PerformanceReader(Path("shot.usda")).rate == ntsc
    assert usdface("ingest", "phone.csv", "--rate", 23.976, "--out", "other.take.usda") == 2
    assert "samples come at 60 frames per second; leave it out" in capsys.readouterr().err


def test_no_target_and_uneven_targets_are_refused(take: np.ndarray, capsys) -> None:
    assert usdface("retarget", "phone.csv", "--out", "shot.usda") == 2
    assert "no target is given" in capsys.readouterr().err
    line = "retarget phone.csv --rig hero.usda --out a.usda --out b.usda"
    assert usdface(*line.split()) == 2
    assert "2 outputs and 1 rigs" in capsys.readouterr().err


@pytest.mark.parametrize("suffix", [".csv", ".json"])
def test_no_name_in_a_table_is_a_formula_for_the_spreadsheet_that_edits_it(
    tmp_path: Path, suffix: str
) -> None:
    names = ("=cmd|'/C calc'!A0", "-2+3", "+jawOpen", "@SUM(A1)", "jaw=open", "'quoted")
    weights = -0.5 * np.eye(len(names))
    made = Transfer(names, names[::-1], weights, {}, ())
    write_name_table(tmp_path / f"names{suffix}", made)
    if suffix == ".csv":
        with (tmp_path / "names.csv").open(encoding="utf-8", newline="") as stream:
            cells = [cell for row in csv.reader(stream) for cell in (row[0], row[1])]
        assert not [cell for cell in cells if cell[0] in "=+-@"]
    back = transfer_by_table(tmp_path / f"names{suffix}", names, names[::-1])
    np.testing.assert_array_equal(back.matrix, weights)


def test_a_table_that_is_replaced_is_whole_for_who_reads_it(tmp_path: Path) -> None:
    rig = named_rig(tmp_path / "hero.usda", {each: each for each in small_rig().shapes})
    table = tmp_path / "names.csv"
    assert usdface("names", rig.file, "--out", table) == 0
    with table.open(encoding="utf-8") as reading:
        assert usdface("names", rig.file, "--out", table, "--overwrite") == 0
        assert reading.read() == table.read_text(encoding="utf-8")
        assert os.fstat(reading.fileno()).st_ino != table.stat().st_ino
    assert usdface("names", rig.file, "--out", tmp_path / "missing" / "names.csv") == 2


def test_a_face_among_several_is_named(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    rig = named_rig(tmp_path / "hero.usda", {each: each for each in small_rig().shapes})
    stage = Usd.Stage.CreateNew(str(tmp_path / "both.usda"))
    for name in ("/A", "/B"):
        stage.DefinePrim(name).GetReferences().AddReference("./hero.usda", rig.prim)
    stage.Save()
    both = stage.GetRootLayer().realPath
    assert usdface("names", both, both, "--prim", "/A") == 2
    assert "2 faces, </A>, </B>; name one with --prim" in capsys.readouterr().err
    assert usdface("names", both, both, *("--prim", "/A", "--prim", "/B", "--prim", "/C")) == 2
    assert "--prim /C" in capsys.readouterr().err
    assert usdface("names", both, both, "--prim", "/A", "--prim", "/B", "--json") == 0
    assert len(json.loads(capsys.readouterr().out)["pairs"]) == len(rig.shapes)


def test_sides_that_are_matched_differently_are_noted(tmp_path: Path, monkeypatch) -> None:
    names = {"jawOpen": "Form_1", "eyeBlink": "Form_2_L", "smile": "Form_2_R"}
    rig = named_rig(tmp_path / "a.usda", names)
    other = named_rig(
        tmp_path / "b.usda", {k: v.replace("Form", "Other") for k, v in names.items()}
    )
    for right, noted in (("Other_2_R", False), ("Other_1", True)):
        found = (ShapeMatch("Form_2_L", "Other_2_L", 0.9), ShapeMatch("Form_2_R", right, 0.8))
        monkeypatch.setattr(
            "usdface.steps.retarget.pairs_propose.match_deformations",
            lambda *given, matches=found, **named: matches,
        )
        notes = match_rigs(rig, other, by="deformation")[1]
        text = f"differently: Form_2_L -> Other_2_L; Form_2_R -> {right}"
        assert any(text in note for note in notes) == noted
