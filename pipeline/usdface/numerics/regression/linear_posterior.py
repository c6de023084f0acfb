"""A linear face, calibrated: what shapes do to markers, and that inverted.

Prior: a pair shows how every marker lies when the rig's weights are known. A marker belongs to the
part of the skin that, under those weights, would move as it does: no registration, no landmarks.
Shapes that the pairs hardly use, or use only together, still have a direction of motion: the rig's.
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

_GAIN_RANGE = (0.4, 2.5)
"""How much further or less far than the rig a performer's skin may go."""
_LOG_GAIN_DEVIATION = 0.35
"""Standard deviation of the gain's logarithm."""
_MARKER_NOISE_MM = 0.4
"""What a marker moves for no reason."""
_MODEL_ERROR_SHARE = 0.15
"""Of a marker's motion, which no place on another face explains."""
_PAIR_SAMPLES = 24.0
"""Independent samples that the pairs count for: faces repeat each other."""
_ROTATION_ROUNDS = 3
_SIZE_QUANTILE = 0.97
"""Quantile of points, by motion, at which two faces are compared in size."""


@dataclass(frozen=True)
class SkinPrior:
    """Expected motion of markers.

    Attributes
    ----------
    basis : (s, markers, 3) float array
        What each shape at 1 does to each marker, in the markers' space [mm].
    rotation : (3, 3) float array
        From the rig's space to the markers'.
    explained : float
        Share of the markers' motion energy in the pairs that the best places explain.
    """

    basis: FloatArray
    rotation: FloatArray
    explained: float


def expect_marker_motion(skin: FloatArray, weights: FloatArray, markers: FloatArray) -> SkinPrior:
    """Find for every marker the skin that moves as it does.

    Every point of the skin is a candidate, each with a gain; candidates are averaged by
    how well they explain the marker. The rotation between the spaces is found on the way. A rig
    of another size than any performer is brought to the performer's first.

    Parameters
    ----------
    skin : (s, points, 3) float array
        Displacement of points of the rig's surface by each shape at 1 [mm].
    weights : (pairs, s) float array
    markers : (pairs, markers, 3) float array
        [mm]

    Raises
    ------
    ValueError
        If the arrays do not fit together.
    """
    if skin.ndim != 3 or skin.shape[2] != 3 or skin.shape[0] != weights.shape[1]:
        raise ValueError(f"skin {skin.shape} and weights {weights.shape} do not fit together")
    if markers.shape[0] != len(weights):
        raise ValueError(f"{markers.shape[0]} marker clouds but {len(weights)} weights")
    seen = (markers - markers.mean(axis=0)).transpose(1, 0, 2)
    flat = (weights - weights.mean(axis=0)) @ skin.reshape(len(skin), -1)
    moved = np.ascontiguousarray(flat.reshape(len(weights), -1, 3).transpose(1, 0, 2))
    energy = np.einsum("mnc,mnc->m", seen, seen)
    size = np.einsum("pnc,pnc->p", moved, moved)
    scale = _size_of_performer(energy, size)
    skin, moved, size = skin * scale, moved * scale, size * scale**2
    values = 3 * len(weights)
    expected = _MARKER_NOISE_MM**2 + _MODEL_ERROR_SHARE**2 * energy[:, None] / values
    rotation = np.eye(3)
    for turn in range(_ROTATION_ROUNDS):
        turned = moved @ rotation.T
        product = seen.reshape(len(seen), -1) @ turned.reshape(len(turned), -1).T
        gain = np.clip(product / np.maximum(size, 1e-9), *_GAIN_RANGE)
        left = energy[:, None] - 2 * gain * product + gain**2 * size
        log_likelihood = -0.5 * _PAIR_SAMPLES * left / values / expected
        log_likelihood -= 0.5 * (np.log(gain) / _LOG_GAIN_DEVIATION) ** 2
        best = log_likelihood.argmax(axis=1)
        if turn < _ROTATION_ROUNDS - 1:
            best_gain = gain[np.arange(len(best)), best]
            rotation = _best_rotation(moved[best] * best_gain[:, None, None], seen)
    log_likelihood -= log_likelihood.max(axis=1, keepdims=True)
    share = np.exp(log_likelihood)
    share /= share.sum(axis=1, keepdims=True)
    basis = np.einsum("mp,spc->smc", share * gain, skin @ rotation.T, optimize=True)
    unexplained = left[np.arange(len(best)), best].sum() / max(float(energy.sum()), 1e-300)
    return SkinPrior(basis, rotation, float(1 - unexplained))


def _size_of_performer(seen: FloatArray, moved: FloatArray) -> float:
    """Scale that brings a rig's motion to the markers'; 1 where the points' gains reach it."""
    rig_motion = float(np.quantile(moved, _SIZE_QUANTILE)) if len(moved) else 0.0
    marker_motion = float(np.quantile(seen, _SIZE_QUANTILE)) if len(seen) else 0.0
    if rig_motion == 0 or marker_motion == 0:
        return 1.0
    scale = float(np.sqrt(marker_motion / rig_motion))
    return 1.0 if _GAIN_RANGE[0] <= scale <= _GAIN_RANGE[1] else scale


def _best_rotation(rows: FloatArray, targets: FloatArray) -> FloatArray:
    """Proper rotation that turns displacements onto others best (Kabsch, without centring)."""
    cross = np.einsum("mni,mnj->ij", rows, targets)
    left, _, right = np.linalg.svd(cross)
    flip = np.diag([1.0, 1.0, np.sign(np.linalg.det(right.T @ left.T))])
    rotation: FloatArray = right.T @ flip @ left.T
    return rotation


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
