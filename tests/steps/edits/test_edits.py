"""Edits, as an animator meets them: set, kept through another mapping, baked, learned from."""

import csv
import json
import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdSkel
from scipy.spatial.transform import Rotation

from tests.edited_weights import read_weights
from tests.steps.small_shot import FRAMES, Shot
from usdface.core.assets import References
from usdface.core.deformer import Deformer
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.core.replacing import replacing
from usdface.core.sidecars import edits_path, tuned_path, weights_path
from usdface.core.trajectories import TRAJECTORY_SECONDS
from usdface.numerics.motion.key_reduction import no_edit
from usdface.runner.execute import execute
from usdface.runner.origin import make_provenance, provenance_of
from usdface.runner.result import StepResult
from usdface.specs.base import Spec
from usdface.specs.edits import BakeSpec, EditsImportSpec, EditSpec, PackageSpec
from usdface.specs.performance import MapSpec, TrainSpec
from usdface.specs.references import (
    ReferencesAddSpec,
    ReferencesFromEditsSpec,
    ReferencesImportSpec,
)
from usdface.specs.retarget import RetargetSpec
from usdface.steps.edits import bake
from usdface.steps.edits import edit as edit_step
from usdface.steps.edits.list_ import list_edit_ranges as list_edits
from usdface.steps.references.from_edits import (
    EDITED_SHARE,
    FULL_STRENGTH,
    LEAST_CHANGE,
    full_strength_frames,
)
from usdface.usdio.performance import write
from usdface.usdio.performance.read import PerformanceReader, read_performance
from usdface.usdio.references.read import read_references
from usdface.usdio.references.weight_layers import TunedPair
from usdface.usdio.references.write import write_references, write_tuned_weights
from usdface.usdio.rig.read import read_rig
from usdface.usdio.take.read import TakeReader, read_first_frame, read_take
from usdface.usdio.take.write import write_take
from usdface.usdio.validation import validate

pytestmark = pytest.mark.usefixtures(
    "without_comparison", "placement_not_drawn", "coverage_not_drawn"
)


def run(spec: Spec) -> StepResult:
    return execute(spec, overwrite=True)


def edit(path: Path, shape: str = "jawOpen", **change: object) -> StepResult:
    return run(EditSpec.model_validate({"performance": path, "shape": (shape,), **change}))


def unpaired(shot: Shot, first: int) -> int:
    """Return the first frame, from one on, that is no pair of the references."""
    pairs = read_references(shot / "hero.references.usda").frames
    return next(frame for frame in range(first, FRAMES) if frame not in pairs)


def curve(path: Path, shape: str) -> np.ndarray:
    clip = read_weights(path)
    return clip.values[:, clip.names.index(shape)].astype(float)


def remap(shot: Shot, *, method: str = "", **more: object) -> StepResult:
    mapping = shot / "hero.mapping.usdc"
    if method:
        references, mapping = shot / "hero.references.usda", shot / "b.mapping.usdc"
        run(TrainSpec(references=references, out=mapping, method=method))
    given = {
        "take": shot / "shot.clean.take.usda",
        "mapping": mapping,
        "rig": shot / "hero.usdc",
        "out": shot / "shot.hero.usda",
    }
    return run(MapSpec.model_validate(given | more))


def test_the_last_edit_wins_and_blends_in_its_fade(shot: Shot) -> None:
    path = shot / "shot.hero.usda"
    solved = curve(path, "jawOpen")
    edit(path, add=0.2, frames="100-200")
    edit(path, override=0.5, frames="150-170", fade=4)
    shown = curve(path, "jawOpen")
    np.testing.assert_allclose(shown[:99], solved[:99])
    np.testing.assert_allclose(shown[99:145], solved[99:145] + 0.2, atol=1e-6)
    np.testing.assert_allclose(shown[149:170], 0.5, atol=1e-6)
    half = 0.5 + 0.5 * np.cos(np.pi * 2 / 5)
    np.testing.assert_allclose(shown[147], (1 - half) * (solved[147] + 0.2) + half * 0.5, atol=1e-6)
    edit(path, clear=True)
    np.testing.assert_array_equal(curve(path, "jawOpen"), solved.astype(np.float32))
    assert list_edits(path).figures == {"edits": []}


def test_mapping_again_keeps_every_edit_and_says_where_the_solve_changed(shot: Shot) -> None:
    path = shot / "shot.hero.usda"
    edit(path, add=0.2, frames="100-200", fade=8)
    edit(
        path,
        "smileLeft" if "smileLeft" in read_weights(path).names else "mouthSmileLeft",
        override=0.3,
        frames="50-60",
    )
    before = edits_path(path).read_bytes()
    notes = remap(shot, method="d06").notes
    assert edits_path(path).read_bytes() == before
    assert any("kept the edits of 2 shapes" in note for note in notes)
    reader = PerformanceReader(path)
    jaw = reader.names.index("jawOpen")
    np.testing.assert_allclose(
        reader.edited()[99:200, jaw], reader.solved()[99:200, jaw] + 0.2, atol=1e-6
    )
    (held,) = [e for e in list_edits(path).figures["edits"] if e["shape"] == "jawOpen"]
    moved = abs(held["solve_change"])
    told = [note for note in notes if note.startswith("jawOpen 92-208: the solve below")]
    assert bool(told) == (moved > 0.1)


def test_an_edit_to_the_last_frame_ends_there_when_the_take_is_mapped_further(shot: Shot) -> None:
    path = shot / "shot.hero.usda"
    solved = curve(path, "jawOpen")
    remap(shot, frames="100-200")
    edit(path, add=0.1, frames="150-200", fade=4)
    edit(path, shape="eyeBlinkLeft", override=1.0, frames="90-120")
    edit(path, shape="browInnerUp", add=0.1)
    changed = replace(read_weights(path), values=read_weights(path).values.copy())
    changed.values[-1, changed.names.index("jawRight")] += 0.3
    csv_file = shot / "changed.csv"
    with csv_file.open("w", newline="") as stream:
        rows = csv.writer(stream)
        rows.writerow(["frame", *changed.names])
        rows.writerows([f, *row] for f, row in zip(range(100, 201), changed.values, strict=True))
    run(EditsImportSpec(performance=path, changed=csv_file))
    remap(shot)
    shown = curve(path, "jawOpen") - solved
    fade = 0.5 + 0.5 * np.cos(np.pi * np.arange(6) / 5)
    np.testing.assert_allclose(shown[149:200], 0.1, atol=1e-6)
    np.testing.assert_allclose(shown[199:205], 0.1 * fade, atol=1e-6)
    np.testing.assert_allclose(shown[205:], 0.0, atol=1e-6)
    assert [
        (each["shape"], each["first"], each["last"])
        for each in list_edits(path).figures["edits"]
        if each["shape"] in ("eyeBlinkLeft", "jawRight")
    ] == [("eyeBlinkLeft", 90, 120), ("jawRight", 200, 200)]
    brow = [each for each in list_edits(path).figures["edits"] if each["shape"] == "browInnerUp"]
    assert [(each["first"], each["last"]) for each in brow] == [(1, FRAMES)]  # told of all frames


def shot_above(performance: Path) -> Path:
    """Return a layer of a shot that has a performance as its sublayer."""
    layer = Sdf.Layer.CreateNew(str(performance.with_name("sq10.usda")))
    below = Sdf.Layer.FindOrOpen(str(performance))
    layer.timeCodesPerSecond = layer.framesPerSecond = below.timeCodesPerSecond
    layer.startTimeCode, layer.endTimeCode = below.startTimeCode, below.endTimeCode
    layer.subLayerPaths = [f"./{performance.name}"]
    layer.Save()
    return Path(layer.realPath)


def test_in_a_shot_the_edits_of_the_performance_beneath_are_changed_as_well(shot: Shot) -> None:
    path = shot / "shot.hero.usda"
    solved = curve(path, "jawOpen")
    edit(path, add=0.1)
    edit(path, override=0.6, frames="300-320", fade=3)
    above = shot_above(path)
    edit(above, override=0.5)
    np.testing.assert_allclose(curve(above, "jawOpen"), 0.5, atol=1e-6)
    edit(above, clear=True)
    np.testing.assert_allclose(curve(above, "jawOpen"), solved, atol=1e-6)
    assert list_edits(above).figures == {"edits": []}
    edit(above, add=0.2, frames="50-60")
    np.testing.assert_allclose(curve(above, "jawOpen")[49:60], solved[49:60] + 0.2, atol=1e-6)
    np.testing.assert_allclose(curve(above, "jawOpen")[60:], solved[60:], atol=1e-6)
    np.testing.assert_allclose(curve(path, "jawOpen")[299:320], 0.6, atol=1e-6)  # as it was


def test_of_two_characters_in_a_shot_each_is_edited_and_baked_by_its_prim(shot: Shot) -> None:
    cast = ("anna", "bert")
    for name in cast:
        remap(shot, out=shot / f"{name}.usda", prim=f"/shot/{name}", frames="1-60")
    solved = curve(shot / "anna.usda", "jawOpen")
    both = shot_above(shot / "anna.usda")
    layer = Sdf.Layer.FindOrOpen(str(both))
    layer.subLayerPaths = [f"./{name}.usda" for name in cast]
    layer.Save()
    with pytest.raises(InputError, match=r"2 animations.*open one face at a time .*--prim"):
        edit(both, add=0.1)
    with pytest.raises(InputError, match="at or below </shot/carl>; check --prim"):
        edit(both, add=0.1, prim="/shot/carl")
    for name, add in zip(cast, (0.1, 0.2), strict=True):
        edit(both, add=add, prim=f"/shot/{name}")
        baked, changed = shot / f"{name}.published.usdc", shot / f"{name}.changed.usdc"
        run(BakeSpec(performance=both, out=baked, prim=f"/shot/{name}"))
        np.testing.assert_allclose(curve(baked, "jawOpen"), solved + add, atol=1e-6)
        run(PackageSpec(performance=both, out=shot / f"{name}.usdz", prim=f"/shot/{name}"))
        np.testing.assert_allclose(curve(shot / f"{name}.usdz", "jawOpen"), solved + add, atol=1e-6)
        shutil.copy(baked, changed)
        with_more = Sdf.Layer.FindOrOpen(str(changed))
        at = f"/shot/{name}/FaceSolve.blendShapeWeights"
        row = list(with_more.QueryTimeSample(at, 30))
        row[read_weights(baked).names.index("jawOpen")] += 0.3
        with_more.SetTimeSample(at, 30, row)
        with_more.Save()
        run(EditsImportSpec(performance=both, changed=changed, prim=f"/shot/{name}"))
        (found,) = list_edits(both, prim=f"/shot/{name}").figures["edits"]
        assert found["change"] == pytest.approx(add + 0.3, abs=1e-5)
    stage = Usd.Stage.Open(str(both))
    for name, add in zip(cast, (0.1, 0.2), strict=True):
        attribute = stage.GetAttributeAtPath(f"/shot/{name}/FaceSolve.face:edit:jawOpen")
        assert attribute.Get(10) == pytest.approx(add)


def test_an_edit_that_a_stronger_layer_would_hide_is_refused(shot: Shot) -> None:
    path = shot / "shot.hero.usda"
    edit(path, add=0.1)
    top = Sdf.Layer.FindOrOpen(str(path))
    prim = Sdf.CreatePrimInLayer(top, "/character/FaceSolve")
    Sdf.AttributeSpec(prim, "face:edit:jawOpen", Sdf.ValueTypeNames.Float).default = 0.3
    top.Save()
    before = edits_path(path).read_bytes()
    with pytest.raises(InputError, match=r"shot.hero.usda <.*face:edit:jawOpen>: is stronger"):
        edit(path, clear=True)
    assert edits_path(path).read_bytes() == before
    edit(path, shape="jawLeft", add=0.1)  # of which the top layer says nothing


def test_of_two_who_edit_at_once_one_is_told_and_the_other_s_edit_stays(
    shot: Shot, monkeypatch
) -> None:
    path = shot / "shot.hero.usda"
    read = edit_step.read_edits

    def slowly(*args: object) -> object:
        monkeypatch.setattr(edit_step, "read_edits", read)
        found = read(*args)
        edit(path, add=0.1, frames="10-20")
        return found

    monkeypatch.setattr(edit_step, "read_edits", slowly)
    with pytest.raises(InputError, match="another process changed it since it was read"):
        edit(path, add=0.2, frames="100-110")
    edit(path, add=0.2, frames="100-110")
    assert [(e["first"], e["last"]) for e in list_edits(path).figures["edits"]] == [
        (10, 20),
        (100, 110),
    ]


def test_a_first_edit_while_the_performance_is_written_is_refused_whole(shot: Shot) -> None:
    path = shot / "shot.hero.usda"
    with replacing(path), pytest.raises(InputError, match="another process is writing it"):
        edit(path, add=0.1)
    assert not edits_path(path).exists()  # or the next try would add it twice


@pytest.mark.parametrize("frames", ["400-100000000", "-100000000-50"])
def test_an_edit_far_beyond_both_ends_can_be_edited_again(shot: Shot, frames: str) -> None:
    path = shot / "shot.hero.usda"
    edit(path, add=0.1, frames=frames)
    edit(path, add=0.1, frames=frames)
    assert len(list_edits(path).figures["edits"]) == 1


def test_edits_beyond_a_take_that_was_cut_are_kept_and_told_of(shot: Shot) -> None:
    path = shot / "shot.hero.usda"
    edit(path, add=0.1, frames="20-30")
    edit(path, add=0.2, frames="300-320")
    edit(path, shape="browInnerUp", add=0.1)  # of all frames, whichever there are
    notes = remap(shot, frames="1-100").notes
    (told,) = [note for note in notes if "edits outside" in note]
    assert told.startswith(
        "edits outside frames 1-100 have no effect: jawOpen 300-320; they are kept"
    )
    assert not [note for note in remap(shot).notes if "edits outside" in note]
    assert [e["first"] for e in list_edits(path).figures["edits"] if e["shape"] == "jawOpen"] == [
        20,
        300,
    ]


def test_a_large_change_beneath_an_edit_is_named_by_frame(shot: Shot) -> None:
    path = shot / "shot.hero.usda"
    edit(path, add=0.2, frames="100-200")
    layer = Sdf.Layer.FindOrOpen(str(edits_path(path)))
    spec = layer.GetAttributeAtPath("/character/FaceSolve.face:beneath:jawOpen")
    times = layer.ListTimeSamplesForPath(spec.path)
    for time in times:
        layer.SetTimeSample(spec.path, time, layer.QueryTimeSample(spec.path, time) - 0.4)
    layer.Save()
    notes = remap(shot).notes
    (note,) = [note for note in notes if "solve below" in note]
    assert note.startswith("jawOpen 100-200: the solve below the edit changed by up to +0.")
    assert note.endswith("check the edit")


def test_edits_are_found_again_when_the_layer_to_open_was_deleted(shot: Shot) -> None:
    path = shot / "shot.hero.usda"
    edit(path, override=0.7, frames="100-110")
    path.unlink()
    remap(shot)
    np.testing.assert_allclose(curve(path, "jawOpen")[99:110], 0.7)


def test_a_place_that_changed_leaves_edits_behind_and_says_so(shot: Shot) -> None:
    edit(shot / "shot.hero.usda", override=0.7, frames="100-110")
    notes = remap(shot, prim="/shot/hero").notes
    assert any(
        "</character/FaceSolve> have no effect, as there is no animation" in note for note in notes
    )


def test_the_progress_of_a_bake_is_of_all_frames(shot: Shot, monkeypatch) -> None:
    monkeypatch.setattr(bake, "_BLOCK_FRAMES", 120)
    shares = list[float]()
    given = BakeSpec(performance=shot / "shot.hero.usda", out=shot / "published.usdc")
    bake.run(
        given,
        provenance=make_provenance(given),
        progress=lambda share, _: shares.append(share),
    )
    assert shares == [0.25, 0.5, 0.75, 1.0]


def test_the_residual_of_earlier_versions_is_not_baked(shot: Shot) -> None:
    """It was another quantity, and there was no coverage."""
    layer = Sdf.Layer.FindOrOpen(str(weights_path(shot / "shot.hero.usda")))
    animation = PerformanceReader(shot / "shot.hero.usda").animation.GetPath()
    solve = layer.GetPrimAtPath(animation)
    solve.RemoveProperty(solve.properties["face:coverage"])
    layer.Save()
    run(BakeSpec(performance=shot / "shot.hero.usda", out=shot / "baked.usdc"))
    baked = PerformanceReader(shot / "baked.usdc")
    assert baked.series("face:uncertainty", 1, 1) is not None
    assert baked.series("face:residual", 1, 1) is None


def test_what_is_baked_is_what_is_shown_to_any_reader_of_usdskel(shot: Shot) -> None:
    path, out = shot / "shot.hero.usda", shot / "published.usdc"
    edit(path, add=0.2, frames="100-200", fade=9)
    run(BakeSpec(performance=path, out=out))
    shown = read_performance(path)
    layer = Sdf.Layer.FindOrOpen(str(shot / "shot.hero.usda"))
    layer.subLayerPaths.insert(0, "./published.usdc")
    stage = Usd.Stage.Open(layer)
    animation = UsdSkel.Animation(stage.GetPrimAtPath("/character/FaceSolve"))
    for frame in (1, 95, 150, 480):
        told = np.array(animation.GetBlendShapeWeightsAttr().Get(frame))
        np.testing.assert_array_equal(told, shown.weights.values[frame - 1])
    assert validate(out) == [] or all(f.severity == "warning" for f in validate(out))
    layer.Reload(force=True)


@pytest.mark.parametrize(("unit", "tolerance"), [("weight", 0.02), ("mm", 0.3)])
def test_fewer_keys_stay_within_the_tolerance(shot: Shot, unit: str, tolerance: float) -> None:
    path, out = shot / "shot.hero.usda", shot / "keys.usdc"
    report = run(BakeSpec(performance=path, out=out, tolerance=tolerance, unit=unit))
    assert report.figures["keys"] < 0.6 * 480
    baked, shown = read_weights(out).values.astype(float), read_weights(path).values.astype(float)
    assert len(baked) == 480
    if unit == "weight":
        assert np.abs(baked - shown).max() <= tolerance + 1e-6
    else:
        rig = read_rig(shot / "hero.usdc")
        names = read_weights(path).names
        place = [names.index(name) for name in rig.shapes]
        deformer = Deformer(rig)
        for start in range(0, 480, 60):
            part = slice(start, start + 60)
            off = deformer.points(baked[part][:, place]) - deformer.points(shown[part][:, place])
            assert np.linalg.norm(off, axis=2).max() <= tolerance + 1e-4


def test_limiting_touches_edited_frames_only(shot: Shot) -> None:
    path, out = shot / "shot.hero.usda", shot / "limited.usdc"
    report = edit(path, override=1.4, frames="100-110")
    assert any("outside 0 to 1 at 11 frames" in note for note in report.notes)
    run(BakeSpec(performance=path, out=out, limit=True))
    np.testing.assert_array_equal(curve(out, "jawOpen")[99:110], 1.0)
    solved = PerformanceReader(path).solved()
    np.testing.assert_array_equal(read_weights(out).values[110:], solved[110:])


def test_samples_between_the_frames_of_a_shot_are_told_when_they_are_left_out(shot: Shot) -> None:
    path = shot / "shot.hero.usda"
    assert not run(BakeSpec(performance=path, out=shot / "whole.usdc")).notes
    slow = Sdf.Layer.FindOrOpen(str(shot_above(path)))
    slow.timeCodesPerSecond = slow.framesPerSecond = 24
    slow.Save()
    notes = run(BakeSpec(performance=Path(slow.realPath), out=shot / "few.usdc")).notes
    # 120 frames per second are labelled as 30, which 24 cannot count
    assert notes[0].startswith("the timecode of the capture has no labels at 24 frames per second")
    between = f"{FRAMES - FRAMES // 5} of {FRAMES} samples lie between the frames of"
    assert notes[1].startswith(between)
    assert PerformanceReader(shot / "few.usdc").timecode_start == ""
    slow.timeCodesPerSecond = slow.framesPerSecond = 30
    slow.Save()
    run(BakeSpec(performance=Path(slow.realPath), out=shot / "fewer.usdc"))
    assert PerformanceReader(shot / "fewer.usdc").timecode_start == "01:00:00:00"


def test_weights_beyond_their_range_that_come_back_are_told(shot: Shot) -> None:
    path = shot / "shot.hero.usda"
    (shot / "dcc.csv").write_text("frame,jawOpen\n10,1.2\n11,1.4\n", encoding="utf-8")
    notes = run(EditsImportSpec(performance=path, changed=shot / "dcc.csv")).notes
    assert any("jawOpen is outside 0 to 1 at 2 frames (1.20 to 1.40)" in note for note in notes)


def test_a_clearing_counts_the_frames_that_had_an_edit(shot: Shot) -> None:
    path = shot / "shot.hero.usda"
    edit(path, add=0.1, frames="100-120")
    assert edit(path, clear=True, frames="300-320").figures["frames"] == 0
    assert edit(path, clear=True, frames="115-320").figures["frames"] == 6


def test_an_animation_changed_in_another_tool_comes_back_as_edits(shot: Shot) -> None:
    path = shot / "shot.hero.usda"
    edit(path, override=0.9, frames="30-40")  # made before the export, so it is in the file
    run(BakeSpec(performance=path, out=shot / "dcc.usdc"))
    clip = read_weights(shot / "dcc.usdc")
    wanted = clip.values.copy()
    jaw, blink = clip.names.index("jawOpen"), clip.names.index("eyeBlinkLeft")
    wanted[200:240, jaw] += 0.15
    wanted[35, jaw] = 0.4  # over what was edited here
    wanted[300:310, blink] = 1.0
    with (shot / "dcc.csv").open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["frame", *clip.names, "someOtherShape"])
        writer.writerows([i + 1, *row, 0] for i, row in enumerate(wanted.tolist()) if i >= 20)
    report = run(EditsImportSpec(performance=path, changed=shot / "dcc.csv"))
    assert set(report.figures["shapes"]) == {"jawOpen", "eyeBlinkLeft"}
    assert "someOtherShape" in report.notes[0]
    np.testing.assert_allclose(read_weights(path).values, wanted, atol=1e-6)
    again = run(EditsImportSpec(performance=path, changed=shot / "dcc.csv"))
    np.testing.assert_allclose(read_weights(path).values, wanted, atol=1e-6)
    assert again.figures["frames"] == 0
    assert not again.outputs
    assert not any("mapped again" in note for note in report.notes)


def test_a_file_whose_time_is_shifted_is_refused(shot: Shot) -> None:
    path, dcc = shot / "shot.hero.usda", shot / "dcc.csv"
    clip = read_weights(path)
    changed = clip.values.copy()
    changed[200:240, clip.names.index("jawOpen")] += 0.15
    for later, fails in ((100, True), (0, False)):
        rows = [[later + i + 1, *row] for i, row in enumerate(changed.tolist())]
        with dcc.open("w", newline="") as stream:
            csv.writer(stream).writerows([["frame", *clip.names], *rows])
        if fails:
            with pytest.raises(InputError, match="from frame 101 instead of 1; export it from"):
                run(EditsImportSpec(performance=path, changed=dcc))
            assert not (shot / "shot.hero.edits.usda").exists()
        else:
            run(EditsImportSpec(performance=path, changed=dcc))
    np.testing.assert_allclose(read_weights(path).values, changed, atol=1e-6)


def test_changed_weights_in_percent_without_frame_numbers_come_back(shot: Shot) -> None:
    path = shot / "shot.hero.usda"
    clip = read_weights(path)
    wanted = clip.values.astype(np.float64)
    wanted[200:240, clip.names.index("jawOpen")] += 0.15
    changed = shot / "dcc.json"
    rows = (100 * wanted).tolist()
    changed.write_text(json.dumps({"names": clip.names, "weights": rows}), encoding="utf-8")
    with pytest.raises(InputError, match="--weight-unit percent"):
        run(EditsImportSpec(performance=path, changed=changed))
    report = run(EditsImportSpec(performance=path, changed=changed, weight_unit="percent"))
    assert report.figures == {"frames": 40, "shapes": ["jawOpen"]}
    assert "count from frame 1" in report.notes[0]
    np.testing.assert_allclose(read_weights(path).values, wanted, atol=1e-6)


def test_a_file_that_was_baked_from_another_solve_is_suspected_and_listed_in_short(
    shot: Shot, monkeypatch
) -> None:
    path, other = shot / "shot.hero.usda", shot / "other.csv"
    clip = read_weights(path)
    with other.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["frame", *clip.names])
        odd = np.arange(len(clip.values)) % 3 > 0
        rows = clip.values + 0.01 * odd[:, None]
        rows[250, clip.names.index("jawOpen")] += 0.5
        writer.writerows([i + 1, *row] for i, row in enumerate(rows.tolist()))
    report = run(EditsImportSpec(performance=path, changed=other))
    assert any("mapped again after it was baked" in note for note in report.notes)
    monkeypatch.setattr("usdface.steps.edits.list_._LISTED_RANGES", 5)
    listed = list_edits(path)
    assert len(listed.table) == 6
    assert any(line.startswith("jawOpen 251-252: +0.51") for line in listed.table)
    assert listed.table[-1].startswith(f"and {len(listed.figures['edits']) - 5} smaller ones")


def test_corrected_frames_become_tuned_pairs_and_fades_do_not(shot: Shot) -> None:
    path, out = shot / "shot.hero.usda", shot / "v2.references.usda"
    late = unpaired(shot, 300)
    edit(path, override=0.8, frames="100-102", fade=10)
    edit(path, "eyeBlinkLeft", override=1.0, frames=f"{late}-{late}", fade=3)
    before = read_references(shot / "hero.references.usda")
    report = run(
        ReferencesFromEditsSpec(
            performances=(path,), references=shot / "hero.references.usda", out=out, count=3
        )
    )
    after = read_references(out)
    new = set(report.figures["frames"])
    assert new <= {*range(97, 106), late}
    assert late in new
    count = len(before.frames)
    kept = ~np.isin(before.frames, [*range(97, 106), 300])  # one of these may be corrected
    np.testing.assert_array_equal(after.weights[:count][kept], before.weights[kept])
    np.testing.assert_array_equal(after.tuned[:count], before.tuned)
    assert after.tuned[count:].all()
    shown = read_weights(path)
    for pair in range(count, len(after.frames)):
        wanted = shown.values[after.frames[pair] - 1]
        order = [shown.names.index(name) for name in after.shape_names]
        np.testing.assert_allclose(after.weights[pair], wanted[order], atol=1e-6)
    np.testing.assert_allclose(after.neutral, before.neutral)
    run(TrainSpec(references=out, out=shot / "v2.mapping.usdc", method="ridge"))


def test_edits_of_a_shape_that_the_solve_has_no_more_teach_nothing(shot: Shot) -> None:
    path, references = shot / "shot.hero.usda", shot / "hero.references.usda"
    late = unpaired(shot, 300)
    edit(path, override=0.8, frames="100-120")
    edit(path, "eyeBlinkLeft", override=1.0, frames=f"{late}-{late}")
    file = edits_path(path)
    file.write_text(file.read_text(encoding="utf-8").replace("jawOpen", "gone"), encoding="utf-8")
    given = {"performances": (path,), "references": references, "out": shot / "v2.references.usda"}
    assert run(ReferencesFromEditsSpec.model_validate(given)).figures["frames"] == [late]


def test_curves_of_a_dcc_that_peak_at_different_frames_teach_where_they_are_strongest(
    shot: Shot,
) -> None:
    path, dcc = shot / "shot.hero.usda", shot / "dcc.csv"
    clip = read_weights(path)
    wanted = clip.values.copy()
    time = np.arange(200, 240)
    for name, peak in (("jawOpen", 213), ("mouthSmileLeft", 226)):  # neither holds anywhere
        wanted[time, clip.names.index(name)] += 0.4 * np.exp(-(((time - peak) / 9.0) ** 2))
    wanted[:, clip.names.index("browInnerUp")] += 0.03 * np.sin(np.arange(len(wanted)) / 3)
    with dcc.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["frame", *clip.names])
        writer.writerows([i + 1, *row] for i, row in enumerate(wanted.tolist()))
    run(EditsImportSpec(performance=path, changed=dcc))
    report = run(
        ReferencesFromEditsSpec(
            performances=(path,),
            references=shot / "hero.references.usda",
            out=shot / "v2.references.usda",
            count=4,
        )
    )
    taken = np.array(report.figures["frames"])
    assert len(taken) == 4
    change = np.abs(wanted - clip.values).max(axis=1)
    assert change[taken - 1].max() > 0.99 * change.max()


def test_edits_teach_references_of_another_head_space_in_that_space(shot: Shot) -> None:
    other, known = shot / "other.references.usda", read_references(shot / "hero.references.usda")
    turn = Rotation.from_rotvec([0.1, -0.2, 0.05]).as_matrix()

    def moved(positions: np.ndarray) -> np.ndarray:
        return positions @ turn.T + 30.0

    there = {"markers": moved(known.markers), "neutral": moved(known.neutral), "motion": None}
    elsewhere = replace(known, **there)
    rig = read_rig(shot / "hero.usdc")
    write_references(other, elsewhere, rig, provenance=Provenance("select"))
    edit(shot / "shot.hero.usda", override=0.8, frames="100-102")
    given = {"references": other, "out": shot / "v2.usda"}
    run(ReferencesFromEditsSpec(performances=(shot / "shot.hero.usda",), **given))
    after, here = read_references(shot / "v2.usda"), [100, 101, 102]
    pairs = [after.frames.tolist().index(frame) for frame in here]
    seen = TakeReader(shot / "shot.clean.take.usda").read_markers_at(here)
    order = [seen.names.index(name) for name in after.marker_names]
    np.testing.assert_allclose(after.markers[pairs], moved(seen.positions[:, order]), atol=0.05)


def test_edits_in_a_shot_teach_at_the_frames_of_the_take_that_it_plays(shot: Shot) -> None:
    moved = 40
    cut, flat = shot / "cut.usda", shot / "flat.usda"
    performance = Sdf.Layer.FindOrOpen(str(shot / "shot.hero.usda"))
    layer = Sdf.Layer.CreateNew(str(cut))
    layer.timeCodesPerSecond = layer.framesPerSecond = performance.timeCodesPerSecond
    placed = Sdf.CreatePrimInLayer(layer, "/cast/actor")
    top, offset = performance.rootPrims[0].path, Sdf.LayerOffset(moved)
    placed.referenceList.prependedItems = [Sdf.Reference("./shot.hero.usda", top, offset)]
    placed.specifier = placed.nameParent.specifier = Sdf.SpecifierDef
    layer.defaultPrim = "cast"
    layer.Save()
    edit(cut, override=0.8, frames=f"{100 + moved}-{102 + moved}", fade=3)
    edit(shot / "shot.hero.usda", override=0.8, frames="100-102", fade=3)

    def learn(path: Path, take: tuple[Path, ...] = ()) -> tuple[set[int], References]:
        given = {"references": shot / "hero.references.usda", "take": take}
        out = path.with_suffix(".references.usda")
        spec = ReferencesFromEditsSpec(performances=(path,), out=out, **given)
        return set(run(spec).figures["frames"]), read_references(out)

    frames, taught = learn(cut)
    wanted_frames, wanted = learn(shot / "shot.hero.usda")
    assert frames == wanted_frames
    np.testing.assert_array_equal(taught.markers, wanted.markers)
    made = provenance_of(shot / "cut.references.usda")
    assert "shot.clean.take.usda" in made.inputs
    flattened = Usd.Stage.Open(str(cut)).Flatten()
    flattened.customLayerData = {}
    flattened.Export(str(flat))
    with pytest.raises(InputError, match=r"does not name the take .* give --take,"):
        learn(flat)
    again = shot / "again" / "shot.clean.take.usda"
    again.parent.mkdir()
    slow = read_first_frame(shot / "shot.clean.take.usda")
    write_take(again, replace(slow, rate=slow.rate / 2), provenance=Provenance())
    with pytest.raises(InputError, match=r"runs at 60 frames per second, .*shot\.hero.* at 120"):
        learn(cut, (again,))
    with pytest.raises(InputError, match=r"moves its weights by \+40 frames"):
        run(
            ReferencesAddSpec(
                performance=cut,
                references=shot / "hero.references.usda",
                out=shot / "more.references.usda",
                frames="100",
            )
        )


def test_where_no_frame_has_all_edits_at_their_peaks_those_nearest_are_meant() -> None:
    rising = np.interp(np.arange(120), [0, 10, 100, 119], [0.01, 0.4, 1.0, 0.01])
    edits = [no_edit(120), no_edit(120)]
    edits[0].offset[:], edits[1].offset[:] = rising, rising[::-1]
    changes = np.array([each.offset for each in edits])
    mean = (changes**2).sum(axis=0) / changes.sum(axis=0)
    wanted = (mean > EDITED_SHARE) & (changes.max(axis=0) > LEAST_CHANGE)
    assert 0 < wanted.sum() < 120
    np.testing.assert_array_equal(full_strength_frames(edits, changes), wanted)
    edits[1].offset[80:111] = 1.0  # held, so that there are frames with both at full strength
    changes = np.array([each.offset for each in edits])
    both = (changes >= FULL_STRENGTH).all(axis=0)
    assert both.any()
    np.testing.assert_array_equal(full_strength_frames(edits, changes), both)


def name_author(asset: Path, pairs: list[int], author: str, **weights: float) -> None:
    """Store tuned weights of pairs, changed by `weights`, with their author."""
    old = read_references(asset)
    tuned = [
        TunedPair(
            pair,
            old.takes[pair],
            int(old.frames[pair]),
            old.weights_of(pair) | weights,
            author=author,
        )
        for pair in pairs
    ]
    write_tuned_weights(old, tuned, layer_path=tuned_path(asset), provenance=Provenance())


def test_keys_that_edits_replace_are_no_longer_of_their_author(shot: Shot) -> None:
    asset, out = shot / "hero.references.usda", shot / "v2.references.usda"
    frames = read_references(asset).frames.tolist()
    name_author(asset, list(range(len(frames))), "Kim")
    edit(shot / "shot.hero.usda", override=0.8, frames=f"{frames[2]}-{frames[2]}")
    spec = ReferencesFromEditsSpec(
        performances=(shot / "shot.hero.usda",), references=asset, out=out
    )
    run(spec)
    authors = read_references(out).authors
    assert [pair for pair, author in enumerate(authors) if author != "Kim"] == [2]
    name_author(out, [4], "Lee", jawOpen=0.3)
    run(spec)
    assert read_references(out).authors[4] == "Lee"


def test_corrections_taken_in_place_twice_are_the_same_as_once(shot: Shot) -> None:
    path, out = shot / "shot.hero.usda", shot / "hero.references.usda"
    edit(path, override=0.8, frames="100-102", fade=10)
    first = run(ReferencesFromEditsSpec(performances=(path,), references=out, out=out, count=3))
    once = read_references(out)
    again = run(ReferencesFromEditsSpec(performances=(path,), references=out, out=out, count=3))
    twice = read_references(out)
    assert first.figures["added"] > again.figures["added"] == 0
    np.testing.assert_array_equal(twice.weights, once.weights)
    np.testing.assert_array_equal(twice.tuned, once.tuned)


def test_fewer_corrections_than_before_replace_them_and_say_so(shot: Shot) -> None:
    path, out = shot / "shot.hero.usda", shot / "v2.references.usda"
    edit(path, override=0.8, frames="100-160", fade=3)
    count = len(read_references(shot / "hero.references.usda").frames)
    reports = [
        run(
            ReferencesFromEditsSpec(
                performances=(path,),
                references=shot / "hero.references.usda",
                out=out,
                count=most,
            )
        )
        for most in (6, 2)
    ]
    gone = set(reports[0].figures["frames"]) - set(reports[1].figures["frames"])
    assert any(f"{len(gone)} pairs tuned there before" in note for note in reports[1].notes)
    after = read_references(out)
    assert list(after.frames[count:]) == reports[1].figures["frames"]
    assert after.tuned[count:].all()


def test_what_was_tuned_in_the_asset_that_is_written_again_stays(shot: Shot) -> None:
    path, out = shot / "shot.hero.usda", shot / "v2.references.usda"
    given = {
        "performances": (path,),
        "references": shot / "hero.references.usda",
        "out": out,
        "count": 3,
    }
    late = unpaired(shot, 300)
    edit(path, override=0.8, frames=f"{late}-{late}")
    run(ReferencesFromEditsSpec(**given))
    made = read_references(out)
    (shot / "mine.csv").write_text(f"frame,jawOpen\n{made.frames[4]},0.125\n{late},0.125\n")
    execute(ReferencesImportSpec(references=out, weights=shot / "mine.csv"), overwrite=True)
    before = read_references(out)
    other = next(frame for frame in range(100, 200) if frame not in before.frames)
    edit(path, override=0.9, frames=f"{other}-{other}")  # late is the second that is added
    for _ in range(2):
        report = run(ReferencesFromEditsSpec(**given))
        after = read_references(out)
        assert after.frames[-2:].tolist() == [other, late]
        np.testing.assert_array_equal(after.weights[4], before.weights[4])
        np.testing.assert_array_equal(after.weights[-1], before.weights[-1])
        assert any("kept as tuned there: 2 pairs" in note for note in report.notes)


def test_corrections_whose_markers_are_not_seen_teach_nothing_and_stop_no_other(shot: Shot) -> None:
    path, out = shot / "shot.hero.usda", shot / "v2.references.usda"
    edit(path, override=0.8, frames="100-102", fade=3)
    clean = shot / "shot.clean.take.usda"
    take = read_take(clean)
    assert take.markers is not None
    visible, confidence = take.markers.visible.copy(), take.markers.confidence.copy()
    few = len(take.markers.names) // 8
    free = [name not in take.markers.rigid for name in take.markers.names].index(True)
    lost = np.s_[90:110, free : free + few]
    visible[lost], confidence[lost] = False, 0.0
    markers = replace(take.markers, visible=visible, confidence=confidence)
    write_take(clean, replace(take, markers=markers), provenance=Provenance())
    given = {"references": shot / "hero.references.usda", "out": out}
    with pytest.raises(InputError, match=r"tenth of the markers: 5 edited frames; choose other"):
        run(ReferencesFromEditsSpec(performances=(path,), **given))
    shutil.copy(path, shot / "other.usda")
    shutil.copy(edits_path(path), edits_path(shot / "other.usda"))
    late = unpaired(shot, 300)
    edit(shot / "other.usda", "eyeBlinkLeft", override=1.0, frames=f"{late}-{late}")
    report = run(ReferencesFromEditsSpec(performances=(path, shot / "other.usda"), **given))
    assert report.figures["frames"] == [late]
    assert sum("missing more than a tenth" in note for note in report.notes) == 2


def test_a_pair_that_is_added_has_the_prediction_of_a_marker_that_was_lost(shot: Shot) -> None:
    clean, frame = shot / "shot.clean.take.usda", unpaired(shot, 300)
    take = read_take(clean)
    assert take.markers is not None
    row = frame - take.first_frame
    moved = np.linalg.norm(
        take.markers.positions[row] - read_references(shot / "hero.references.usda").neutral, axis=1
    )
    marker = int(moved.argmax())
    visible, confidence = take.markers.visible.copy(), take.markers.confidence.copy()
    positions = take.markers.positions.copy()
    lost = np.s_[row - 20 : row + 20, marker]
    visible[lost], confidence[lost], positions[lost] = False, 0.0, 0.0
    markers = replace(take.markers, visible=visible, confidence=confidence, positions=positions)
    write_take(clean, replace(take, markers=markers), provenance=Provenance())
    out = shot / "more.references.usda"
    given = {"performance": shot / "shot.hero.usda", "references": shot / "hero.references.usda"}
    run(ReferencesAddSpec(**given, frames=str(frame), out=out))
    away = read_references(out).markers[-1, marker] - take.markers.positions[row, marker]
    assert np.linalg.norm(away) < 0.25 * moved[marker]


def test_pairs_have_the_motion_about_their_frames(shot: Shot) -> None:
    out, frame = shot / "more.references.usda", unpaired(shot, 300)
    given = {"performance": shot / "shot.hero.usda", "references": shot / "hero.references.usda"}
    run(ReferencesAddSpec(**given, frames=str(frame), out=out))
    after, take = read_references(out), read_take(shot / "shot.clean.take.usda")
    assert take.markers is not None
    assert after.trajectories is not None
    clip = take.markers.positions[:, [take.markers.names.index(n) for n in after.marker_names]]
    before = read_references(given["references"]).trajectories
    np.testing.assert_array_equal(after.trajectories[:-1], before)
    for pair in (0, -1):  # selected, and added
        row = int(after.frames[pair]) - take.first_frame
        at = np.clip(row + float(take.rate) * TRAJECTORY_SECONDS, 0, len(clip) - 1)
        low, high = np.floor(at).astype(int), np.ceil(at).astype(int)
        moved = clip[low] + (at - low)[:, None, None] * (clip[high] - clip[low]) - clip[row]
        np.testing.assert_allclose(after.trajectories[pair], moved, atol=2e-4)


def test_what_is_said_in_old_pairs_is_not_said_in_new_ones(shot: Shot) -> None:
    path, asset = shot / "shot.hero.usda", shot / "hero.references.usda"
    layer = Sdf.Layer.FindOrOpen(str(asset))
    for name in ("viseme", "emotion"):
        root = layer.GetPrimAtPath("/References")
        label = Sdf.AttributeSpec(root, f"face:reference:{name}", Sdf.ValueTypeNames.Token)
        for time in range(1, 25):
            layer.SetTimeSample(label.path, time, name)
    layer.Save()
    edit(path, override=0.8, frames="301-301")
    run(ReferencesFromEditsSpec(performances=(path,), references=asset, out=shot / "v2.usda"))
    after = read_references(shot / "v2.usda")
    assert after.visemes == ("viseme",) * 24 + ("",)
    assert after.emotions == ("emotion",) * 24 + ("",)


def test_of_a_frame_corrected_twice_the_later_performance_counts(shot: Shot) -> None:
    path, other, out = shot / "shot.hero.usda", shot / "other.usda", shot / "v2.usda"
    edit(path, override=0.8, frames="301-301")
    shutil.copy(path, other)
    shutil.copy(edits_path(path), edits_path(other))
    edit(other, override=0.3, frames="301-301")
    asset = shot / "hero.references.usda"
    run(ReferencesFromEditsSpec(performances=(path, other), references=asset, out=out))
    after = read_references(out)
    assert after.frames[24:].tolist() == [301]
    assert after.weights[24, after.shape_names.index("jawOpen")] == pytest.approx(0.3)


def test_edits_of_a_shape_that_the_solve_has_no_more_can_be_cleared(shot: Shot) -> None:
    path = shot / "shot.hero.usda"
    edit(path, override=0.8, frames="100-120")
    file = edits_path(path)
    file.write_text(file.read_text(encoding="utf-8").replace("jawOpen", "gone"), encoding="utf-8")
    edit(path, "gone", clear=True, frames="100-110")
    assert PerformanceReader(path).edits["gone"].curve.active.sum() == 10
    edit(path, "gone", clear=True)
    assert "gone" not in PerformanceReader(path).edits


def test_a_package_needs_nothing_beside_it(shot: Shot, tmp_path: Path) -> None:
    path = shot / "shot.hero.usda"
    edit(path, override=0.8, frames="100-102")
    run(PackageSpec(performance=path, out=shot / "review.usdz"))
    made = (shot / "review.usdz").read_bytes()
    os.utime(shot / "hero.usdc", (1e9, 1e9))
    run(PackageSpec(performance=path, out=shot / "review.usdz"))
    assert (shot / "review.usdz").read_bytes() == made  # whenever it is made, and of whatever age
    alone = tmp_path / "elsewhere" / "review.usdz"
    alone.parent.mkdir()
    (shot / "review.usdz").rename(alone)
    np.testing.assert_array_equal(read_weights(alone).values, read_weights(path).values)

    stage = Usd.Stage.Open(str(alone))
    assert [each for each in stage.Traverse() if each.IsA(UsdSkel.Root)]
    assert not [f for f in validate(alone) if f.severity == "error"]


def test_a_package_is_a_source_of_retargeting_and_is_traced(shot: Shot) -> None:
    path, package, out = (shot / name for name in ("shot.hero.usda", "p.usdz", "again.usda"))
    execute(PackageSpec(performance=path, out=package))
    spec = RetargetSpec(source=package, rig=(shot / "hero.usdc",), out=(out,))
    execute(spec)
    np.testing.assert_allclose(read_weights(out).values, read_weights(path).values, atol=1e-6)
    made = provenance_of(out)
    assert made is not None
    assert set(made.inputs) == {"p.usdz", "hero.usdc"}
    assert execute(spec).up_to_date
    edit(path, override=0.8, frames="100-102")
    execute(PackageSpec(performance=path, out=package), overwrite=True)
    assert not execute(spec).up_to_date


def test_a_texture_that_changes_makes_a_package_out_of_date_and_no_solve(shot: Shot) -> None:
    skin = shot / "skin.png"
    skin.write_bytes(b"pink")
    rig = Sdf.Layer.FindOrOpen(str(shot / "hero.usdc"))
    prim = Sdf.CreatePrimInLayer(rig, "/character/skin")
    attribute = Sdf.AttributeSpec(prim, "inputs:file", Sdf.ValueTypeNames.Asset)
    attribute.default = Sdf.AssetPath("./skin.png")
    rig.Save()
    del prim, attribute, rig
    package = PackageSpec(performance=shot / "shot.hero.usda", out=shot / "review.usdz")
    bake = BakeSpec(performance=shot / "shot.hero.usda", out=shot / "baked.usdc")
    before = [make_provenance(spec).inputs for spec in (package, bake)]
    skin.write_bytes(b"blue")
    after = [make_provenance(spec).inputs for spec in (package, bake)]
    assert [old == new for old, new in zip(before, after, strict=True)] == [False, True]


def test_a_layer_that_an_expression_of_another_layer_reaches_is_hashed(tmp_path: Path) -> None:
    top = '#usda 1.0\n(\n    expressionVariables = {{\n        string X = "{}"\n    }}\n)\n{}'
    (tmp_path / "sub.usda").write_text(
        top.format("./none.usda", 'def "A" (\n    references = @`"${X}"`@</A>\n)\n{\n}\n')
    )
    (tmp_path / "top.usda").write_text(
        top.format("./inner.usda", 'def "A" (\n    references = @sub.usda@</A>\n)\n{\n}\n')
    )
    spec = BakeSpec(performance=tmp_path / "top.usda", out=tmp_path / "b.usdc")
    inputs = []
    for value in (1, 2):
        (tmp_path / "inner.usda").write_text(f'#usda 1.0\ndef "A" {{\n    double x = {value}\n}}\n')
        inputs.append(make_provenance(spec).inputs)
    assert inputs[0] != inputs[1]


@pytest.mark.parametrize("harm", ["cut", "flip", "empty"])
def test_a_package_that_was_not_written_whole_is_refused_and_the_old_one_stays(
    shot: Shot, harm: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    spec = PackageSpec(performance=shot / "shot.hero.usda", out=shot / "review.usdz")
    run(spec)
    old = spec.out.read_bytes()
    pack = write.UsdUtils.CreateNewUsdzPackage

    def fail(source: str, target: str) -> bool:
        assert pack(source, target)
        data = Path(target).read_bytes()
        middle = len(data) // 2
        flipped = data[:middle] + bytes([data[middle] ^ 1]) + data[middle + 1 :]
        Path(target).write_bytes({"cut": data[:middle], "flip": flipped, "empty": b""}[harm])
        return True  # as USD says where a write failed

    monkeypatch.setattr(write.UsdUtils, "CreateNewUsdzPackage", fail)
    with pytest.raises(InputError, match="could not write the package whole"):
        run(spec)
    assert spec.out.read_bytes() == old
    assert not list(shot.folder.glob(".*"))


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"shape": ("jawOpne",), "add": 0.1}, "did you mean jawOpen"),
        (
            {"shape": ("jawOpen",), "add": 0.1, "frames": "900-1000"},
            "outside the performance, 1-480",
        ),
        ({"shape": ("jawOpen; rm -rf ~",), "add": 0.1}, "has no shape 'jawOpen; rm -rf ~'"),
    ],
)
def test_an_edit_that_cannot_be_made_is_refused(shot: Shot, change: dict, reason: str) -> None:
    before = sorted(each.name for each in shot.folder.iterdir())
    with pytest.raises(InputError, match=reason):
        run(EditSpec(performance=shot / "shot.hero.usda", **change))
    assert sorted(each.name for each in shot.folder.iterdir()) == before


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({}, "one of --add, --override and --clear"),
        ({"add": 0.1, "clear": True}, "one of --add"),
        ({"add": float("nan")}, "finite"),
        ({"add": 0.1, "fade": 4}, "fade needs --frames"),
        ({"add": 0.1, "frames": "9-3"}, "precedes"),
    ],
)
def test_an_edit_that_means_nothing_is_refused(change: dict, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        EditSpec(performance=Path("a.usda"), shape=("jawOpen",), **change)


def test_a_rig_that_moved_since_is_named(shot: Shot) -> None:
    (shot / "hero.usdc").rename(shot / "elsewhere.usdc")
    with pytest.raises(InputError, match=r"hero\.usdc|rig's file still where it was"):
        run(BakeSpec(performance=shot / "shot.hero.usda", out=shot / "x.usdc"))


def test_a_take_that_lacks_many_markers_of_the_references_asks_for_another_selection(
    shot: Shot,
) -> None:
    """No frame of it has enough markers, so that other frames would be refused as well."""
    path, clean = shot / "shot.hero.usda", shot / "shot.clean.take.usda"
    take = read_take(clean)
    assert take.markers is not None
    gone = [name not in take.markers.rigid for name in take.markers.names].index(True)
    kept = np.ones(len(take.markers.names), bool)
    kept[gone : gone + len(kept) // 8] = False
    markers = replace(
        take.markers,
        names=tuple(np.array(take.markers.names)[kept].tolist()),
        positions=take.markers.positions[:, kept],
        visible=take.markers.visible[:, kept],
        confidence=take.markers.confidence[:, kept],
    )
    write_take(clean, replace(take, markers=markers), provenance=Provenance())
    edit(path, override=0.8, frames="100-102", fade=3)
    given = {"references": shot / "hero.references.usda", "out": shot / "v2.references.usda"}
    advice = f"has no {take.markers.names[gone]}.*: `usdface select` from it and their takes"
    with pytest.raises(InputError, match=advice):
        run(ReferencesFromEditsSpec(performances=(path,), **given))
    late = str(unpaired(shot, 300))
    with pytest.raises(InputError, match=advice):
        run(ReferencesAddSpec(performance=path, frames=late, **given))
