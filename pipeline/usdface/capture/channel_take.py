"""From the weight samples of a file to a take: missing frames are interpolated and reported."""

import re
from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from pathlib import Path

import numpy as np

from usdface.capture.marker_take import Capture
from usdface.capture.sample_times import SampleTimes
from usdface.core.arrays import BoolArray, Float32Array, FloatArray, runs
from usdface.core.assets import Take, WeightsClip
from usdface.core.errors import InputError
from usdface.core.rates import exact_rate
from usdface.core.text import frame_ranges, pluralize

_FIRST_FRAME = 1
"""Number of the first frame for formats without frame numbers, as in optical takes."""

LARGEST_FRACTION = 2.0
"""Largest plausible weight: weights exceed 1 slightly in extreme expressions."""

_ANGLE = re.compile(r"(yaw|pitch|roll|rotation_?[xyz])$", re.IGNORECASE)
"""Names of channels that are angles, not weights."""

_CLOCK_ERROR = 0.002
"""Largest relative difference of a stated rate; 60 and 59.94 differ by 0.001."""

_FROZEN_SECONDS = 0.5
"""Duration of identical rows from which a stream counts as frozen: measured values have noise."""
_LARGEST_GAP_SHARE = 0.5
"""Share of the frames; with more, the table holds keys, or a face that is meant to be still."""


def build_channel_take(
    path: Path,
    names: Sequence[str],
    values: FloatArray,
    times: SampleTimes,
    *,
    notes: Sequence[str],
    format_name: str,
    timecode_start: str = "",
    first_frame: int = _FIRST_FRAME,
) -> Capture:
    """Return a take of weights; missing frames are interpolated and reported.

    `path`: the capture; its stem names the take.
    """
    found = [*notes, *_describe_times(times, first_frame)]
    seen = np.ones(len(values), dtype=bool)
    if format_name != "weights":  # authored curves may be constant, and state their unit
        seen = ~_frozen_rows(values, times)
        found += _describe_large_weights(names, values, first_frame + times.frames)
    if not seen.all():
        numbers = first_frame + times.frames.astype(np.int64)
        stretches = [(int(numbers[a]), int(numbers[b - 1])) for a, b in runs(~seen)]
        found.append(
            f"{pluralize(int((~seen).sum()), 'row')} repeat the one before to the last digit: the "
            f"stream froze; treated as a gap, and interpolated: {frame_ranges(stretches)}"
        )
    clip = WeightsClip(
        names=tuple(names),
        values=fill_frames(values, times.frames, seen),
        first_frame=first_frame,
        rate=times.rate,
        gaps=_gaps(times.frames[seen], times.frames[-1], first_frame),
    )
    take = Take(
        name=path.stem,
        rate=times.rate,
        first_frame=first_frame,
        source=clip,
        timecode_start=timecode_start,
    )
    return Capture(take, format_name, tuple(found))


def start_notes(missing: int, rate: Fraction) -> list[str]:
    """Return a note on frames without a face at the start of a recording, which are left out."""
    if not missing:
        return []
    seconds = missing / rate
    return [
        f"{pluralize(missing, 'frame')} without a face at the start, left out: the take begins "
        f"{float(seconds):.3f} s into the recording; a video that began with the recording needs "
        f"--video-offset {-float(seconds):.3f}, unless it is aligned"
    ]


def _describe_large_weights(
    names: Sequence[str], values: FloatArray, frames: FloatArray
) -> list[str]:
    """Return a note on weights above `LARGEST_FRACTION`, which no device measures."""
    weights = [column for column, name in enumerate(names) if not _ANGLE.search(name)]
    size = np.abs(values[:, weights])
    large = size > LARGEST_FRACTION
    if not large.any():
        return []
    row, at = np.unravel_index(int(size.argmax()), size.shape)
    column = weights[int(at)]
    return [
        f"{names[column]} is {values[row, column]:g} at frame {frames[row]:.0f}, and weights are "
        f"about 0 to 1; {pluralize(int(large.sum()), 'weight')} beyond {LARGEST_FRACTION:g}, kept: "
        "correct the recording and ingest it again"
    ]


def with_stated_rate(capture: Capture, rate: float, *, where: object) -> Capture:
    """Return weights of a device at the nominal rate that the user states, such as 59.94 for 60.

    Frame numbers stay: non-drop-frame labels at 59.94 frames per second count to 60.
    """
    stated, source = exact_rate(rate, where="--rate"), capture.take.source
    measured = capture.take.rate
    if abs(stated / measured - 1) > _CLOCK_ERROR:
        raise InputError(
            f"{where}: --rate {rate:g}, but by their own times its samples come at "
            f"{float(measured):g} frames per second; leave it out"
        )
    if source is not None:
        source = replace(source, rate=stated)
    return replace(capture, take=replace(capture.take, rate=stated, source=source))


def fill_frames(
    values: FloatArray, frames: FloatArray, seen: BoolArray | None = None
) -> Float32Array:
    """Return one row per whole frame between the first and the last sample: (frames, channels).

    Linear between samples; a sample at a whole frame is unchanged.

    Parameters
    ----------
    values : (samples, channels) float64 array
    frames : (samples,) float64 array
        Frame of each sample, ascending.
    seen : (samples,) bool array, optional
        Samples to use.
    """
    grid = np.arange(np.ceil(frames[0]), np.floor(frames[-1]) + 1)
    filled = np.empty((len(grid), values.shape[1]), np.float32)
    limit = np.finfo(np.float32).max
    if seen is not None:
        values, frames = values[seen], frames[seen]
    for channel in range(values.shape[1]):
        column = np.clip(values[:, channel], -limit, limit)
        filled[:, channel] = np.interp(grid, frames, column)
    return filled


def _frozen_rows(values: FloatArray, times: SampleTimes) -> BoolArray:
    """Return the rows that repeat the one before, in runs of at least `_FROZEN_SECONDS`."""
    same = np.zeros(len(values), dtype=bool)
    same[1:] = (values[1:] == values[:-1]).all(axis=1)
    for start, stop in runs(same):
        same[start:stop] &= stop - start >= _FROZEN_SECONDS * float(times.rate)
    return np.asarray(same & (same.mean() <= _LARGEST_GAP_SHARE))


def _gaps(frames: FloatArray, end: float, first_frame: int) -> tuple[tuple[int, int], ...]:
    """Return the ranges of frames that have no sample within one frame, as frame numbers.

    Parameters
    ----------
    frames : (samples,) float64 array
        Ascending; the first is that of the take.
    end : float
        Frame of the take's last sample, usable or not.
    """
    origin = np.ceil(frames[0])
    grid = np.arange(origin, np.floor(end) + 1)
    after = np.searchsorted(frames, grid, "left")
    later = np.append(frames, np.inf)[after] - grid
    earlier = grid - np.append(-np.inf, frames)[after]
    in_gap = np.minimum(later, earlier) >= 1.0
    if in_gap.mean() > _LARGEST_GAP_SHARE:
        return ()
    return gap_ranges(in_gap, first_frame)


def gap_ranges(missing: BoolArray, first_frame: int) -> tuple[tuple[int, int], ...]:
    """Return the first and last frame of each run of missing frames, from a mask over the take."""
    return tuple((first_frame + a, first_frame + b - 1) for a, b in runs(missing))


def _describe_missing(frames: FloatArray, first_frame: int) -> list[str]:
    """Return a note with the missing frames between samples at whole frames, if any."""
    missing = [
        (first_frame + int(before) + 1, first_frame + int(after) - 1)
        for before, after in pairwise(frames.tolist())
        if after - before > 1
    ]
    if not missing:
        return []
    count = sum(last - first + 1 for first, last in missing)
    return [
        f"{count} of {int(frames[-1]) + 1} frames were dropped by the recorder and are "
        f"interpolated: {frame_ranges(missing)}"
    ]


def _describe_times(times: SampleTimes, first_frame: int) -> list[str]:
    """Return notes on how samples were brought to whole frames."""
    rate = float(times.rate)
    if not times.even:
        return [f"samples came unevenly; resampled by their times to {rate:g} frames per second"]
    notes = _describe_missing(times.frames, first_frame)
    drift = times.clock_error * float(times.frames[-1])
    if abs(drift) > 0.5:  # noticeable against a video
        notes.append(
            f"the recorder's clock runs {abs(times.clock_error) * 1e6:.0f} ppm "
            f"{'slow' if drift > 0 else 'fast'} against {rate:g} frames per second: "
            f"{abs(drift):.1f} frames over the take"
        )
    return notes
