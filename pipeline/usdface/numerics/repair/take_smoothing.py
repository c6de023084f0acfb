"""Smooth a take along the face's own directions of motion, slow ones more than quick ones."""

import numpy as np
from numpy.typing import NDArray

from usdface.numerics.repair.frame_blocks import frame_blocks, widened
from usdface.numerics.repair.low_rank import LowRankModel
from usdface.numerics.repair.smoothing import DETAIL_REACH, significant_detail, smooth_tracks

_DIRECTIONS_AT_ONCE = 8


def smooth_take(
    positions: NDArray[np.floating], model: LowRankModel, *, noise: NDArray[np.float64]
) -> None:
    """Smooth whole frames, in place.

    Blinks, which coordinates of single markers would lose in their noise, are few directions.
    What of a marker the directions miss comes back where it is too large to be noise.

    Parameters
    ----------
    positions : (frames, markers, 3) float array
        [mm] Complete, without head motion; changed.
    model : LowRankModel
        Learned from the same take.
    noise : (markers,) float array
        Standard deviation of the measurement noise per coordinate [mm].
    """
    count, kind = len(positions), positions.dtype
    flat = positions.reshape(count, -1)
    mean, components = model.mean.astype(kind), model.components.astype(kind)
    scores = np.empty((count, len(components)), kind)
    for block in frame_blocks(count):
        scores[block] = (flat[block] - mean) @ components.T
    for start in range(0, len(components), _DIRECTIONS_AT_ONCE):
        columns = slice(start, start + _DIRECTIONS_AT_ONCE)
        scores[:, columns] = smooth_tracks(scores[:, columns]).values
    behind = positions[:0]  # the rest of the frames before a block, which are smooth already
    for block in frame_blocks(count):
        around = widened(block, DETAIL_REACH, count)
        ahead = slice(block.start, around.stop)
        tracks = (scores[ahead] @ components + mean).reshape(-1, *positions.shape[1:])
        rest = np.concatenate([behind, positions[ahead] - tracks])
        inner = slice(len(behind), len(behind) + block.stop - block.start)
        behind = rest[max(0, inner.stop - DETAIL_REACH) : inner.stop].copy()
        detail = significant_detail(rest, noise=noise)
        positions[block] = tracks[: block.stop - block.start] + detail[inner]
