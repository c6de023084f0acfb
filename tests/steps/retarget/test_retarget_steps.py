"""From face to face as a user does it, by the command line; and what users get wrong."""

import json
import re
import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from pxr import Sdf, Ts, Usd, UsdGeom

from tests.steps.small_shot import Shot
from tests.usdio.small_creature import (
    creature_acts,
    human_moves,
    write_creature,
    write_creature_performance,
    write_human,
    write_human_performance,
)
from usdface.cli import main
from usdface.core.assets import Rig
from usdface.core.sidecars import proposed_path
from usdface.media.picture.image import read_image_metadata
from usdface.steps.inputs.solve_verdict import describe_retarget
from usdface.steps.inputs.source_motion import read_source_motion
from usdface.usdio.layers import read_provenance
from usdface.usdio.performance.read import PerformanceReader
from usdface.usdio.retarget.controls import read_control_clip
from usdface.usdio.retarget.pairs import read_pairs
from usdface.usdio.retarget.sequences import read_sequence
from usdface.usdio.rig.read import read_rig
from usdface.usdio.rig.write import write_rig
from usdface.usdio.validation import validate

FRAMES = 200
FIRST = 101


@dataclass(frozen=True)
class Stall:
    """A folder with two characters, a performance of the one, and pairs."""

    folder: Path
    human: Rig
    beast: Rig
    weights: np.ndarray

    def __truediv__(self, name: str) -> Path:
        return self.folder / name


def poses(count: int = 30) -> np.ndarray:
    rng = np.random.default_rng(0)
    return np.concatenate([np.zeros((1, 3)), np.eye(3), rng.random((count - 4, 3))])


def usdface(*arguments: object) -> int:
    with pytest.raises(SystemExit) as stopped:
        main([str(each) for each in arguments])
    return int(stopped.value.code or 0)


def build(folder: Path) -> Stall:
    """Write both characters and what they act."""
    human, beast = write_human(folder / "human.usda"), write_creature(folder / "beast.usda")
    weights = human_moves(FRAMES)
    write_human_performance(folder / "shot.usda", human, weights, first=FIRST)
    write_human_performance(folder / "human_poses.usda", human, poses(), first=1)
    write_creature_performance(folder / "beast_poses.usda", beast, creature_acts(poses()))
    return Stall(folder, human, beast, weights)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Stall:
    """Pairs imported, trained and retargeted once; read only."""
    made = build(tmp_path_factory.mktemp("stall"))
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(made.folder)
        assert import_pairs() == 0
        assert usdface("train-retarget", "x.pairs.usda", "--out", "x.retarget.usdc") == 0
        line = "retarget shot.usda --retargeting x.retarget.usdc --out beast.shot.usda"
        assert usdface(*line.split()) == 0
    return made


def copied(made: Stall, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, but: str = "") -> Stall:
    folder = tmp_path / "zwei Köpfe"  # a name as users give them
    shutil.copytree(made.folder, folder, ignore=shutil.ignore_patterns(*but.split()))
    monkeypatch.chdir(folder)
    human, beast = (replace(rig, file=folder / rig.file.name) for rig in (made.human, made.beast))
    return Stall(folder, human, beast, made.weights)


@pytest.fixture
def stall(finished: Stall, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Stall:
    """Two characters and what they act: nothing has been run."""
    return copied(finished, tmp_path, monkeypatch, but="x.* beast.shot.*")


@pytest.fixture
def trained(finished: Stall, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Stall:
    """As `stall`, with pairs and a retargeting."""
    return copied(finished, tmp_path, monkeypatch, but="beast.shot.*")


@pytest.fixture
def performed(finished: Stall, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Stall:
    """As `trained`, with the performance of the target."""
    return copied(finished, tmp_path, monkeypatch)


def import_pairs(*flags: str, **changes: str) -> int:
    given = {
        "source": "human_poses.usda",
        "target": "beast_poses.usda",
        "source-rig": "human.usda",
        "target-rig": "beast.usda",
        "attributes": "rig/lattice.dfm:squash,rig/lattice.dfm:c*",
        "out": "x.pairs.usda",
    }
    given |= changes
    words = [word for name, value in given.items() for word in (f"--{name}", value)]
    return usdface("pairs", "import", *words, *flags)


def test_pairs_without_rest_get_one_so_that_a_face_at_rest_stays_there(
    stall: Stall, capsys
) -> None:
    moving = poses()[1:]
    write_human_performance(stall / "human_poses.usda", stall.human, moving, first=1)
    write_creature_performance(stall / "beast_poses.usda", stall.beast, creature_acts(moving))
    assert import_pairs() == 0
    assert "added a pair of both at rest" in " ".join(capsys.readouterr().out.split())
    assert len(read_pairs(stall / "x.pairs.usda")) == len(moving) + 1
    assert usdface("train-retarget", "x.pairs.usda", "--out", "x.retarget.usdc") == 0
    write_human_performance(stall / "still.usda", stall.human, 0 * human_moves(20))
    line = "retarget still.usda --retargeting x.retarget.usdc --out still.beast.usda"
    assert usdface(*line.split()) == 0
    made = read_control_clip(stall / "still.beast.usda").controls
    np.testing.assert_allclose(made.weights, 0.0, atol=1e-5)


def test_every_control_of_the_target_is_driven(performed: Stall, capsys) -> None:
    read = read_control_clip(performed / "beast.shot.usda")
    truth = creature_acts(performed.weights)
    controls = read.controls
    assert read.first_frame == FIRST
    assert read.timecode_start == "01:00:04:05"
    assert len(controls) == FRAMES
    assert np.sqrt(((controls.weights - truth.weights) ** 2).mean()) < 0.06
    assert np.sqrt(((controls.values - truth.values) ** 2).mean()) < 0.06
    turn = np.abs(np.einsum("fji,fji->fj", controls.rotations, truth.rotations))
    assert np.rad2deg(2 * np.arccos(np.clip(turn, 0, 1))).mean() < 3
    np.testing.assert_allclose(np.linalg.norm(controls.rotations, axis=2), 1, atol=1e-6)
    assert read_provenance(performed / "beast.shot.controls.usdc").step == "retarget"
    assert not [e for e in validate(performed / "beast.shot.usda") if e.severity == "error"]


def test_a_sheet_says_what_a_performance_was_retargeted_by(performed: Stall, capsys) -> None:
    sheet = "sheet beast.shot.usda --out x.png --rows 1 --tile 64 --quality draft --overwrite"
    assert usdface(*sheet.split()) == 0
    assert "Check: a retarget of 30 pairs, keyed by hand; " in capsys.readouterr().out
    propose = "pairs propose --source human.usda --target human.usda --out own.pairs.usda"
    train = "train-retarget own.pairs.usda --out own.retarget.usdc"
    act = "retarget shot.usda --retargeting own.retarget.usdc --out own.shot.usda"
    for line in (propose, train, act, sheet.replace("beast", "own")):
        assert usdface(*line.split()) == 0
    count = len(read_pairs(Path("own.pairs.usda")))
    assert f"a retarget of {count} pairs, none of them tuned; " in capsys.readouterr().out
    Path("own.pairs.usda").unlink()
    assert describe_retarget(Path("own.shot.usda")) == "a retarget of pairs"
    assert describe_retarget(Path("shot.usda")) == ""


def test_a_control_held_by_the_pose_of_the_pairs_is_not_stuck(stall: Stall) -> None:
    """Its pose at rest is 0.3, to which it returns, or in which every pair holds it."""
    for gain, told in ((0.5, ""), (0.0, "1 shape without any motion: smile; if the pairs do not")):
        keyed = creature_acts(poses())
        keyed.weights[:, 2] = 0.3 + gain * poses()[:, 2]
        write_creature_performance(Path("beast_poses.usda"), stall.beast, keyed)
        moves = np.tile(human_moves(100), (5, 1))
        moves[np.r_[80:200, 330:480], 2] = 0
        write_human_performance(Path("long.usda"), stall.human, moves, first=FIRST)
        assert import_pairs("--overwrite") == 0
        train = "train-retarget x.pairs.usda --out x.retarget.usdc --overwrite --method additive"
        line = "retarget long.usda --retargeting x.retarget.usdc --out beast.shot.usda --overwrite"
        assert usdface(*train.split()) == 0
        assert usdface(*line.split()) == 0
        found = [each.message for each in validate(Path("beast.shot.usda"))]
        found = [each for each in found if "smile" in each]
        assert [told in each for each in found] == [True] * bool(told), found


def test_edits_are_told_of_when_a_target_is_retargeted_or_warped_again(
    performed: Stall, capsys
) -> None:
    sequence_and_matches(performed)
    warp = "warp beast.shot.usda --matches shot.matches.usda --out warped.usda --timing fit"
    assert usdface(*warp.split()) == 0
    shape = read_control_clip(Path("beast.shot.usda")).controls.shapes[0]
    again = "retarget shot.usda --retargeting x.retarget.usdc --out beast.shot.usda"
    for line, name in ((again, "beast.shot.usda"), (warp, "warped.usda")):
        assert usdface("edit", name, "--shape", shape, "--add", "0.1") == 0
        edits = Path(name).with_suffix(".edits.usda")
        before = edits.read_bytes()
        capsys.readouterr()
        assert usdface(*line.split(), "--overwrite") == 0
        assert f"kept the edits of 1 shape: {shape}" in capsys.readouterr().out
        assert edits.read_bytes() == before


def test_one_source_drives_many_targets_at_once(trained: Stall, capsys) -> None:
    assert import_pairs(out="y.pairs.usda", attributes="rig/lattice.dfm:squash") == 0
    assert (
        usdface("train-retarget", "y.pairs.usda", "--out", "y.retarget.usda", "--method", "rbf")
        == 0
    )
    capsys.readouterr()
    line = (
        "retarget shot.usda --retargeting x.retarget.usdc --retargeting y.retarget.usda "
        "--out one.usda --out two.usda --json"
    )
    assert usdface(*line.split()) == 0
    told = json.loads(capsys.readouterr().out)
    assert [each["attributes"] for each in told["figures"]["targets"]] == [2, 1]
    for name in ("one.usda", "two.usda"):
        assert len(read_control_clip(Path(name)).controls) == FRAMES
    before = Path("one.usda").read_bytes()
    assert usdface(*line.split()) == 0  # nothing has changed, and nothing is written
    assert json.loads(capsys.readouterr().out)["up_to_date"]
    assert Path("one.usda").read_bytes() == before


def test_pairs_are_proposed_by_name_and_by_hand_keyed_ones_stay(stall: Stall, capsys) -> None:
    line = (
        "pairs propose --source human.usda --target beast.usda --out p.pairs.usda --match name "
        "--attributes rig/lattice.*"
    )
    assert usdface(*line.split()) == 0
    pairs = read_pairs(Path("p.pairs.usda"))
    assert pairs.names == ("rest", "jawOpen", "eyeBlink", "smile")
    np.testing.assert_array_equal(pairs.source[1:], np.eye(3))
    np.testing.assert_array_equal(pairs.target.weights[1:], np.eye(3))
    assert pairs.target.attributes == ("rig/lattice.dfm:curl", "rig/lattice.dfm:squash")
    np.testing.assert_array_equal(pairs.target.values, np.tile([0.0, 0.25], (4, 1)))
    assert "2 controls of the target are at rest in every pair" in capsys.readouterr().out
    stage = Usd.Stage.Open("p.pairs.usda")
    squash = stage.GetAttributeAtPath("/Pairs/Target/rig/lattice.dfm:squash")
    for time in (1, 2, 3, 4):
        squash.Set(0.2 * time, time)
    stage.GetRootLayer().Save()
    assert usdface(*line.split(), "--overwrite") == 0
    again = read_pairs(Path("p.pairs.usda"))
    np.testing.assert_allclose(again.target.values[:, 1], 0.2 * np.arange(1, 5), atol=1e-6)
    assert again.names == pairs.names
    assert proposed_path(Path("p.pairs.usda")).is_file()
    for name in ("human", "beast"):
        rig = Usd.Stage.Open(f"{name}.usda")
        for prim in (each for each in rig.Traverse() if each.GetName() == "jawOpen"):
            prim.CreateAttribute("face:range", Sdf.ValueTypeNames.Double2).Set((-1.0, 0.0))
        rig.GetRootLayer().Save()
    assert usdface(*line.replace("p.pairs", "negative.pairs").split()) == 0
    pairs = read_pairs(Path("negative.pairs.usda"))
    np.testing.assert_array_equal(pairs.source[1:], np.diag([-1, 1, 1]))
    np.testing.assert_array_equal(pairs.target.weights[1:], np.diag([-1, 1, 1]))


def test_proposals_of_an_earlier_run_are_replaced_and_imported_pairs_stay(
    stall: Stall, capsys
) -> None:
    line = "pairs propose --source human.usda --target beast.usda --out p.pairs.usda"
    assert usdface(*line.split(), "--match", "name") == 0
    Path("n.csv").write_text("source,target,weight\nsmile,eyeBlink,0.5\njawOpen,jawOpen,1\n")
    named = (*line.split(), "--names", "n.csv", "--overwrite")
    assert usdface(*named) == 0
    pairs = read_pairs(Path("p.pairs.usda"))
    assert pairs.names == ("rest", "jawOpen", "smile")
    np.testing.assert_array_equal(pairs.target.weights[2], [0, 0.5, 0])
    attributes = {"attributes": "rig/lattice.dfm:*", "out": "p.pairs.usda"}
    assert import_pairs("--overwrite", **attributes) == 0
    named = (*named, "--attributes", attributes["attributes"])
    for _ in range(2):
        assert usdface(*named) == 0
        assert read_pairs(Path("p.pairs.usda")).names[29:] == ("frame 30", *pairs.names)
    assert "kept 30 pairs at their time codes" in capsys.readouterr().out


def test_nothing_is_proposed_where_keys_made_by_hand_would_hide_it(stall: Stall, capsys) -> None:
    line = "pairs propose --source human.usda --target beast.usda --out p.pairs.usda --match name"
    assert usdface(*line.split()) == 0
    stage = Usd.Stage.Open("p.pairs.usda")
    for prim in stage.Traverse():  # the first two pairs are keyed whole, the others taken out
        for attribute in prim.GetAttributes():
            if attribute.GetNumTimeSamples():
                for time, value in [(time, attribute.Get(time)) for time in (1, 2)]:
                    attribute.Set(value, time)
    stage.GetRootLayer().Save()
    del stage
    capsys.readouterr()
    assert usdface(*line.split(), "--overwrite") == 0
    assert "left out 2 new pairs (eyeBlink, smile)" in capsys.readouterr().out
    assert read_pairs(Path("p.pairs.usda")).names == ("rest", "jawOpen")


def test_describe_says_what_was_tried(trained: Stall, capsys) -> None:
    capsys.readouterr()
    assert usdface("describe", "x.retarget.usdc") == 0
    told = capsys.readouterr().out
    for method in ("additive", "rbf", "kernel_cca", "hybrid", "ridge"):
        assert told.count(f"\n  {method} ") == 1, "a row for the best of each method"


def test_cyclic_errors_are_figures_and_curves(trained: Stall, capsys) -> None:
    truth = creature_acts(trained.weights).weights
    rows = [",".join(["Frame", "beast_JawOpen", "beast_eye_blink", "beast_Smile"])]
    rows += [",".join(map(str, [FIRST + i, *row])) for i, row in enumerate(truth.tolist())]
    Path("truth.csv").write_text("\n".join(rows))
    line = (
        "cyclic x.pairs.usda --source shot.usda --truth truth.csv --every 3 "
        "--methods auto,rbf,kernel_cca,hybrid,ridge --out c.json --out c.png"
    )
    assert usdface(*line.split()) == 0
    figures = json.loads(Path("c.json").read_text())["methods"]
    default = next(name for name in figures if name.startswith("default"))
    for name, figure in figures.items():
        assert figures[default]["mean_mm"] <= figure["mean_mm"] + 2e-3, name
        assert figure["direct_mm"] < 1.0
    assert read_image_metadata(Path("c.png"))["step"] == "cyclic"
    with Image.open("c.png") as image:
        below = np.asarray(image)[-200:, :, :3].astype(int)
    drawn = np.ptp(below.reshape(200, -1), axis=0).reshape(-1, 3).max(axis=1) > 20
    faces = np.count_nonzero(np.diff(drawn.astype(int)) == 1)
    assert faces >= 6, "the source, and what each of five methods makes of it"


def test_cyclic_refuses_pairs_of_shapes_that_the_source_lacks(trained: Stall, capsys) -> None:
    layer = Sdf.Layer.FindOrOpen(str(trained / "x.pairs.proposed.usda"))
    names = layer.GetAttributeAtPath("/Pairs/SourceWeights.blendShapes")
    names.default = ["sneer", *names.default[1:]]
    layer.Save()
    assert usdface("cyclic", "x.pairs.usda", "--source", "shot.usda", "--out", "c.json") == 2
    told = capsys.readouterr().err
    assert "x.pairs.usda: 1 of its 3 shapes are not on " in told
    assert "(sneer); propose pairs again" in told


def test_cyclic_names_the_rig_that_its_pairs_lack(trained: Stall, capsys) -> None:
    (trained / "human.usda").rename(trained / "moved.usda")
    assert usdface("cyclic", "x.pairs.usda", "--source", "shot.usda", "--out", "c.json") == 2
    told = capsys.readouterr().err
    assert "x.pairs.usda: its source rig, " in told
    assert "is gone; put it back" in told
    (trained / "weights.csv").write_text("frame,jawOpen,eyeBlink\n1,0,0\n2,1,0\n3,0,1\n")
    line = "pairs propose --source weights.csv --target beast.usda --match name --out w.pairs.usda"
    assert usdface(*line.split()) == 0
    capsys.readouterr()
    assert usdface("cyclic", "w.pairs.usda", "--source", "weights.csv", "--out", "c.json") == 2
    told = capsys.readouterr().err
    assert "w.pairs.usda: has no source rig, which errors in mm need; propose pairs" in told


def sequence_and_matches(stall: Stall, target_frames: int = 61) -> None:
    """A smile of the creature's own, found in the shot."""
    time = np.linspace(0, 1, target_frames)[:, None]
    own = creature_acts(np.sin(np.pi * time) * [0.1, 0.6, 1.0])
    write_creature_performance(stall / "own.usda", stall.beast, own)
    line = (
        "make-sequence --source shot.usda --source-frames 150-190 --target own.usda "
        "--label joy --out joy.sequence.usda"
    )
    assert usdface(*line.split()) == 0
    line = (
        "find-sequences shot.usda --sequence joy.sequence.usda --by threshold --threshold 0.01 "
        "--out shot.matches.usda"
    )
    assert usdface(*line.split()) == 0


@pytest.mark.parametrize("timing", ["own", "fit"])
def test_a_sequence_is_put_in_and_the_rest_stays_to_the_last_bit(
    performed: Stall, timing: str, capsys
) -> None:
    sequence_and_matches(performed)
    capsys.readouterr()
    line = (
        "warp beast.shot.usda --matches shot.matches.usda --out warped.usda --weight 1000 "
        f"--timing {timing} --blend 8 --curves warp.png"
    )
    assert usdface(*line.split()) == 0
    beyond = "differ in length: 191-210 after joy at 150-190 replaced; --timing fit"
    assert (beyond in capsys.readouterr().out) == (timing == "own")
    before = read_control_clip(Path("beast.shot.usda")).controls
    after = read_control_clip(Path("warped.usda")).controls
    last = 190 if timing == "fit" else 150 + 60
    outside = np.r_[0 : 150 - 8 - FIRST, last + 9 - FIRST : FRAMES]
    for field in ("weights", "translations", "rotations", "scales", "values"):
        assert np.array_equal(getattr(after, field)[outside], getattr(before, field)[outside]), (
            field
        )
    middle = (150 + last) // 2 - FIRST
    wanted = creature_acts(np.array([[0.1, 0.6, 1.0]]))
    np.testing.assert_allclose(after.weights[middle], wanted.weights[0], atol=0.02)
    np.testing.assert_allclose(after.values[middle], wanted.values[0], atol=0.02)
    turn = abs(after.rotations[middle, 1] @ wanted.rotations[0, 1])
    assert np.rad2deg(2 * np.arccos(min(turn, 1.0))) < 2
    np.testing.assert_allclose(np.linalg.norm(after.rotations, axis=2), 1, atol=1e-6)
    steps = np.abs(np.diff(after.weights, axis=0)).max()
    assert steps < 3 * np.abs(np.diff(before.weights, axis=0)).max()
    assert read_image_metadata(Path("warp.png"))["step"] == "warp"


def test_a_blink_at_the_end_of_a_sequence_is_played_whole(stall: Stall) -> None:
    sequence_and_matches(stall)
    closing = np.interp(np.arange(FRAMES) + FIRST, [188, 190, 191, 195], [0, 1, 1, 0])
    acted = creature_acts(np.column_stack([np.zeros(FRAMES), closing, np.zeros(FRAMES)]))
    write_creature_performance(Path("beast.shot.usda"), stall.beast, acted, first=FIRST)
    line = "warp beast.shot.usda --matches shot.matches.usda --out w.usda --timing fit --blend 6"
    assert usdface(*line.split()) == 0
    lids = read_control_clip(Path("w.usda")).controls.weights[:, 1]
    np.testing.assert_allclose(lids[188 - FIRST :], closing[188 - FIRST :], atol=0.02)
    assert lids[170 - FIRST] == pytest.approx(0.6, abs=0.02), "the sequence's"


def test_a_sequence_of_another_rate_lasts_as_long(performed: Stall, capsys) -> None:
    sequence_and_matches(performed)
    assert "resampled" not in capsys.readouterr().out
    before = read_sequence(Path("joy.sequence.usda"))
    layer = Sdf.Layer.FindOrOpen("joy.sequence.usda")
    rate = layer.timeCodesPerSecond
    layer.timeCodesPerSecond = layer.framesPerSecond = 2 * rate
    layer.Save()
    told = f"joy.sequence.usda runs at {2 * rate:g} frames per second, and is resampled to {rate:g}"
    line = "warp beast.shot.usda --matches shot.matches.usda --out w.usda --json"
    assert usdface(*line.split()) == 0
    said = json.loads(capsys.readouterr().out)
    assert any(told in note for note in said["notes"])
    (placed,) = (each["placed"] for each in said["figures"]["sequences"])
    assert placed[1] - placed[0] == (len(before.target) - 1) / 2
    shorter = "differ in length: 181-190 after joy at 150-180 kept; --timing fit"
    assert any(shorter in note for note in said["notes"])
    line = "find-sequences shot.usda --sequence joy.sequence.usda --out two.matches.usda"
    assert usdface(*line.split()) == 0
    assert told in capsys.readouterr().out


def test_attributes_that_move_are_carried(performed: Stall, capsys) -> None:
    make = "make-sequence --source shot.usda --source-frames 150-190 --target own.usda --label joy"
    own = creature_acts(np.sin(np.pi * np.linspace(0, 1, 61)[:, None]) * [0.1, 0.6, 1.0])
    write_creature_performance(performed / "own.usda", performed.beast, own)
    layer = Sdf.Layer.FindOrOpen("own.controls.usdc")
    layer.GetAttributeAtPath("/Beast/FaceSolve.face:controls:attributes").default = []
    layer.Save()  # as another tool writes it: attributes that move, and no list of them
    assert usdface(*make.split(), "--out", "a.sequence.usda") == 0
    assert "including the attributes that move: rig/lattice.dfm" in capsys.readouterr().out
    assert usdface(*make.split(), "--out", "b.sequence.usda", "--attributes", "rig/lattice.*") == 0
    for name in ("a", "b"):
        held = read_sequence(Path(f"{name}.sequence.usda")).target
        assert set(held.attributes) == {"rig/lattice.dfm:curl", "rig/lattice.dfm:squash"}
        order = [own.attributes.index(each) for each in held.attributes]
        np.testing.assert_allclose(held.values, own.values[:, order], atol=1e-6)
    assert usdface(*make.split(), "--out", "c.sequence.usda", "--attributes", "rig/cage.*") == 2
    assert "no float attribute below it is like 'rig/cage.*'" in capsys.readouterr().err


def test_sequences_are_found_without_a_threshold_and_by_label(performed: Stall, capsys) -> None:
    sequence_and_matches(performed)
    capsys.readouterr()
    line = "find-sequences shot.usda --sequence joy.sequence.usda --out m.usda --json"
    assert usdface(*line.split()) == 0
    found = json.loads(capsys.readouterr().out)["figures"]["matches"]
    assert [150, 190] in [each["frames"] for each in found]
    assert usdface(*line.split(), "--overwrite", "--by", "label", "--label", "JOY") == 0
    (best,) = json.loads(capsys.readouterr().out)["figures"]["matches"]
    assert best["frames"] == [150, 190]
    assert best["distance"] == pytest.approx(0, abs=1e-6)
    assert usdface(*line.split(), "--overwrite", "--shapes", "jaw*") == 0
    assert usdface(*line.split(), "--overwrite", "--shapes", "eye*", "--by", "threshold",
                   "--threshold", "1e-9", "--frames", "145-186") == 0  # fmt: skip
    told = capsys.readouterr().out
    assert re.search(r"the nearest, 14\d-18\d, are 0\.\d+ off: if they show joy, raise", told)
    make = "make-sequence --source shot.usda --target beast_poses.usda --label all --out long.usda"
    assert usdface(*make.split()) == 0
    both = line.replace("--sequence", "--sequence long.usda --sequence").split()
    assert usdface(*both, "--overwrite", "--frames", "140-200") == 0  # the other is searched for
    assert "long.usda: the sequence 'all' is 200 frames long" in capsys.readouterr().out
    assert (
        usdface(*both[:2], "--sequence", "long.usda", "--out", "n.usda", "--frames", "140-200") == 2
    )


def test_the_papers_threshold_is_a_sum(performed: Stall, capsys) -> None:
    """Eq. 10 as printed: its delta is the mean of --by threshold, times frames and root shapes."""
    find = "find-sequences shot.usda --sequence joy.sequence.usda --out"
    make = "make-sequence --source shot.usda --source-frames 150-190 --target own.usda"
    write_creature_performance(Path("own.usda"), performed.beast, creature_acts(poses(41)))
    assert usdface(*f"{make} --label joy --out joy.sequence.usda".split()) == 0
    capsys.readouterr()
    shapes = len(read_source_motion(Path("shot.usda"), None).names)
    delta = 0.05 * 41 * np.sqrt(shapes)
    places = []
    for out, asked in (("a.usda", "--by threshold --threshold 0.05"),
                       ("b.usda", f"--by published --threshold {delta}")):  # fmt: skip
        assert usdface(*f"{find} {out} {asked} --json".split()) == 0
        places.append(
            [each["frames"] for each in json.loads(capsys.readouterr().out)["figures"]["matches"]]
        )
    assert places[0] == places[1]
    assert places[0]
    assert usdface(*f"{find} c.usda --by published".split()) == 0  # the paper's 1.0
    assert usdface(*f"{find} d.usda --threshold 1.0".split()) == 2
    assert "by published" in capsys.readouterr().err
    assert usdface(*f"{find} d.usda --by published --threshold 0".split()) == 2
    assert "give more than 0" in capsys.readouterr().err


def test_faces_are_drawn_side_by_side(performed: Stall, capsys) -> None:
    line = (
        "faces shot.usda beast.shot.usda --out faces.png --rows 2 --tile 64 --quality draft --json"
    )
    assert usdface(*line.split()) == 0
    frames = json.loads(capsys.readouterr().out)["figures"]["frames"]
    assert len(frames) == 2
    assert all(FIRST <= frame < FIRST + FRAMES for frame in frames)
    assert read_image_metadata(Path("faces.png"))["step"] == "faces"
    assert usdface(*line.split(), "--frames", "900-950", "--overwrite") == 2
    assert "have no common frame in 900-950" in capsys.readouterr().err


def test_alpha_is_keyed_over_time(trained: Stall) -> None:
    assert usdface("train-retarget", "x.pairs.usda", "--out", "h.usda", "--method", "hybrid") == 0
    Path("alpha.csv").write_text("frame,alpha\n101,0\n150,1\n")
    layer = Sdf.Layer.CreateNew("alpha.usda")
    prim = Sdf.CreatePrimInLayer(layer, "/blend")
    Sdf.AttributeSpec(prim, "face:mapping:alpha", Sdf.ValueTypeNames.Float)
    layer.SetTimeSample("/blend.face:mapping:alpha", 101, 0.0)
    layer.SetTimeSample("/blend.face:mapping:alpha", 150, 1.0)
    layer.Save()
    Path("alpha.usda").rename("alpha.USDA")  # as some systems write it
    spline = Ts.Spline("float")
    for time, value in ((101, 0.0), (150, 1.0)):
        spline.SetKnot(Ts.Knot("float", time=time, value=value, nextInterp=Ts.InterpLinear))
    stage = Usd.Stage.CreateNew("spline.usda")
    kind = Sdf.ValueTypeNames.Float
    stage.DefinePrim("/blend").CreateAttribute("face:mapping:alpha", kind).SetSpline(spline)
    stage.Save()
    made = []
    for number, file in enumerate(("", "alpha.csv", "alpha.USDA", "spline.usda")):
        extra = f"--alpha {file}" if file else ""
        line = f"retarget shot.usda --retargeting h.usda --out a{number}.usda {extra}"
        assert usdface(*line.split()) == 0
        made.append(read_control_clip(Path(f"a{number}.usda")).controls.weights)
    assert np.abs(made[1] - made[0]).max() > 1e-4
    np.testing.assert_array_equal(made[1], made[2])
    np.testing.assert_allclose(made[1], made[3], atol=1e-6)


def test_a_keyed_share_is_measured_by_the_round_trip(trained: Stall, capsys) -> None:
    """Where alpha is 1 the hybrid is the multiquadric, and where it is 0 kernel CCA."""
    Path("alpha.csv").write_text("frame,alpha\n101,1\n")
    line = "cyclic x.pairs.usda --source shot.usda --every 10 --methods rbf --published --json"
    assert usdface(*line.split(), "--alpha", "alpha.csv") == 0
    found = json.loads(capsys.readouterr().out)["figures"]["methods"]
    assert found["hybrid, keyed"]["mean_mm"] == pytest.approx(found["rbf"]["mean_mm"], rel=1e-9)
    Path("wrong.csv").write_text("frame,alpha\n101,1.5\n")
    assert usdface(*line.split(), "--alpha", "wrong.csv") == 2
    assert "alpha" in capsys.readouterr().err


def test_kernel_cca_as_published_has_few_components_and_plain_lines(trained: Stall, capsys) -> None:
    line = "train-retarget x.pairs.usda --method kernel_cca --published --out p.usdc --json"
    assert usdface(*line.split()) == 0
    settings = json.loads(capsys.readouterr().out)["figures"]["settings"]
    assert settings["lines"] == "published"
    assert settings["components"] in (8, 16, 32)
    assert usdface("train-retarget", "x.pairs.usda", "--published", "--out", "q.usdc") == 2
    assert "published has no effect with method" in capsys.readouterr().err


def test_a_lying_head_is_retargeted_with_a_note(
    finished_shot: Shot, tmp_path: Path, capsys
) -> None:
    """Weights need no direction; pictures and whoever opens the shot do."""
    stage = Usd.Stage.Open(str(finished_shot / "hero.usdc"))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    stage.Export(str(tmp_path / "lies.usdc"))
    for rig, noted in ((finished_shot / "hero.usdc", False), (tmp_path / "lies.usdc", True)):
        line = ["retarget", str(finished_shot / "shot.hero.usda"), "--rig", str(rig)]
        assert usdface(*line, "--out", str(tmp_path / f"{noted}.usda"), "--frames", "101-110") == 0
        assert ("the head lies" in capsys.readouterr().out) == noted


def test_matched_positions_beyond_the_range_are_named(
    finished_shot: Shot, tmp_path: Path, capsys
) -> None:
    rig = read_rig(finished_shot / "hero.usdc")
    jaws = [each for mesh in rig.meshes for each in mesh.shapes if each.name == "jawOpen"]
    for key in (key for each in jaws for key in each.keys):
        key.offsets[:] *= 0.25
    write_rig(tmp_path / "stiff.usdc", rig)
    line = ["retarget", str(finished_shot / "shot.hero.usda"), "--out", str(tmp_path / "o.usda")]
    line += [
        "--source-rig",
        str(finished_shot / "hero.usdc"),
        "--rig",
        str(tmp_path / "stiff.usdc"),
    ]
    assert usdface(*line, "--frames", "101-140") == 0
    assert re.search(
        r"drive .* beyond (its|their) range: .*jawOpen \(by [1-4]\d+%", capsys.readouterr().out
    )


def test_positions_are_matched_without_pairs(finished_shot: Shot, tmp_path: Path, capsys) -> None:
    """A face matched with itself does what it did."""
    out = tmp_path / "same.usda"
    rig = str(finished_shot / "hero.usdc")
    line = ["retarget", str(finished_shot / "shot.hero.usda"), "--source-rig", rig, "--rig", rig]
    assert usdface(*line, "--out", str(out), "--frames", "101-140") == 0
    capsys.readouterr()
    line = [*line, "--retargeting", "x.usdc", "--out", str(tmp_path / "y.usda")]
    assert usdface(*line) == 2
    assert "source_rig has no effect with retargeting" in capsys.readouterr().err
    asked = read_source_motion(finished_shot / "shot.hero.usda", (101, 140))
    made = read_source_motion(out, None)
    assert made.weights.min() >= 0
    jaw = asked.names.index("jawOpen")
    np.testing.assert_allclose(
        made.weights[:, made.names.index("jawOpen")], asked.weights[:, jaw], atol=0.1
    )


def test_pairs_are_not_imported_beneath_keys_that_would_hide_them(stall: Stall, capsys) -> None:
    assert import_pairs(out="k.pairs.usda") == 0
    assert import_pairs("--overwrite", out="k.pairs.usda") == 0
    before = proposed_path(Path("k.pairs.usda")).read_bytes()
    stage = Usd.Stage.Open("k.pairs.usda")
    stage.GetAttributeAtPath("/Pairs/Target/rig/lattice.dfm:squash").Set(0.5, 3)
    stage.GetRootLayer().Save()
    capsys.readouterr()
    assert import_pairs("--overwrite", out="k.pairs.usda") == 2
    told = capsys.readouterr().err
    assert "keys made in it by hand, of 1 attribute (/Pairs/Target/rig/lattice.dfm:squash)" in told
    assert proposed_path(Path("k.pairs.usda")).read_bytes() == before


def no_target_side(stall: Stall) -> list[str]:
    write_creature_performance(stall / "short.usda", stall.beast, creature_acts(poses()[:20]))
    return ["short.usda"]


def key(path: str, prim: str, name: str, values: list[object]) -> None:
    layer = Sdf.Layer.FindOrOpen(path)
    spec = layer.GetAttributeAtPath(f"{prim}.{name}")
    for time in layer.ListTimeSamplesForPath(spec.path):
        layer.EraseTimeSample(spec.path, time)
    for time, value in enumerate(values, start=1):
        layer.SetTimeSample(spec.path, time, value)
    layer.Save()


def test_pairs_without_a_side_are_refused(stall: Stall, capsys) -> None:
    no_target_side(stall)
    assert import_pairs(target="short.usda") == 2
    assert (
        "10 pairs have no target: its weights have no keys at frames 21, 22"
        in capsys.readouterr().err
    )
    assert import_pairs(attributes="rig/lattice.dfm:bend") == 2
    assert "has no attribute 'dfm:bend'" in capsys.readouterr().err
    assert import_pairs(attributes="rig/lattice.dfm:name") == 2
    assert "is string, and a control must be one float" in capsys.readouterr().err
    assert not Path("x.pairs.usda").exists()


def test_a_table_of_the_target_is_matched_by_meaning(stall: Stall, capsys) -> None:
    """Columns under other names were 0 in all pairs, and nothing was said of them."""
    rows = [f"{n},{a},{b},{c},0" for n, (a, b, c) in enumerate(poses().tolist(), start=1)]
    table = "\n".join(["frame,jawOpen,EyeBlink,Smile,Hat", *rows])
    (stall / "t.csv").write_text(table, encoding="utf-8")
    given = {"source": "human_poses.usda", "target": "t.csv", "source-rig": "human.usda"}
    given |= {"target-rig": "beast.usda", "out": "t.pairs.usda"}
    assert usdface("pairs", "import", *(f"--{name}={value}" for name, value in given.items())) == 0
    told = " ".join(capsys.readouterr().out.split())
    assert "2 shapes, such as EyeBlink to eyeBlink" in told
    assert "left out 1 column of t.csv, not on beast.usda: Hat" in told
    np.testing.assert_allclose(read_pairs(stall / "t.pairs.usda").target.weights, poses())


def test_one_pair_and_pairs_all_alike_are_refused(stall: Stall, capsys) -> None:
    write_human_performance(stall / "one.usda", stall.human, poses()[3:4], first=1)
    write_creature_performance(stall / "one_t.usda", stall.beast, creature_acts(poses()[3:4]))
    assert import_pairs(source="one.usda", target="one_t.usda") == 2
    assert "1 pair; at least two are needed" in capsys.readouterr().err
    write_human_performance(
        stall / "same.usda", stall.human, np.repeat(poses()[3:4], 9, 0), first=1
    )
    write_creature_performance(stall / "nine.usda", stall.beast, creature_acts(poses()[:9]))
    assert import_pairs(source="same.usda", target="nine.usda") == 2
    assert "all 9 pairs have the same source expression" in capsys.readouterr().err


def test_motion_that_is_no_sum_of_the_pairs_is_noted(stall: Stall, capsys) -> None:
    together, alone = poses()[:, [0, 1, 0]], poses() * [0, 0, 1]
    write_human_performance(stall / "together.usda", stall.human, together, first=1)
    write_creature_performance(stall / "together_t.usda", stall.beast, creature_acts(together))
    write_human_performance(stall / "alone.usda", stall.human, alone, first=1)
    assert import_pairs(source="together.usda", target="together_t.usda") == 0
    assert usdface("train-retarget", "x.pairs.usda", "--out", "x.retarget.usdc") == 0
    for name, noted in (("alone", True), ("together", False)):
        line = f"retarget {name}.usda --retargeting x.retarget.usdc --out {name}.made.usda"
        assert usdface(*line.split()) == 0
        assert ("50% of the motion (mean square) is no sum of" in capsys.readouterr().out) == noted


def test_a_source_shape_that_no_pair_uses_is_told_at_training_and_at_work(
    stall: Stall, capsys
) -> None:
    still = poses() * [1, 0, 1]
    write_human_performance(stall / "still.usda", stall.human, still, first=1)
    write_creature_performance(stall / "still_t.usda", stall.beast, creature_acts(still))
    assert import_pairs(source="still.usda", target="still_t.usda") == 0
    assert usdface("train-retarget", "x.pairs.usda", "--out", "x.retarget.usdc") == 0
    assert "in no pair and without effect: 1 source shape, eyeBlink" in capsys.readouterr().out
    line = "retarget shot.usda --retargeting x.retarget.usdc"
    assert usdface(*line.split(), "--out", "b.usda") == 0
    assert "on the target, so the target does not follow: eyeBlink" in capsys.readouterr().out
    words = describe_retarget(Path("b.usda"))
    assert words == "a retarget of 30 pairs, keyed by hand; eyeBlink moves and is not followed"
    whole = PerformanceReader(Path("b.usda")).header
    for frames, out in (("101-130", "b1"), ("131-300", "b2")):
        assert usdface(*line.split(), "--frames", frames, "--out", f"{out}.usda") == 0
    assert usdface("join", "b1.usda", "b2.usda", "--out", "joined.usda") == 0
    assert "wrote joined.controls.usdc" in capsys.readouterr().out
    sequence_and_matches(stall)
    warp = "warp joined.usda --matches shot.matches.usda --out warped.usda --timing fit"
    assert usdface(*warp.split()) == 0
    for name in ("joined.usda", "warped.usda"):
        assert describe_retarget(Path(name)) == words
        shares = PerformanceReader(Path(name)).header.unmatched_shares
        np.testing.assert_allclose(shares, whole.unmatched_shares, rtol=0.2)
    rows = "".join(f"{frame},0.1,{0.02 * frame},0.1\n" for frame in range(40))
    Path("phone.csv").write_text(f"frame,JawOpen,EyeBlink,Smile\n{rows}", encoding="utf-8")
    line = "retarget phone.csv --rate 24 --retargeting x.retarget.usdc --out c.usda"
    assert usdface(*line.split()) == 0  # the source's own spelling
    told = capsys.readouterr().out
    assert "on the target, so the target does not follow: EyeBlink" in told
    assert "Do not use" in told


def test_a_region_that_no_pair_keys_is_named_at_training_at_work_and_in_the_verdict(
    stall: Stall, capsys
) -> None:
    resting = poses() * [1, 0, 1] + [0, 0.2, 0]
    write_human_performance(stall / "t.usda", stall.human, resting, first=1)
    rigs = "--source-rig human.usda --target-rig human.usda --out x.pairs.usda"
    line = f"pairs import --source human_poses.usda --target t.usda {rigs}"
    assert usdface(*line.split()) == 0
    capsys.readouterr()
    assert usdface("train-retarget", "x.pairs.usda", "--out", "x.retarget.usdc", "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert told["figures"]["unkeyed"] == {"lids": ["eyeBlink"]}
    assert (
        "lids: the source moves there, and the target rests in every pair, at 1 control, eyeBlink: "
        "it will not follow; key them in these pairs"
    ) in told["notes"]
    line = "retarget shot.usda --retargeting x.retarget.usdc --out b.usda"
    assert usdface(*line.split()) == 0
    assert "on the target, so the target does not follow: eyeBlink" in capsys.readouterr().out
    assert describe_retarget(Path("b.usda")).endswith("; eyeBlink moves and is not followed")
    (found,) = (each.message for each in validate(Path("b.usda")) if "Names" in each.check)
    assert re.search("shapes of the source move and have no counterpart.*: eyeBlink", found)


def test_bake_names_the_layer_of_joints_and_attributes(performed: Stall, capsys) -> None:
    assert usdface("bake", "beast.shot.usda", "--out", "baked.usdc") == 0
    assert "only weights are baked: beast.shot.controls.usdc" in capsys.readouterr().out
    assert usdface("edits", "import", "beast.shot.usda", "--changed", "baked.usdc") == 0
    assert "changes of joints and attributes are not imported" in capsys.readouterr().out
    assert usdface("package", "beast.shot.usda", "--out", "beast.usdz") == 0  # holds the layer
    assert usdface("bake", "shot.usda", "--out", "human.usdc") == 0
    assert "only weights" not in capsys.readouterr().out


@pytest.mark.parametrize("side", ["source", "target"])
def test_a_sequence_of_one_frame_names_the_option(stall: Stall, capsys, side: str) -> None:
    line = "make-sequence --source shot.usda --target beast_poses.usda --label joy --out j.usda"
    frames = {"source": "150-150", "target": "5-5"}[side]
    assert usdface(*line.split(), f"--{side}-frames", frames) == 2
    assert f"1 frame to pair, and a sequence needs at least 2; widen --{side}-frames" in (
        capsys.readouterr().err
    )


def test_controls_cut_at_their_range_are_told(stall: Stall, capsys) -> None:
    assert import_pairs() == 0
    line = "train-retarget x.pairs.usda --method additive --out x.retarget.usdc --overwrite"
    assert usdface(*line.split()) == 0
    line = "retarget shot.usda --retargeting x.retarget.usdc --out beast.shot.usda --overwrite"
    assert usdface(*line.split()) == 0
    assert "beyond" not in capsys.readouterr().out
    write_human_performance(stall / "shot.usda", stall.human, 2 * stall.weights, first=FIRST)
    assert usdface(*line.split()) == 0
    told = capsys.readouterr().out
    assert re.search(r"expressions that add up would drive \d+ controls beyond", told)
    assert "head/ear_L.translateY (by " in told
    assert "cut there" in told
    assert usdface("evaluate", "beast.shot.usda", "--against", "beast.shot.usda") == 0
    assert "moves joints or Xforms, whose error is not measured" in capsys.readouterr().out


def test_a_character_of_joints_and_attributes_needs_no_moving_shape(stall: Stall, capsys) -> None:
    still = replace(creature_acts(poses()), weights=np.zeros((len(poses()), 3)))
    write_creature_performance(stall / "still.usda", stall.beast, still)
    assert import_pairs(target="still.usda") == 0
    assert usdface("train-retarget", "x.pairs.usda", "--out", "x.retarget.usdc") == 0
    assert (
        usdface("retarget", "shot.usda", "--retargeting", "x.retarget.usdc", "--out", "j.usda") == 0
    )
    assert not PerformanceReader(stall / "j.usda").solved().any()
    assert usdface("validate", "j.usda") == 0
    human = stall.weights * 0
    write_human_performance(stall / "nothing.usda", stall.human, human, first=FIRST)
    line = "retarget nothing.usda --retargeting x.retarget.usdc --rig beast.usda --out n.usda"
    assert usdface(*line.split()) == 0
    assert usdface("validate", "n.usda") == 1
    assert "nothing ever moves" in capsys.readouterr().out


def test_conflicting_pairs_are_reported(stall: Stall, capsys) -> None:
    source = np.concatenate([poses(), poses()[[5]] + 0.004])
    target = creature_acts(np.concatenate([poses(), 1 - poses()[[5]]]))
    write_human_performance(stall / "c.usda", stall.human, source, first=1)
    write_creature_performance(stall / "ct.usda", stall.beast, target)
    assert import_pairs(source="c.usda", target="ct.usda") == 0
    assert usdface("train-retarget", "x.pairs.usda", "--out", "x.retarget.usdc", "--json") == 0
    told = capsys.readouterr().out
    assert "pairs 6 (frame 6) and 31 (frame 31) conflict" in told


def test_a_target_like_the_source_of_another_pair_is_reported(
    finished_shot: Shot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
) -> None:
    monkeypatch.chdir(tmp_path)
    header = "frame,jawOpen,mouthSmileLeft,eyeBlinkLeft,eyeBlinkRight\n"
    right = ["1,0,0,0,0", "2,1,0,0,0", "3,0,1,0,0", "4,0,0,1,0", "5,0,0,0,1"]
    wrong = [*right[:1], "2,0,1,0,0", *right[2:3], "4,0,0,0,1", *right[4:]]
    for name, rows in (("source", right), ("right", right), ("wrong", wrong)):
        Path(f"{name}.csv").write_text(header + "\n".join(rows) + "\n")
    rig = str(finished_shot / "hero.usdc")
    doubted = []
    for name in ("right", "wrong"):
        files = ["--source", "source.csv", "--target", f"{name}.csv", "--out", f"{name}.pairs.usda"]
        rigs = ["--source-rig", rig, "--target-rig", rig]
        assert usdface("pairs", "import", *files, *rigs, "--weight-unit", "one") == 0
        capsys.readouterr()
        line = f"train-retarget {name}.pairs.usda --out {name}.usdc --json"
        assert usdface(*line.split()) == 0
        report = json.loads(capsys.readouterr().out)
        doubted.append((report["figures"]["doubted"], " ".join(report["notes"])))
    assert doubted[0][0] == []
    assert doubted[1][0] == [2, 4]
    assert "pair 2 (frame 2): the target moves like the source of pair 3 (frame 3)" in doubted[1][1]
    assert "pair 4 (frame 4): the target moves like the mirror image" in doubted[1][1]


JOB = """
job: face_to_face
steps:
  - {step: pairs-import, source: human_poses.usda, target: beast_poses.usda,
     source_rig: human.usda, target_rig: beast.usda, attributes: ["rig/lattice.dfm:[cs]*"],
     out: x.pairs.usda}
  - {step: train-retarget, pairs: x.pairs.usda, source: shot.usda, out: x.retarget.usdc}
  - {step: retarget, source: shot.usda, retargeting: x.retarget.usdc, out: beast.shot.usda}
  - {step: make-sequence, source: shot.usda, source_frames: 150-190, target: beast_poses.usda,
     label: joy, out: joy.sequence.usda}
  - {step: find-sequences, source: shot.usda, sequence: joy.sequence.usda, by: label, label: joy,
     out: shot.matches.usda}
  - {step: warp, performance: beast.shot.usda, matches: shot.matches.usda, out: warped.usda}
"""


def test_a_job_of_all_steps_runs_once_and_then_is_up_to_date(stall: Stall, capsys) -> None:
    Path("x.job.yaml").write_text(JOB, encoding="utf-8")
    assert usdface("run", "x.job.yaml") == 0
    assert len(read_control_clip(Path("warped.usda")).controls) == FRAMES
    capsys.readouterr()
    assert usdface("check", "x.job.yaml", "--json") == 0
    states = [each["state"] for each in json.loads(capsys.readouterr().out)]
    assert len(states) == 6
    assert len(set(states)) == 1, states
    first = Path("warped.usda").stat().st_mtime_ns
    assert usdface("run", "x.job.yaml") == 0
    assert Path("warped.usda").stat().st_mtime_ns == first


Fault = Callable[[Stall], str]


def longer_than_the_take(stall: Stall) -> str:
    sequence_and_matches(stall)
    write_human_performance(stall / "brief.usda", stall.human, stall.weights[:20], first=1)
    return "find-sequences brief.usda --sequence joy.sequence.usda --out new.usda"


def target_longer_than_the_performance(stall: Stall) -> str:
    sequence_and_matches(stall, target_frames=FRAMES + 1)
    return "warp beast.shot.usda --matches shot.matches.usda --out new.usda"


def past_the_end(stall: Stall) -> str:
    sequence_and_matches(stall, target_frames=FRAMES - 10)
    return "warp beast.shot.usda --matches shot.matches.usda --out new.usda"


def overlapping(stall: Stall) -> str:
    sequence_and_matches(stall)
    layer = Sdf.Layer.FindOrOpen("shot.matches.usda")
    Sdf.CopySpec(layer, "/Matches/match_001", layer, "/Matches/mine")
    first = layer.GetAttributeAtPath("/Matches/mine.face:match:firstFrame")
    first.default = first.default + 30
    layer.Save()
    return "warp beast.shot.usda --matches shot.matches.usda --out new.usda"


def all_deactivated(stall: Stall) -> str:
    sequence_and_matches(stall)
    layer = Sdf.Layer.FindOrOpen("shot.matches.usda")
    for prim in layer.GetPrimAtPath("/Matches").nameChildren:
        prim.active = False
    layer.Save()
    return "warp beast.shot.usda --matches shot.matches.usda --out new.usda"


def another_character(stall: Stall) -> str:
    sequence_and_matches(stall)
    return "warp shot.usda --matches shot.matches.usda --out new.usda"


def standing_still(stall: Stall) -> str:
    write_human_performance(stall / "still.usda", stall.human, np.ones((30, 3)), first=1)
    return "make-sequence --source still.usda --target beast.shot.usda --label x --out new.usda"


def beyond_the_source(stall: Stall) -> str:
    return (
        "make-sequence --source shot.usda --source-frames 250-400 --target beast.shot.usda "
        "--label x --out new.usda"
    )


def unknown_label(stall: Stall) -> str:
    sequence_and_matches(stall)
    return "find-sequences shot.usda --sequence joy.sequence.usda --label grief --out new.usda"


def no_label(stall: Stall) -> str:
    sequence_and_matches(stall)
    return "find-sequences shot.usda --sequence joy.sequence.usda --by label --out new.usda"


def lonely_threshold(stall: Stall) -> str:
    sequence_and_matches(stall)
    return "find-sequences shot.usda --sequence joy.sequence.usda --threshold 0.1 --out new.usda"


def unmatched_targets(stall: Stall) -> str:
    return "retarget shot.usda --retargeting x.retarget.usdc --out new.usda --out other.usda"


def alpha_without_hybrid(stall: Stall) -> str:
    Path("alpha.csv").write_text("frame,alpha\n1,0.5\n")
    return "retarget shot.usda --retargeting x.retarget.usdc --out new.usda --alpha alpha.csv"


def alpha_out_of_range(stall: Stall) -> str:
    assert usdface("train-retarget", "x.pairs.usda", "--out", "h.usda", "--method", "hybrid") == 0
    Path("alpha.csv").write_text("frame,alpha\n1,0.5\n9,1.5\n")
    return "retarget shot.usda --retargeting h.usda --out new.usda --alpha alpha.csv"


def alpha_without_numbers(stall: Stall) -> str:
    assert usdface("train-retarget", "x.pairs.usda", "--out", "h.usda", "--method", "hybrid") == 0
    Path("alpha.csv").write_text("time,value\n1,0.5\n")
    return "retarget shot.usda --retargeting h.usda --out new.usda --alpha alpha.csv"


def mapping_of_markers(stall: Stall) -> str:
    return "retarget shot.usda --retargeting x.pairs.usda --out new.usda"


def rig_gone(stall: Stall) -> str:
    (stall / "beast.usda").rename(stall / "moved.usda")
    return "retarget shot.usda --retargeting x.retarget.usdc --out new.usda"


def another_source(stall: Stall) -> str:
    layer = Sdf.Layer.FindOrOpen("shot.weights.usdc")
    names = layer.GetAttributeAtPath("/Human/FaceSolve.blendShapes")
    names.default = ["a", "b", "c"]
    layer.Save()
    return "retarget shot.usda --retargeting x.retarget.usdc --out new.usda"


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        (longer_than_the_take, "is 41 frames long, and brief.usda has 20"),
        (target_longer_than_the_performance, "would replace frames"),
        (past_the_end, "would replace frames 150-339, but beast.shot.usda has 101-300"),
        (overlapping, "joy at 150-210 and joy at 180-240 overlap"),
        (all_deactivated, "holds no active match"),
        (another_character, "3 of its joints are not in shot.usda"),
        (standing_still, "do not move"),
        (beyond_the_source, "frames 250-400 are not all there; it has 101-300"),
        (unknown_label, "no sequence is labelled 'grief'; there are joy"),
        (no_label, "needs --label"),
        (lonely_threshold, "threshold has no effect with by"),
        (unmatched_targets, "1 retargetings, 2 outputs and 0 rigs"),
        (alpha_without_hybrid, "train with --method hybrid"),
        (alpha_out_of_range, "frame 9: alpha is 1.5"),
        (alpha_without_numbers, "line 1: has no `frame` column"),
        (mapping_of_markers, "not a retargeting"),
        (rig_gone, "is gone; name it with --rig"),
        (another_source, "none of its 3 shapes"),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_what_users_get_wrong_is_named_and_nothing_is_written(
    performed: Stall, fault: Fault, message: str, capsys
) -> None:
    line = fault(performed)
    capsys.readouterr()
    assert usdface(*line.split()) == 2
    assert message in capsys.readouterr().err
    assert not list(performed.folder.glob("new*"))


def test_a_stretch_of_a_performance_keeps_the_timecode_of_its_first_frame(shot: Shot) -> None:
    path = shot / "shot.hero.usda"
    whole = read_source_motion(path)
    assert whole.timecode_start == "01:00:00:00"
    assert read_source_motion(path, (whole.first_frame, 50)).timecode_start == "01:00:00:00"
    assert read_source_motion(path, (121, 240)).timecode_start == "01:00:01:00"
    assert read_source_motion(path, (125, 240)).timecode_start == "01:00:01:01"
