"""The sagittal plane, about which a face is symmetric, of a marker cloud.

It determines roll and yaw of the head, half of the unknowns of a placement.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

from usdface.core.arrays import FloatArray, IntArray, rms_radius

_UP = np.array([0.0, 1.0, 0.0])
FEWEST_PAIRS = 3
"""Fewest mirrored pairs that determine a plane."""
_YAWS_DEGREES = np.arange(0, 180, 6)
_ROLLS_DEGREES = (-16, -8, 0, 8, 16)
_TOLERANCE_SHARE = 0.3
"""[of the cloud's root mean square radius] Largest distance between a marker and its partner: about
that of neighbours among 35 markers over a face, which need not be opposite each other."""

_MIDDLE_WEIGHT = 0.5
"""Of a marker on the plane, against 1 of a mirrored pair."""


@dataclass(frozen=True)
class SagittalPlane:
    """Points x of the plane satisfy ``normal @ x == offset``."""

    normal: FloatArray
    """(3,): unit vector, towards the performer's left if labels name sides, else either side."""
    offset: float
    """[mm]"""

    def mirrored(self, points: FloatArray) -> FloatArray:
        """Return points reflected in the plane."""
        away = points @ self.normal - self.offset
        return points - 2 * away[:, None] * self.normal

    def levelled_frame(self) -> FloatArray:
        """Return the rotation whose rows are left, up and forward.

        Up is as near to +Y as the plane allows. ``points @ frame.T`` has the plane at
        ``x == offset``.
        """
        up = _UP - self.normal * (self.normal @ _UP)
        up /= np.linalg.norm(up)
        return np.stack([self.normal, up, np.cross(self.normal, up)])


def plane_of_pairs(
    points: FloatArray, pairs: IntArray, middle: IntArray, *, rounds: int = 12
) -> SagittalPlane:
    """Fit the plane that mirrors left points onto right ones, robustly.

    Minimises the sum of ``w |x_right - mirror(x_left)|^2`` over pairs and ``w (n @ x - d)^2`` over
    points on the plane, with Cauchy weights: the normal is the eigenvector of the least eigenvalue
    of the pairs' midpoints' scatter less a quarter of their differences'.

    Parameters
    ----------
    points : (points, 3) float array
        [mm]
    pairs : (pairs, 2) int array
        Left and right; at least three.
    middle : (m,) int array
        Points on the plane.
    rounds : int
        Of reweighting.
    """
    left, right, on_plane = points[pairs[:, 0]], points[pairs[:, 1]], points[middle]
    across = left - right
    centres = np.concatenate([(left + right) / 2, on_plane])
    pair_weight, middle_weight = np.ones(len(pairs)), np.ones(len(middle))
    plane = SagittalPlane(_UP, 0.0)
    for _ in range(rounds):
        weight = np.concatenate([pair_weight, _MIDDLE_WEIGHT * middle_weight])
        mean = weight @ centres / weight.sum()
        spread = (centres - mean).T @ (weight[:, None] * (centres - mean))
        spread -= across.T @ (pair_weight[:, None] * across) / 4
        normal = np.linalg.eigh(spread)[1][:, 0]
        normal *= 1.0 if normal @ across.sum(axis=0) > 0 else -1.0
        plane = SagittalPlane(normal, float(normal @ mean))
        away = np.linalg.norm(right - plane.mirrored(left), axis=1)
        scale = 1.5 * np.median(away) + 0.5  # [mm], at least the accuracy of markers
        pair_weight = 1 / (1 + (away / scale) ** 2)
        middle_weight = 1 / (1 + ((on_plane @ normal - plane.offset) / (scale / 2)) ** 2)
    return plane


def plane_by_reflection(points: FloatArray) -> SagittalPlane:
    """Find the plane of symmetry of a cloud without labels.

    A grid of normals within 16 degrees of level is refined by nearest mirror images, and the best
    of these by one-to-one assignment.

    Parameters
    ----------
    points : (points, 3) float array
        At rest, Y roughly up [mm].
    """
    centre = points.mean(axis=0)
    tolerance = _TOLERANCE_SHARE * rms_radius(points)
    tree = KDTree(points)
    candidates = []
    for yaw in np.deg2rad(_YAWS_DEGREES):
        for roll in np.deg2rad(_ROLLS_DEGREES):
            level = np.array([np.cos(yaw), 0.0, -np.sin(yaw)])
            normal = np.cos(roll) * level + np.sin(roll) * _UP
            candidates.append(_nearest_refined(points, tree, normal, centre, tolerance))
    _, best = min(candidates, key=lambda candidate: candidate[0])
    for _ in range(10):
        pairs = _assigned_pairs(points, best, tolerance)
        if len(pairs) < FEWEST_PAIRS:
            raise ValueError(
                "the markers show no plane of symmetry; name sides in their labels (L, R), or give "
                "landmarks"
            )
        best = plane_of_pairs(points, pairs, np.zeros(0, np.int64), rounds=3)
    return best


def _nearest_refined(
    points: FloatArray, tree: KDTree, normal: FloatArray, centre: FloatArray, tolerance: float
) -> tuple[float, SagittalPlane]:
    """Refine a plane three times by nearest mirror images; return its truncated cost too."""
    plane = SagittalPlane(normal, float(normal @ centre))
    cost = np.inf
    for _ in range(3):
        away, near = tree.query(plane.mirrored(points))
        cost = float(np.minimum((away / tolerance) ** 2, 1).mean())
        paired = np.flatnonzero(away < tolerance)
        pairs = np.stack([paired, np.asarray(near)[paired]], axis=1)
        pairs = _left_first(points, pairs[pairs[:, 0] != pairs[:, 1]], plane)
        if len(pairs) < FEWEST_PAIRS + 1:
            break
        plane = plane_of_pairs(points, pairs, np.zeros(0, np.int64), rounds=1)
    return cost, plane


def _assigned_pairs(points: FloatArray, plane: SagittalPlane, tolerance: float) -> IntArray:
    from scipy.optimize import linear_sum_assignment  # slow to import

    cost = np.minimum((cdist(plane.mirrored(points), points) / tolerance) ** 2, 1)
    point, partner = linear_sum_assignment(cost)
    good = (cost[point, partner] < 1) & (point != partner)
    return _left_first(points, np.stack([point, partner], axis=1)[good], plane)


def _left_first(points: FloatArray, pairs: IntArray, plane: SagittalPlane) -> IntArray:
    swapped = points[pairs[:, 0]] @ plane.normal < plane.offset
    return np.where(swapped[:, None], pairs[:, ::-1], pairs)
