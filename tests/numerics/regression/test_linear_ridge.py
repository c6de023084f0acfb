import numpy as np
import pytest
from scipy.stats import multivariate_normal
from sklearn.linear_model import Ridge, RidgeCV

from usdface.numerics.regression import linear_ridge
from usdface.numerics.regression.linear_ridge import (
    EVIDENCE_INTERVAL,
    LinearRidge,
    fit_linear_ridge,
    fit_slope,
)


def lines(rows: int = 30, columns: int = 8, outputs: int = 4, noise: float = 0.1):
    rng = np.random.default_rng(0)
    features = rng.normal(size=(rows, columns)) * 0.6 ** np.arange(columns) + 5.0
    exact = features @ rng.normal(size=(columns, outputs)) + rng.normal(size=outputs)
    return features, exact + noise * rng.normal(size=exact.shape)


def predicted(model: LinearRidge, features: np.ndarray) -> np.ndarray:
    return (features - model.mean) @ model.coefficients + model.intercept


def scale_of(features: np.ndarray) -> float:
    return float(np.linalg.svd(features - features.mean(axis=0))[1][0] ** 2)


def test_fit_equals_sklearns_ridge_at_the_same_penalty(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    features, outputs = lines()
    monkeypatch.setattr(linear_ridge, "_RIDGES", np.array([1e-3]))
    model = fit_linear_ridge(features, outputs)
    theirs = Ridge(alpha=1e-3 * scale_of(features)).fit(features, outputs)
    np.testing.assert_allclose(model.coefficients, theirs.coef_.T, rtol=1e-8)
    new = np.random.default_rng(1).normal(size=(5, features.shape[1]))
    np.testing.assert_allclose(predicted(model, new), theirs.predict(new), rtol=1e-8)


def test_leave_one_out_residuals_equal_refitting_without_each_row(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    features, outputs = lines(rows=12)
    monkeypatch.setattr(linear_ridge, "_RIDGES", np.array([1e-2]))
    model = fit_linear_ridge(features, outputs)
    penalty = 1e-2 * scale_of(features)
    for row in range(len(features)):
        rest = np.arange(len(features)) != row
        refit = Ridge(alpha=penalty).fit(features[rest], outputs[rest])
        expected = outputs[row] - refit.predict(features[[row]])[0]
        np.testing.assert_allclose(model.loo_residuals[row], expected, rtol=1e-7, atol=1e-10)


def test_chosen_ridge_is_the_one_sklearns_leave_one_out_chooses(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    features, outputs = lines(noise=0.5)
    ridges = 10.0 ** np.arange(-6.0, 1.0)
    monkeypatch.setattr(linear_ridge, "_RIDGES", ridges)
    model = fit_linear_ridge(features, outputs)
    scale = scale_of(features)
    for column in range(outputs.shape[1]):
        theirs = RidgeCV(alphas=ridges * scale).fit(features, outputs[:, column])
        assert model.ridge[column] * scale == pytest.approx(theirs.alpha_)


def test_exact_lines_are_recovered() -> None:
    features, outputs = lines(noise=0.0)
    model = fit_linear_ridge(features, outputs)
    np.testing.assert_allclose(predicted(model, features), outputs, atol=1e-5)


def test_more_columns_than_rows_are_welcome() -> None:
    features, outputs = lines(rows=6, columns=20)
    model = fit_linear_ridge(features, outputs)
    assert np.isfinite(model.loo_residuals).all()


def test_bad_input_is_refused() -> None:
    features, outputs = lines()
    with pytest.raises(ValueError, match="do not pair up"):
        fit_linear_ridge(features[:-1], outputs)
    with pytest.raises(ValueError, match="at least 2 rows"):
        fit_linear_ridge(features[:1], outputs[:1])
    with pytest.raises(ValueError, match="all rows of the features are equal"):
        fit_linear_ridge(np.ones((4, 3)), outputs[:4])
    with pytest.raises(ValueError, match="not finite"):
        fit_linear_ridge(features, outputs * np.inf)


def test_slope_has_the_smallest_ridge_that_the_likelihood_allows(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rng = np.random.default_rng(0)
    features = rng.normal(size=(40, 6)) * [1, 1, 1, 0.1, 0.01, 0.001]
    outputs = features @ rng.normal(size=(6, 3)) + 0.05 * rng.normal(size=(40, 3))
    ridges = 10.0 ** np.arange(-8.0, 2.0)
    scale = np.linalg.svd(features)[1][0] ** 2

    def cost(ridge: float) -> float:
        covariance = features @ features.T + ridge * scale * np.eye(40)
        deviation = np.sqrt((outputs * np.linalg.solve(covariance, outputs)).mean(axis=0))
        laws = [multivariate_normal(np.zeros(40), s**2 * covariance) for s in deviation]
        logs = [law.logpdf(y) for law, y in zip(laws, outputs.T, strict=True)]
        return -2 * float(np.mean(logs))

    costs = np.array([cost(ridge) for ridge in ridges])
    expected = ridges[np.argmax(costs <= costs.min() + EVIDENCE_INTERVAL)]
    assert ridges[0] < expected < ridges[-1]
    monkeypatch.setattr(linear_ridge, "_RIDGES", ridges)
    theirs = Ridge(alpha=expected * scale, fit_intercept=False).fit(features, outputs)
    np.testing.assert_allclose(fit_slope(features, outputs), theirs.coef_.T, rtol=1e-6)


def test_slope_of_rows_that_share_no_feature_meets_them_all() -> None:
    features = np.vstack([np.zeros(5), np.eye(5)])
    outputs = features @ np.random.default_rng(0).random((5, 3))
    np.testing.assert_allclose(features @ fit_slope(features, outputs), outputs, atol=1e-7)


def test_exact_lines_are_recovered_in_directions_that_hardly_move() -> None:
    rng = np.random.default_rng(0)
    features = rng.normal(size=(40, 4)) * [1, 1, 0.1, 0.01]
    slope = rng.normal(size=(4, 3))
    np.testing.assert_allclose(fit_slope(features, features @ slope), slope, atol=1e-3)
