"""Pairs of takes that carry weights: chosen, tuned, added to, learned from."""

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from tests.regenerate import REPOSITORY
from tests.steps.retarget.test_names import SHAPES, phone_csv
from tests.steps.small_shot import Shot
from tests.test_docs import commands, run
from tests.usdio.small_rig import small_rig
from usdface.core.assets import Take, WeightsClip
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.core.sidecars import proposed_path
from usdface.runner.execute import execute
from usdface.specs.performance import TrainSpec
from usdface.specs.references import ReferencesAddSpec, ReferenceSheetSpec, SelectSpec
from usdface.specs.retarget import PairsProposeSpec, RetargetSpec, TrainRetargetSpec
from usdface.specs.review import ReportSpec
from usdface.steps.performance.describe import describe_mapping
from usdface.tuning.journal import Change
from usdface.tuning.session import TuningSession
from usdface.usdio.performance.read import PerformanceReader
from usdface.usdio.references.read import read_references, take_files
from usdface.usdio.references.weight_layers import read_keyed_references
from usdface.usdio.retarget.pairs import read_pairs
from usdface.usdio.retarget.retargeting import read_retargeting
from usdface.usdio.rig.write import write_rig
from usdface.usdio.take.write import write_take
from usdface.usdio.validation import validate

pytestmark = pytest.mark.usefixtures("without_comparison")

NAMES = ("jawOpen", "eyeBlink", "smile", "HeadYaw")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A rig, and a minute of a phone that moves all of it at random."""
    write_rig(tmp_path / "rig.usda", small_rig())
    steps = np.random.default_rng(3).random((13, 4))
    weights = np.stack([np.interp(np.arange(120), np.arange(13) * 10, row) for row in steps.T], 1)
    source = WeightsClip(NAMES, weights.astype(np.float32), 11, Fraction(30))
    write_take(
        tmp_path / "phone.take.usda",
        Take("phone", Fraction(30), 11, source=source),
        provenance=Provenance(),
    )
    return tmp_path


def select(folder: Path, **changed: object) -> SelectSpec:
    given = {
        "takes": (folder / "phone.take.usda",),
        "rig": folder / "rig.usda",
        "out": folder / "phone.references.usda",
        "count": 6,
    }
    return SelectSpec(**(given | changed))  # type: ignore[arg-type]


def tune(path: Path, pair: int, **weights: float) -> None:
    session = TuningSession(path)
    known = session.references
    change = Change(pair, known.takes[pair], int(known.frames[pair]), weights, done=True)
    session.apply([change], revision=session.revision)
    session.close()


def test_proposals_are_the_takes_weights_and_what_is_tuned_stays(folder: Path) -> None:
    path = folder / "phone.references.usda"
    execute(select(folder))
    references = read_references(path)
    assert references.marker_names == ()
    assert references.source_names == NAMES
    assert references.source is not None
    np.testing.assert_array_equal(references.weights, references.source[:, :3])
    apart = np.linalg.norm(references.weights[:, None] - references.weights, axis=2)
    assert apart[np.triu_indices(6, 1)].min() > 0.2, "frames that differ"
    tune(path, 2, smile=1.25)
    execute(select(folder, count=8), overwrite=True)
    again = read_references(path)
    assert again.frames[2] == references.frames[2]
    assert again.weights[2, 2] == 1.25
    assert again.tuned.tolist() == [False, False, True] + [False] * 5
    assert validate(path) == []
    drawn = execute(
        ReferenceSheetSpec(references=path, out=folder / "s.jpg", tile=64, quality="draft")
    )
    assert drawn.figures["pairs"] == list(range(1, 9))


def test_what_is_said_of_markers_is_refused(shot: Shot, folder: Path) -> None:
    with pytest.raises(InputError, match="no markers, so --mapping has no effect"):
        execute(select(folder, mapping=shot / "hero.mapping.usdc"))
    with pytest.raises(InputError, match="--count is 6, but only 1 frames differ"):
        execute(select(folder, frames="20-20"))
    (folder / "names.csv").write_text("source,target\na,b\n", encoding="utf-8")
    takes = (shot / "shot.clean.take.usda",)
    with pytest.raises(InputError, match="has markers, so --names has no effect"):
        execute(select(folder, takes=takes, names=folder / "names.csv"))
    execute(select(folder))
    given = {"references": folder / "phone.references.usda", "out": folder / "x.usdc"}
    with pytest.raises(InputError, match=r"no markers; use it with `usdface train-retarget"):
        execute(TrainSpec(**given))


def test_a_layer_of_pairs_is_described_by_the_command_that_trains_on_it(
    finished_shot: Shot, folder: Path
) -> None:
    pairs, rig = folder / "phone.pairs.usda", folder / "rig.usda"
    execute(select(folder))
    execute(PairsProposeSpec(source=folder / "phone.take.usda", target=rig, out=pairs))
    for path, command in (
        (pairs, "train-retarget"),
        (proposed_path(pairs), "train-retarget"),
        (folder / "phone.references.usda", "train-retarget --references"),
        (finished_shot / "hero.references.usda", "train"),
    ):
        with pytest.raises(
            InputError, match=f"it holds pairs, to train on with `usdface {command}`"
        ):
            describe_mapping(path)
    with pytest.raises(InputError, match="not a retargeting: it holds pairs, to train on with"):
        read_retargeting(pairs)
    with pytest.raises(InputError, match="not a mapping: no FaceMapping is"):
        describe_mapping(rig)


def test_a_retargeting_passes_through_the_tuned_pairs(folder: Path) -> None:
    path, pairs = folder / "phone.references.usda", folder / "phone.pairs.usda"
    take, rig = folder / "phone.take.usda", folder / "rig.usda"
    execute(select(folder))
    execute(PairsProposeSpec(source=take, target=rig, out=pairs))
    train = {"pairs": pairs, "references": path, "method": "additive"}
    spec = TrainRetargetSpec(**train, out=folder / "phone.retarget.usdc")
    with pytest.raises(InputError, match="no pair is tuned"):
        execute(spec)
    before = read_references(path)
    for pair in range(6):
        tune(path, pair, smile=float(before.weights[pair, 2] ** 2))
    execute(spec)
    out = folder / "phone.hero.usda"
    execute(RetargetSpec(source=take, retargeting=(folder / "phone.retarget.usdc",), out=(out,)))
    solved = PerformanceReader(out).solved()[before.frames - 11]
    np.testing.assert_allclose(solved[:, 2], before.weights[:, 2] ** 2, atol=0.02)
    np.testing.assert_allclose(solved[:, 0], before.weights[:, 0], atol=0.02)
    page = folder / "phone.html"
    execute(ReportSpec(performance=out, out=page, frames="11-14", height=120))
    assert "references add phone.hero.usda --references phone.references" in page.read_text("utf-8")


def test_shapes_of_the_tuned_frames_that_no_pair_has_are_named(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, pairs = folder / "phone.references.usda", folder / "phone.pairs.usda"
    execute(select(folder))
    execute(
        PairsProposeSpec(source=folder / "phone.take.usda", target=folder / "rig.usda", out=pairs)
    )
    tune(path, 0, smile=0.5)
    spec = TrainRetargetSpec(
        pairs=pairs, references=path, method="additive", out=folder / "phone.retarget.usdc"
    )
    assert not any("in no pair" in note for note in execute(spec).notes)
    known = read_pairs(pairs)
    moved = known.source_shapes[int(read_keyed_references(path).source[0].argmax())]
    kept = [name != moved for name in known.source_shapes]
    monkeypatch.setattr(
        "usdface.steps.retarget.train.read_pairs",
        lambda path: replace(known, source=known.source * kept),
    )
    (note,) = [note for note in execute(spec, overwrite=True).notes if "in no pair" in note]
    assert moved in note


def test_the_block_of_the_page_on_tuning_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    weights = np.random.default_rng(5).random((440, len(SHAPES)))
    phone_csv(Path("phone.csv"), weights.astype(np.float32))
    write_rig(Path("hero.usdc"), small_rig())
    path = Path("phone.references.usda")
    lines = [line for line in commands(REPOSITORY / "docs" / "tuning.md") if "phone" in line]
    steps = [line.split()[1] for line in lines]
    assert steps == "ingest select tune pairs train-retarget retarget references".split()
    for line in lines:
        if line.split()[1] == "tune":  # a server; what a person does there
            assert line == f"usdface tune {path}"
            tune(path, 3, smile=1.5)
        else:
            assert run(line) == 0, f"{line}\n{capsys.readouterr()}"
    references = read_references(path)
    assert references.frames[-1] == 434
    assert references.tuned.tolist() == [pair == 3 for pair in range(25)]
    solved = PerformanceReader(Path("phone.hero.usda")).solved()[references.frames[3] - 1]
    assert solved[2] > 1.0, "what was tuned: proposals are half a smile at most"


def test_takes_that_spell_their_shapes_otherwise_keep_their_weights(folder: Path) -> None:
    """Those of the second take were 0, next to proposals of its own weights."""
    spelled = ("JawOpen", "eye_blink", "tongueOut", "Smile")
    weights = np.random.default_rng(4).random((120, 4)).astype(np.float32)
    source = WeightsClip(spelled, weights, 11, Fraction(30))
    take = Take("other", Fraction(30), 11, source=source)
    write_take(folder / "other.take.usda", take, provenance=Provenance())
    takes = (folder / "phone.take.usda", folder / "other.take.usda")
    notes = execute(select(folder, takes=takes, count=12)).notes
    references = read_references(folder / "phone.references.usda")
    assert set(references.takes) == {"phone", "other"}
    assert references.source is not None
    np.testing.assert_allclose(references.source[:, :3], references.weights, atol=1e-6)
    (told,) = [note for note in notes if "phone.take.usda has no such shapes" in note]
    assert told.startswith("other.take.usda: tongueOut move")
    retarget = {"source": takes[1], "rig": (folder / "rig.usda",)}
    execute(RetargetSpec(**retarget, out=(folder / "other.hero.usda",)))
    free = next(f for f in range(11, 131) if f not in references.frames)
    path = folder / "phone.references.usda"
    added = {"performance": folder / "other.hero.usda", "references": path, "out": path}
    execute(ReferencesAddSpec(**added, frames=str(free)))
    again = read_references(path)
    assert again.source is not None
    np.testing.assert_allclose(again.source[-1, :3], again.weights[-1], atol=1e-6)
    assert again.source[-1].any()


def test_frames_of_a_retargeted_performance_are_added(folder: Path) -> None:
    path, out = folder / "phone.references.usda", folder / "phone.hero.usda"
    execute(select(folder))
    spec = RetargetSpec(source=folder / "phone.take.usda", rig=(folder / "rig.usda",), out=(out,))
    execute(spec)
    free = next(f for f in range(11, 131) if f not in read_references(path).frames)
    added = ReferencesAddSpec(performance=out, references=path, frames=str(free), out=path)
    execute(added)
    references = read_references(path)
    assert references.frames[-1] == free
    assert references.source is not None
    np.testing.assert_allclose(references.weights[-1], references.source[-1, :3], atol=1e-6)
    assert take_files(path) == (folder / "phone.take.usda",)


def test_a_still_take_has_no_pairs(folder: Path) -> None:
    still = WeightsClip(NAMES, np.zeros((60, 4), np.float32), 1, Fraction(30))
    take = Take("phone", Fraction(30), 1, source=still)
    write_take(folder / "phone.take.usda", replace(take, name="still"), provenance=Provenance())
    with pytest.raises(InputError, match="--count is 6"):
        execute(select(folder))
