"""Weights in parts, played as value clips: the same as one layer, between frames too."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdSkel

from tests.usdio.small_rig import small_rig
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.core.sidecars import weights_path
from usdface.runner.execute import execute
from usdface.specs.performance import JoinSpec
from usdface.usdio.performance.read import read_performance
from usdface.usdio.performance.weights_layer import SolveFigures, make_header
from usdface.usdio.performance.write import writing_performance
from usdface.usdio.rig.read import read_rig
from usdface.usdio.rig.write import write_rig
from usdface.usdio.validation import validate

NAMES = ("smile", "jawOpen", "eyeBlink")
WEIGHTS = np.random.default_rng(0).random((23, 3)).astype(np.float32)
ALL = slice(0, len(WEIGHTS))


def write(
    folder: Path,
    name: str,
    part_frames: int | None,
    *,
    spec: str = "a",
    rows: slice = ALL,
) -> Path:
    if not (folder / "rig.usda").exists():
        write_rig(folder / "rig.usda", small_rig())
    path = folder / name
    with writing_performance(
        path,
        make_header(
            read_rig(folder / "rig.usda"),
            shape_names=NAMES,
            rate=Fraction(60),
            first_frame=rows.start - 3,
            last_frame=rows.stop - 4,
            regions=("face",),
            timecode_start="01:00:00:00",
        ),
        read_rig(folder / "rig.usda"),
        part_frames=part_frames,
        provenance=Provenance("map", spec, {}),
    ) as writer:
        for start in range(rows.start, rows.stop, 5):
            part = WEIGHTS[start : min(start + 5, rows.stop)]
            residual = np.full((len(part), 1), 0.5)
            writer.append(part, SolveFigures(part[:, :1], part[:, 1:2], residual))
    return path


@pytest.mark.parametrize("part_frames", [1, 2, 7, 22, 23, 100])
def test_parts_play_as_one_layer_between_frames_too(tmp_path: Path, part_frames: int) -> None:
    whole, parts = write(tmp_path, "whole.usda", None), write(tmp_path, "parts.usda", part_frames)
    np.testing.assert_array_equal(read_performance(parts).weights.values, WEIGHTS)
    one, other = Usd.Stage.Open(str(whole)), Usd.Stage.Open(str(parts))
    for name in ("blendShapeWeights", "face:uncertainty", "face:coverage", "face:residual"):
        single, joined = (s.GetAttributeAtPath(f"/Hero/FaceSolve.{name}") for s in (one, other))
        for time in np.arange(-5, 22, 0.25):
            np.testing.assert_array_equal(np.array(joined.Get(time)), np.array(single.Get(time)))
    skeleton = UsdSkel.Skeleton(other.GetPrimAtPath("/Hero/Skeleton"))
    if skeleton:
        query = UsdSkel.Cache().GetSkelQuery(skeleton).GetAnimQuery()
        np.testing.assert_array_equal(query.ComputeBlendShapeWeights(4.0), WEIGHTS[7])


def test_parts_that_were_moved_are_merged_and_not_played(tmp_path: Path) -> None:
    parts = (
        write(tmp_path, "a.usda", None, rows=slice(0, 10)),
        write(tmp_path, "b.usda", None, rows=slice(10, 23)),
    )
    for part in parts:
        layer = Sdf.Layer.FindOrOpen(str(part))
        layer.subLayerOffsets[0] = Sdf.LayerOffset(50)
        layer.Save()
    merged, played = tmp_path / "merged.usda", tmp_path / "played.usda"
    execute(JoinSpec(parts=parts, out=merged, clips="never"))
    back = read_performance(merged).weights
    np.testing.assert_array_equal(back.values, WEIGHTS)
    assert back.first_frame == 47
    with pytest.raises(InputError, match=r"a\.usda: a layer above moves it by \+50 frames"):
        execute(JoinSpec(parts=parts, out=played, clips="always"))
    assert not played.exists()


def test_parts_that_are_clips_themselves_join_as_one(tmp_path: Path) -> None:
    whole = write(tmp_path, "whole.usda", None)
    (tmp_path / "chunks").mkdir()
    write_rig(tmp_path / "chunks" / "rig.usda", small_rig())
    halves = (
        write(tmp_path / "chunks", "a.usda", 4, rows=slice(0, 10)),
        write(tmp_path / "chunks", "b.usda", None, rows=slice(10, 15)),
        write(tmp_path / "chunks", "c.usda", 3, rows=slice(15, 23)),
    )
    execute(JoinSpec(parts=halves[:2], out=tmp_path / "ab.usda", clips="always"))
    execute(
        JoinSpec(parts=(tmp_path / "ab.usda", halves[2]), out=tmp_path / "abc.usda", clips="always")
    )
    np.testing.assert_array_equal(read_performance(tmp_path / "abc.usda").weights.values, WEIGHTS)
    one, other = (Usd.Stage.Open(str(each)) for each in (whole, tmp_path / "abc.usda"))
    for name in ("blendShapeWeights", "face:uncertainty", "face:coverage", "face:residual"):
        single, joined = (s.GetAttributeAtPath(f"/Hero/FaceSolve.{name}") for s in (one, other))
        for time in np.arange(-5, 22, 0.25):
            np.testing.assert_array_equal(np.array(joined.Get(time)), np.array(single.Get(time)))


def test_a_joined_performance_outlives_the_mapping_of_its_parts_again(tmp_path: Path) -> None:
    first = write(tmp_path, "a.usda", 4, rows=slice(0, 10))
    second = write(tmp_path, "b.usda", None, rows=slice(10, len(WEIGHTS)))
    joined = tmp_path / "joined.usda"
    execute(JoinSpec(parts=(first, second), out=joined, clips="always"))
    write(tmp_path, "a.usda", 3, spec="b", rows=slice(0, 10))
    assert not [each for each in validate(joined) if each.severity == "error"]
    np.testing.assert_array_equal(read_performance(joined).weights.values, WEIGHTS)


def test_a_part_that_is_mapped_again_beneath_a_joined_performance_is_named(tmp_path: Path) -> None:
    first = write(tmp_path, "a.usda", None, rows=slice(0, 10))
    second = write(tmp_path, "b.usda", None, rows=slice(10, len(WEIGHTS)))
    joined = tmp_path / "joined.usda"
    execute(JoinSpec(parts=(first, second), out=joined, clips="always"))
    assert not [each for each in validate(joined) if each.severity == "error"]
    layer = Sdf.Layer.FindOrOpen(str(weights_path(first)))
    for time in layer.ListTimeSamplesForPath("/Hero/FaceSolve.blendShapeWeights"):
        layer.SetTimeSample("/Hero/FaceSolve.blendShapeWeights", time, [0.5, 0.5, 0.5])
    layer.Save()
    (found,) = [each for each in validate(joined) if each.severity == "error"]
    assert found.check == "usdface:Weights"
    assert found.message.startswith("time code 6: a.weights.usdc was mapped again since it was")


def test_a_performance_of_parts_passes_every_validator(tmp_path: Path) -> None:
    found = validate(write(tmp_path, "parts.usda", 7))
    assert {each.check for each in found} == {"usdface:Curves"}  # random weights do jump


def test_parts_that_are_played_no_more_are_removed_and_others_stay(tmp_path: Path) -> None:
    path = write(tmp_path, "a.usda", 7)
    other = write(tmp_path, "a.weights.usda", 7)  # a name as like as can be
    before = {each.name for each in tmp_path.glob("a.weights.weights*")}

    def parts() -> set[str]:
        names = {each.name for each in tmp_path.glob("a.weights.*.*.usdc")}
        return names - before

    old = parts()
    assert len(old) == 4 + 1  # the parts, and the frames at their seams
    write(tmp_path, "a.usda", 10, spec="b")
    new = parts()
    assert len(new) == 3 + 1
    assert not old & new
    write(tmp_path, "a.usda", None)
    assert not parts()
    assert weights_path(path).is_file()
    assert {each.name for each in tmp_path.glob("a.weights.weights*")} == before
    np.testing.assert_array_equal(read_performance(other).weights.values, WEIGHTS)


def test_an_interruption_leaves_the_old_parts(tmp_path: Path) -> None:
    path = write(tmp_path, "a.usda", 7)
    before = {each.name: each.read_bytes() for each in tmp_path.iterdir()}

    def interrupted() -> None:
        with writing_performance(
            path,
            make_header(
                read_rig(tmp_path / "rig.usda"),
                shape_names=NAMES,
                rate=Fraction(60),
                first_frame=1,
                last_frame=100,
            ),
            read_rig(tmp_path / "rig.usda"),
            part_frames=4,
            provenance=Provenance("map", "b", {}),
        ) as writer:
            writer.append(WEIGHTS)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    after = {each.name: each.read_bytes() for each in tmp_path.iterdir()}
    assert {name: after[name] for name in before} == before
    np.testing.assert_array_equal(read_performance(path).weights.values, WEIGHTS)
