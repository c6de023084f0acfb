"""Ways to solve and to regress that users may name, held to what they are said to be."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear, nnls

from tests.model.synthetic import references_of, synthetic_face
from usdface.model import predict_weights, train_mapping
from usdface.model.regressions import METHODS, Pairs
from usdface.model.regressions.d06 import METHOD as D06
from usdface.numerics.regression.rbf_ridge import (
    centre_widths,
    gaussian_design,
    reestimate_ridge,
    rotate,
)

CHOSEN = np.arange(0, 1200, 30)


def pairs_of_a_face() -> Pairs:
    face = synthetic_face(bend=0.2)
    references = references_of(face, CHOSEN)
    motion = references.motion
    assert motion is not None
    flat = references.markers.reshape(len(CHOSEN), -1)
    coordinates = (flat - motion.mean) @ motion.components.T
    return Pairs(coordinates, references.weights, face.ranges, face.gram, motion)


def solved(name: str, **changes: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return a method's prediction beside the basis and target that it solved with."""
    pairs, method = pairs_of_a_face(), METHODS[name]
    fitted = method.fit(pairs, method.candidates(pairs, 16)[0] | changes)
    rows = pairs.coordinates + np.random.default_rng(0).normal(size=pairs.coordinates.shape)
    basis = (fitted.arrays["basis"] / fitted.arrays["noise"]).T
    target = (rows[:, :16] - fitted.arrays["offset"]) / fitted.arrays["noise"]
    return method.predict(fitted.arrays, fitted.settings, rows), basis, target


def test_least_squares_is_that_of_numpy() -> None:
    found, basis, target = solved("least_squares")
    np.testing.assert_allclose(found, np.linalg.lstsq(basis, target.T)[0].T, atol=1e-9)


def test_non_negative_least_squares_is_that_of_scipy() -> None:
    found, basis, target = solved("nnls")
    wanted = np.array([nnls(basis, row)[0] for row in target])
    np.testing.assert_allclose(found, wanted, atol=1e-4)


def test_bounded_least_squares_is_that_of_scipy_with_the_prior_as_more_rows() -> None:
    pairs, method = pairs_of_a_face(), METHODS["bounded"]
    fitted = method.fit(pairs, method.candidates(pairs, 16)[0])
    found, basis, target = solved("bounded")
    prior = np.linalg.cholesky(fitted.arrays["weight_precision"]).T
    for row, weights in zip(target[:10], found, strict=False):
        right = np.concatenate([row, prior @ fitted.arrays["weight_mean"]])
        wanted = lsq_linear(np.vstack([basis, prior]), right, bounds=(0, 1), tol=1e-12).x
        np.testing.assert_allclose(weights, wanted, atol=1e-5)


def test_the_l1_penalty_leaves_fewer_shapes_on() -> None:
    free, sparse = solved("sparse", l1=0.0)[0], solved("sparse", l1=200.0)[0]
    assert (sparse > 1e-6).sum() < (free > 1e-6).sum()


def test_a_model_for_each_region_ignores_what_happens_elsewhere() -> None:
    """Markers of one shape alone move: the other shapes, of other markers, stay."""
    face = synthetic_face()
    shapes = np.zeros_like(face.shapes)
    for shape in range(6):  # three markers each
        part = slice(5 + 3 * shape, 8 + 3 * shape)
        shapes[shape, part] = face.shapes[shape, part]
    positions = face.neutral + np.einsum("fs,smc->fmc", face.weights, shapes)
    made = type(face)(**{**vars(face), "shapes": shapes, "positions": positions})
    mapping = train_mapping(
        references_of(made, CHOSEN), ranges=face.ranges, gram=face.gram, method="regional"
    )
    before = predict_weights(mapping, positions[:50]).weights
    positions[:50, 5:8] += 0.5
    after = predict_weights(mapping, positions[:50]).weights
    moved = np.abs(after - before).mean(axis=0)
    assert moved[1:].max() < 0.1 * moved[0]


def test_the_paper_s_own_iteration_can_choose_the_ridge() -> None:
    pairs = pairs_of_a_face()
    iterated = [each for each in D06.candidates(pairs, None) if each["ridge"] == "iterated"]
    fitted = D06.fit(pairs, iterated[0])
    centres = pairs.coordinates[:, :4]
    widths = centre_widths(centres, multiple=2.0)
    rotated = rotate(gaussian_design(centres, centres, widths), pairs.weights)
    np.testing.assert_allclose(fitted.arrays["ridge"], reestimate_ridge(rotated, start=1e-3))


def test_each_centre_may_have_a_width_of_its_own() -> None:
    pairs, method = pairs_of_a_face(), METHODS["rbf"]
    own = [each for each in method.candidates(pairs, 8) if each["widths"] == "per centre"]
    fitted = method.fit(pairs, own[0])
    assert len(np.unique(fitted.arrays["widths"])) > 10


@pytest.mark.parametrize("name", METHODS)
def test_a_head_placed_a_hair_aside_has_the_same_face(name: str) -> None:
    """Cleaned takes have components that hardly move: what moves there is never the face."""
    face = synthetic_face(bend=0.2, noise=5e-4)
    mapping = train_mapping(
        references_of(face, CHOSEN),
        ranges=face.ranges,
        gram=face.gram,
        method=name,
        dimensions=20,
    )
    before = predict_weights(mapping, face.positions[:200]).weights
    after = predict_weights(mapping, face.positions[:200] + 0.02).weights
    np.testing.assert_allclose(after, before, atol=0.03)
