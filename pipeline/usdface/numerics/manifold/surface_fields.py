"""Fields over a surface by distances from its markers: covariance, multiquadric, folds.

**Covariance** (W06 eq. 7), made positive definite. With geodesic distances the paper's ``exp(-d^2 /
(2 l^2))`` is no covariance: its matrix over the markers has negative eigenvalues at the length
scales of a face. It is also far smoother than faces, whose lips and lids crease between markers, so
that intervals are too narrow. The default is ``'creased'``, the sum of a Matérn 3/2 and an
exponential covariance, with ``r = d / l``::

    (1 - a) (1 + sqrt(3) r) exp(-sqrt(3) r) + a exp(-r),    a = `ROUGH_SHARE`

Over a surface it may have negative eigenvalues too, though rarely. So for either shape:

1. The covariance over the markers is projected to the positive definite cone, ``K+ = Q L Q'``.
2. Every point x has features ``f(x) = L^(-1/2) Q' k(x)``, so that ``<f(x), f(y)>`` is K+ between
   markers. Where ``|f(x)| > 1`` they are scaled to length 1.
3. The covariance is ``<f(x), f(y)>``, and 1 of a point with itself: ``1 - |f(x)|^2`` is independent
   variance of the point.

An inner product plus a diagonal of 0 or more is positive semidefinite over any set of points, so
that no predicted variance is negative, and all points have the prior variance v0 of eq. 7.

**Multiquadric** (Hardy's, with any distance: W06, "Geodesic manifold distances"):
``F(x) = sum_i w_i sqrt(d(x, i)^2 + s_i^2)``, interpolates at the markers.

**Folds**, such as lips and lids: the inside of a lip moves with the lip, but its covariance with
the lip's markers falls with the distance along the surface, so that about half of the opening is
lost. A point x is across a fold from marker k in a share s_k(x), if k is far along the surface, but
near by the straight line, and no farther than the nearest marker along the surface. With their
largest, s(x), it follows the markers of its own side::

    h(x) <- (1 - s(x)) h(x) + s(x) sum_i q_i(x) h(x_i)
    q_i ~ d_i(x)^-6 sum_k s_k(x) (1 - e_ik / d_ik),    sum_i q_i = 1

with d the distance along the surface, e the straight one, and h any quantity in which the
prediction is linear. The detour between markers tells their sides: from one at the nose to one at
the corner of the mouth there is none, to one on the chin there is. With features as h the
covariance remains positive semidefinite. Predictions at markers do not change.

Two points at a distance d differ with a variance of twice the semivariogram (Matheron, 1963), ``2
v0 (1 - c(d / l))``. That of the mean distance to the markers is added, as a share of v0::

    added(x) = 2 s(x) (1 - c(d(x) / l)),    d(x) = sum_i q_i(x) d_i(x)
"""

from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from usdface.core.arrays import (
    Float32Array,
    FloatArray,
    IntArray,
    RealArray,
    frame_blocks,
    nearest_distances,
    smoothstep,
)

LEAST_DETOUR, FULL_DETOUR = 1.5, 3.0
"""Distance along the surface over the straight line: s is 0 below the first and 1 above the second.
The ratio is 1.0 to 1.4 on a cheek and 3 to 8 across closed lips."""

NEAR_MARKER_SHARE = 0.3
"""Straight distance over the markers' spread at which s begins to fall, to 0 at twice that."""

_WEIGHT_POWER = 6
"""Exponent in q. 4 preserves 74 to 85 % of the lips' opening on the fixture faces, 6 82 to 93 %;
from 8 on errors increase, since the nearest marker alone counts."""


@dataclass(frozen=True)
class Folds:
    """Points in folds, and the markers they follow."""

    points: IntArray
    """(n,): those in a fold."""
    share: Float32Array
    """(n,): s [0-1]"""
    weights: Float32Array
    """(n, markers): q, sum 1."""
    away: Float32Array
    """(n,): mean distance to those markers along the surface [mm]."""

    def apply(self, at_points: RealArray, at_markers: RealArray) -> None:
        """Change h at all points (points, k) in place, by that at the markers (markers, k)."""
        of_side = self.weights @ at_markers.astype(np.float32)
        before = at_points[self.points]
        at_points[self.points] = before + self.share[:, None] * (of_side - before)


def find_folds(
    geodesic: RealArray, euclidean: RealArray, *, detours: FloatArray, spread: float
) -> Folds:
    """Find the points in folds.

    Parameters
    ----------
    geodesic, euclidean : (markers, points) float array
        Distances along the surface and by the straight line [mm].
    detours : (markers, markers) float array
        ``1 - e / d`` [0-1]
    spread : float
        Root mean square of the markers' coordinates around their centre [mm].
    """
    points, shares, weights, away = [], [], [], []
    for part in frame_blocks(geodesic.shape[1], frames=_BLOCK_POINTS):
        along = np.asarray(geodesic[:, part], np.float64)
        straight = np.asarray(euclidean[:, part], np.float64)
        fold = smoothstep(along / np.maximum(straight, 1e-6), LEAST_DETOUR, FULL_DETOUR)
        near = np.clip(along.min(axis=0), 1e-6, NEAR_MARKER_SHARE * spread)
        fold *= smoothstep(2 - straight / near)
        share = fold.max(axis=0)
        inside = np.flatnonzero(share > 0)
        distance = np.maximum(along[:, inside], 1e-6)
        q = (distance.min(axis=0) / distance) ** _WEIGHT_POWER
        q *= detours @ fold[:, inside] + 1e-6  # the nearest, if no marker has a detour
        q /= q.sum(axis=0)
        points.append(inside + part.start)
        shares.append(share[inside].astype(np.float32))
        weights.append(q.T.astype(np.float32))
        away.append((q * distance).sum(axis=0).astype(np.float32))
    return Folds(*map(np.concatenate, (points, shares, weights, away)))


STIFFNESS_SHARE = 0.1
"""Stiffness s_i over the distance to the nearest marker. With Song's and Hardy's 1 the matrix of
geodesic distances is nearly singular (errors of centimetres); with 0 there are creases at the
markers."""

_LEAST_CONDITION = 1e-12
"""Least ratio of the smallest to the largest singular value of distinct markers."""


def nearest_stiffness(between: FloatArray) -> FloatArray:
    """Return `STIFFNESS_SHARE` of each marker's distance to the nearest other place [mm]."""
    nearest = nearest_distances(between)
    if not np.isfinite(nearest).all():
        raise ValueError("all markers sit at one place; no distance between them")
    return STIFFNESS_SHARE * nearest


def fit_distance_multiquadric(between: FloatArray, stiffness: FloatArray) -> FloatArray:
    """Return the network that interpolates the markers, with `stiffness` s_i (markers,) [mm].

    A (markers, markers) map from displacements of markers to weights of centres.
    """
    left, singular, right = np.linalg.svd(_values(between, stiffness))
    if singular[-1] < _LEAST_CONDITION * singular[0]:
        others = np.where(np.eye(len(between), dtype=np.bool_), np.inf, between)
        i, j = np.unravel_index(int(others.argmin()), others.shape)
        raise ValueError(
            f"markers {i} and {j} are {others[i, j]:.3g} mm apart and cannot both be met; "
            "leave one out"
        )
    gain = 1.0 / singular
    return np.asarray((right.T * gain) @ left.T)


def multiquadric_fields(
    inverse: FloatArray, stiffness: FloatArray, distances: RealArray
) -> Float32Array:
    """Return the linear map from displacements of markers to those of points.

    Returns (points, markers); displacements of points are ``fields @ displacements``.

    Parameters
    ----------
    inverse, stiffness
        See `fit_distance_multiquadric`.
    distances : (markers, points) float array
        [mm]
    """
    out = np.empty((distances.shape[1], len(distances)), np.float32)
    for part in frame_blocks(len(out), frames=_BLOCK_POINTS):
        out[part] = _values(distances[:, part], stiffness) @ inverse
    return out


def _values(distances: RealArray, stiffness: FloatArray) -> FloatArray:
    """Evaluate every centre at every point: (points, markers) float array."""
    squared = np.asarray(distances, np.float64).T ** 2
    squared += stiffness**2
    return np.asarray(np.sqrt(squared), np.float64)


CovarianceShape = Literal["creased", "published"]
"""``'published'`` is the squared exponential of eq. 7."""

ROUGH_SHARE = 0.4
"""Share a of the exponential covariance [0-1]. Between 0.2 and 0.7 errors hardly differ on the
fixture faces; 95 % intervals contain 93 to 96 % of held-out points at 0.4, 87 to 93 % at 0."""

SMALLEST_EIGENVALUE_SHARE = 1e-6
"""[of the largest] Smaller eigenvalues are taken for rounding errors."""

_LEAST_LEFT = 0.25
"""[of the variance unexplained by the nearest marker] Least that all markers leave unexplained.
Half way between two markers it is half in rough motion, and a third among four."""

_BLOCK_POINTS = 1 << 15
"""Points computed in double precision at once."""


@dataclass(frozen=True)
class SurfaceCovariance:
    """A covariance function, by its features."""

    shape: CovarianceShape
    length_scale: float
    """l [mm]"""
    projection: FloatArray
    """(markers, rank): ``Q L^(-1/2)``, maps similarities to the markers to features."""
    features: FloatArray
    """(markers, rank): of the markers."""
    clipped: float
    """Relative change of the markers' matrix by the projection; 0 if it was positive definite."""

    def matrix(self) -> FloatArray:
        """Return the covariance between the markers, 1 on its diagonal: (markers, markers)."""
        between = self.features @ self.features.T
        np.fill_diagonal(between, 1.0)
        return between

    def cross(self, distances: RealArray) -> Float32Array:
        """Return the covariance of points with the markers: (points, markers) float32.

        Blended distances are not those of any metric space, and far from the markers the explained
        variance may reach or exceed the prior. At least `_LEAST_LEFT` of the variance unexplained
        by the nearest marker alone remains, but for eq. 7, which is smooth.

        Parameters
        ----------
        distances : (markers, points) float array
            [mm]
        """
        out = np.empty((distances.shape[1], len(self.features)), np.float32)
        least = _LEAST_LEFT if self.shape == "creased" else 0.0
        for part in frame_blocks(len(out), frames=_BLOCK_POINTS):
            similar = similarity(distances[:, part], self.length_scale, shape=self.shape)
            longest = np.sqrt(1.0 - least * (1.0 - similar.max(axis=0) ** 2))
            out[part] = _shorten(similar.T @ self.projection, longest) @ self.features.T
        return out


def similarity(distances: RealArray, length_scale: float, *, shape: CovarianceShape) -> FloatArray:
    """Return the correlation at some distances: 1 at 0, decreasing over the length scale."""
    scaled: FloatArray = np.asarray(distances, np.float64) / length_scale
    if shape == "creased":
        rough = ROUGH_SHARE * np.exp(-scaled)
        scaled *= 3.0**0.5
        return np.asarray(
            (1.0 - ROUGH_SHARE) * (1.0 + scaled) * np.exp(-scaled) + rough, np.float64
        )
    return np.asarray(np.exp(-0.5 * scaled**2), np.float64)


def fit_covariance(
    between: FloatArray, *, length_scale: float, shape: CovarianceShape = "creased"
) -> SurfaceCovariance:
    """Fit the covariance to the distances between markers.

    Parameters
    ----------
    between : (markers, markers) float array
        [mm], symmetric.
    length_scale : float
        l [mm]; 1 in the paper's unit of length.
    shape : {'creased', 'published'}
    """
    if shape not in get_args(CovarianceShape):
        raise ValueError(
            f"no covariance {shape!r}; there are {', '.join(get_args(CovarianceShape))}"
        )
    if not length_scale > 0:
        raise ValueError(f"the length scale must be positive millimetres, got {length_scale}")
    if not np.isfinite(between).all():
        raise ValueError("distances between markers are not finite; replace pairs without a path")
    similar = similarity(between, length_scale, shape=shape)
    values, vectors = np.linalg.eigh(similar)
    positive = values > SMALLEST_EIGENVALUE_SHARE * values[-1]
    projection = vectors[:, positive] / np.sqrt(values[positive])
    features = _shorten(similar @ projection)
    covariance = SurfaceCovariance(shape, length_scale, projection, features, 0.0)
    change = float(np.linalg.norm(covariance.matrix() - similar) / np.linalg.norm(similar))
    return replace(covariance, clipped=change)


def _shorten(features: FloatArray, longest: FloatArray | float = 1.0) -> FloatArray:
    """Limit the lengths of features; their squares are shares of explained variance."""
    norms = np.linalg.norm(features, axis=1)
    return np.asarray(features * np.minimum(longest / np.maximum(norms, 1e-12), 1.0)[:, None])
