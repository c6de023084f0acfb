"""Errors of a performance: of weights, of the surface, of the lips' distance and of blinks.

Errors of weights are hard to compare: half a squint is hardly visible, half a blink is an open eye.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse
from scipy.spatial import cKDTree

from usdface.core.arrays import FloatArray, IntArray

_LIP_MOTION_SHARE = 0.3
"""[of a mouth shape's largest displacement] Least of the lips; teeth move less."""

_UPPER_LIP_SHARE, _LOWER_LIP_SHARE = 0.2, 0.5
"""[of the jaw's largest displacement] Largest of the upper lip, least of the lower."""

_TOUCHING_SHARE = 0.03
"""[of the opening by the jaw] Largest distance at rest of pairs that touch."""

_CORNER_SHARE = 0.2
"""The same towards the corners, where the lips open less."""

_MIDDLE_SHARE = 0.75
"""[of the widest opening] Least of pairs in the middle."""


@dataclass(frozen=True)
class LipPairs:
    """Pairs of opposite points of the lower and the upper lip."""

    lower: IntArray
    upper: IntArray
    """`lower`, `upper`: (n,): points, pair by pair."""
    direction: FloatArray
    """(3,): unit vector of their opening by the jaw."""
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
    """Find the pairs of points at which the lips touch.

    Both lips are moved by shapes of the mouth, unlike teeth; the lower lip moves with the jaw, the
    upper does not; and the pairs are those nearest to each other. Returns None if the jaw opens no
    mouth.

    Parameters
    ----------
    points : (points, 3) array
        At rest [mm].
    offsets : (shapes, 3 * points) sparse array
        Displacements by each shape at 1 [mm].
    jaw_open : int
        The shape that opens the jaw.
    mouth : (n,) int array
        The shapes of the mouth.
    to_corners : bool, optional
        Include pairs towards the corners, which the jaw opens less.
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
    upper = lips[travel < _UPPER_LIP_SHARE * travel.max()]
    lower = lips[travel > _LOWER_LIP_SHARE * travel.max()]
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
    chosen = touching if to_corners else middle
    low, high = lower[chosen], partner[chosen]
    return LipPairs(
        lower=low,
        upper=high,
        direction=direction,
        rest_mm=float(((rest[high] - rest[low]) @ direction).mean()),
    )


def gap_of_keys(pairs: LipPairs, key_offsets: sparse.csr_array) -> FloatArray:
    """Return the opening of the lips by each key at 1: (keys,) float array [mm].

    The gap of a frame is ``rest_mm + key_weights @ gap_of_keys``; below 0 the lips overlap.
    """
    projection = np.zeros((key_offsets.shape[1] // 3, 3))
    for points, sign in ((pairs.upper, 1.0), (pairs.lower, -1.0)):
        counts = np.bincount(points, minlength=len(projection))
        projection += sign / len(points) * counts[:, None] * pairs.direction
    return np.asarray(key_offsets @ projection.ravel(), np.float64)


def _motion(offsets: sparse.csr_array, shape: int, points: int) -> FloatArray:
    return np.asarray(offsets[[shape]].toarray(), np.float64).reshape(points, 3)


PEAK_QUANTILE = 0.97
"""Of a blink's true weights: frames above it are its peaks, or, if there are none, frames at it."""

CLOSED_MM = 1.0
"""Largest true distance of closed lips, unless they are farther apart at rest."""

_QUANTILE_95 = 0.95
_LEAST_ROUGHNESS = 1e-6
"""Third difference below which weights stand still: the rounding of single precision."""


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
        """Largest of the frames [mm]."""
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
    """Mean difference where the truth is closed: above 0 the mouth does not close [mm]; NaN if it
    never is."""


@dataclass(frozen=True)
class ShapeErrors:
    """Errors of each shape over the frames."""

    rmse: FloatArray
    bias: FloatArray
    largest: FloatArray
    """`rmse`, `bias`, `largest`: (shapes,): root mean square, mean, and largest size of the
    weight's error."""


def measure_shapes(errors: FloatArray) -> ShapeErrors:
    """Return the errors of each shape: (frames, shapes) float array."""
    return ShapeErrors(
        rmse=np.sqrt((errors**2).mean(axis=0)),
        bias=errors.mean(axis=0),
        largest=np.abs(errors).max(axis=0),
    )


def measure_lips(
    truth_keys: FloatArray, solved_keys: FloatArray, gap: FloatArray, *, rest_mm: float
) -> LipError:
    """Return the error of the distance between the lips.

    Parameters
    ----------
    truth_keys, solved_keys : (frames, keys) float arrays
    gap : (keys,) float array
        See `gap_of_keys` [mm].
    rest_mm : float
        Distance at rest [mm].
    """
    truth, solved = rest_mm + truth_keys @ gap, rest_mm + solved_keys @ gap
    error = solved - truth
    closed = truth <= max(CLOSED_MM, rest_mm)
    return LipError(
        truth_mm=truth,
        solved_mm=solved,
        rms_mm=float(np.sqrt((error**2).mean())),
        closed_bias_mm=float(error[closed].mean()) if closed.any() else float("nan"),
    )


def blink_peak_bias(errors: FloatArray, truth: FloatArray, blinks: IntArray) -> float:
    """Return the mean error of blinks at their peaks: below 0 the eyes do not close.

    Returns NaN if there is no blink.

    Parameters
    ----------
    errors, truth : (frames, shapes) float arrays
    blinks : (n,) int array
        Columns of the shapes that close an eye.
    """
    weights = truth[:, blinks]
    high = np.quantile(weights, PEAK_QUANTILE, axis=0) if len(weights) else np.zeros(len(blinks))
    peaks = weights > high
    if not peaks.any():
        peaks = (weights >= high) & (weights > 0)
    peak_errors = errors[:, blinks][peaks]
    return float(peak_errors.mean()) if len(peak_errors) else float("nan")


def relative_jitter(solved: FloatArray, truth: FloatArray, frames: IntArray) -> float:
    """Return the roughness of the solve over that of the truth.

    Roughness is the mean absolute third difference, over runs of consecutive frames. Returns NaN
    without four consecutive frames, or if the truth stands still.

    Parameters
    ----------
    solved, truth : (frames, shapes) float arrays
    frames : (frames,) int array
        Ascending frame numbers.
    """
    consecutive = frames[3:] - frames[:-3] == 3
    if not consecutive.any():
        return float("nan")
    of_solve, of_truth = (
        float(np.abs(np.diff(rows, 3, axis=0))[consecutive].mean()) for rows in (solved, truth)
    )
    return of_solve / of_truth if of_truth > _LEAST_ROUGHNESS else float("nan")
