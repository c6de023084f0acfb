"""How far the process is wrong at markers it is not told, and how far it expects to be.

A Gaussian process says too little or too much where a face is less, or more, smooth than on the
whole. What it is surprised by at left-out markers, near each, says by how much. Markers come in
rows, along lids and lips: one that is left out is told by its neighbour in the row, and points off
the row are not. So for that question its nearest neighbour is left out with it.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from usdface.core.arrays import Float32Array, FloatArray
from usdface.numerics.manifold.hyper_posterior import MarkerSpectrum

_NORMAL_95 = 1.959963984540054
_JITTER = 1e-10  # of the trace: samples without any noise stay invertible
_LEAST = 1e-3  # a face at rest surprises nobody
_WEIGHT = 0.3
"""Markers' worth of surprise of the average place that each place is given: a few markers say
little of one place."""


@dataclass(frozen=True)
class LeftOut:
    """Predictions of markers that were left out of the fit, one after the other.

    Attributes
    ----------
    errors : (chains, N) float array
        Measured minus predicted [mm].
    expected : (chains, N) float array
        Standard deviation foreseen, the marker's noise included [mm].
    """

    errors: FloatArray
    expected: FloatArray


@dataclass(frozen=True)
class Widening:
    """By how much standard deviations are to be multiplied.

    Attributes
    ----------
    of_axes : (3,) float array
    of_points : (points,) float32 array
    """

    of_axes: FloatArray
    of_points: Float32Array


def leave_markers_out(
    spectrum: MarkerSpectrum,
    displacements: FloatArray,
    theta: FloatArray,
    *,
    with_nearest: bool = False,
) -> LeftOut:
    """Predict every marker from the others, in closed form (Rasmussen and Williams, eq. 5.12).

    Parameters
    ----------
    spectrum : MarkerSpectrum
    displacements : (chains, N) float array
        [mm]
    theta : (samples, 4, chains or 1) float array
        Predictions are averaged over the samples; one theta may serve all chains.
    with_nearest : bool
        Whether the marker that is most alike is left out too: from all but these two.
    """
    Q = spectrum.vectors
    covariance = (Q * spectrum.values) @ Q.T
    trend = Q @ spectrum.trend
    linear = trend[:, 1:] @ trend[:, 1:].T
    errors, squares = np.empty_like(displacements), np.empty_like(displacements)
    scales = np.exp(np.clip(theta, -30.0, 30.0))  # a take at rest has none
    together = theta.shape[2] == 1
    others = covariance - 2.0 * np.diag(np.diagonal(covariance))
    markers, nearest = np.arange(len(Q)), others.argmax(axis=1)
    for chain in range(theta.shape[2]):
        rows = slice(None) if together else slice(chain, chain + 1)
        v0, v1, a0, a1 = (scales[:, k, chain][:, None, None] for k in range(4))
        whole = v0 * covariance + a0 + a1 * linear + v1 * np.eye(len(Q))
        whole += _JITTER * np.trace(whole, axis1=1, axis2=2)[:, None, None] * np.eye(len(Q))
        inverse = np.linalg.inv(whole)
        own = np.diagonal(inverse, axis1=1, axis2=2)[:, None]
        told = displacements[rows] @ inverse
        each, expected = told / own, 1.0 / own
        if with_nearest:
            across = inverse[:, None, markers, nearest]
            determinant = own * own[..., nearest] - across**2
            each = (own[..., nearest] * told - across * told[..., nearest]) / determinant
            expected = own[..., nearest] / determinant
        errors[rows] = each.mean(axis=0)
        squares[rows] = expected.mean(axis=0) + each.var(axis=0)
    return LeftOut(errors, np.sqrt(squares))


def calibrate_spread(left_out: LeftOut, covariance: FloatArray, cross: Float32Array) -> Widening:
    """Find by how much standard deviations must be widened, over the surface and along its axes.

    Each marker's mean squared surprise is spread to the points it speaks for; then one factor
    for each axis makes 95 of 100 left-out values lie within the 95 % interval.

    Parameters
    ----------
    left_out : LeftOut
        Chains go x, y, z, frame by frame.
    covariance : (N, N) float array
        Between markers, 1 on its diagonal.
    cross : (points, N) float32 array
        Covariance of points with markers.
    """
    z = (left_out.errors / left_out.expected).reshape(-1, 3, left_out.errors.shape[1])
    size = np.sqrt((z**2).mean(axis=(0, 2), keepdims=True))
    surprise = ((z / np.maximum(size, _LEAST)) ** 2).mean(axis=(0, 1))
    near = np.maximum(covariance, 0.0) ** 2
    np.fill_diagonal(near, 0.0)  # a marker may not speak for itself where it is left out
    levelled = np.abs(z) / np.sqrt(_spread(near, surprise))
    factors = np.quantile(np.moveaxis(levelled, 1, 0).reshape(3, -1), 0.95, axis=1) / _NORMAL_95
    of_points = np.sqrt(_spread(np.maximum(cross, 0.0) ** 2, surprise))
    return Widening(np.maximum(factors, _LEAST), of_points.astype(np.float32))


def _spread(weights: NDArray[np.floating], surprise: FloatArray) -> FloatArray:
    total = weights.sum(axis=1) + _WEIGHT
    spread: FloatArray = (weights @ surprise + _WEIGHT * surprise.mean()) / total
    return np.maximum(spread, _LEAST)
