"""Mapped in chunks and joined: as if mapped in one go, value for value."""

import itertools
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf

from tests.steps.small_shot import Shot
from usdface.core.errors import InputError
from usdface.runner.execute import execute
from usdface.runner.result import StepResult
from usdface.specs.base import Spec
from usdface.specs.capture import CleanSpec
from usdface.specs.edits import EditSpec
from usdface.specs.performance import JoinSpec, MapSpec, TrainSpec
from usdface.specs.references import ReferencesFromEditsSpec
from usdface.steps.performance import map as map_step
from usdface.usdio.performance.read import PerformanceReader
from usdface.usdio.performance.weights_layer import COVERAGE_TOLERANCE, SAMPLE_TOLERANCE_MM
from usdface.usdio.validation import validate

pytestmark = pytest.mark.usefixtures("without_comparison")


def run(spec: Spec) -> StepResult:
    return execute(spec, overwrite=True)


def map_to(shot: Shot, out: str, **more: object) -> Path:
    given = {
        "take": shot / "shot.clean.take.usda",
        "mapping": shot / "hero.mapping.usdc",
        "rig": shot / "hero.usdc",
        "out": shot / out,
    }
    run(MapSpec.model_validate(given | more))
    return shot / out


def all_values(path: Path) -> dict[str, np.ndarray]:
    reader = PerformanceReader(path)
    first, last = reader.first_frame, reader.last_frame
    return {
        "weights": reader.solved(),
        "uncertainty": reader.series("face:uncertainty", first, last),
        "coverage": reader.series("face:coverage", first, last),
        "residual": reader.series("face:residual", first, last),
        "frames": reader.frames,
        "timecode": np.array(reader.timecode_start),
    }


def assert_same(one: Path, other: Path, *, cut_anywhere: bool = False) -> None:
    """All is equal; figures near where cuts make other samples of them be kept."""
    within = dict.fromkeys(("uncertainty", "residual"), SAMPLE_TOLERANCE_MM)
    within["coverage"] = COVERAGE_TOLERANCE
    found, wanted = all_values(one), all_values(other)
    for name, values in wanted.items():
        if cut_anywhere and name in within:
            np.testing.assert_allclose(found[name], values, rtol=0, atol=2 * within[name])
        else:
            np.testing.assert_array_equal(found[name], values, err_msg=name)


@pytest.fixture
def in_small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(map_step, "BLOCK_FRAMES", 64)


@pytest.mark.usefixtures("in_small_blocks")
def test_joined_parts_equal_the_whole_wherever_they_are_cut(shot: Shot) -> None:
    whole = map_to(shot, "whole.usda")
    cuts = [1, 2, 65, 229, 480 + 1]
    parts = [
        map_to(shot, f"part.{first}.usda", frames=f"{first}-{stop - 1}")
        for first, stop in itertools.pairwise(cuts)
    ]
    for clips in ("never", "always"):
        run(JoinSpec(parts=tuple(parts[::-1]), out=shot / "joined.usda", clips=clips))
        assert_same(shot / "joined.usda", whole, cut_anywhere=True)
        assert validate(shot / "joined.usda") == [], clips
    # Chunks on one machine equal one layer.
    assert_same(map_to(shot, "chunks.usda", chunk=111), whole, cut_anywhere=True)
    assert len(list(shot.folder.glob("chunks.weights.*-*.usdc"))) == 5


@pytest.mark.usefixtures("in_small_blocks")
def test_chunks_of_whole_blocks_equal_the_whole_in_all_they_say(shot: Shot) -> None:
    whole = map_to(shot, "whole.usda")
    parts = [
        map_to(shot, f"part.{first}.usda", frames=f"{first}-{min(first + 191, 480)}")
        for first in range(1, 481, 192)
    ]
    for clips in ("never", "always"):
        run(JoinSpec(parts=tuple(parts), out=shot / "joined.usda", clips=clips))
        assert_same(shot / "joined.usda", whole)


def test_a_size_that_is_too_much_for_one_layer_makes_parts(shot: Shot, monkeypatch) -> None:
    monkeypatch.setattr(map_step, "LARGEST_LAYER_BYTES", 480 * 52 * 4 - 1)
    monkeypatch.setattr(map_step, "PART_BYTES", 200 * 52 * 4)
    map_to(shot, "large.usda")
    assert len(list(shot.folder.glob("large.weights.*-*.usdc"))) == 3


def test_the_same_chunks_give_the_same_bytes(shot: Shot) -> None:
    map_to(shot, "a.usda", chunk=200)
    first = {each.name: each.read_bytes() for each in shot.folder.glob("a.*")}
    map_to(shot, "a.usda", chunk=200)
    assert {each.name: each.read_bytes() for each in shot.folder.glob("a.*")} == first


def test_parts_that_do_not_fit_are_all_named(shot: Shot) -> None:
    first = map_to(shot, "a.usda", frames="1-10")
    gap = map_to(shot, "b.usda", frames="21-30")
    moved = map_to(shot, "c.usda", frames="29-40", prim="/shot/hero")
    with pytest.raises(InputError) as fault:
        run(JoinSpec(parts=(first, gap, moved), out=shot / "joined.usda"))
    for told in ("frames 11-20 are in no part", "frames 29-30 are in two", "another prim"):
        assert told in str(fault.value)
    assert not (shot / "joined.usda").exists()


def test_parts_of_another_take_or_mapping_are_not_joined(shot: Shot) -> None:
    run(CleanSpec(take=shot / "shot.take.usda", out=shot / "rough.usda", smooth=False))
    take = map_to(shot, "b.usda", frames="11-20", take=shot / "rough.usda")
    run(TrainSpec(references=shot / "hero.references.usda", out=shot / "r.usdc", method="ridge"))
    mapping = map_to(shot, "c.usda", frames="21-30", mapping=shot / "r.usdc")
    with pytest.raises(
        InputError, match=r"b\.usda: has another take .*c\.usda: has another mapping "
    ):
        run(JoinSpec(parts=(shot / "shot.hero.usda", take, mapping), out=shot / "joined.usda"))


def test_parts_of_a_rig_that_has_changed_meanwhile_are_not_joined(shot: Shot) -> None:
    rig = shot / "hero.usdc"
    first = map_to(shot, "a.usda", frames="1-10")
    layer = Sdf.Layer.FindOrOpen(str(rig))
    before, layer.comment = rig.read_bytes(), "published again"
    layer.Save()
    try:
        second = map_to(shot, "b.usda", frames="11-20")
        with pytest.raises(InputError, match=r"b\.usda: has another rig \(file or contents\) than"):
            run(JoinSpec(parts=(first, second), out=shot / "joined.usda"))
    finally:
        rig.write_bytes(before)
        layer.Reload(force=True)


def test_parts_of_other_options_are_told(shot: Shot) -> None:
    first = map_to(shot, "a.usda", frames="1-10")
    second = map_to(shot, "b.usda", frames="11-20", temporal="whole", cutoff=8)
    third = map_to(shot, "c.usda", frames="21-30", chunk=5)
    told = run(JoinSpec(parts=(first, second, third), out=shot / "joined.usda")).notes
    assert told == (f"{second}: made with another cutoff and temporal than {first}",)


def test_frames_outside_the_take_are_refused(shot: Shot) -> None:
    with pytest.raises(InputError, match=r"frames 400-500 are not all there; it has 1-480"):
        map_to(shot, "x.usda", frames="400-500")


def test_corrections_of_joined_parts_are_learned_from(shot: Shot) -> None:
    parts = tuple(map_to(shot, f"part.{cut}.usda", frames=cut) for cut in ("1-200", "201-480"))
    joined = shot / "joined.usda"
    run(JoinSpec(parts=parts, out=joined))
    run(EditSpec(performance=joined, shape=("jawOpen",), override=0.8, frames="301-301"))
    learned = ReferencesFromEditsSpec(
        performances=(joined,), references=shot / "hero.references.usda", out=shot / "v2.usda"
    )
    assert run(learned).figures["frames"] == [301]
    parts[0].unlink()
    with pytest.raises(
        InputError, match=r"joined\.usda: does not name .* such parts that still exist"
    ):
        run(learned)
