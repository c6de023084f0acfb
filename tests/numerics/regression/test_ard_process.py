import numpy as np
import pytest
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

from usdface.numerics.regression.ard_process import (
    fit_ard_process,
    log_evidence,
    predict_ard_process,
)


def problem() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    features = rng.normal(size=(60, 4))
    outputs = np.stack([np.sin(2 * features[:, 0]), features[:, 0] * features[:, 1]], axis=1)
    return features, outputs + 0.02 * rng.normal(size=outputs.shape)


def test_evidence_and_its_gradient_are_those_of_scikit_learn() -> None:
    features, outputs = problem()
    theta = np.log([0.7, 1.5, 2.0, 3.0, 1.3, 0.05])
    kernel = ConstantKernel(1.3) * RBF([0.7, 1.5, 2.0, 3.0]) + WhiteKernel(0.05)
    peer = GaussianProcessRegressor(kernel, optimizer=None, alpha=0.0).fit(features, outputs)
    value, gradient = peer.log_marginal_likelihood(peer.kernel_.theta, eval_gradient=True)
    mine, slope = log_evidence(features, outputs, theta)
    np.testing.assert_allclose(mine, value, rtol=1e-10)
    np.testing.assert_allclose(slope, gradient[[1, 2, 3, 4, 0, 5]], rtol=1e-7)


def test_predictions_are_those_of_scikit_learn_under_the_same_kernel() -> None:
    features, outputs = problem()
    model = fit_ard_process(features, outputs)
    kernel = ConstantKernel(model.amplitude) * RBF(model.lengths) + WhiteKernel(model.noise)
    peer = GaussianProcessRegressor(kernel, optimizer=None, alpha=0.0, normalize_y=True)
    peer.fit(features, outputs)
    new = np.random.default_rng(1).normal(size=(30, 4))
    np.testing.assert_allclose(predict_ard_process(model, new), peer.predict(new), atol=1e-7)


def test_features_that_tell_nothing_get_long_lengths() -> None:
    features, outputs = problem()
    lengths = fit_ard_process(features, outputs).lengths
    assert lengths[2:].min() > 5 * lengths[:2].max()


def test_an_output_that_does_not_change_is_predicted_as_it_is() -> None:
    features, outputs = problem()
    still = np.column_stack([outputs, np.full(60, 0.3)])
    predicted = predict_ard_process(fit_ard_process(features, still), features)
    np.testing.assert_allclose(predicted[:, 2], 0.3)


def test_what_cannot_be_fitted_is_refused() -> None:
    with pytest.raises(ValueError, match="do not pair up"):
        fit_ard_process(np.zeros((3, 2)), np.zeros((4, 1)))
    with pytest.raises(ValueError, match="at least 2 pairs, got 1"):
        fit_ard_process(np.zeros((1, 2)), np.zeros((1, 1)))
    with pytest.raises(ValueError, match="not finite"):
        fit_ard_process(np.full((3, 2), np.nan), np.zeros((3, 1)))
