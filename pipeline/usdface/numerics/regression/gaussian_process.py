"""Gaussian process regression with settings chosen by closed-form leave-one-out errors.

The covariance is the sum of those of a linear function, a local correction and a constant::

    k(x, y) = <x, y> + radial exp(-|x - y|^2 / (2 width m)) + OFFSET_VARIANCE

of features scaled by ``variance ** (-power / 2)``, and such that the expected ``<x, x>`` is
LINE_VARIANCE; m is the median squared distance between the pairs. Chosen are the number of
features, power, radial, width and, for every output, the noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import FloatArray, IntArray
from usdface.numerics.regression.linear_ridge import check_examples

LINE_VARIANCE = 10.0
OFFSET_VARIANCE = 100.0
"""Prior variance of the constant, large against weights in [0-1]."""

NOISES = 10.0 ** np.arange(-3.0, 1.1, 0.5)
"""Noise variances tried, in units of the covariance before its factor `amplitude`. With less than
1e-3 (a standard deviation of a weight of about .01) fits would follow the markers' noise."""

ERROR_SLACK = 0.05
"""Relative difference from the least error up to which the smoothest fit is chosen: few pairs do
not resolve less."""

_GROUP_COUNT = 4
"""Number of groups of similar pairs that are left out together. Of 3 to 10, 4 and 3 give the best
coverage on simulated performers with few markers (decision 49)."""

_MOST_LEVERAGE = 1 - 1e-6
"""Keeps leave-one-out residuals finite."""


@dataclass(frozen=True)
class ProcessSettings:
    """One covariance to try."""

    dimensions: int
    """Number of features used."""
    power: float
    """Degree of whitening: 0 none, 1 full."""
    radial: float = 0.0
    """Prior variance of the local part."""
    width: float = 1.0
    """Squared width of the local part in median squared distances."""


@dataclass(frozen=True)
class GaussianProcess:
    """A fitted process, of mean ``r @ slope + intercept + exp(exponent |r - centres|^2) @ dual``.

    With ``r = x[:d] * scale``.
    """

    scale: FloatArray
    """(d,): factors of the features; d is the choice's dimensions."""
    centres: FloatArray
    """(n, d): scaled features of the pairs."""
    exponent: float
    """Of the local part: ``exp(exponent * squared distance)``."""
    slope: FloatArray
    """(d, s)"""
    intercept: FloatArray
    """(s,)"""
    dual: FloatArray
    """(n, s): coefficients of the local part, 0 without it."""
    residuals: FloatArray
    """(n, s): output minus its leave-one-out prediction."""
    amplitude: FloatArray
    """(s,): factor of the covariance, noise included, with which residuals of left-out pairs have
    their expected size: the mean of ``residual^2 / variance``, of pairs left out one at a time or
    in groups of similar ones, whichever is larger. Without a group, the process has to extrapolate
    as in a performance unlike the references."""


def usable_choices(choices: Sequence[ProcessSettings], *, most: int) -> tuple[ProcessSettings, ...]:
    """Return the distinct choices limited to the dimensions available."""
    limited = (
        ProcessSettings(min(c.dimensions, most), c.power, c.radial, c.width) for c in choices
    )
    return tuple(dict.fromkeys(limited))


def leave_one_out_errors(
    features: FloatArray,
    outputs: FloatArray,
    *,
    variances: FloatArray,
    choices: Sequence[ProcessSettings],
) -> FloatArray:
    """Return mean squared leave-one-out errors by choice, noise and output: (choices, r, s).

    Parameters
    ----------
    features : (n, D) float array
    outputs : (n, s) float array
    variances : (D,) float array
        Of the features over all frames; positive, descending.
    """
    check_examples(features, outputs)
    out = np.empty((len(choices), len(NOISES), outputs.shape[1]))
    scalings = {(choice.dimensions, choice.power) for choice in choices}
    scaled = {each: _Scaled(features, variances, *each) for each in scalings}
    for i, choice in enumerate(choices):
        covariance = scaled[choice.dimensions, choice.power].covariance(choice)
        values, vectors = np.linalg.eigh(covariance)
        values = np.maximum(values, 0.0)
        rotated = vectors.T @ outputs
        unfitted = NOISES / (values[:, None] + NOISES)  # eigenvalues of I - hat matrix
        leverage = np.minimum(vectors**2 @ (1 - unfitted), _MOST_LEVERAGE)
        fit = np.tensordot(vectors, unfitted[:, :, None] * rotated[:, None], 1)
        residual = fit / (1 - leverage[:, :, None])
        out[i] = (residual**2).mean(axis=0)
    return out


def smoothest_near_best(errors: FloatArray) -> IntArray:
    """Return the row of the smoothest setting whose error is near the least, by column: (s,).

    Parameters
    ----------
    errors : (r, s) float array
        Rows from the roughest to the smoothest setting.
    """
    near = errors <= (1 + ERROR_SLACK) * errors.min(axis=0)
    return np.asarray(len(errors) - 1 - near[::-1].argmax(axis=0))


def fit_gaussian_process(
    features: FloatArray,
    outputs: FloatArray,
    *,
    variances: FloatArray,
    choice: ProcessSettings,
    noise: FloatArray,
) -> GaussianProcess:
    """Fit all outputs under one covariance, each with its own noise.

    Parameters
    ----------
    features, outputs, variances, choice
        See `leave_one_out_errors`.
    noise : (s,) float array
    """
    check_examples(features, outputs)
    scaled = _Scaled(features, variances, choice.dimensions, choice.power)
    covariance = scaled.covariance(choice)
    groups = _similar_pairs(scaled.rows)
    dual, residuals = np.empty_like(outputs), np.empty_like(outputs)
    amplitude = np.empty(outputs.shape[1])
    for level in np.unique(noise):
        same = noise == level
        inverse = np.linalg.inv(covariance + level * np.eye(len(covariance)))
        each = inverse @ outputs[:, same]
        precision = np.diag(inverse)[:, None]
        residual = each / precision  # Rasmussen and Williams 2006, eq. 5.12
        singly = (residual**2 * precision).mean(axis=0)
        amplitude[same] = np.maximum(singly, _group_amplitude(inverse, each, groups))
        dual[:, same], residuals[:, same] = each, residual
    return GaussianProcess(
        scale=scaled.scale,
        centres=scaled.rows,
        exponent=scaled.exponent(choice),
        slope=scaled.rows.T @ dual,
        intercept=OFFSET_VARIANCE * dual.sum(axis=0),
        dual=choice.radial * dual,
        residuals=residuals,
        amplitude=amplitude,
    )


def _similar_pairs(rows: FloatArray) -> list[IntArray]:
    """Return up to `_GROUP_COUNT` clusters of rows by Ward's method."""
    from scipy.cluster.hierarchy import fcluster, linkage  # SciPy is only loaded for training

    group = fcluster(linkage(rows, "ward"), _GROUP_COUNT, "maxclust")
    return [np.flatnonzero(group == k) for k in np.unique(group)]


def _group_amplitude(inverse: FloatArray, dual: FloatArray, groups: list[IntArray]) -> FloatArray:
    """Return the mean of ``residual^2 / variance`` over pairs left out in groups: (s,).

    The prediction of a left-out group g has the covariance ``V = (K^-1)_gg^-1`` and the error
    ``V (K^-1 y)_g``.
    """
    squared = np.empty_like(dual)
    for group in groups:
        covariance = np.linalg.inv(inverse[np.ix_(group, group)])
        squared[group] = (covariance @ dual[group]) ** 2 / np.diag(covariance)[:, None]
    return np.asarray(squared.mean(axis=0))


class _Scaled:
    """Scaled features, and the terms of their covariances."""

    def __init__(
        self, features: FloatArray, variances: FloatArray, dimensions: int, power: float
    ) -> None:
        kept = variances[:dimensions]
        whitened = kept ** (1 - power)
        self.scale: FloatArray = np.sqrt(LINE_VARIANCE * whitened / (kept * whitened.sum()))
        self.rows: FloatArray = features[:, :dimensions] * self.scale
        size2 = np.einsum("ij,ij->i", self.rows, self.rows)
        self._product: FloatArray = self.rows @ self.rows.T
        self._distance2: FloatArray = np.maximum(size2[:, None] + size2 - 2 * self._product, 0.0)
        pairs = self._distance2[~np.tri(len(size2), dtype=np.bool_)]
        median = float(np.median(pairs)) if len(pairs) else 0.0
        self._median = max(median, 1e-12 * LINE_VARIANCE)

    def exponent(self, choice: ProcessSettings) -> float:
        return -0.5 / (choice.width * self._median)

    def covariance(self, choice: ProcessSettings) -> FloatArray:
        out: FloatArray = self._product + OFFSET_VARIANCE
        if choice.radial:
            out += choice.radial * np.exp(self.exponent(choice) * self._distance2)
        return out
