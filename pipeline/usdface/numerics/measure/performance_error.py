"""How far a performance is from what it should have been: figures an animator can place.

Weights alone mislead: half a weight of a squint is hardly seen, half a blink is an open eye. So
errors are also measured where they show, on the surface and between the lips.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse
from scipy.spatial import cKDTree

from usdface.core.arrays import BoolArray, FloatArray, IntArray
from usdface.numerics.regression.cross_validation import (
    surface_errors_mm,
    weight_rmse,
)

_LIP_MOTION_SHARE = 0.3
"""[of a mouth shape's largest motion] Lips reach it and teeth do not."""

_UPPER_LIP_SHARE, _LOWER_LIP_SHARE = 0.2, 0.5
"""[of the jaw's largest motion] The upper lip stays below the one, the lower lip above the
other."""

_TOUCHING_SHARE = 0.03
"""[of what the jaw opens] Pairs nearer than this at rest are lips upon each other."""

_CORNER_SHARE = 0.2
"""[of the same] Towards the corners lips open less than between them, and are as near."""

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
    points: ArrayLike,
    offsets: sparse.csr_array,
    *,
    jaw_open: int,
    mouth: ArrayLike,
    to_corners: bool = False,
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
    to_corners : bool, optional
        Keep pairs beside the middle as well, which the jaw parts less.

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
    share = _CORNER_SHARE if to_corners else _TOUCHING_SHARE
    touching = ratio <= max(share, 2.0 * float(ratio.min()))
    middle = touching & (width >= _MIDDLE_SHARE * width[touching].max())
    direction = parted[middle].mean(axis=0)
    direction /= np.linalg.norm(direction)
    kept = touching if to_corners else middle
    low, high = lower[kept], partner[kept]
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


PEAK_QUANTILE = 0.97
"""Of a blink's true weights: frames above are its peaks. Where none is, for the eyes are shut so
long, frames at it are."""

CLOSED_MM = 1.0
"""Lips no further apart than this are meant to be closed."""

_QUANTILE_95 = 0.95
_LEAST_ROUGHNESS = 1e-9


@dataclass(frozen=True)
class SurfaceError:
    """Errors of one region over time."""

    frames_mm: FloatArray
    """(frames,): root mean square distance of the region's points [mm]."""

    @property
    def mean_mm(self) -> float:
        """Mean over the frames [mm]."""
        return float(self.frames_mm.mean())

    @property
    def rms_mm(self) -> float:
        """Root mean square over the frames [mm]."""
        return float(np.sqrt(np.square(self.frames_mm).mean()))

    @property
    def p95_mm(self) -> float:
        """95th percentile over the frames [mm]."""
        return float(np.quantile(self.frames_mm, _QUANTILE_95))

    @property
    def max_mm(self) -> float:
        """Largest of all frames [mm]."""
        return float(self.frames_mm.max())


@dataclass(frozen=True)
class LipError:
    """Errors of the distance between the lips."""

    truth_mm: FloatArray
    solved_mm: FloatArray
    """`truth_mm`, `solved_mm`: (frames,): the distance; below 0 the lips overlap [mm]."""
    rms_mm: float
    """Of the difference [mm]."""
    closed_bias_mm: float
    """Mean difference where the truth is closed: above 0 the mouth does not close [mm]; NaN where
    it never is."""


@dataclass(frozen=True)
class ShapeErrors:
    """Errors of each shape over the frames."""

    rmse: FloatArray
    bias: FloatArray
    largest: FloatArray
    """`rmse`, `bias`, `largest`: (shapes,): root mean square, mean, and largest size of the
    weight's error."""


def measure_weights(errors: FloatArray, *, observable: BoolArray | None = None) -> float:
    """Return the root mean square error over frames and shapes.

    Parameters
    ----------
    errors : (frames, shapes) float array
    observable : (shapes,) bool array, optional
        Shapes that count; by default all. NaN where none does.
    """
    counted = errors if observable is None else errors[:, observable]
    return weight_rmse(counted) if counted.size else float("nan")


def measure_shapes(errors: FloatArray) -> ShapeErrors:
    """Return the errors of each shape: (frames, shapes) float array."""
    return ShapeErrors(
        rmse=np.sqrt((errors**2).mean(axis=0)),
        bias=errors.mean(axis=0),
        largest=np.abs(errors).max(axis=0),
    )


def measure_surface(key_errors: FloatArray, gram: FloatArray) -> SurfaceError:
    """Return how far errors move a surface.

    Parameters
    ----------
    key_errors : (frames, keys) float array
        Differences of key weights; those of channel weights where no shape has in-betweens.
    gram : (keys, keys) float array
    """
    return SurfaceError(surface_errors_mm(key_errors, gram))


def measure_lips(
    truth_keys: FloatArray, solved_keys: FloatArray, gap: FloatArray, *, rest_mm: float
) -> LipError:
    """Return how far the distance between the lips is off.

    Parameters
    ----------
    truth_keys, solved_keys : (frames, keys) float arrays
    gap : (keys,) float array
        How far each key at 1 parts the lips [mm].
    rest_mm : float
        Their distance at rest [mm].
    """
    truth, solved = rest_mm + truth_keys @ gap, rest_mm + solved_keys @ gap
    off = solved - truth
    closed = truth <= max(CLOSED_MM, rest_mm)
    return LipError(
        truth_mm=truth,
        solved_mm=solved,
        rms_mm=float(np.sqrt((off**2).mean())),
        closed_bias_mm=float(off[closed].mean()) if closed.any() else float("nan"),
    )


def blink_peak_bias(errors: FloatArray, truth: FloatArray, blinks: IntArray) -> float:
    """Return the mean error of blinks at their peaks: below 0 the eyes do not shut.

    Parameters
    ----------
    errors, truth : (frames, shapes) float arrays
    blinks : (n,) int array
        Columns of the shapes that shut an eye.

    Returns
    -------
    float
        NaN where there is no blink.
    """
    acted = truth[:, blinks]
    high = np.quantile(acted, PEAK_QUANTILE, axis=0) if len(acted) else np.zeros(len(blinks))
    peaks = acted > high
    if not peaks.any():
        peaks = (acted >= high) & (acted > 0)
    found = errors[:, blinks][peaks]
    return float(found.mean()) if len(found) else float("nan")


def relative_jitter(solved: FloatArray, truth: FloatArray, frames: IntArray) -> float:
    """Return the roughness of the solve over that of the truth: 1 is as smooth as it should be.

    Roughness is the mean size of the third difference, over runs of consecutive frames.

    Parameters
    ----------
    solved, truth : (frames, shapes) float arrays
    frames : (frames,) int array
        Ascending frame numbers.

    Returns
    -------
    float
        NaN where no four frames follow each other.
    """
    rough = [np.abs(np.diff(rows, 3, axis=0)) for rows in (solved, truth)]
    consecutive = frames[3:] - frames[:-3] == 3
    if not consecutive.any():
        return float("nan")
    mine, theirs = (float(each[consecutive].mean()) for each in rough)
    return mine / max(theirs, _LEAST_ROUGHNESS)
