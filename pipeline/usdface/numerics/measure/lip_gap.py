"""How far the lips are apart, whatever the rig: found from where its jaw opens the mouth.

A mouth that does not close is the first thing an animator sees, and a tenth of a millimetre on
the surface's average error.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse
from scipy.spatial import cKDTree

from usdface.core.arrays import FloatArray, IntArray

_LIP_MOTION_SHARE = 0.3
"""[of a mouth shape's largest motion] Lips reach it and teeth do not."""

_UPPER_LIP_SHARE, _LOWER_LIP_SHARE = 0.2, 0.5
"""[of the jaw's largest motion] The upper lip stays below the one, the lower lip above the
other."""

_TOUCHING_SHARE = 0.03
"""[of what the jaw opens] Pairs nearer than this at rest are lips upon each other."""

_MIDDLE_SHARE = 0.75
"""[of the widest opening] Pairs that open less lie towards the corners."""


@dataclass(frozen=True)
class LipPairs:
    """Points of the lower and the upper lip that meet."""

    lower: IntArray
    upper: IntArray
    """`lower`, `upper`: (n,): points, pair by pair."""
    direction: FloatArray
    """(3,): unit vector along which the jaw parts them."""
    rest_mm: float
    """Mean distance along it at rest [mm]."""


def find_lip_pairs(
    points: ArrayLike, offsets: sparse.csr_array, *, jaw_open: int, mouth: ArrayLike
) -> LipPairs | None:
    """Find where the lips meet.

    The lower lip goes with the jaw and the upper does not; both are moved by shapes of the mouth,
    as teeth are not; and of all such pairs the lips are those nearest to each other.

    Parameters
    ----------
    points : (points, 3) array
        At rest [mm].
    offsets : (shapes, 3 * points) sparse array
        What each shape at 1 does [mm].
    jaw_open : int
        The shape that opens the jaw.
    mouth : (n,) int array
        The shapes of the mouth, of which some move the lips.

    Returns
    -------
    LipPairs or None
        None where the jaw opens no mouth.
    """
    rest = np.asarray(points, np.float64)
    activity = np.zeros(len(rest))
    for shape in np.asarray(mouth, np.int64):
        moved = _motion(offsets, int(shape), len(rest))
        size = np.linalg.norm(moved, axis=1)
        if size.max() > 0:
            np.maximum(activity, size / size.max(), out=activity)
    lips = np.flatnonzero(activity > _LIP_MOTION_SHARE)
    opened = _motion(offsets, jaw_open, len(rest))
    travel = np.linalg.norm(opened[lips], axis=1)
    if not len(lips) or travel.max() == 0:
        return None
    upper, lower = (
        lips[travel < _UPPER_LIP_SHARE * travel.max()],
        lips[travel > _LOWER_LIP_SHARE * travel.max()],
    )
    if not (len(upper) and len(lower)):
        return None
    distance, nearest = cKDTree(rest[upper]).query(rest[lower])
    partner = upper[nearest]
    parted = opened[partner] - opened[lower]
    width = np.linalg.norm(parted, axis=1)
    ratio = distance / width
    touching = ratio <= max(_TOUCHING_SHARE, 2.0 * float(ratio.min()))
    middle = touching & (width >= _MIDDLE_SHARE * width[touching].max())
    direction = parted[middle].mean(axis=0)
    direction /= np.linalg.norm(direction)
    low, high = lower[middle], partner[middle]
    return LipPairs(
        lower=low,
        upper=high,
        direction=direction,
        rest_mm=float(((rest[high] - rest[low]) @ direction).mean()),
    )


def gap_of_keys(pairs: LipPairs, key_offsets: sparse.csr_array) -> FloatArray:
    """Return how far each key at 1 parts the lips: (keys,) float array [mm].

    The gap of a frame is ``rest_mm + key_weights @ gap_of_keys``; below 0 the lips overlap.
    """
    onto = np.zeros((key_offsets.shape[1] // 3, 3))
    for points, sign in ((pairs.upper, 1.0), (pairs.lower, -1.0)):
        times = np.bincount(points, minlength=len(onto))
        onto += sign / len(points) * times[:, None] * pairs.direction
    return np.asarray(key_offsets @ onto.ravel(), np.float64)


def _motion(offsets: sparse.csr_array, shape: int, points: int) -> FloatArray:
    return np.asarray(offsets[[shape]].toarray(), np.float64).reshape(points, 3)
