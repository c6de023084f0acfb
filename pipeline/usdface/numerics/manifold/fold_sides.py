"""Points in a fold follow the markers of their own side: lips that touch, lids that meet.

A process over a surface forgets what a marker does over its length scale, which lips are not
thick enough for: from a marker on the lip to where lips touch it loses about half of the opening.
But a lip's inside goes with the lip. So where a marker is near through the air and far along the
surface, there is a fold, and a point in it takes, by the *share* s(x) that the fold has of it, what
the process says at the markers of its own side instead of what it says at the point::

    h(x) <- (1 - s(x)) h(x) + s(x) sum_i q_i(x) h(x_i),      q_i ~ (distance along the surface)^-6

h being anything the prediction is linear in. Features of a covariance stay features, so it stays
positive definite; what they lose is part of the point's own variance; markers are met as before.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from usdface.core.arrays import Float32Array, FloatArray

LEAST_DETOUR, FULL_DETOUR = 2.0, 3.0
"""Way along the surface over the straight line: below the one there is no fold, above the other
there is nothing else. A cheek's are 1.0 to 1.4, across closed lips they are 3 to 8."""

NEAR = 0.3
"""Of the markers' spread: a marker farther away through the air says nothing of a fold."""

_POWER = 6
"""4 leaves 74 to 85 % of the lips' opening on the fixture faces, 6 leaves 82 to 93 %; from 8 on
errors grow, since points then jump from marker to marker."""

_COLUMNS = 1 << 15


@dataclass(frozen=True)
class FoldSides:
    """Where folds are, and whom points in them follow.

    Attributes
    ----------
    points : (n,) int array
        Those in a fold.
    share : (n,) float32 array
        The fold's share of each [0-1].
    follow : (n, markers) float32 array
        Weights q of the markers of its own side, sum 1.
    """

    points: NDArray[np.int64]
    share: Float32Array
    follow: Float32Array

    def apply(self, at_points: NDArray[np.floating], at_markers: NDArray[np.floating]) -> None:
        """Let points in folds follow their side, in place.

        Parameters
        ----------
        at_points : (all points, k) float array
            Values that the prediction is linear in; changed.
        at_markers : (markers, k) float array
            The same at the markers.
        """
        own = self.follow @ at_markers.astype(np.float32)
        here = at_points[self.points]
        at_points[self.points] = here + self.share[:, None] * (own - here)


def find_fold_sides(
    geodesic: NDArray[np.floating], euclidean: NDArray[np.floating], *, spread: float
) -> FoldSides:
    """Find the points in folds.

    Parameters
    ----------
    geodesic, euclidean : (markers, points) float array
        Distances along the surface and through the air [mm].
    spread : float
        Root mean square of the markers' coordinates around their centre [mm].
    """
    found, shares, follows = [], [], []
    reach = NEAR * spread
    for start in range(0, geodesic.shape[1], _COLUMNS):
        along = np.asarray(geodesic[:, start : start + _COLUMNS], np.float64)
        straight = np.asarray(euclidean[:, start : start + _COLUMNS], np.float64)
        detour = along / np.maximum(straight, 1e-6)
        fold = _rise(detour, LEAST_DETOUR, FULL_DETOUR) * (1 - _rise(straight, reach, 2 * reach))
        share = fold.max(axis=0)
        inside = np.flatnonzero(share > 0)
        near = np.maximum(along[:, inside], 1e-6)
        weights = (near.min(axis=0) / near) ** _POWER
        found.append(inside + start)
        shares.append(share[inside].astype(np.float32))
        follows.append((weights / weights.sum(axis=0)).T.astype(np.float32))
    return FoldSides(np.concatenate(found), np.concatenate(shares), np.concatenate(follows))


def _rise(values: FloatArray, low: float, high: float) -> FloatArray:
    """Go from 0 at `low` to 1 at `high`, smoothly."""
    t = np.clip((values - low) / (high - low), 0.0, 1.0)
    out: FloatArray = t * t * (3.0 - 2.0 * t)
    return out
