"""Samples that do not belong to their marker: a reflection, another marker's ghost."""

import numpy as np
from numpy.typing import NDArray

from usdface.numerics.repair.frame_blocks import frame_blocks, sample_frames, widened
from usdface.numerics.repair.gaps import runs
from usdface.numerics.repair.low_rank import LowRankModel, fill_missing, predict_from_others

_USUAL_DISTANCES = 4.5
"""Medians of the distance from the prediction; one in 10^8 of normal samples is farther."""
_NOISE_DEVIATIONS = 5.0
_LEAST_LIMIT = 1.0
"""[mm] What is nearer does no harm."""
_JUMP_SHARE = 0.5
"""A stray comes and goes by jumps of at least this share of the limit; skin does not."""
_PLAIN_LIMITS = 2.0
"""So many limits away, one jump or a gap beside it is enough."""
_LONGEST_SHARE = 0.2
"""A marker that is off for longer has moved on the skin."""
_SAMPLE_FRAMES = 8192
_BESIDE = 2
"""Frames beside a step that tell a leap."""
_MOST_PER_FRAME = 8


def find_strays(
    positions: NDArray[np.floating],
    visible: NDArray[np.bool_],
    *,
    model: LowRankModel,
    noise: NDArray[np.float64],
) -> NDArray[np.bool_]:
    """Find samples that all other markers contradict and that came or went by a jump.

    A stray also spoils what is expected of its neighbours, so only the worst sample of a frame is
    taken out before the frame is looked at again.

    Parameters
    ----------
    positions : (frames, markers, 3) float array
        [mm] Without head motion; anything where not visible.
    visible : (frames, markers) bool array
    model : LowRankModel
        Learned from the same take.
    noise : (markers,) float array
        Standard deviation of the measurement noise per coordinate [mm].

    Returns
    -------
    (frames, markers) bool array
    """
    count = len(positions)
    limits = _limits(positions, visible, model, noise)
    doubted, far, leaps = (np.zeros(visible.shape, bool) for _ in range(3))
    for block in frame_blocks(count):
        around = widened(block, _BESIDE, count)
        inner = slice(block.start - around.start, block.stop - around.start)
        points, seen = positions[around], visible[around]
        complete = fill_missing(model, points, seen)
        predicted = predict_from_others(model, complete)
        offsets = complete - predicted
        doubts = _doubted(points, seen, predicted, model, limits)
        doubted[block] = doubts[inner]
        for marker in np.flatnonzero(doubts.any(axis=0)):
            limit = limits[marker]
            distance = np.linalg.norm(points[:, marker] - predicted[:, marker], axis=1)
            far[block, marker] = distance[inner] > _PLAIN_LIMITS * limit
            leap = np.minimum(_leaps(points[:, marker]), _leaps(offsets[:, marker]))
            steps = slice(inner.start, min(inner.stop, len(leap)))
            found = leap[steps] > _JUMP_SHARE * limit
            leaps[block.start : block.start + len(found), marker] = found
    strays = np.zeros_like(doubted)
    for marker in np.flatnonzero(doubted.any(axis=0)):
        strays[:, marker] = _that_leap(
            doubted[:, marker], far[:, marker], leaps[:, marker], visible[:, marker]
        )
    return strays


def _doubted(
    points: NDArray[np.floating],
    seen: NDArray[np.bool_],
    predicted: NDArray[np.floating],
    model: LowRankModel,
    limits: NDArray[np.float64],
) -> NDArray[np.bool_]:
    """Return which samples are too far off; `predicted` becomes what all others say."""
    believed = seen.copy()
    active = np.arange(len(points))
    for _ in range(_MOST_PER_FRAME):
        excess = np.linalg.norm(points[active] - predicted[active], axis=2) / limits
        excess[~believed[active]] = 0.0
        worst = excess.argmax(axis=1)
        doubtful = excess[np.arange(len(active)), worst] > 1.0
        active = active[doubtful]
        if not active.size:
            break
        believed[active, worst[doubtful]] = False
        filled = fill_missing(model, points[active], believed[active])
        predicted[active] = predict_from_others(model, filled)
    return np.asarray(seen & ~believed)


def _limits(
    positions: NDArray[np.floating],
    visible: NDArray[np.bool_],
    model: LowRankModel,
    noise: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return how far from its prediction each marker may lie [mm]."""
    rows = sample_frames(len(positions), _SAMPLE_FRAMES)
    seen = visible[rows]
    complete = fill_missing(model, positions[rows], seen)
    distance = np.linalg.norm(complete - predict_from_others(model, complete), axis=2)
    limits = np.maximum(_NOISE_DEVIATIONS * noise, _LEAST_LIMIT)
    for marker, ok in enumerate(seen.T):
        if ok.any():
            usual = float(np.median(distance[ok, marker]))
            limits[marker] = max(limits[marker], _USUAL_DISTANCES * usual)
    return limits


def _that_leap(
    doubted: NDArray[np.bool_],
    far: NDArray[np.bool_],
    leaps: NDArray[np.bool_],
    seen: NDArray[np.bool_],
) -> NDArray[np.bool_]:
    """Keep a marker's doubted stretches that begin and end with a leap: skin does not leap."""
    strays = np.zeros_like(doubted)
    tracked = seen[1:] & seen[:-1]
    for start, stop in runs(doubted):
        if stop - start > _LONGEST_SHARE * len(seen):
            continue
        ends = [edge - 1 for edge in (start, stop) if 0 < edge < len(seen)]
        both_leap = len(ends) == 2 and all(leaps[edge] and tracked[edge] for edge in ends)
        one_leaps = any(leaps[edge] or not tracked[edge] for edge in ends)
        strays[start:stop] = both_leap or (far[start:stop].any() and one_leaps)
    return strays


def _leaps(track: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return the size of each step as far as it differs from the steps beside it [mm].

    Quick skin takes several frames to get up to speed; a leap comes from nothing.
    """
    steps = np.diff(track, axis=0, prepend=track[:1], append=track[-1:])
    change = np.linalg.norm(np.diff(steps, axis=0), axis=1)
    size = np.linalg.norm(steps[1:-1], axis=1)
    return np.asarray(np.minimum(size, np.maximum(change[:-1], change[1:])))
