"""Filling of gaps in marker tracks: short ones by splines, long ones from the other markers.

Short gaps are filled by a cubic spline through the samples on both sides. Long ones are filled by
the prediction from the other markers (see `low_rank`), plus its error next to the gap, interpolated
from one end to the other. The length up to which splines are better depends on the noise, the rate
and the face; it is chosen by cross-validation with hidden samples.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from usdface.core.arrays import (
    BoolArray,
    Float32Array,
    FloatArray,
    RealArray,
    extend_block,
    frame_blocks,
    runs,
)
from usdface.core.processes import map_threads
from usdface.numerics.repair.low_rank import LowRankModel, fill_and_predict
from usdface.numerics.repair.outliers import USUAL_RATE

_TRIAL_LENGTHS = (1, 2, 4, 8, 16, 32)
"""[frames]"""
_TRIAL_COUNT = 120
"""Stretches hidden for each length."""
_INFORMED_SHARE = 0.3
"""[0-1] Share of visible markers below which a prediction is close to the take's mean."""
_UNINFORMED_LIMIT = 16
"""[frames] Longest gap filled by a spline where fewer markers are visible."""
_END_SAMPLES = 5
"""Samples next to a gap over which the prediction's error is averaged."""
_SPLINE_KNOTS = 4
"""Knots of a spline on each side of a gap."""
_GAP_REACH = 3 * _SPLINE_KNOTS
"""[frames] Range on each side of a gap that its filling depends on."""
_FADE_FRAMES = 30.0
"""[frames] Decay length of the prediction's error at the ends of a take, where it is known on one
side only."""
_LEAST_CONFIDENCE = 0.01
"""Of a filled sample; 0 is one that is not filled."""
_CORRELATION_SECONDS = 0.15
"""Correlation time of a marker's motion: a sample t seconds from the nearest visible one explains
the share exp(-(t / .15)^2) of its variance. In stretches hidden on five takes, simulated and
recorded, the shares at .04, .1 and .15 s were .94, .65 and .4 in speech, and larger in slow
motion."""
_FILL_FRAMES = 8192
"""[frames] Filled at a time: few of them twice, in the margins."""
_TRIAL_FRAMES = 20_000
"""[frames] From the middle of a take, for `choose_spline_limit`."""


def complete_take(
    positions: RealArray,
    good: BoolArray,
    *,
    model: LowRankModel,
    max_gap: int,
    noise: float,
    rate: float = USUAL_RATE,
) -> tuple[BoolArray, Float32Array]:
    """Fill all samples that are not good, in place; return those filled, and confidence.

    Gaps of at most `max_gap` frames by `fill_gaps`; longer ones by the model's prediction, so that
    whole frames can be smoothed. See `fill_gaps` for the confidence.

    Parameters
    ----------
    positions : (frames, markers, 3) float array
        [mm] Without head motion; changed.
    good : (frames, markers) bool array
    model : LowRankModel
        Fitted to the same take.
    max_gap : int
        [frames]
    noise : float
        Standard deviation of a measured coordinate [mm].
    rate : float
        Frames per second.
    """
    count = len(good)
    filled = np.zeros_like(good)
    confidence = good.astype(np.float32)
    if good.all():
        return filled, confidence
    middle = max(0, (count - _TRIAL_FRAMES) // 2)
    trial = slice(middle, middle + _TRIAL_FRAMES)
    points, ok = positions[trial], good[trial]
    prediction = fill_and_predict(model, points, ok)[1]
    limit = choose_spline_limit(points, ok, prediction, noise=noise)

    def fill(block: slice) -> None:
        """Fill a block with a margin of the longest gap around it."""
        if good[block].all():
            return
        around = extend_block(block, max_gap + _GAP_REACH, count)
        points, ok = positions[around], good[around]
        complete, prediction = fill_and_predict(model, points, ok)
        values, in_gap, trust = fill_gaps(
            points,
            ok,
            max_gap=max_gap,
            prediction=prediction,
            noise=noise,
            spline_limit=limit,
            open_start=around.start > 0,
            open_stop=around.stop < count,
            rate=rate,
        )
        inner = slice(block.start - around.start, block.stop - around.start)
        filled[block], confidence[block] = in_gap[inner], trust[inner]
        repaired = np.where(filled[block][..., None], values[inner], complete[inner])
        missing = ~good[block]
        positions[block][missing] = repaired[missing]

    map_threads(fill, frame_blocks(count, frames=_FILL_FRAMES, at_least=max_gap))
    return filled, confidence


def fill_gaps(
    positions: ArrayLike,
    visible: ArrayLike,
    *,
    max_gap: int,
    prediction: ArrayLike,
    spline_limit: int,
    noise: float = 0.0,
    open_start: bool = False,
    open_stop: bool = False,
    rate: float = USUAL_RATE,
) -> tuple[RealArray, BoolArray, Float32Array]:
    """Return positions with every gap of at most `max_gap` frames filled, and a record.

    The record: which samples were filled, and confidence, both (frames, markers). Confidence is 1
    where visible, 0 where not filled, else the share of the variance of the marker's motion that
    the nearest visible sample explains; see `_CORRELATION_SECONDS`.

    Parameters
    ----------
    positions : (frames, markers, 3) array_like
        [mm] Anything where not visible.
    visible : (frames, markers) array_like of bool
    max_gap : int
        Longest gap to fill [frames].
    prediction : (frames, markers, 3) array_like
        Of each marker from the others, also where it is visible.
    spline_limit : int
        Longest gap to fill with a spline [frames]; see `choose_spline_limit`.
    noise : float
        Standard deviation of a measured coordinate [mm], by which the prediction's error next to a
        gap is shrunk.
    open_start, open_stop : bool
        Whether the take continues there: gaps that reach this end are not filled.
    rate : float
        Frames per second.
    """
    points, seen = np.array(positions), np.asarray(visible, bool)
    expected = np.asarray(prediction)
    confidence = seen.astype(np.float32)
    filled = np.zeros_like(seen)
    informed = seen.mean(axis=1) >= _INFORMED_SHARE
    for marker in np.flatnonzero(~seen.all(axis=0) & seen.any(axis=0)):
        track, ok, base = points[:, marker].copy(), seen[:, marker], expected[:, marker]
        for start, stop in runs(~ok):
            cut = (open_start and start == 0) or (open_stop and stop == len(ok))
            if cut or stop - start > max_gap:
                continue
            inner = 0 < start and stop < len(ok)
            reach = max(spline_limit, 0 if informed[start:stop].all() else _UNINFORMED_LIMIT)
            if inner and stop - start <= reach:
                values = _spline(track, ok, start, stop)
            else:
                # Next to the gap alone: over all frames, time would grow as gaps times frames.
                low, high = max(0, start - _END_SAMPLES), stop + _END_SAMPLES
                rest = track[low:high] - base[low:high]
                values = base[start:stop] + _blend_offsets(
                    rest, ok[low:high], start - low, stop - low, noise
                )
            points[start:stop, marker] = values
            filled[start:stop, marker] = True
            confidence[start:stop, marker] = _gap_confidence(start, stop, len(ok), rate)
    return points, filled, confidence


def choose_spline_limit(
    positions: RealArray, visible: BoolArray, prediction: RealArray, *, noise: float
) -> int:
    """Return the longest gap that a spline fills better than the prediction does [frames].

    By the mean error over hidden stretches; the arguments are those of `fill_gaps`.
    """
    rng = np.random.default_rng(0)
    frames, markers = visible.shape
    limit = 0
    for length in _TRIAL_LENGTHS:
        if frames <= length + 2 * _END_SAMPLES:
            return limit
        errors = np.zeros(2)
        for _ in range(_TRIAL_COUNT):
            start = int(rng.integers(_END_SAMPLES, frames - length - _END_SAMPLES))
            marker, stop = int(rng.integers(markers)), start + length
            window = slice(max(0, start - 4 * _END_SAMPLES), stop + 4 * _END_SAMPLES)
            first, last = start - window.start, stop - window.start
            ok = visible[window, marker].copy()
            if not ok[first - 1 : last + 1].all():
                continue
            ok[first:last] = False
            track, base = positions[window, marker], prediction[window, marker]
            by_spline = _spline(track, ok, first, last)
            by_others = base[first:last] + _blend_offsets(track - base, ok, first, last, noise)
            for i, values in enumerate((by_spline, by_others)):
                errors[i] += float(np.linalg.norm(values - track[first:last], axis=1).mean())
        if errors[0] >= errors[1]:
            return limit
        limit = length
    return limit


def _spline(track: RealArray, ok: BoolArray, start: int, stop: int) -> RealArray:
    """Return the cubic spline through the nearest visible samples on both sides."""
    low, high = max(0, start - _GAP_REACH), stop + _GAP_REACH
    near = np.flatnonzero(ok[low:high]) + low
    before, after = near[near < start][-_SPLINE_KNOTS:], near[near >= stop][:_SPLINE_KNOTS]
    knots = np.concatenate([before, after])
    return _spline_weights(tuple((knots - start).tolist()), stop - start) @ track[knots]


@lru_cache(maxsize=4096)
def _spline_weights(knots: tuple[int, ...], length: int) -> FloatArray:
    """Return the spline's weight of each knot in each frame of a gap, (length, knots)."""
    frames, unit = np.arange(length), np.eye(len(knots))
    if len(knots) > 2:
        return CubicSpline(knots, unit)(frames)
    return np.stack([np.interp(frames, knots, row) for row in unit], axis=1)


def _blend_offsets(
    offsets: RealArray, ok: BoolArray, start: int, stop: int, noise: float
) -> FloatArray:
    """Return the correction of the prediction: its errors at both ends, interpolated linearly."""
    ends = slice(max(0, start - _END_SAMPLES), start), slice(stop, stop + _END_SAMPLES)
    before, after = (_end_offset(offsets[end][ok[end]], noise) for end in ends)
    frames = np.arange(start, stop, dtype=np.float64)
    if start == 0 or stop == len(ok):
        edge, distance = (after, stop - frames) if start == 0 else (before, frames - start + 1)
        return np.exp(-distance / _FADE_FRAMES)[:, None] * edge
    share = ((frames - start + 1) / (stop - start + 1))[:, None]
    return (1.0 - share) * before + share * after


def _end_offset(offsets: RealArray, noise: float) -> FloatArray:
    """Return the mean offset of the n samples next to a gap, shrunk as by James and Stein (1961).

    ``mean max(0, 1 - 2 s^2 / |mean|^2)``, with ``s^2 = noise^2 (1 + 1 / n)``: the noise of the
    samples' mean, and that of a prediction of about the same quality as a sample.
    """
    if not len(offsets):
        return np.zeros(3)
    mean = np.asarray(offsets.mean(axis=0, dtype=np.float64))
    square = float(mean @ mean)
    if square == 0.0:
        return mean
    expected = 2.0 * noise**2 * (1.0 + 1.0 / len(offsets))
    return mean * max(0.0, 1.0 - expected / square)


def _gap_confidence(start: int, stop: int, frame_count: int, rate: float) -> RealArray:
    """Return the variance share that the nearest visible sample explains; see `explained_after`."""
    frames = np.arange(start, stop)
    before = frames - start + 1 if start > 0 else np.full(stop - start, frame_count)
    after = stop - frames if stop < frame_count else np.full(stop - start, frame_count)
    return np.maximum(explained_after(np.minimum(before, after) / rate), _LEAST_CONFIDENCE)


def explained_after(seconds: RealArray) -> RealArray:
    """Return the share of a motion's variance that a sample explains some time away [0-1]."""
    return np.exp(-((seconds / _CORRELATION_SECONDS) ** 2))
