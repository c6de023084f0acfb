"""Frame rates and ranges as files state them: made exact, and refused where they cannot be."""

from collections.abc import Sequence
from fractions import Fraction
from math import isfinite

from usdface.core.errors import InputError

NTSC_BASES = (24, 30, 48, 60, 72, 90, 96, 120, 144, 180, 192, 240, 300, 360, 480)
"""[Hz] Rates that video also has over 1.001."""

_NTSC_TOLERANCE = 0.0051
"""[Hz] 23.976 is also written 23.98."""

_WHOLE_TOLERANCE = 1e-4
"""Relative; single precision and three written decimals are both finer."""

_LARGEST_DENOMINATOR = 1001
_HIGHEST_RATE = 100_000
"""[Hz] Beyond any camera: such a number is damage."""

_LARGEST_FRAME_COUNT = 10_000_000
"""23 hours at 120 frames per second: more is a mistake, and would ask for memory nobody has."""

FARTHEST_FRAME = 1e12
"""Clocks of stages that count frames from their own midnight stay far below it."""

FRAMES_BETWEEN_KEYS = 100
"""Most frames per sample on average: keyed animation has fewer, captures and solves have one."""

UNSAMPLED_FRAMES = 100_000
"""Frames that are accepted whatever the number of samples: reading them takes a second or two."""


def exact_rate(value: float, *, where: str) -> Fraction:
    """Return the exact rate behind a rounded one.

    Whole numbers stay whole; multiples of 24 and 30 over 1.001 (23.976, 29.97, 59.94, 119.88, …)
    become exact rationals; anything else becomes the nearest fraction with a denominator of at
    most 1001.

    Parameters
    ----------
    value : float
        Frames per second as the file states them.
    where : str
        File and place, for the message.

    Raises
    ------
    InputError
        If the rate is not a number above 0.
    """
    if not (isfinite(value) and 0 < value <= _HIGHEST_RATE):
        raise InputError(
            f"{where}: frame rate {value}; it must be above 0 and at most {_HIGHEST_RATE}; "
            "export the take again with its rate"
        )
    whole = round(value)
    if whole and abs(value - whole) <= _WHOLE_TOLERANCE * value and value / whole > 1 - 5e-4:
        return Fraction(whole)
    for base in NTSC_BASES:
        ntsc = Fraction(base * 1000, 1001)
        if abs(value - float(ntsc)) <= _NTSC_TOLERANCE:
            return ntsc
    exact = Fraction(value).limit_denominator(_LARGEST_DENOMINATOR)
    return exact if exact > 0 else Fraction(value)


def check_frame_span(where: str, first: float, last: float, *, samples: int | None) -> None:
    """Refuse a range of frames that is not finite, or too long for the samples of its file.

    Readers count frame by frame: one damaged time code would have them count for hours.

    Parameters
    ----------
    where : str
        File and prim, for the message.
    first, last : float
        Inclusive; what a file says, finite or not.
    samples : int or None
        Time codes at which the file has a value; None where nothing in it is read by frames.

    Raises
    ------
    InputError
        If an end is no frame, or there are too many frames between them.
    """
    if not (abs(first) < FARTHEST_FRAME and abs(last) < FARTHEST_FRAME):  # also catches NaN
        raise InputError(
            f"{where}: {first:g} to {last:g} is no range of frames; correct its ends, or write the "
            "file again"
        )
    count = last - first + 1
    limit = _LARGEST_FRAME_COUNT
    if samples is not None:
        limit = min(limit, max(UNSAMPLED_FRAMES, FRAMES_BETWEEN_KEYS * samples))
    if count > limit:
        sampled = "no samples" if samples is None else f"{samples} samples"
        raise InputError(
            f"{where}: {sampled} on {count:.0f} frames, {first:g} to {last:g}: an end is damaged, "
            "or a sample lies far off; correct it, or write the file again"
        )


def span_of_samples(where: str, times: Sequence[float]) -> tuple[int, int]:
    """Return the first and the last frame of ascending time codes.

    Raises
    ------
    InputError
        If they span more frames than a file of so few samples can mean.
    """
    check_frame_span(where, times[0], times[-1], samples=len(times))
    return round(times[0]), round(times[-1])
