import numpy as np
import pytest
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, DotProduct

from usdface.numerics.regression.gaussian_process import (
    LINE_VARIANCE,
    OFFSET_VARIANCE,
    GaussianProcess,
    ProcessSettings,
    fit_gaussian_process,
    leave_one_out_errors,
    smoothest_near_best,
    usable_choices,
)


def pairs(count: int = 30, dimensions: int = 5, outputs: int = 3, noise: float = 0.05):
    rng = np.random.default_rng(0)
    variances = 4.0 * 0.5 ** np.arange(dimensions)
    features = rng.normal(size=(count, dimensions)) * np.sqrt(variances)
    smooth = np.sin(features @ rng.normal(size=(dimensions, outputs)) / 2)
    return features, smooth + noise * rng.normal(size=smooth.shape), variances


def radial_values(rows: np.ndarray, centres: np.ndarray, exponent: float) -> np.ndarray:
    return np.exp(exponent * ((rows[:, None] - centres) ** 2).sum(axis=2))


def predicted(model: GaussianProcess, features: np.ndarray) -> np.ndarray:
    rows = features[:, : len(model.scale)] * model.scale
    local = radial_values(rows, model.centres, model.exponent) @ model.dual
    return rows @ model.slope + model.intercept + local


def test_prediction_equals_sklearns_process_with_the_same_covariance() -> None:
    features, outputs, variances = pairs()
    choice = ProcessSettings(4, 0.0, radial=2.0, width=1.5)
    model = fit_gaussian_process(
        features, outputs, variances=variances, choice=choice, noise=np.full(3, 0.01)
    )
    size = variances[:4].sum()
    length = np.sqrt(-0.5 / model.exponent) / model.scale[0]
    kernel = ConstantKernel(LINE_VARIANCE / size, "fixed") * DotProduct(0.0, "fixed")
    kernel += ConstantKernel(OFFSET_VARIANCE, "fixed") + ConstantKernel(2.0, "fixed") * RBF(
        length, "fixed"
    )
    theirs = GaussianProcessRegressor(kernel, alpha=0.01, optimizer=None)
    theirs.fit(features[:, :4], outputs)
    new = np.random.default_rng(1).normal(size=(20, 5))
    np.testing.assert_allclose(predicted(model, new), theirs.predict(new[:, :4]), atol=1e-9)


def test_width_is_measured_in_median_distances_of_whitened_features() -> None:
    features, outputs, variances = pairs()
    choice = ProcessSettings(5, 1.0, radial=1.0, width=3.0)
    model = fit_gaussian_process(
        features, outputs, variances=variances, choice=choice, noise=np.full(3, 0.1)
    )
    white = features * np.sqrt(LINE_VARIANCE / (5 * variances))
    away = ((white[:, None] - white) ** 2).sum(axis=2)
    middle = np.median(away[np.triu_indices(30, 1)])
    assert model.exponent == pytest.approx(-0.5 / (3.0 * middle))


@pytest.mark.parametrize("radial", [0.0, 1.0])
def test_leave_one_out_residuals_equal_refitting_without_each_pair(radial: float) -> None:
    features, outputs, variances = pairs(count=12)
    choice, noise = ProcessSettings(5, 0.5, radial=radial), np.array([0.01, 0.1, 1.0])
    whole = fit_gaussian_process(features, outputs, variances=variances, choice=choice, noise=noise)
    scaled = features * whole.scale
    assert (variances * whole.scale**2).sum() == pytest.approx(LINE_VARIANCE)
    covariance = scaled @ scaled.T + OFFSET_VARIANCE
    covariance += radial * radial_values(scaled, scaled, whole.exponent)
    for i in range(12):
        rest = np.arange(12) != i
        for j, level in enumerate(noise):
            inner = covariance[np.ix_(rest, rest)] + level * np.eye(11)
            gain = np.linalg.solve(inner, covariance[rest, i])
            unseen = gain @ outputs[rest, j]
            assert whole.residuals[i, j] == pytest.approx(outputs[i, j] - unseen, abs=1e-8)


@pytest.mark.parametrize("smooth", [True, False])
def test_amplitude_is_that_of_pairs_left_out_singly_or_with_similar_ones(smooth: bool) -> None:
    rng = np.random.default_rng(3)
    group = np.repeat(np.arange(4), 5)
    features = 8 * np.eye(4)[group] + 0.3 * rng.standard_normal((20, 4))
    outputs = (np.array([0.0, 1.0, -1.0, 3.0])[group] if smooth else rng.standard_normal(20))[
        :, None
    ]
    variances = np.sort(features.var(axis=0))[::-1]
    choice, noise = ProcessSettings(4, 0.5, radial=3.0), np.array([0.03])
    whole = fit_gaussian_process(features, outputs, variances=variances, choice=choice, noise=noise)
    scaled = features * whole.scale
    covariance = scaled @ scaled.T + OFFSET_VARIANCE
    covariance += 3.0 * radial_values(scaled, scaled, whole.exponent)

    def amplitude(folds: np.ndarray) -> float:
        ratios = []
        for i in range(20):
            rest = folds != folds[i]
            inner = covariance[np.ix_(rest, rest)] + noise * np.eye(rest.sum())
            gain = np.linalg.solve(inner, covariance[rest, i])
            variance = covariance[i, i] + noise[0] - gain @ covariance[rest, i]
            ratios.append((outputs[i, 0] - gain @ outputs[rest, 0]) ** 2 / variance)
        return float(np.mean(ratios))

    singly, in_groups = amplitude(np.arange(20)), amplitude(group)
    assert (in_groups > singly) == smooth, "smooth outputs are known from similar pairs"
    assert whole.amplitude[0] == pytest.approx(max(singly, in_groups), rel=1e-6)


def test_errors_of_the_search_are_those_of_the_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    features, outputs, variances = pairs()
    choices = (ProcessSettings(3, 0.0), ProcessSettings(5, 0.5, radial=1.0))
    noises = np.array([0.01, 0.3])
    monkeypatch.setattr("usdface.numerics.regression.gaussian_process.NOISES", noises)
    errors = leave_one_out_errors(features, outputs, variances=variances, choices=choices)
    for i, choice in enumerate(choices):
        for k, level in enumerate(noises):
            fit = fit_gaussian_process(
                features, outputs, variances=variances, choice=choice, noise=np.full(3, level)
            )
            np.testing.assert_allclose(errors[i, k], (fit.residuals**2).mean(axis=0), rtol=1e-6)


def test_a_line_needs_no_local_part_and_is_recovered() -> None:
    rng = np.random.default_rng(0)
    features, _, variances = pairs(count=40)
    outputs = features @ rng.normal(size=(5, 2)) + 3.0
    choices = (ProcessSettings(5, 0.0), ProcessSettings(5, 0.0, radial=1.0, width=0.2))
    errors = leave_one_out_errors(features, outputs, variances=variances, choices=choices)
    assert errors[0].min() < errors[1].min()
    model = fit_gaussian_process(
        features, outputs, variances=variances, choice=choices[0], noise=np.full(2, 1e-3)
    )
    new = rng.normal(size=(10, 5))
    expected = new @ np.linalg.lstsq(features, outputs - 3.0, rcond=None)[0] + 3.0
    np.testing.assert_allclose(predicted(model, new), expected, atol=0.02)


def test_choices_are_limited_to_the_dimensions_there_are_and_appear_once() -> None:
    limited = usable_choices(
        (ProcessSettings(8, 0.5), ProcessSettings(16, 0.5), ProcessSettings(3, 0.5)), most=6
    )
    assert limited == (ProcessSettings(6, 0.5), ProcessSettings(3, 0.5))


def test_bad_input_is_refused() -> None:
    features, outputs, variances = pairs()
    choices = (ProcessSettings(5, 0.0),)
    with pytest.raises(ValueError, match="do not pair up"):
        leave_one_out_errors(features[1:], outputs, variances=variances, choices=choices)


def test_of_errors_near_the_least_the_smoothest_is_taken_and_no_other(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    errors = np.array([[1.0, 1.0], [0.9, 3.0], [0.93, 1.04], [2.0, 1.06]])
    for slack, expected in ((0.05, [2, 2]), (0.0, [1, 0])):
        monkeypatch.setattr("usdface.numerics.regression.gaussian_process.ERROR_SLACK", slack)
        np.testing.assert_array_equal(smoothest_near_best(errors), expected)
