"""A linear face, calibrated: what shapes do to markers, and that inverted.

Prior: what the rig's shapes do where the markers sit (`marker_prior`).
Forward: ``z = w B + b + noise`` with B near that prior and corrected by the pairs. Backward:
weights are Gaussian around the pairs' mean, so the most probable weights given z are linear in z.
Unlike a regression from z to w, it knows shapes that the pairs hardly used, and separates shapes
that the pairs only used together.
"""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import FloatArray

_RIDGES = 10.0 ** np.arange(-2.5, 1.1, 0.5)
_SPREADS = (0.05, 0.1)
"""Standard deviation of every weight alone, beside what the pairs' covariance says."""

_INDEPENDENT_SHARE = 0.15
"""How much of the weights' covariance is each weight alone; the rest is the pairs'."""

_MOST_SINGLE_PAIRS = 100
_FOLD_COUNT = 25
"""Pairs are left out one by one up to the first number, beyond in this many parts."""

_COORDINATE_NOISE_MM = 0.03
"""Least noise of a coordinate."""
_CORRELATED_SHARE = 0.4
"""Of the errors' covariance that is taken as it is; the rest marker by marker: pairs are few."""
_MARKER_EVIDENCE = 3.0
"""How much more markers say together than one direction's error suggests."""


@dataclass(frozen=True)
class LinearPosterior:
    """``w = z @ slope + intercept``, and the forward map it inverts.

    Attributes
    ----------
    slope : (d, s) float array
    intercept : (s,) float array
    residuals : (n, s) float array
        Weights of each pair minus their prediction by a fit that has not seen it.
    forward : (s, d) float array
    noise : (d, d) float array
        Covariance of what the forward map leaves over [mm^2].
    ridge, spread : float
        As chosen.
    """

    slope: FloatArray
    intercept: FloatArray
    residuals: FloatArray
    forward: FloatArray
    noise: FloatArray
    ridge: float
    spread: float


@dataclass(frozen=True)
class _Forward:
    matrix: FloatArray
    offset: FloatArray
    residuals: FloatArray


def fit_linear_posterior(
    coordinates: FloatArray,
    weights: FloatArray,
    *,
    expected: FloatArray,
    components: FloatArray,
    variances: FloatArray,
    gram: FloatArray,
) -> LinearPosterior:
    """Calibrate the forward map, invert it, and choose how by leave-one-out.

    Parameters
    ----------
    coordinates : (n, d) float array
        Of the pairs [mm].
    weights : (n, s) float array
    expected : (s, d) float array
        What each shape should do to the coordinates; zeros where nothing is known.
    components : (d, markers * 3) float array
        Orthonormal rows: from markers to coordinates.
    variances : (d,) float array
        Of the coordinates over all frames: makes errors of small motions count.
    gram : (s, s) float array
        Quadratic form that weighs the weights' errors.

    Raises
    ------
    ValueError
        If there are fewer than three pairs or the arrays do not fit together.
    """
    n, s = weights.shape
    if n < 3:
        raise ValueError(f"a calibration needs at least 3 pairs, got {n}")
    if expected.shape != (s, coordinates.shape[1]) or len(coordinates) != n:
        raise ValueError(
            f"coordinates {coordinates.shape}, weights {weights.shape} and expected "
            f"{expected.shape} do not fit together"
        )
    importance = 1 / np.sqrt(variances)
    fits = [_calibrate(coordinates, weights, expected, ridge) for ridge in _RIDGES]
    scores = [float((fit.residuals**2).mean(axis=0) @ importance) for fit in fits]
    ridge = float(_RIDGES[int(np.argmin(scores))])
    whole = fits[int(np.argmin(scores))]
    out = np.array_split(np.arange(n), n if n <= _MOST_SINGLE_PAIRS else _FOLD_COUNT)
    others = [np.setdiff1d(np.arange(n), each) for each in out]
    without = [_calibrate(coordinates[k], weights[k], expected, ridge) for k in others]
    tried = []
    for spread in _SPREADS:
        predicted = np.empty_like(weights)
        for left, rest, fit in zip(out, others, without, strict=True):
            slope, intercept = _invert(
                fit, weights[rest], _noise_of(whole.residuals[rest], components), spread
            )
            predicted[left] = coordinates[left] @ slope + intercept
        error = weights - predicted
        tried.append((float(np.einsum("ns,st,nt->", error, gram, error)), spread, error))
    _, spread, residuals = min(tried, key=lambda entry: entry[0])
    noise = _noise_of(whole.residuals, components)
    slope, intercept = _invert(whole, weights, noise, spread)
    return LinearPosterior(slope, intercept, residuals, whole.matrix, noise, ridge, spread)


def _calibrate(z: FloatArray, w: FloatArray, expected: FloatArray, ridge: float) -> _Forward:
    """Ridge regression of coordinates on weights, shrunk to what is expected."""
    mean_z, mean_w = z.mean(axis=0), w.mean(axis=0)
    rows = w - mean_w
    penalty = ridge * max(float((rows**2).mean()), 1e-9) * len(w)
    # As large as the pairs, however many shapes there are: (R'R + p)^-1 R' = R' (RR' + p)^-1.
    product = rows @ rows.T
    inverse = np.linalg.inv(product + penalty * np.eye(len(w)))
    matrix = expected + rows.T @ (inverse @ (z - mean_z - rows @ expected))
    leverage = np.einsum("ij,ij->i", product, inverse) + 1 / len(w)
    residual = (z - mean_z - rows @ matrix) / np.maximum(1 - leverage, 0.02)[:, None]
    return _Forward(matrix, mean_z - mean_w @ matrix, residual)


def _noise_of(residuals: FloatArray, components: FloatArray) -> FloatArray:
    """Covariance of the forward map's errors: marker by marker, and partly as they come together.

    A jaw marker is off by more than a lid marker. Marker by marker, the jaw's errors leave what the
    lids say alone.
    """
    together = residuals.T @ residuals / len(residuals)
    at_markers = (residuals @ components).reshape(len(residuals), -1, 3)
    each = np.repeat((at_markers**2).mean(axis=(0, 2)), 3)
    at_each = (components * each) @ components.T / _MARKER_EVIDENCE
    floor = _COORDINATE_NOISE_MM**2 * np.eye(len(together))
    noise: FloatArray = _CORRELATED_SHARE * together
    noise += (1 - _CORRELATED_SHARE) * at_each + floor
    return noise


def _invert(
    fit: _Forward, w: FloatArray, noise: FloatArray, spread: float
) -> tuple[FloatArray, FloatArray]:
    """Mean of the weights given the coordinates: ``S B (B' S B + R)^-1`` and its constant."""
    mean = w.mean(axis=0)
    independent = _INDEPENDENT_SHARE * spread**2
    rows = w - mean
    together = rows.T @ (rows @ fit.matrix) / max(len(w) - 1, 1)  # their covariance, not formed
    carried = independent * fit.matrix + (1 - _INDEPENDENT_SHARE) * together
    slope = np.linalg.solve(fit.matrix.T @ carried + noise, carried.T).astype(np.float64)
    return slope, mean - (mean @ fit.matrix + fit.offset) @ slope
