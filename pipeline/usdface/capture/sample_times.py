"""When samples were taken: the rate behind written times, and the frame each sample belongs to."""

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from usdface.core.arrays import FloatArray, IntArray
from usdface.core.errors import InputError
from usdface.core.rates import NTSC_BASES, exact_rate

_INDEX_TITLES = {
    "frame": ("frame", "frame#", "frames", "frame_number", "frame number", "framenumber"),
    "time": ("time", "time_s", "time (s)", "time (seconds)", "seconds", "timestamp", "t"),
    "ms": ("time_ms", "timestamp_ms", "timestampms", "milliseconds", "ms"),
    "take": ("take", "take_name", "clip"),
    "timecode": ("timecode", "tc"),
}
"""What tables call the columns that say which sample a row is."""
DEVICE_RATES = (15, 20, 24, 25, 30, 48, 50, 60, 90, 100, 120, 240)
"""What cameras and phones are set to; their clocks are close to it, never exact."""
_CLOCK_ERROR = 0.005
"""Relative; phones measured are within 0.001."""
_NTSC_CLOCK_ERROR = 5e-5
"""The same, to take 59.94 for what a clock kept in step with video says; 60 is 1e-3 off."""

_UNEVEN_FRAMES = 0.3
"""[frames] A step this far from a whole number of frames is not even."""
_UNEVEN_SHARE = 0.02
_LONGEST_SECONDS = 1e10
"""Times may count from 1970."""
_LOWEST_RATE = 1.0
"""[Hz] No face is captured slower; times in milliseconds look like that."""
_LARGEST_RATIO = 10
"""Frames a take may have for each sample in it: with more missing, frame numbers are damaged."""


@dataclass(frozen=True)
class SampleTimes:
    """Samples on a clock of even frames."""

    rate: Fraction
    """Frames per second."""
    frames: FloatArray
    """(samples,): where each sample lies, in frames from the first; whole numbers where `even`."""
    even: bool
    """Whether samples came at whole frames, some perhaps missing."""
    clock_error: float = 0.0
    """How much faster than `rate` samples came by their own clock, relative; 0 unless `even`."""


def settle_device_times(seconds: FloatArray, lines: IntArray, *, where: str) -> SampleTimes:
    """Find the frame rate a device ran at and the frame of each of its samples.

    Frames are counted from one sample to the next, so a device whose clock is a little off keeps
    one sample per frame however long the take. Samples that come unevenly stay at their times.

    Parameters
    ----------
    seconds : (samples,) float64 array
        [s]
    lines : (samples,) int array
        Where each is in its file, for messages.
    """
    check_ascending(seconds, lines, where=where)
    if len(seconds) < 2:
        raise InputError(f"{where}: one sample does not tell a frame rate; export a longer take")
    steps = np.diff(seconds)
    step = float(np.median(steps))
    counts = np.rint(steps / step)
    if counts.min() >= 1:
        step = float(steps.sum() / counts.sum())  # times are rounded: many tell the step better
        counts = np.rint(steps / step)
    even = (
        counts.min() >= 1
        and np.mean(np.abs(steps / step - counts) > _UNEVEN_FRAMES) <= _UNEVEN_SHARE
    )
    nearest = min(DEVICE_RATES, key=lambda rate: abs(rate * step - 1))
    if abs(nearest * step - 1) <= (_CLOCK_ERROR if even else 0.2):
        rate = Fraction(nearest)
        ntsc = min(
            (Fraction(1000 * base, 1001) for base in NTSC_BASES), key=lambda r: abs(r * step - 1)
        )
        if even and abs(ntsc * step - 1) <= _NTSC_CLOCK_ERROR:
            rate = ntsc
    else:
        rate = exact_rate(1 / step, where=where)
    frames = (
        np.concatenate([[0.0], np.cumsum(counts)]) if even else (seconds - seconds[0]) * float(rate)
    )
    check_span(frames, lines, where=where)
    return SampleTimes(rate, frames, bool(even), 1 / (step * float(rate)) - 1 if even else 0.0)


def settle_frame_numbers(
    numbers: FloatArray, lines: IntArray, *, where: str
) -> tuple[int, IntArray]:
    """Return the first frame number, and the frame of each row from 0."""
    whole = np.isfinite(numbers) & (np.abs(numbers) < 2**31)
    whole[whole] = numbers[whole] == np.rint(numbers[whole])
    if not whole.all():
        bad = int(np.argmin(whole))
        raise InputError(
            f"{where} line {lines[bad]}: frame number {numbers[bad]:g}; it must be a whole number: "
            "export the take again"
        )
    check_ascending(numbers, lines, where=where)
    frames = numbers - numbers[0]
    check_span(frames, lines, where=where)
    return int(numbers[0]), frames.astype(np.int64)


def rate_of_times(seconds: FloatArray, frames: IntArray, *, where: str) -> Fraction:
    """Return the simplest rate that rounded times of numbered frames allow."""
    low, measured, high = _rate_limits(seconds, frames, where=where)
    if high < _LOWEST_RATE:
        raise InputError(
            f"{where}: the times of the rows tell {measured:.3g} frames per second; they must be "
            "in seconds, not milliseconds: export the take again"
        )
    usual = min(DEVICE_RATES, key=lambda rate: abs(rate - measured))
    over_1001 = (Fraction(1000 * base, 1001) for base in NTSC_BASES)
    for rate in (Fraction(usual), Fraction(round(measured)), *over_1001):
        if low <= rate <= high:
            return rate
    return exact_rate(measured, where=where)


def check_rate(
    rate: Fraction,
    stated_in: str,
    seconds: FloatArray,
    frames: IntArray,
    *,
    where: str,
) -> None:
    """Refuse a file whose header and times tell two frame rates.

    Parameters
    ----------
    seconds : (rows,) float64 array
        [s]
    frames : (rows,) int array

    Raises
    ------
    InputError
        If they differ by more than rounding and one per cent.
    """
    if np.isnan(seconds).all() or (seconds == seconds[0]).all():  # without times, or one frame
        return
    low, measured, high = _rate_limits(seconds, frames, where=where)
    if not low * 0.99 <= float(rate) <= high * 1.01:
        raise InputError(
            f"{where}: two frame rates: {stated_in} says {float(rate):g}, the times of the rows "
            f"{measured:g}; export the take again, or say which is right with --rate"
        )


def check_ascending(values: FloatArray, lines: IntArray, *, where: str) -> None:
    """Refuse times or frame numbers that repeat or go back."""
    wrong = ~(np.diff(values) > 0)
    if wrong.any():
        row = int(np.argmax(wrong)) + 1
        raise InputError(
            f"{where} line {lines[row]}: {values[row]:.12g} follows {values[row - 1]:.12g}; it "
            "must ascend: one file holds one recording, export the take again"
        )


def check_span(frames: FloatArray, lines: IntArray, *, where: str) -> None:
    """Refuse samples so far apart that most of a take would be missing."""
    if frames[-1] > _LARGEST_RATIO * (len(frames) + 100):
        row = int(np.argmax(np.diff(frames))) + 1
        raise InputError(
            f"{where} line {lines[row]}: {frames[row] - frames[row - 1] - 1:.0f} frames are "
            "missing before this row; split the recording there, or export the take again"
        )


def _rate_limits(
    seconds: FloatArray, frames: IntArray, *, where: str
) -> tuple[float, float, float]:
    """Return the lowest, the measured and the highest rate that such rounded times can mean."""
    usable = len(seconds) > 1 and bool((np.abs(seconds) < _LONGEST_SECONDS).all())  # and not NaN
    span = float(seconds[-1] - seconds[0]) if usable else 0.0
    if span <= 0:
        raise InputError(
            f"{where}: the times of the rows do not tell a frame rate; export the take with "
            "times in seconds"
        )
    decimals = next(
        (
            count
            for count in range(7)
            if np.abs(np.round(seconds, count) - seconds).max() < 1e-9 + 1e-15 * span
        ),
        7,
    )
    count = float(frames[-1] - frames[0])
    rounding = min(10.0**-decimals, span / 2)  # half a unit at either end
    return count / (span + rounding), count / span, count / (span - rounding)


def picture_frames(times: FloatArray, rate: Fraction | None) -> tuple[Fraction, FloatArray]:
    """Return the rate of a video, and where each picture lies in frames from the first.

    Parameters
    ----------
    times : (pictures,) float array
        [s]
    rate : Fraction or None
        None where pictures come unevenly: then a device's rate near their median.
    """
    if rate is None:
        step = float(np.median(np.diff(times)))
        rate = Fraction(min(DEVICE_RATES, key=lambda each: abs(each * step - 1)))
    frames = (times - times[0]) * float(rate)
    whole = np.rint(frames)
    # A tenth of a frame: times are rounded.
    return rate, whole if np.abs(frames - whole).max() < 0.1 else frames


def index_kind(title: str) -> str:
    """Return ``'frame'``, ``'time'``, ``'ms'``, ``'take'`` or ``'timecode'``; empty for others."""
    lowered = title.strip().lower()
    return next((kind for kind, names in _INDEX_TITLES.items() if lowered in names), "")


def index_seconds(at: Mapping[str, int], values: FloatArray) -> FloatArray | None:
    """Return the times of rows [s] by the columns of their kinds; None where there are none."""
    if "ms" in at:
        return values[:, at["ms"]] * 1e-3
    if "time" not in at:
        return None
    times = values[:, at["time"]]
    if len(times) < 2:
        return times
    # No face is captured once a second or slower: steps of one and more are milliseconds.
    steps = np.diff(times)
    if "frame" in at:  # keys are farther apart than frames
        steps = steps / np.maximum(np.diff(values[:, at["frame"]]), 1.0)
    return times * 1e-3 if np.median(steps) >= 1.0 else times
