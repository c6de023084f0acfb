"""What the rig's geometry expects of markers, and the linear face calibrated on it."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from usdface.numerics.regression.linear_posterior import _calibrate, fit_linear_posterior
from usdface.numerics.regression.marker_prior import expect_marker_motion

SHAPES, POINTS, MARKERS, PAIRS = 6, 80, 30, 20


def skin() -> np.ndarray:
    """Shapes that are smooth over a disc of points: neighbours move alike."""
    rng = np.random.default_rng(0)
    where = rng.uniform(-1, 1, size=(POINTS, 2))
    middle = rng.uniform(-1, 1, size=(SHAPES, 2))
    near = np.exp(-((where - middle[:, None]) ** 2).sum(axis=2) / 0.5)
    return 10 * near[:, :, None] * rng.normal(size=(SHAPES, 1, 3))


def take(turn: np.ndarray, gain: float = 1.0, noise: float = 0.0):
    rng = np.random.default_rng(1)
    chosen = rng.choice(POINTS, MARKERS, replace=False)
    basis = gain * skin()[:, chosen] @ turn.T
    weights = rng.uniform(0, 1, size=(PAIRS, SHAPES))
    markers = 50.0 + np.einsum("ns,smc->nmc", weights, basis)
    return weights, markers + noise * rng.normal(size=markers.shape), basis


@pytest.mark.parametrize("degrees", [0, 25])
def test_markers_are_found_on_a_turned_and_smaller_face(degrees: int) -> None:
    turn = Rotation.from_euler("xyz", [degrees, -degrees / 2, 5], degrees=True).as_matrix()
    weights, markers, basis = take(turn, gain=0.7, noise=0.05)
    prior = expect_marker_motion(skin(), weights, markers)
    assert prior.explained > 0.99
    np.testing.assert_allclose(prior.rotation, turn, atol=0.03)
    assert np.linalg.norm(prior.basis - basis) < 0.15 * np.linalg.norm(basis)


def test_a_shape_that_no_pair_uses_still_has_its_motion() -> None:
    weights, markers, basis = take(np.eye(3))
    weights = weights.copy()
    markers = markers - np.einsum("n,mc->nmc", weights[:, 2], basis[2])
    weights[:, 2] = 0.0
    prior = expect_marker_motion(skin(), weights, markers)
    direction = (prior.basis[2] * basis[2]).sum() / np.linalg.norm(basis[2]) ** 2
    assert direction > 0.7


def test_skin_that_does_not_fit_the_pairs_is_refused() -> None:
    weights, markers, _ = take(np.eye(3))
    with pytest.raises(ValueError, match="do not fit together"):
        expect_marker_motion(skin()[:-1], weights, markers)
    with pytest.raises(ValueError, match="19 marker clouds but 20 weights"):
        expect_marker_motion(skin(), weights, markers[1:])


def linear_face(pairs: int = 25, noise: float = 0.02):
    rng = np.random.default_rng(2)
    d = 9
    components = np.linalg.qr(rng.normal(size=(3 * MARKERS, d)))[0].T
    forward = rng.normal(size=(SHAPES, d)) * 4
    weights = rng.uniform(0, 1, size=(pairs, SHAPES))
    z = weights @ forward + 1.5 + noise * rng.normal(size=(pairs, d))
    return z, weights, forward, components


def test_a_linear_face_is_inverted() -> None:
    z, weights, forward, components = linear_face()
    model = fit_linear_posterior(
        z,
        weights,
        expected=np.zeros_like(forward),
        components=components,
        variances=z.var(axis=0),
        gram=np.eye(SHAPES),
    )
    new = np.random.default_rng(3).uniform(0, 1, size=(40, SHAPES))
    predicted = (new @ forward + 1.5) @ model.slope + model.intercept
    assert np.sqrt(((predicted - new) ** 2).mean()) < 0.02
    assert np.sqrt((model.residuals**2).mean()) < 0.03


def test_geometry_separates_shapes_that_the_pairs_only_used_together() -> None:
    z, weights, forward, components = linear_face()
    together = weights.copy()
    together[:, 1] = together[:, 0] + 0.02 * np.random.default_rng(4).normal(size=len(weights))
    z = together @ forward + 1.5
    alone = np.zeros((1, SHAPES))
    alone[0] = 0.5
    alone[0, 0], alone[0, 1] = 0.9, 0.1
    errors = []
    for expected in (np.zeros_like(forward), forward * 1.1):
        model = fit_linear_posterior(
            z,
            together,
            expected=expected,
            components=components,
            variances=z.var(axis=0),
            gram=np.eye(SHAPES),
        )
        predicted = (alone @ forward + 1.5) @ model.slope + model.intercept
        errors.append(np.abs(predicted - alone)[0, :2].max())
    assert errors[1] < 0.5 * errors[0]


def test_too_few_pairs_for_a_calibration_are_refused() -> None:
    z, weights, forward, components = linear_face(pairs=2)
    with pytest.raises(ValueError, match="at least 3 pairs, got 2"):
        fit_linear_posterior(
            z,
            weights,
            expected=forward,
            components=components,
            variances=np.ones(9),
            gram=np.eye(SHAPES),
        )


def test_a_rig_of_any_size_expects_the_same_of_a_performer() -> None:
    turn = Rotation.from_euler("y", 20, degrees=True).as_matrix()
    weights, markers, basis = take(turn, noise=0.05)
    usual = expect_marker_motion(skin(), weights, markers)
    giant, titan, imp = (
        expect_marker_motion(size * skin(), weights, markers) for size in (8.0, 100.0, 0.05)
    )
    for other in (titan, imp):
        np.testing.assert_allclose(other.basis, giant.basis, atol=1e-9)
    assert giant.explained == pytest.approx(usual.explained, abs=0.005)
    for prior in (usual, giant):
        assert np.linalg.norm(prior.basis - basis) < 0.2 * np.linalg.norm(basis)


def test_pairs_at_rest_tell_nothing_of_a_rigs_size() -> None:
    weights, markers, _ = take(np.eye(3))
    for still in ((0 * weights, markers), (weights, 0 * markers)):
        assert np.isfinite(expect_marker_motion(skin(), *still).basis).all()


def test_a_face_in_other_units_is_inverted_alike() -> None:
    z, weights, forward, components = linear_face(noise=0.5)
    slopes = []
    for size in (1e3, 1e4):  # so large that the floor of the noise does not count
        model = fit_linear_posterior(
            size * z,
            weights,
            expected=size * forward,
            components=components,
            variances=size**2 * z.var(axis=0),
            gram=np.eye(SHAPES),
        )
        slopes.append(size * model.slope)
    np.testing.assert_allclose(slopes[1], slopes[0], rtol=1e-5, atol=1e-9)


def test_residuals_of_a_calibration_are_those_of_fits_without_the_pair() -> None:
    z, weights, forward, _ = linear_face(pairs=12, noise=0.5)
    found = _calibrate(z, weights, forward * 0, 1e-7).residuals
    for pair in range(12):
        others = np.arange(12) != pair
        fit = _calibrate(z[others], weights[others], forward * 0, 1e-7)
        left = z[pair] - weights[pair] @ fit.matrix - fit.offset
        np.testing.assert_allclose(found[pair], left, atol=1e-4)
