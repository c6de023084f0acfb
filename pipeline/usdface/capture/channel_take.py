"""Weights as a reader found them, made into a take: no frame missing, nothing silent."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from usdface.capture.marker_take import Capture
from usdface.capture.sample_times import SampleTimes
from usdface.core.arrays import Float32Array, FloatArray
from usdface.core.assets import Take, WeightsClip
from usdface.core.text import first_few

_FIRST_FRAME = 1
"""Where takes start whose format does not number frames, as optical takes do."""


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
    """Make a take of weights; frames that are missing are interpolated, and reported.

    Options for markers (units, axes, rigid set, neutral frame) have nothing to act on here.

    Parameters
    ----------
    path : Path
        The capture; its stem names the take.
    """
    found = [*notes, *_describe_times(times, first_frame)]
    clip = WeightsClip(
        names=tuple(names),
        values=fill_frames(values, times.frames),
        first_frame=first_frame,
        rate=times.rate,
    )
    take = Take(
        name=path.stem,
        rate=times.rate,
        first_frame=first_frame,
        source=clip,
        timecode_start=timecode_start,
    )
    return Capture(take, format_name, tuple(found))


def fill_frames(values: FloatArray, frames: FloatArray) -> Float32Array:
    """Return one row per whole frame, linear between the samples around it.

    Parameters
    ----------
    values : (samples, channels) float64 array
    frames : (samples,) float64 array
        Ascending; where each sample lies. A sample at a whole frame is kept as it is.

    Returns
    -------
    (frames, channels) float32 array
        From the whole frame at or after the first sample to that at or before the last.
    """
    grid = np.arange(np.ceil(frames[0]), np.floor(frames[-1]) + 1)
    filled = np.empty((len(grid), values.shape[1]), np.float32)
    limit = np.finfo(np.float32).max
    for channel in range(values.shape[1]):
        column = np.clip(values[:, channel], -limit, limit)
        filled[:, channel] = np.interp(grid, frames, column)
    return filled


def describe_missing(frames: FloatArray, first_frame: int = _FIRST_FRAME) -> list[str]:
    """Say which frames are missing between samples at whole frames, if any."""
    skipped = (np.diff(frames) - 1).astype(np.int64)
    if not skipped.any():
        return []
    runs = []
    for before in np.flatnonzero(skipped):
        first = first_frame + int(frames[before]) + 1
        last = first + int(skipped[before]) - 1
        runs.append(f"{first}" if first == last else f"{first}-{last}")
    return [
        f"{skipped.sum()} of {int(frames[-1]) + 1} frames were dropped by the recorder and are "
        f"interpolated: {first_few(runs)}"
    ]


def _describe_times(times: SampleTimes, first_frame: int) -> list[str]:
    """Say what was done to bring samples to whole frames."""
    rate = float(times.rate)
    if not times.even:
        return [f"samples came unevenly; resampled by their times to {rate:g} frames per second"]
    notes = describe_missing(times.frames, first_frame)
    drift = times.clock_error * float(times.frames[-1])
    if abs(drift) > 0.5:  # noticeable against a video
        notes.append(
            f"the recorder's clock runs {abs(times.clock_error) * 1e6:.0f} ppm "
            f"{'slow' if drift > 0 else 'fast'} against {rate:g} frames per second: "
            f"{abs(drift):.1f} frames over the take"
        )
    return notes
