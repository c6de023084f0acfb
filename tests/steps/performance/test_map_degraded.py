"""Shots mapped although something is not as it was in training."""

from dataclasses import replace

import numpy as np
import pytest
from pxr import Sdf, Vt

from tests.model.placement.test_rig_orientation import transformed
from tests.steps.small_shot import Shot, coarse_rig
from usdface.core.assets import Rig
from usdface.core.errors import InputError
from usdface.model.mapping.head_space import MINIMUM_SHARE
from usdface.runner.execute import execute
from usdface.runner.result import StepResult
from usdface.specs.performance import MapSpec
from usdface.usdio.performance.read import read_performance
from usdface.usdio.rig.write import write_rig


def mapped(shot: Shot, *, rig: str = "hero.usdc") -> StepResult:
    return execute(
        MapSpec(
            take=shot / "shot.clean.take.usda",
            mapping=shot / "hero.mapping.usdc",
            rig=shot / rig,
            out=shot / "new.hero.usda",
        )
    )


def with_jaw(rig: Rig, factor: float) -> Rig:
    """Sculpt the jaw's opening again, under its old name."""

    def sculpted(mesh):
        return tuple(
            replace(
                shape,
                keys=tuple(replace(key, offsets=factor * key.offsets) for key in shape.keys),
            )
            if shape.name == "jawOpen"
            else shape
            for shape in mesh.shapes
        )

    return replace(rig, meshes=tuple(replace(mesh, shapes=sculpted(mesh)) for mesh in rig.meshes))


def test_a_shape_sculpted_again_since_training_is_noted_and_mapped(shot: Shot) -> None:
    before = mapped(shot)
    assert not [note for note in before.notes if "since training" in note]
    write_rig(shot / "other.usdc", with_jaw(coarse_rig(), 1.2))
    (shot / "new.hero.usda").unlink()
    (note,) = [note for note in mapped(shot, rig="other.usdc").notes if "since training" in note]
    assert "1 of the mapping's" in note
    assert "jawOpen (moves" in note


def test_a_rig_that_lies_is_refused(shot: Shot) -> None:
    rig = coarse_rig()
    turn = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    write_rig(shot / "lying.usdc", transformed(rig, turn))
    with pytest.raises(InputError, match="the head lies"):
        mapped(shot, rig="lying.usdc")


def test_a_rig_with_other_points_is_refused(shot: Shot) -> None:
    rig = coarse_rig()
    face = max(range(len(rig.meshes)), key=lambda index: len(rig.meshes[index].shapes))
    points = np.r_[rig.meshes[face].points, [[0.0, 0.0, 0.0]]]
    meshes = tuple(
        replace(mesh, points=points, normals=None, colors=None) if index == face else mesh
        for index, mesh in enumerate(rig.meshes)
    )
    write_rig(shot / "other.usdc", replace(rig, meshes=meshes))
    with pytest.raises(InputError, match=r"points, .* when the mapping was trained.*train again"):
        mapped(shot, rig="other.usdc")
    assert not (shot / "new.hero.usda").exists()


def hide(shot: Shot, frames: range, share: float) -> None:
    """Leave no more than a share of the markers in some frames of the cleaned take."""
    layer = Sdf.Layer.FindOrOpen(str(shot / "shot.clean.take.samples.usdc"))
    seen, trusted = (f"/Take/Markers.primvars:face:{name}" for name in ("visible", "confidence"))
    count = len(layer.QueryTimeSample("/Take/Markers.points", frames[0]))
    kept = np.arange(count) < share * count
    for edge in (frames.start - 1, frames.stop):  # held between samples: both sides are told
        for path in (seen, trusted):
            before = max(time for time in layer.ListTimeSamplesForPath(path) if time <= edge)
            layer.SetTimeSample(path, edge, layer.QueryTimeSample(path, before))
    for frame in frames:
        layer.SetTimeSample(seen, frame, Vt.BoolArray.FromNumpy(kept))
        layer.SetTimeSample(trusted, frame, Vt.FloatArray.FromNumpy(kept.astype(np.float32)))
    layer.Save()


def test_frames_that_lack_too_many_markers_are_counted_and_not_trusted(shot: Shot) -> None:
    hide(shot, range(101, 104), MINIMUM_SHARE - 0.05)
    hide(shot, range(201, 203), MINIMUM_SHARE + 0.05)
    (note,) = [note for note in mapped(shot).notes if "fewer than" in note]
    assert note.startswith("fewer than 50% of the mapping's markers in 3 frames (101, 102, 103)")
    performance = read_performance(shot / "new.hero.usda")
    uncertainty = performance.uncertainty_mm
    assert uncertainty is not None
    face = uncertainty[:, 0]
    assert face[100:103].min() > 3 * np.median(face)
    assert np.isfinite(performance.weights.values).all()
