"""Shapes with negative weights: as accurate as one shape for each side."""

from dataclasses import replace

import numpy as np
import pytest

from tests.model.synthetic import SyntheticFace, references_of, sample_skin, synthetic_face
from usdface.core.assets import References, TrainedMapping
from usdface.core.rig_logic import Combination, CombinationMode, RigLogic
from usdface.model.mapping.predict import WeightPredictor
from usdface.model.mapping.train import train_mapping
from usdface.model.regressions.shape_sides import JOINED_OUTPUTS, ShapeSides

pytestmark = pytest.mark.usefixtures("without_comparison")

RANGES = np.array([[0.0, 1.0], [-1.0, 1.0], [-0.5, 0.0], [-2.0, 1.0]])


def test_weights_come_back_from_their_sides() -> None:
    sides = ShapeSides.divided(RANGES)
    assert sides.shapes.tolist() == [0, 1, 2, 3, 1, 3]
    np.testing.assert_array_equal(sides.ranges[:, 0], 0)
    np.testing.assert_array_equal(sides.ranges[:, 1], [1, 1, 0.5, 1, 1, 2])
    weights = np.random.default_rng(0).uniform(*RANGES.T, size=(50, 4))
    columns = sides.split(weights)
    assert (columns >= 0).all()
    np.testing.assert_allclose(sides.join(columns), weights)
    # Both describe the same surface.
    skin = np.random.default_rng(1).standard_normal((4, 7, 3))
    moved = np.einsum("ns,spc->npc", weights, skin)
    np.testing.assert_allclose(np.einsum("nk,kpc->npc", columns, sides.motion(skin)), moved)
    gram = np.einsum("spc,tpc->st", skin, skin)
    np.testing.assert_allclose(
        np.einsum("nk,kl,nl->n", columns, sides.gram(gram), columns), (moved**2).sum(axis=(1, 2))
    )


def turning() -> SyntheticFace:
    """A face whose second shape is the opposite of its first, and moves when that does not."""
    face = synthetic_face()
    shapes, turn = face.shapes.copy(), face.weights[:, 0] - face.weights[:, 1]
    shapes[1] = -shapes[0]
    weights = face.weights.copy()
    weights[:, 0], weights[:, 1] = np.maximum(turn, 0), np.maximum(-turn, 0)
    bent = weights + 0.3 * weights * (1 - weights)
    noise = 0.02 * np.random.default_rng(5).standard_normal(face.positions.shape)
    return replace(
        face,
        shapes=shapes,
        weights=weights,
        positions=face.neutral + np.einsum("fs,smc->fmc", bent, shapes) + noise,
        gram=np.einsum("smc,tmc->st", shapes, shapes) / len(face.names),
    )


def with_one_shape(face: SyntheticFace) -> SyntheticFace:
    """Replace the opposite shapes by the first with negative weights."""
    kept = [0, 2, 3, 4, 5]
    weights = face.weights[:, kept]
    weights[:, 0] -= face.weights[:, 1]
    ranges = face.ranges[kept].copy()
    ranges[0, 0] = -1.0
    return replace(
        face,
        shapes=face.shapes[kept],
        weights=weights,
        gram=face.gram[np.ix_(kept, kept)],
        ranges=ranges,
    )


def pairs_of(face: SyntheticFace) -> References:
    pairs = references_of(face, np.arange(0, 600, 15))
    return replace(pairs, shape_names=pairs.shape_names[: len(face.ranges)])


def train(face: SyntheticFace, method: str = "face_map") -> TrainedMapping:
    return train_mapping(
        pairs_of(face),
        ranges=face.ranges,
        gram=face.gram,
        skin=sample_skin(face.shapes.reshape(len(face.shapes), -1)),
        method=method,
    )


def test_a_shape_with_negative_weights_is_solved_as_well_as_two() -> None:
    two, one = turning(), with_one_shape(turning())
    apart, together = (
        WeightPredictor(train(each)).predict(two.positions[600:]) for each in (two, one)
    )
    expected = apart.weights[:, 0] - apart.weights[:, 1]
    np.testing.assert_allclose(together.weights[:, 0], expected, atol=0.005)
    assert np.abs(together.weights[:, 0] - one.weights[600:, 0]).max() < 0.1
    np.testing.assert_allclose(together.uncertainty[:, 0], apart.uncertainty[:, 0], rtol=0.2)


def test_other_methods_predict_whole_shapes_and_are_as_certain() -> None:
    """Of a face whose markers move by halves of its shapes to either side of rest."""
    face = synthetic_face()
    signed = replace(
        face,
        neutral=face.neutral + 0.5 * face.shapes.sum(axis=0),
        shapes=0.5 * face.shapes,
        weights=2 * face.weights - 1,
        gram=0.25 * face.gram,
        ranges=2 * face.ranges - 1,
    )
    by_map, by_ridge = (
        WeightPredictor(train(signed, method)).predict(face.positions[600:])
        for method in ("face_map", "ridge")
    )
    np.testing.assert_allclose(by_ridge.weights, signed.weights[600:], atol=0.02)
    assert by_ridge.uncertainty.mean() < 1.2 * by_map.uncertainty.mean()  # it was four times that
    assert by_ridge.residual_mm.max() < 0.05


def test_shapes_of_negative_weights_alone_are_as_certain_as_others() -> None:
    face = synthetic_face()
    mirrored = replace(
        face, weights=-face.weights, shapes=-face.shapes, ranges=-face.ranges[:, ::-1]
    )
    for method in ("face_map", "ridge"):
        usual, other = (
            WeightPredictor(train(each, method)).predict(face.positions[600:])
            for each in (face, mirrored)
        )
        np.testing.assert_allclose(other.weights, -usual.weights, atol=1e-6)
        np.testing.assert_allclose(other.uncertainty, usual.uncertainty, rtol=1e-3)


def test_mappings_of_earlier_versions_predict_as_before() -> None:
    """Their outputs are the columns of sides; without sides, whole shapes."""
    face = with_one_shape(turning())
    mapping = train(face, "ridge")
    usual = WeightPredictor(mapping).predict(face.positions[600:620]).weights
    sides = ShapeSides.from_arrays(mapping.arrays, mapping.ranges)
    columns = {
        name: sides.signs * mapping.arrays[name][..., sides.shapes]
        for name in ("slope", "intercept")
    }
    earlier = {name: each for name, each in mapping.arrays.items() if name != JOINED_OUTPUTS}
    divided = replace(mapping, arrays=earlier | columns)
    np.testing.assert_allclose(
        WeightPredictor(divided).predict(face.positions[600:620]).weights, usual, atol=1e-12
    )
    undivided = train(synthetic_face(), "ridge")
    earlier = {name: each for name, each in undivided.arrays.items() if name != "shape_sides"}
    np.testing.assert_array_equal(
        WeightPredictor(replace(undivided, arrays=earlier)).predict(face.positions[:9]).weights,
        WeightPredictor(undivided).predict(face.positions[:9]).weights,
    )


@pytest.mark.parametrize("mode", ["product", "minimum"])
def test_combinations_of_a_shape_with_negative_weights_are_solved(mode: CombinationMode) -> None:
    face = with_one_shape(turning())
    pairs = pairs_of(face)
    combinations = (Combination("both", pairs.shape_names[:2], mode),)
    logic = RigLogic(pairs.shape_names, combinations)
    motion = 6 * np.random.default_rng(2).standard_normal(face.neutral.shape)
    driven = logic.evaluate(face.weights)[:, [-1]]
    assert driven.max() > 0.3
    positions = face.positions + driven[:, :, None] * motion
    skin = np.concatenate([face.shapes, motion[None]])
    moved = replace(face, positions=positions)
    mapping = train_mapping(
        replace(pairs_of(moved), combinations=combinations),
        ranges=face.ranges,
        gram=face.gram,
        skin=sample_skin(skin.reshape(len(skin), -1)),
        method="face_map",
    )
    assert len(mapping.arrays["shape_sides"]) == len(face.ranges) + 1
    error = WeightPredictor(mapping).predict(positions[600:]).weights - face.weights[600:]
    alone = WeightPredictor(train(face)).predict(face.positions[600:]).weights - face.weights[600:]
    assert np.sqrt((error**2).mean()) < 1.5 * np.sqrt((alone**2).mean())
