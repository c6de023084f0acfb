"""Linear ridge regression with leave-one-out errors in closed form."""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import FloatArray, first_smallest

_RIDGES = 10.0 ** np.arange(-8.0, 2.01, 0.25)
"""Ridges tried, as shares of the largest squared singular value of the centred features."""


EVIDENCE_INTERVAL = 3.84
"""Twice the log likelihood ratio of the limits of an interval of 95 %, by Wilks' theorem."""


@dataclass(frozen=True)
class LinearRidge:
    """``y = (x - mean) @ coefficients + intercept``."""

    mean: FloatArray
    """(d,)"""
    coefficients: FloatArray
    """(d, s)"""
    intercept: FloatArray
    """(s,)"""
    ridge: FloatArray
    """(s,): as a share of the largest squared singular value."""
    loo_residuals: FloatArray
    """(n, s): output minus its leave-one-out prediction, at the chosen ridge."""


def check_examples(inputs: FloatArray, outputs: FloatArray) -> None:
    """Refuse examples of a regression that are not (n, d) and (n, s), or not finite."""
    if inputs.ndim != 2 or outputs.ndim != 2 or len(inputs) != len(outputs):
        raise ValueError(f"{inputs.shape} inputs and {outputs.shape} outputs do not pair up")
    if not (np.isfinite(inputs).all() and np.isfinite(outputs).all()):
        raise ValueError("inputs or outputs hold values that are not finite")


def fit_linear_ridge(features: FloatArray, outputs: FloatArray) -> LinearRidge:
    """Fit with an unpenalised intercept; choose the ridge by leave-one-out error.

    The leave-one-out residual of row i is its residual over one minus its leverage, where the
    leverage is ``1/n + sum_k u_ik^2 s_k^2 / (s_k^2 + ridge)``: exact, without refitting.
    """
    check_examples(features, outputs)
    if len(features) < 2:
        raise ValueError(f"a line needs at least 2 rows, got {len(features)}")
    mean, intercept = features.mean(axis=0), outputs.mean(axis=0)
    left, singular, right = np.linalg.svd(features - mean, full_matrices=False)
    centred = outputs - intercept
    rotated = left.T @ centred
    scale = float(singular[0]) ** 2
    if scale == 0.0:
        raise ValueError("all rows of the features are equal; there is nothing to regress on")
    errors = [
        (_loo_residuals(left, singular, centred, rotated, ridge * scale) ** 2).mean(axis=0)
        for ridge in _RIDGES
    ]
    chosen = _RIDGES[first_smallest(np.stack(errors))]
    residuals = np.empty_like(centred)
    for ridge in np.unique(chosen):
        same = chosen == ridge
        residuals[:, same] = _loo_residuals(
            left, singular, centred[:, same], rotated[:, same], ridge * scale
        )
    gain = singular[:, None] / (singular[:, None] ** 2 + chosen * scale)
    return LinearRidge(mean, right.T @ (gain * rotated), intercept, chosen, residuals)


def fit_slope(features: FloatArray, outputs: FloatArray) -> FloatArray:
    """Return the (d, s) slope of a line through zero, with one ridge for all outputs.

    Each output is ``y ~ N(0, t^2 (X X' + ridge I))``, with the t^2 of its largest likelihood
    (MacKay 1992, Bayesian interpolation, Neural Computation 4(3)). The ridge is the smallest within
    `EVIDENCE_INTERVAL` of the largest mean likelihood.
    """
    moved = features.any(axis=1)  # other rows fit any slope
    left, singular, right = np.linalg.svd(features[moved], full_matrices=False)
    rotated, sums = left.T @ outputs[moved], (outputs[moved] ** 2).sum(axis=0)
    power = rotated[:, sums > 0] ** 2
    beyond = np.maximum(sums[sums > 0] - power.sum(axis=0), 0.0)
    ridges = _RIDGES[:, None] * float(singular[0]) ** 2
    variances = singular**2 + ridges
    fits = np.log(power.T @ (1 / variances).T + beyond[:, None] / ridges.T)
    costs = len(left) * fits.sum(axis=0) / max(1, len(fits)) + np.log(variances).sum(axis=1)
    costs += (len(left) - len(singular)) * np.log(ridges[:, 0])  # minus twice the log likelihood
    best = int(np.argmax(costs <= costs.min() + EVIDENCE_INTERVAL))
    return np.asarray(right.T @ ((singular / variances[best])[:, None] * rotated))


def _loo_residuals(
    left: FloatArray, singular: FloatArray, centred: FloatArray, rotated: FloatArray, ridge: float
) -> FloatArray:
    kept = singular**2 / (singular**2 + ridge)
    leverage = 1 / len(left) + left**2 @ kept
    residual = centred - left @ (kept[:, None] * rotated)
    # Rows of leverage 1 have no leave-one-out prediction.
    return np.asarray(residual / np.maximum(1 - leverage, 1e-9)[:, None])
