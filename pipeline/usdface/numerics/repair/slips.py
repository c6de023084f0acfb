"""Markers that moved on the skin during a take, and stayed where they then were.

The others predict a marker from how they have moved together; what is left of it keeps its mean
over a take. A marker that slips leaves a step there: its mean differs before and after one moment,
by more than it varies on either side.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import BoolArray, Float32Array, FloatArray, RealArray, frame_blocks
from usdface.numerics.repair.fit_low_rank import fit_low_rank
from usdface.numerics.repair.low_rank import LowRankModel, fill_missing, predict_from_others

_BLOCK_SECONDS = 0.5
"""Means over it are nearly independent: an expression that the others do not predict lasts so
long."""

_FEWEST_BLOCKS = 10
"""On either side of a slip: an expression that one marker alone shows, a wink, is not held for five
seconds."""

_JUMP_BLOCKS = 4

_STEP_DEVIATIONS = 2.0
"""Step over the deviation of block means on either side. Of takes without slips the largest is 1.2,
of three with one, of 2 and 4 mm, the smallest 2.7."""

_LEAST_STEP_MM = 0.7
"""Of what the model leaves over, which has learnt a part of the slip: half of it or more."""

_LEAST_DEVIATION_MM = 0.05
_SUDDEN_SHARE = 0.5
"""[of the step] What is left differs so much between the `_JUMP_BLOCKS` on either side."""

MOST_SLIP_MM = 5.0
"""Farther, a marker is on another one's place or on a lid that shut, and stays where it is."""

_BATCH_BLOCKS = 64
"""Predicted at a time."""


@dataclass(frozen=True)
class Slip:
    """A marker that sits elsewhere on the skin from one frame on."""

    marker: int
    row: int
    """The first in the new place, to half a second."""
    offset: FloatArray
    """(3,): new place less the old one [mm]; zeros until it is measured."""

    @property
    def distance_mm(self) -> float:
        """Of the places; beyond `MOST_SLIP_MM` the marker was left in the new one."""
        return float(np.linalg.norm(self.offset))


def find_slips(
    positions: RealArray, good: BoolArray, *, model: LowRankModel, rate: float
) -> tuple[Slip, ...]:
    """Find markers whose place on the skin changes once in a take.

    Parameters
    ----------
    positions : (frames, markers, 3) float array
        [mm] Without head motion; anything where not good.
    good : (frames, markers) bool array
    model : LowRankModel
        Fitted to the same take.
    rate : float
        Frames per second.
    """
    size = max(int(_BLOCK_SECONDS * rate), 1)
    means = _left_over_means(positions, good, model, size)
    found = []
    for marker in range(means.shape[1]):
        blocks = np.flatnonzero(np.isfinite(means[:, marker, 0]))
        left = means[blocks, marker]
        count = len(left)
        if count < 2 * _FEWEST_BLOCKS:
            continue
        splits = np.arange(_JUMP_BLOCKS, count - _JUMP_BLOCKS + 1)
        sums, squares = left.cumsum(axis=0), (left**2).sum()
        before = sums[splits - 1] / splits[:, None]
        after = (sums[-1] - sums[splits - 1]) / (count - splits)[:, None]
        inside = squares - splits * (before**2).sum(axis=1)
        inside -= (count - splits) * (after**2).sum(axis=1)
        deviation = np.sqrt(np.maximum(inside, 0.0) / count)
        step = np.linalg.norm(after - before, axis=1)
        best = int(np.argmax(step / np.maximum(deviation, _LEAST_DEVIATION_MM)))
        at, near = int(splits[best]), _JUMP_BLOCKS
        if min(at, count - at) < _FEWEST_BLOCKS:
            continue
        jump = np.linalg.norm(left[at : at + near].mean(axis=0) - left[at - near : at].mean(axis=0))
        limit = _STEP_DEVIATIONS * max(float(deviation[best]), _LEAST_DEVIATION_MM)
        if step[best] > max(limit, _LEAST_STEP_MM) and jump > _SUDDEN_SHARE * step[best]:
            found.append(Slip(marker, int(blocks[at]) * size, np.zeros(3)))
    return tuple(found)


def undo_slips(
    positions: Float32Array,
    good: BoolArray,
    slips: Sequence[Slip],
    *,
    neutral: int,
    rank: int,
    noise: FloatArray,
) -> tuple[Slip, ...]:
    """Put markers that slipped where they sat in the neutral frame; return how far they slipped.

    What the others predict of a marker is learnt from its frames on the neutral's side alone. Those
    that are farther than `MOST_SLIP_MM` are measured only.

    Parameters
    ----------
    positions : (frames, markers, 3) float32 array
        Changed in place [mm].
    neutral : int
        Row.
    rank : int
        Most directions of the face's motion.
    noise : (markers,) float array
        Standard deviation per coordinate [mm].
    """
    known = good.copy()
    sides = [slice(slip.row, None) if neutral < slip.row else slice(slip.row) for slip in slips]
    for slip, side in zip(slips, sides, strict=True):
        known[side, slip.marker] = False
    learnt = fit_low_rank(positions, known, rank_limit=rank, noise=noise)
    columns = [slip.marker for slip in slips]
    left = np.empty((len(columns), len(positions), 3))
    for block in frame_blocks(len(positions)):
        others = good[block].copy()
        others[:, columns] = False
        predicted = fill_missing(learnt, positions[block], others)[:, columns]
        left[:, block] = np.swapaxes(positions[block][:, columns] - predicted, 0, 1)
    measured = []
    for slip, side, away in zip(slips, sides, left, strict=True):
        seen = good[:, slip.marker]
        other = np.zeros_like(seen)
        other[side] = True
        offset = np.median(away[seen & other], axis=0) - np.median(away[seen & ~other], axis=0)
        if np.linalg.norm(offset) <= MOST_SLIP_MM:
            positions[side, slip.marker] -= offset.astype(np.float32)
        measured.append(Slip(slip.marker, slip.row, offset if neutral < slip.row else -offset))
    return tuple(measured)


def _left_over_means(
    positions: RealArray, good: BoolArray, model: LowRankModel, size: int
) -> FloatArray:
    """Return means of what the others do not predict: (blocks, markers, 3) [mm].

    NaN in blocks of which less than half is seen.
    """
    count = len(positions) // size
    means = np.full((count, *positions.shape[1:]), np.nan)
    for first in range(0, count, _BATCH_BLOCKS):
        blocks = min(_BATCH_BLOCKS, count - first)
        rows = slice(first * size, (first + blocks) * size)
        points, seen = positions[rows], good[rows]
        left = points - predict_from_others(model, fill_missing(model, points, seen))
        left = np.where(seen[..., None], left, 0.0).reshape(blocks, size, *points.shape[1:])
        times = seen.reshape(blocks, size, -1).sum(axis=1)
        mean = left.sum(axis=1) / np.maximum(times, 1)[..., None]
        means[first : first + blocks] = np.where(times[..., None] * 2 >= size, mean, np.nan)
    return means
