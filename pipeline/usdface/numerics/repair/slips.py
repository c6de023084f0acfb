"""Markers that slip to another place on the skin during a take.

The residual of a marker from its prediction by the others has a constant mean over a take, unless
the marker slips: then its mean changes once, by more than it varies on either side.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import BoolArray, Float32Array, FloatArray, RealArray, frame_blocks
from usdface.core.processes import map_threads
from usdface.numerics.repair.fit_low_rank import fit_low_rank
from usdface.numerics.repair.low_rank import LowRankModel, fill_and_predict, fill_missing

_BLOCK_SECONDS = 0.5
"""Block length of means of the residual: the duration of unpredicted expressions, over which means
are nearly independent."""

_FEWEST_BLOCKS = 10
"""On either side of a slip: an expression of one marker alone, such as a wink, is shorter than five
seconds."""

_JUMP_BLOCKS = 4
"""On either side of a slip, to measure its suddenness."""

_STEP_DEVIATIONS = 2.0
"""Least step over the standard deviation of block means. The largest in takes without slips is 1.2,
the smallest in three takes with slips of 2 and 4 mm is 2.7."""

_LEAST_STEP_MM = 0.7
"""Of the residual; the model has fitted up to half of the slip."""

_LEAST_DEVIATION_MM = 0.05
_SUDDEN_SHARE = 0.5
"""[of the step] Least difference between the means of the `_JUMP_BLOCKS` on either side."""

MOST_SLIP_MM = 5.0
"""Longer slips are not corrected: the marker is at another's place, or on a lid that shut."""

_BATCH_BLOCKS = 64
"""Blocks predicted at a time."""


@dataclass(frozen=True)
class Slip:
    """A change of a marker's place on the skin."""

    marker: int
    row: int
    """First frame index at the new place, to half a second."""
    offset: FloatArray
    """(3,): new place less the old one [mm]; zeros until it is measured."""

    @property
    def distance_mm(self) -> float:
        """Length of the offset; slips beyond `MOST_SLIP_MM` are not corrected."""
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
    means = _residual_means(positions, good, model, size)
    slips = []
    for marker in range(means.shape[1]):
        blocks = np.flatnonzero(np.isfinite(means[:, marker, 0]))
        residual = means[blocks, marker]
        count = len(residual)
        if count < 2 * _FEWEST_BLOCKS:
            continue
        splits = np.arange(_JUMP_BLOCKS, count - _JUMP_BLOCKS + 1)
        sums, squares = residual.cumsum(axis=0), (residual**2).sum()
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
        jump = np.linalg.norm(
            residual[at : at + near].mean(axis=0) - residual[at - near : at].mean(axis=0)
        )
        limit = _STEP_DEVIATIONS * max(float(deviation[best]), _LEAST_DEVIATION_MM)
        if step[best] > max(limit, _LEAST_STEP_MM) and jump > _SUDDEN_SHARE * step[best]:
            slips.append(Slip(marker, int(blocks[at]) * size, np.zeros(3)))
    return tuple(slips)


def undo_slips(
    positions: Float32Array,
    good: BoolArray,
    slips: Sequence[Slip],
    *,
    neutral: int,
    rank: int,
    noise: FloatArray,
) -> tuple[Slip, ...]:
    """Move markers that slipped to their place in the neutral frame; return the slips measured.

    The model that predicts them is fitted to their frames on the neutral's side alone. Slips longer
    than `MOST_SLIP_MM` are measured only.

    Parameters
    ----------
    positions : (frames, markers, 3) float32 array
        Changed in place [mm].
    neutral : int
        Frame index.
    rank : int
        Most directions of the face's motion.
    noise : (markers,) float array
        Standard deviation per coordinate [mm].
    """
    if not slips:
        return ()
    known = good.copy()
    sides = [slice(slip.row, None) if neutral < slip.row else slice(slip.row) for slip in slips]
    for slip, side in zip(slips, sides, strict=True):
        known[side, slip.marker] = False
    model = fit_low_rank(positions, known, rank_limit=rank, noise=noise)
    columns = [slip.marker for slip in slips]
    residuals = np.empty((len(columns), len(positions), 3))
    for block in frame_blocks(len(positions)):
        others = good[block].copy()
        others[:, columns] = False
        predicted = fill_missing(model, positions[block], others)[:, columns]
        residuals[:, block] = np.swapaxes(positions[block][:, columns] - predicted, 0, 1)
    measured = []
    for slip, side, residual in zip(slips, sides, residuals, strict=True):
        seen = good[:, slip.marker]
        moved = np.zeros_like(seen)
        moved[side] = True
        offset = np.median(residual[seen & moved], axis=0)
        offset -= np.median(residual[seen & ~moved], axis=0)
        if np.linalg.norm(offset) <= MOST_SLIP_MM:
            positions[side, slip.marker] -= offset.astype(np.float32)
        measured.append(Slip(slip.marker, slip.row, offset if neutral < slip.row else -offset))
    return tuple(measured)


def _residual_means(
    positions: RealArray, good: BoolArray, model: LowRankModel, size: int
) -> FloatArray:
    """Return block means of residuals from the predictions: (blocks, markers, 3) [mm].

    NaN in blocks of which less than half is visible.
    """
    count = len(positions) // size
    means = np.full((count, *positions.shape[1:]), np.nan)

    def average(batch: slice) -> None:
        rows = slice(batch.start * size, batch.stop * size)
        points, seen = positions[rows], good[rows]
        residual = points - fill_and_predict(model, points, seen)[1]
        residual = np.where(seen[..., None], residual, 0.0)
        residual = residual.reshape(-1, size, *points.shape[1:])
        counts = seen.reshape(-1, size, points.shape[1]).sum(axis=1)
        mean = residual.sum(axis=1) / np.maximum(counts, 1)[..., None]
        means[batch] = np.where(counts[..., None] * 2 >= size, mean, np.nan)

    map_threads(average, frame_blocks(count, frames=_BATCH_BLOCKS))
    return means
