"""The covariance of W06 eq. 7 between markers, made positive definite, and its cross terms.

With geodesic distances ``exp(-d^2 / (2 l^2))`` is no covariance: its matrix over the markers has
negative eigenvalues for the length scales that suit a face. What is done about it:

1. Over the markers, the part with positive eigenvalues is kept, ``K+ = Q L Q'``.
2. Every point x gets features ``f(x) = L^(-1/2) Q' k(x)``, so that ``<f(x), f(y)>`` is K+ between
   markers. Where ``|f(x)| > 1`` they are shortened to 1.
3. The covariance is ``<f(x), f(y)>``, and 1 of a point with itself: what the features leave of the
   1 is a part of the point's own.

An inner product plus a diagonal that is 0 or more is positive definite over any set of points, so
no predicted variance is negative; and every point has the prior variance v0 that eq. 7 gives it.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Float32Array = NDArray[np.float32]

SMALLEST = 1e-6
"""Eigenvalues below this share of the largest are rounding, not covariance."""

_COLUMNS = 1 << 15  # points whose features are held in double precision at once


@dataclass(frozen=True)
class SurfaceCovariance:
    """Features that make the covariance; see the module.

    Attributes
    ----------
    length_scale : float
        [mm]
    projection : (markers, rank) float array
        ``Q L^(-1/2)``: turns similarities to the markers into features.
    features : (markers, rank) float array
        Of the markers themselves.
    clipped : float
        Change of the markers' matrix as a share of its norm; 0 where it was positive definite.
    """

    length_scale: float
    projection: Array
    features: Array
    clipped: float

    def matrix(self) -> Array:
        """Return the covariance between the markers, 1 on its diagonal: (markers, markers)."""
        between = self.features @ self.features.T
        np.fill_diagonal(between, 1.0)
        return between

    def cross(self, distances: NDArray[np.floating]) -> Float32Array:
        """Covariance of points with the markers.

        Parameters
        ----------
        distances : (markers, points) float array
            [mm]

        Returns
        -------
        (points, markers) float32 array
        """
        out = np.empty((distances.shape[1], len(self.features)), np.float32)
        for start in range(0, len(out), _COLUMNS):
            part = slice(start, start + _COLUMNS)
            similar = squared_exponential(distances[:, part], self.length_scale)
            out[part] = _shorten(similar.T @ self.projection) @ self.features.T
        return out


def squared_exponential(distances: NDArray[np.floating], length_scale: float) -> Array:
    """``exp(-d^2 / (2 l^2))``."""
    scaled: Array = np.asarray(distances, np.float64) / length_scale
    return np.asarray(np.exp(-0.5 * scaled**2), np.float64)


def fit_covariance(between: Array, *, length_scale: float) -> SurfaceCovariance:
    """Make the covariance of eq. 7 from distances between markers.

    Parameters
    ----------
    between : (markers, markers) float array
        [mm], symmetric.
    length_scale : float
        [mm]; the paper hides it in its unit of length.

    Raises
    ------
    ValueError
        If the length scale is not positive or distances are not finite.
    """
    if not length_scale > 0:
        raise ValueError(f"the length scale must be positive millimetres, got {length_scale}")
    if not np.isfinite(between).all():
        raise ValueError("distances between markers are not finite; replace pairs without a path")
    similar = squared_exponential(between, length_scale)
    values, vectors = np.linalg.eigh(similar)
    kept = values > SMALLEST * values[-1]
    projection = vectors[:, kept] / np.sqrt(values[kept])
    features = _shorten(similar @ projection)
    covariance = SurfaceCovariance(length_scale, projection, features, 0.0)
    change = float(np.linalg.norm(covariance.matrix() - similar) / np.linalg.norm(similar))
    return SurfaceCovariance(length_scale, projection, features, change)


def _shorten(features: Array) -> Array:
    norms = np.linalg.norm(features, axis=1, keepdims=True)
    shortened: Array = features / np.maximum(norms, 1.0)
    return shortened
