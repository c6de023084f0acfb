"""How far the process is wrong at markers it is not told, and how far it expects to be.

A Gaussian process says too little or too much where a face is less, or more, smooth than on the
whole. What it is surprised by at left-out markers, near each, says by how much.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from usdface.numerics.manifold.hyper_posterior import MarkerSpectrum

Array = NDArray[np.float64]
Float32Array = NDArray[np.float32]

_NORMAL_95 = 1.959963984540054
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

    errors: Array
    expected: Array

    def of_axis(self, axis: int) -> "LeftOut":
        """Every third chain: those of one axis, where chains go x, y, z frame by frame."""
        return LeftOut(self.errors[axis::3], self.expected[axis::3])


def leave_markers_out(spectrum: MarkerSpectrum, displacements: Array, theta: Array) -> LeftOut:
    """Predict every marker from the others, in closed form (Rasmussen and Williams, eq. 5.12).

    Parameters
    ----------
    spectrum : MarkerSpectrum
    displacements : (chains, N) float array
        [mm]
    theta : (samples, 4, chains) float array
        Predictions are averaged over the samples.
    """
    Q = spectrum.vectors
    covariance = (Q * spectrum.values) @ Q.T
    trend = Q @ spectrum.trend
    linear = trend[:, 1:] @ trend[:, 1:].T
    errors, squares = np.empty_like(displacements), np.empty_like(displacements)
    for chain, row in enumerate(displacements):
        v0, v1, a0, a1 = (np.exp(theta[:, k, chain])[:, None, None] for k in range(4))
        whole = v0 * covariance + a0 + a1 * linear + v1 * np.eye(len(Q))
        inverse = np.linalg.inv(whole)
        own = np.diagonal(inverse, axis1=1, axis2=2)
        each = (inverse @ row) / own
        errors[chain] = each.mean(axis=0)
        squares[chain] = (1.0 / own).mean(axis=0) + each.var(axis=0)
    return LeftOut(errors, np.sqrt(squares))


def calibrate_spread(left_out: LeftOut, covariance: Array, cross: Float32Array) -> Float32Array:
    """Find by how much standard deviations must be widened, over the surface.

    Each marker's mean squared surprise is spread to the points it speaks for; then one factor
    makes 95 of 100 left-out values lie within the 95 % interval.

    Parameters
    ----------
    left_out : LeftOut
    covariance : (N, N) float array
        Between markers, 1 on its diagonal.
    cross : (points, N) float32 array
        Covariance of points with markers.

    Returns
    -------
    (points,) float32 array
    """
    z = left_out.errors / left_out.expected
    surprise = (z**2).mean(axis=0)
    near = np.maximum(covariance, 0.0) ** 2
    np.fill_diagonal(near, 0.0)  # a marker may not speak for itself where it is left out
    at_markers = _spread(near, surprise)
    factor = np.quantile(np.abs(z / np.sqrt(at_markers)), 0.95) / _NORMAL_95
    at_points = _spread(np.maximum(cross, 0.0) ** 2, surprise)
    return np.float32(factor * np.sqrt(at_points))


def _spread(weights: NDArray[np.floating], surprise: Array) -> Array:
    total = weights.sum(axis=1) + _WEIGHT
    spread: Array = (weights @ surprise + _WEIGHT * surprise.mean()) / total
    return spread
