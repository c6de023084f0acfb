import numpy as np
import pytest
from sklearn.linear_model import Ridge, RidgeCV

from usdface.numerics.regression import linear_ridge
from usdface.numerics.regression.linear_ridge import LinearRidge, fit_linear_ridge


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
