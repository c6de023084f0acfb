"""Sample times: the frame rate behind times in a file, and the frame of each sample."""

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from usdface.core.arrays import FloatArray, IntArray
from usdface.core.errors import InputError
from usdface.core.rates import NTSC_BASES, exact_rate

_INDEX_TITLES = {
    "frame": ("frame", "frame#", "frames", "frame_number", "frame number", "framenumber"),
    "time": ("time", "timestamp", "t"),
    "s": ("time_s", "time (s)", "time (seconds)", "seconds"),
    "ms": ("time_ms", "timestamp_ms", "timestampms", "milliseconds", "ms"),
    "take": ("take", "take_name", "clip"),
    "timecode": ("timecode", "tc"),
}
"""Titles of columns that index the rows of a table, by kind."""
DEVICE_RATES = (15, 20, 24, 25, 30, 48, 50, 60, 90, 100, 120, 240)
"""Nominal rates of cameras and phones [Hz]."""
_CLOCK_ERROR = 0.005
"""Largest relative deviation from a nominal rate; measured phones are within 0.001."""
_NTSC_CLOCK_ERROR = 5e-5
"""Largest relative deviation from 59.94 and alike, of clocks locked to video; 60 is 1e-3 off."""

_UNEVEN_FRAMES = 0.3
"""Deviation of a step from a whole number of frames that counts as uneven [frames]."""
_UNEVEN_SHARE = 0.02
_LONGEST_SECONDS = 1e10
"""Times may count from 1970."""
_LOWEST_RATE = 1.0
"""Lowest rate of a capture [Hz]; below it, times are in milliseconds."""
_LARGEST_ERROR_FRAMES, _LARGEST_ERROR_SECONDS = 2.0, 0.1
"""Largest difference of a row's time from that of its frame number, by the larger of the two: times
of arrival are uneven. Beyond it the sound is visibly out of step: frames are missing from the
count, or recordings were joined."""
_LARGEST_RATIO = 10
"""Frames per sample above which frame numbers count as damaged."""
_LARGEST_FRAME_NUMBER = 2**31
"""USD stores frame numbers of references and neutral faces in 32 bits."""


@dataclass(frozen=True)
class SampleTimes:
    """Positions of samples on a clock of even frames."""

    rate: Fraction
    """Frames per second."""
    frames: FloatArray
    """(samples,): frames since the first sample; whole numbers if `even`."""
    even: bool
    """Whether samples are at whole frames, perhaps with some missing."""
    clock_error: float = 0.0
    """Relative excess of the measured rate over `rate`; 0 unless `even`."""


def resolve_device_times(seconds: FloatArray, lines: IntArray, *, where: str) -> SampleTimes:
    """Return the nominal frame rate of a device and the frame of each of its samples.

    Frames are counted from sample to sample, so that clock drift does not accumulate over a long
    take. Unevenly spaced samples keep their times.

    Parameters
    ----------
    seconds : (samples,) float64 array
        [s]
    lines : (samples,) int array
        Line of each sample in its file, for messages.
    """
    check_ascending(seconds, lines, where=where)
    if len(seconds) < 2:
        raise InputError(
            f"{where}: one sample does not determine a frame rate; export a longer take"
        )
    steps = np.diff(seconds)
    step = float(np.median(steps))
    counts = np.rint(steps / step)
    if counts.min() >= 1:
        step = float(steps.sum() / counts.sum())  # the mean is less affected by rounding of times
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


def resolve_frame_numbers(
    numbers: FloatArray, lines: IntArray, *, where: str
) -> tuple[int, IntArray]:
    """Return the first frame number, and the frame of each row from 0."""
    whole = whole_numbers(numbers, lines, where=where)
    check_ascending(numbers, lines, where=where)
    frames = whole - whole[0]
    check_span(frames, lines, where=where)
    return int(whole[0]), frames


def whole_numbers(numbers: FloatArray, lines: IntArray, *, where: str) -> IntArray:
    """Return frame numbers as integers; refuse others."""
    whole = np.isfinite(numbers) & (np.abs(numbers) < _LARGEST_FRAME_NUMBER)
    whole[whole] = numbers[whole] == np.rint(numbers[whole])
    if not whole.all():
        bad = int(np.argmin(whole))
        raise InputError(
            f"{where} line {lines[bad]}: frame number {numbers[bad]:g}; it must be a whole number "
            f"below {_LARGEST_FRAME_NUMBER}; correct it, or export the file again"
        )
    return numbers.astype(np.int64)


def rate_of_times(seconds: FloatArray, frames: IntArray, *, where: str) -> Fraction:
    """Return the simplest rate consistent with rounded times of numbered frames."""
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
    rate: Fraction, stated_in: str, seconds: FloatArray, frames: IntArray, *, where: str
) -> None:
    """Refuse a header and times whose frame rates differ by more than rounding and one per cent.

    Parameters
    ----------
    seconds : (rows,) float64 array
        [s]
    frames : (rows,) int array
    """
    if np.isnan(seconds).all() or (seconds == seconds[0]).all():  # without times, or one frame
        return
    low, measured, high = _rate_limits(seconds, frames, where=where)
    if not low * 0.99 <= float(rate) <= high * 1.01:
        raise InputError(
            f"{where}: two frame rates: {stated_in} says {float(rate):g}, the times of the rows "
            f"{measured:g}; export the take again, or set the right one with --rate"
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


def check_span(frames: FloatArray | IntArray, lines: IntArray, *, where: str) -> None:
    """Refuse samples so sparse that most frames of the take would be missing."""
    if frames[-1] > _LARGEST_RATIO * (len(frames) + 100):
        row = int(np.argmax(np.diff(frames))) + 1
        raise InputError(
            f"{where} line {lines[row]}: {frames[row] - frames[row - 1] - 1:.0f} frames are "
            "missing before this row; split the recording there, or export the take again"
        )


def _rate_limits(
    seconds: FloatArray, frames: IntArray, *, where: str
) -> tuple[float, float, float]:
    """Return the lowest, the measured and the highest rate consistent with rounded times."""
    if len(seconds) < 2:
        raise InputError(f"{where}: one row does not determine a frame rate; give it by --rate")
    usable = bool((np.abs(seconds) < _LONGEST_SECONDS).all())  # and not NaN
    span = float(seconds[-1] - seconds[0]) if usable else 0.0
    if span <= 0:
        raise InputError(
            f"{where}: the times of the rows do not determine a frame rate; export the take with "
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
    errors = np.abs((seconds - seconds[0]) - (frames - frames[0]) * (span / count))
    if errors.max() > max(_LARGEST_ERROR_FRAMES * span / count, _LARGEST_ERROR_SECONDS):
        row = int(np.argmax(np.abs(np.diff(seconds) - np.diff(frames) * (span / count)))) + 1
        raise InputError(
            f"{where}: times and frame numbers of the rows differ by up to {errors.max():.3g} s at "
            f"{count / span:.4g} frames per second, most between rows {row} and {row + 1}: frames "
            "are missing from the count, or two recordings were joined; export without frame "
            "numbers, or split the recording; of markers, --rate sets the rate without the times"
        )
    rounding = min(10.0**-decimals, span / 2)  # half a unit at either end
    return count / (span + rounding), count / span, count / (span - rounding)


def picture_frames(times: FloatArray, rate: Fraction | None) -> tuple[Fraction, FloatArray]:
    """Return the rate of a video, and the position of each picture in frames from the first.

    Parameters
    ----------
    times : (pictures,) float array
        [s]
    rate : Fraction or None
        None for uneven pictures: then the nominal rate nearest to their median.
    """
    if rate is None:
        step = float(np.median(np.diff(times)))
        rate = Fraction(min(DEVICE_RATES, key=lambda each: abs(each * step - 1)))
    frames = (times - times[0]) * float(rate)
    whole = np.rint(frames)
    # A tenth of a frame: times are rounded.
    return rate, whole if np.abs(frames - whole).max() < 0.1 else frames


def index_kind(title: str) -> str:
    """Return a key of `_INDEX_TITLES`, such as ``'frame'``, or else ``''``."""
    lowered = title.strip().lower()
    return next((kind for kind, names in _INDEX_TITLES.items() if lowered in names), "")


def index_seconds(at: Mapping[str, int], values: FloatArray) -> FloatArray | None:
    """Return the times of rows [s], given the column of each kind; None without times."""
    for kind, unit in (("s", 1.0), ("ms", 1e-3)):
        if kind in at:
            return values[:, at[kind]] * unit
    if "time" not in at:
        return None
    times = values[:, at["time"]]
    if len(times) < 2:
        return times
    # Steps of one and more are milli-, micro- or nanoseconds: captures have 1 to 1000 Hz.
    steps = np.diff(times)
    if "frame" in at:  # keys are farther apart than frames
        steps = steps / np.maximum(np.diff(values[:, at["frame"]]), 1.0)
    return times / 1e3 ** np.searchsorted([1.0, 1e3, 1e6], np.median(steps), side="right")
