"""The Gaussian's conditionals against their textbook form, and learning against itself."""

import numpy as np
import pytest

from tests.numerics.simulated_face import simulate_face
from usdface.numerics.repair.fit_low_rank import _principal, fit_low_rank, with_rank
from usdface.numerics.repair.low_rank import LowRankModel, fill_missing, predict_from_others

MARKERS = 12


@pytest.fixture
def model() -> LowRankModel:
    rng = np.random.default_rng(0)
    components = np.linalg.qr(rng.standard_normal((3 * MARKERS, 10)))[0].T
    return LowRankModel(
        mean=rng.normal(0, 50, 3 * MARKERS),
        components=components,
        variances=np.geomspace(400, 0.1, 10),
        noise=rng.uniform(0.05, 0.4, MARKERS),
    )


def covariance(model: LowRankModel) -> np.ndarray:
    spread = (model.components.T * model.variances) @ model.components
    return spread + np.diag(np.repeat(model.noise**2, 3))


def conditional(model: LowRankModel, row: np.ndarray, hidden: np.ndarray) -> np.ndarray:
    """Return E[hidden | seen] from blocks of the covariance."""
    full, seen = covariance(model), ~hidden
    solved = np.linalg.solve(full[np.ix_(seen, seen)], (row - model.mean)[seen])
    return model.mean[hidden] + full[np.ix_(hidden, seen)] @ solved


def test_the_precision_inverts_the_covariance(model):
    precision = model.precision_of(np.arange(3 * MARKERS))
    np.testing.assert_allclose(precision @ covariance(model), np.eye(3 * MARKERS), atol=1e-9)


def test_each_marker_is_predicted_by_all_others_as_in_the_textbook(model):
    rng = np.random.default_rng(3)
    rows = rng.multivariate_normal(model.mean, covariance(model), 4)
    predicted = predict_from_others(model, rows.reshape(4, MARKERS, 3))
    for marker in range(MARKERS):
        hidden = np.repeat(np.arange(MARKERS) == marker, 3)
        expected = [conditional(model, row, hidden) for row in rows]
        np.testing.assert_allclose(predicted[:, marker], expected, atol=1e-8)


@pytest.mark.parametrize("frames", [20, 300], ids=["fewer than coordinates", "more"])
def test_principal_directions_are_those_of_the_singular_value_decomposition(frames):
    filled = np.random.default_rng(0).standard_normal((frames, MARKERS, 3)) * np.geomspace(
        9, 0.1, MARKERS
    ).reshape(-1, 1)
    mean, values, components, squares = _principal(filled, 8)
    np.testing.assert_allclose(mean, filled.reshape(frames, -1).mean(axis=0), atol=1e-12)
    centered = filled.reshape(frames, -1) - mean
    _, size, right = np.linalg.svd(centered, full_matrices=False)
    np.testing.assert_allclose(values[:8], size[:8] ** 2)
    np.testing.assert_allclose(np.abs(components @ right[:8].T), np.eye(8), atol=1e-6)
    np.testing.assert_allclose(squares, (centered**2).sum(axis=0))


@pytest.mark.parametrize("count", [1, 3, 4, 7, MARKERS])
def test_any_number_of_missing_markers_gets_its_conditional_mean(model, count):
    rng = np.random.default_rng(count)
    rows = rng.multivariate_normal(model.mean, covariance(model), 20).reshape(20, MARKERS, 3)
    good = np.ones((20, MARKERS), bool)
    for row in good:
        row[rng.choice(MARKERS, count, replace=False)] = False
    filled = fill_missing(model, np.where(good[..., None], rows, 1e6), good)
    for row, seen, found in zip(rows, good, filled, strict=True):
        hidden = np.repeat(~seen, 3)
        expected = conditional(model, row.ravel(), hidden)
        np.testing.assert_allclose(found.ravel()[hidden], expected, atol=1e-8)
        np.testing.assert_array_equal(found[seen], row[seen])


def test_single_precision_predicts_within_a_ten_thousandth_of_a_millimetre(model):
    rng = np.random.default_rng(0)
    rows = rng.multivariate_normal(model.mean, covariance(model), 500).reshape(500, MARKERS, 3)
    rough = predict_from_others(model, rows.astype(np.float32))
    assert rough.dtype == np.float32
    exact = predict_from_others(model, rows.astype(np.float32).astype(np.float64))
    np.testing.assert_allclose(rough, exact, atol=1e-4)


def test_learning_that_starts_from_a_model_ends_where_learning_from_nothing_does():
    face = simulate_face(frames=600, dropout_share=0.05)
    good = face.visible
    noisy = face.truth + 0.15 * np.random.default_rng(0).standard_normal(face.truth.shape)
    noisy[face.visible & (np.random.default_rng(1).random(good.shape) < 1e-3)] += 20.0
    cold = fit_low_rank(noisy, good, rank_limit=20)
    warm = fit_low_rank(noisy, good, rank_limit=20, start=fit_low_rank(noisy, good))
    one, other = (predict_from_others(m, fill_missing(m, noisy, good)) for m in (cold, warm))
    assert np.sqrt(np.mean((one - other) ** 2)) < 0.01  # of noise of 0.15
    np.testing.assert_allclose(warm.noise, cold.noise, rtol=0.02)


def test_directions_that_are_left_out_count_as_noise(model):
    fewer = with_rank(model, 6)
    assert len(fewer.variances) == 6
    assert np.trace(covariance(fewer)) == pytest.approx(np.trace(covariance(model)))
