"""Complete a take: gaps that are not too long filled, all others at least plausible."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from usdface.numerics.repair.frame_blocks import frame_blocks, widened
from usdface.numerics.repair.gaps import GAP_REACH, choose_spline_limit, fill_gaps
from usdface.numerics.repair.low_rank import LowRankModel, fill_missing, predict_from_others

_TRIAL_FRAMES = 20_000
"""Of the middle of a take: where it is seen how well gaps can be filled."""


@dataclass(frozen=True)
class Completed:
    """What was filled.

    Attributes
    ----------
    filled : (frames, markers) bool array
    confidence : (frames, markers) float array
        [0-1] 1 where good, lower the deeper in a filled gap, 0 where a gap was too long.
    """

    filled: NDArray[np.bool_]
    confidence: NDArray[np.float32]


def complete_take(
    positions: NDArray[np.floating],
    good: NDArray[np.bool_],
    *,
    model: LowRankModel,
    max_gap: int,
    noise: float,
) -> Completed:
    """Fill every sample that is not good, in place.

    Gaps of at most `max_gap` frames as `fill_gaps` does; longer ones with what the other markers
    say, so that whole frames can be smoothed.

    Parameters
    ----------
    positions : (frames, markers, 3) float array
        [mm] Without head motion; changed.
    good : (frames, markers) bool array
    model : LowRankModel
        Learned from the same take.
    max_gap : int
        [frames]
    noise : float
        Standard deviation of a measured coordinate [mm].
    """
    count = len(good)
    filled = np.zeros_like(good)
    confidence = good.astype(np.float32)
    if good.all():
        return Completed(filled, confidence)
    middle = max(0, (count - _TRIAL_FRAMES) // 2)
    limit = _spline_limit(positions, good, model, slice(middle, middle + _TRIAL_FRAMES), noise)
    # Blocks of at least one gap: each is looked at with a gap's length around it.
    for block in frame_blocks(count, at_least=max_gap):
        if good[block].all():
            continue
        around = widened(block, max_gap + GAP_REACH, count)
        points, ok = positions[around], good[around]
        complete = fill_missing(model, points, ok)
        gaps = fill_gaps(
            points,
            ok,
            max_gap=max_gap,
            prediction=predict_from_others(model, complete),
            noise=noise,
            spline_limit=limit,
            open_start=around.start > 0,
            open_stop=around.stop < count,
        )
        inner = slice(block.start - around.start, block.stop - around.start)
        found = gaps.filled[inner]
        values = np.where(found[..., None], gaps.positions[inner], complete[inner])
        lacking = ~good[block]
        positions[block][lacking] = values[lacking]
        filled[block], confidence[block] = found, gaps.confidence[inner]
    return Completed(filled, confidence)


def _spline_limit(
    positions: NDArray[np.floating],
    good: NDArray[np.bool_],
    model: LowRankModel,
    stretch: slice,
    noise: float,
) -> int:
    points, ok = positions[stretch], good[stretch]
    prediction = predict_from_others(model, fill_missing(model, points, ok))
    return choose_spline_limit(points, ok, prediction, noise=noise)
