"""A rig's logic on disk, and what is written and seen of it, against USD's own baking."""

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdSkel

from tests.tuning.small_asset import small_references
from tests.usdio.driven_rig import COMBINATIONS, driven_rig
from tests.usdio.posed_points import PosedRig
from usdface.core.assets import Rig
from usdface.core.deformer import Deformer
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.core.sidecars import tuned_path
from usdface.numerics.motion.key_reduction import EditCurve
from usdface.usdio.performance.edits import ShapeEdit, write_edits
from usdface.usdio.performance.read import PerformanceReader
from usdface.usdio.performance.weights_layer import make_header
from usdface.usdio.performance.write import writing_performance
from usdface.usdio.references.read import read_references
from usdface.usdio.references.weight_layers import TunedPair, read_tuned_pairs
from usdface.usdio.references.write import write_references, write_tuned_weights
from usdface.usdio.rig.read import read_rig
from usdface.usdio.rig.write import write_rig


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    write_rig(tmp_path / "rig.usda", driven_rig())
    return read_rig(tmp_path / "rig.usda")


@pytest.fixture
def weights() -> np.ndarray:
    return np.random.default_rng(2).uniform(0, 1, (6, 3))


@pytest.fixture
def performance(tmp_path: Path, rig: Rig, weights: np.ndarray) -> Path:
    path = tmp_path / "p.usda"
    header = make_header(
        rig, shape_names=rig.shapes, rate=Fraction(30), first_frame=1, last_frame=6
    )
    with writing_performance(path, header, rig) as writer:
        writer.append(weights)
    return path


def test_logic_is_read_back_and_its_shapes_are_not_animated(rig: Rig) -> None:
    assert rig.combinations == tuple(
        replace(each, weights=each.part_weights) for each in COMBINATIONS
    )
    assert rig.shapes == ("jawOpen", "eyeBlink", "smile")
    assert (
        not Usd.Stage.Open(str(rig.file))
        .GetPrimAtPath("/Hero/geo/skin/jaw_smile")
        .GetAttribute("face:combination:shapes")
        .IsCustom()
    )


def test_what_is_written_poses_the_face_in_usd_as_here(
    rig: Rig, weights: np.ndarray, performance: Path
) -> None:
    posed, deformer = PosedRig(performance), Deformer(rig)
    for frame in (1, 4, 6):
        expected = deformer.points(weights[[frame - 1]])[0]
        np.testing.assert_allclose(posed.points(frame), expected, atol=1e-3)
    assert PerformanceReader(performance).names == (*rig.shapes, "jaw_smile", "smile50", "all")


def test_the_metric_is_the_mean_over_poses(rig: Rig, weights: np.ndarray) -> None:
    deformer, error = Deformer(rig), np.array([0, 0, 3e-5])  # the others bend
    moved = [deformer.points(row[None] + error) - deformer.points(row[None]) for row in weights]
    expected = np.mean([(each**2).sum(axis=2).mean() for each in moved])
    found = error @ deformer.shapes.gram(weights) @ error
    np.testing.assert_allclose(found, expected, rtol=0.02)


def test_what_is_driven_follows_edits_and_may_be_edited_on_top(
    rig: Rig, weights: np.ndarray, performance: Path
) -> None:
    reader = PerformanceReader(performance)
    nothing = np.zeros(6)
    edits = {
        name: ShapeEdit(EditCurve(np.full(6, by), nothing, nothing), np.full(6, np.nan))
        for name, by in (("jawOpen", -0.1), ("jaw_smile", 0.05))
    }
    write_edits(performance, reader.animation, edits, reader.frames, provenance=Provenance())
    edited = PerformanceReader(performance).edited()
    moved = weights - [0.1, 0, 0]
    expected = rig.logic.evaluate(moved)
    expected[:, reader.names.index("jaw_smile")] += 0.05
    np.testing.assert_allclose(edited, expected, atol=1e-6)


def test_references_hold_what_is_driven_and_do_not_teach_it(tmp_path: Path, rig: Rig) -> None:
    references = replace(small_references(tmp_path), combinations=rig.combinations)
    path = tmp_path / "hero.references.usda"
    write_references(path, references, rig, provenance=Provenance())
    read = read_references(path)
    assert read.shape_names == references.shape_names
    assert read.combinations == rig.combinations
    pair = TunedPair(1, read.takes[1], int(read.frames[1]), {"jawOpen": 0.7, "smile": 0.5})
    write_tuned_weights(read, [pair], layer_path=tuned_path(path), provenance=Provenance())
    stage = Usd.Stage.Open(str(path))
    animation = UsdSkel.Animation.Get(stage, "/References/Weights")
    names = list(animation.GetBlendShapesAttr().Get())
    row = np.array(animation.GetBlendShapeWeightsAttr().Get(2))
    np.testing.assert_allclose(row[names.index("jaw_smile")], 0.35, atol=1e-6)
    np.testing.assert_allclose(row[names.index("smile50")], 1.0, atol=1e-6)
    assert read_tuned_pairs(tuned_path(path))[0].weights["jawOpen"] == pytest.approx(0.7)
    np.testing.assert_allclose(read_references(path).weights[1][[0, 2]], [0.7, 0.5], atol=1e-6)


def test_two_meshes_that_state_it_differently_are_refused(tmp_path: Path, rig: Rig) -> None:
    stage = Usd.Stage.Open(str(rig.file))
    shape = stage.GetPrimAtPath("/Hero/geo/skin/jawOpen")
    shape.CreateAttribute("face:combination:shapes", Sdf.ValueTypeNames.TokenArray).Set(["smile"])
    shape = stage.GetPrimAtPath("/Hero/geo/teeth/jawOpen")
    shape.CreateAttribute("face:combination:shapes", Sdf.ValueTypeNames.TokenArray).Set(["all"])
    stage.GetRootLayer().Export(str(tmp_path / "odd.usda"))
    with pytest.raises(InputError, match="states jawOpen = all, another mesh jawOpen = smile"):
        read_rig(tmp_path / "odd.usda")
