"""Points in folds of the surface follow the markers of their own side: lips, lids.

Where lips touch, the covariance of a point inside has fallen with the distance along the surface to
the lip's markers, and about half of the opening is lost; but a lip's inside moves with the lip. A
fold is where a marker is near by the straight line and far along the surface. A point x in a fold
takes, by the share s(x) of the fold, the values at the markers of its own side::

    h(x) <- (1 - s(x)) h(x) + s(x) sum_i q_i(x) h(x_i),    q_i = d_i^-6 / sum_j d_j^-6

with d the distance along the surface and h whatever the prediction is linear in. Features of a
covariance stay features: it stays positive definite, and what they lose in length becomes part of
the point's own variance. Markers are met as before.
"""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import Float32Array, FloatArray, IntArray, RealArray

LEAST_DETOUR, FULL_DETOUR = 2.0, 3.0
"""Distance along the surface over the straight line: s is 0 below the first and 1 above the second.
The ratio is 1.0 to 1.4 on a cheek and 3 to 8 across closed lips."""

NEAR_MARKER_SHARE = 0.3
"""Straight distance over the markers' spread up to which a marker counts as near; s falls to 0 at
twice that."""

_WEIGHT_POWER = 6
"""Exponent in q. 4 keeps 74 to 85 % of the lips' opening on the fixture faces, 6 keeps 82 to 93 %;
from 8 on errors grow, since the nearest marker alone counts."""

_BLOCK_POINTS = 1 << 15
"""Points evaluated in double precision at once."""


@dataclass(frozen=True)
class Folds:
    """Which points lie in folds, and the markers they follow."""

    points: IntArray
    """(n,): those in a fold."""
    share: Float32Array
    """(n,): s [0-1]"""
    weights: Float32Array
    """(n, markers): q, sum 1."""

    def apply(self, at_points: RealArray, at_markers: RealArray) -> None:
        """Replace h at points in folds, in place.

        Parameters
        ----------
        at_points : (all points, k) float array
            h; changed.
        at_markers : (markers, k) float array
            h at the markers.
        """
        of_side = self.weights @ at_markers.astype(np.float32)
        before = at_points[self.points]
        at_points[self.points] = before + self.share[:, None] * (of_side - before)


def find_folds(geodesic: RealArray, euclidean: RealArray, *, spread: float) -> Folds:
    """Find the points in folds.

    Parameters
    ----------
    geodesic, euclidean : (markers, points) float array
        Distances along the surface and by the straight line [mm].
    spread : float
        Root mean square of the markers' coordinates around their centre [mm].
    """
    points, shares, weights = [], [], []
    near = NEAR_MARKER_SHARE * spread
    for start in range(0, geodesic.shape[1], _BLOCK_POINTS):
        along = np.asarray(geodesic[:, start : start + _BLOCK_POINTS], np.float64)
        straight = np.asarray(euclidean[:, start : start + _BLOCK_POINTS], np.float64)
        detour = along / np.maximum(straight, 1e-6)
        fold = _smoothstep(detour, LEAST_DETOUR, FULL_DETOUR)
        share = (fold * (1 - _smoothstep(straight, near, 2 * near))).max(axis=0)
        inside = np.flatnonzero(share > 0)
        distance = np.maximum(along[:, inside], 1e-6)
        q = (distance.min(axis=0) / distance) ** _WEIGHT_POWER
        points.append(inside + start)
        shares.append(share[inside].astype(np.float32))
        weights.append((q / q.sum(axis=0)).T.astype(np.float32))
    return Folds(np.concatenate(points), np.concatenate(shares), np.concatenate(weights))


def _smoothstep(values: FloatArray, low: float, high: float) -> FloatArray:
    """Rise from 0 at `low` to 1 at `high`: ``t^2 (3 - 2 t)``."""
    t = np.clip((values - low) / (high - low), 0.0, 1.0)
    out: FloatArray = t * t * (3.0 - 2.0 * t)
    return out
