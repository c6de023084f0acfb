"""Exact frame rates, frame ranges and SMPTE timecode.

A timecode's label counts at a base rate of at most 30, whole or over 1.001; captures at multiples
of 24, 25 or 30 have several frames per label, as on recorders: at 120 frames per second four.
"""

import re
from collections.abc import Sequence
from fractions import Fraction

from usdface.core.errors import InputError

_DAY_SECONDS = 86_400
_DROPPED_LABELS = 2 * (24 * 60 - 24 * 6)
"""Labels that drop frame leaves out of a day."""

LABEL = re.compile(r"^(\d\d):(\d\d):(\d\d)([:;])(\d\d)$")
FASTEST_BASE = 30


def label_rate(rate: Fraction) -> tuple[int, int]:
    """Return (labels per nominal second, frames per label) of a capture rate.

    `InputError` if the rate is above 30 and no multiple of 24, 25 or 30.
    """
    nominal = round(float(rate) * 1.001) if rate.denominator == 1001 else round(float(rate))
    for base in (30, 25, 24):
        if nominal % base == 0 and nominal // base >= 1:
            return base, nominal // base
    if 0 < nominal <= FASTEST_BASE:
        return nominal, 1
    raise InputError(
        f"timecode cannot label {float(rate):g} frames per second: it is no multiple of 24, 25 or "
        "30; leave the timecode out"
    )


def label_alike(rate: Fraction, other: Fraction) -> bool:
    """Return whether a label of one rate is the same moment at the other."""
    try:
        bases = label_rate(rate)[0], label_rate(other)[0]
    except InputError:
        return rate == other
    return rate.denominator == other.denominator and bases[0] == bases[1]


def frames_of(timecode: str, rate: Fraction) -> int:
    """Return the capture frames from midnight to the frame of a label."""
    base, per_label = label_rate(rate)
    match = LABEL.match(timecode)
    if match is None:
        raise InputError(f"timecode {timecode!r} is not hh:mm:ss:ff or hh:mm:ss;ff")
    hours, minutes, seconds, frames = (int(match[group]) for group in (1, 2, 3, 5))
    if hours > 23 or minutes > 59 or seconds > 59 or frames >= base:
        raise InputError(f"timecode {timecode!r} does not exist at {base} labels per second")
    labels = ((hours * 60 + minutes) * 60 + seconds) * base + frames
    if match[4] == ";":
        _check_drop_rate(timecode, rate, base)
        if minutes % 10 and seconds == 0 and frames < 2:
            raise InputError(
                f"timecode {timecode!r} does not exist: drop frame leaves out ;00 and ;01 of each "
                "minute that is no multiple of ten"
            )
        total_minutes = hours * 60 + minutes
        labels -= 2 * (total_minutes - total_minutes // 10)
    return labels * per_label


def timecode_of(frames: int, rate: Fraction, *, drop: bool = False) -> str:
    """Return the label of a frame, counted in capture frames from midnight."""
    base, per_label = label_rate(rate)
    labels = frames // per_label
    if drop:
        _check_drop_rate("drop frame", rate, base)
        ten_minutes, rest = divmod(labels, 17982)
        # Each full minute after the first of ten has two labels fewer.
        labels += 18 * ten_minutes + (2 * ((rest - 2) // 1798) if rest > 1 else 0)
    seconds, frame = divmod(labels, base)
    minutes, second = divmod(seconds, 60)
    hours, minute = divmod(minutes, 60)
    return f"{hours % 24:02d}:{minute:02d}:{second:02d}{';' if drop else ':'}{frame:02d}"


def valid_timecode(timecode: str, rate: Fraction) -> tuple[str, tuple[str, ...]]:
    """Return a capture's label, or an empty one and a note on what is wrong with it."""
    try:
        if timecode:
            frames_of(timecode, rate)
    except InputError as error:
        return "", (f"the capture's timecode was left out: {error}",)
    return timecode, ()


def day_seconds(rate: Fraction, *, drop: bool) -> Fraction:
    """Return the duration of a day of labels at a rate [s]."""
    if drop:
        return Fraction(_DAY_SECONDS * 30 - _DROPPED_LABELS) * Fraction(1001, 30_000)
    return Fraction(_DAY_SECONDS) * (Fraction(1001, 1000) if rate.denominator == 1001 else 1)


def shift_timecode(start: str, frames: int, rate: Fraction) -> str:
    """Return the label of the frame `frames` capture frames after that of `start`."""
    if not start:
        return ""
    return timecode_of(frames_of(start, rate) + frames, rate, drop=";" in start)


def _check_drop_rate(what: str, rate: Fraction, base: int) -> None:
    if base != 30 or rate.denominator != 1001:
        raise InputError(
            f"{what}: drop frame exists only at multiples of 29.97, not at {float(rate):g}"
        )


NTSC_BASES = (12, 15, 24, 30, 48, 60, 72, 90, 96, 120, 144, 180, 192, 240, 300, 360, 480)
"""[Hz] Rates that video also has over 1.001."""

_NTSC_TOLERANCE = 0.0051
"""[Hz] 23.976 is also written 23.98."""

_WHOLE_TOLERANCE = 1e-4
"""Relative; larger than the rounding of single precision and of three decimals."""

_LARGEST_DENOMINATOR = 1001
_LOWEST_RATE, _HIGHEST_RATE = 0.001, 100_000
"""[Hz] Beyond those of any camera."""

_LARGEST_FRAME_COUNT = 10_000_000
"""23 hours at 120 frames per second."""

MAX_FRAME = 1e12
"""Far above frame numbers counted from midnight."""

FRAMES_BETWEEN_KEYS = 100
"""Most frames per sample on average: keyed animation has fewer, captures and solves have one."""

UNSAMPLED_FRAMES = 100_000
"""Frames accepted whatever the number of samples: reading them takes a second or two."""


def exact_rate(value: float, *, where: str) -> Fraction:
    """Return the exact rate of a rounded one.

    A whole number, one of `NTSC_BASES` over 1.001 (14.985, 23.976, 29.97, 59.94, …), or the
    nearest fraction with a denominator of at most 1001.
    """
    if not _LOWEST_RATE <= value <= _HIGHEST_RATE:  # NaN included
        raise InputError(
            f"{where}: frame rate {value}; it must be at least {_LOWEST_RATE} and at most "
            f"{_HIGHEST_RATE}; export the take again with its rate"
        )
    whole = round(value)
    if whole and abs(value - whole) <= _WHOLE_TOLERANCE * value:
        return Fraction(whole)
    for base in NTSC_BASES:
        ntsc = Fraction(base * 1000, 1001)
        if abs(value - float(ntsc)) <= _NTSC_TOLERANCE:
            return ntsc
    return Fraction(value).limit_denominator(_LARGEST_DENOMINATOR)


def frames_within(
    where: object, frames: tuple[int, int] | None, first: int, last: int
) -> tuple[int, int]:
    """Return the first and the last of the chosen frames, by default all; refuse missing ones."""
    if frames is None:
        return first, last
    if not first <= frames[0] <= frames[1] <= last:
        raise InputError(
            f"{where}: frames {frames[0]}-{frames[1]} are not all there; it has {first}-{last}"
        )
    return frames


def check_frame_span(where: str, first: float, last: float, *, samples: int | None) -> None:
    """Refuse a range of frames that is not finite, or too long for the samples of its file.

    With one damaged time code, readers of all frames would run for hours.

    Parameters
    ----------
    first, last : float
        Inclusive; as in the file, perhaps not finite.
    samples : int or None
        Number of time codes with a value; None if nothing in the file is read by frames.
    """
    if not (abs(first) < MAX_FRAME and abs(last) < MAX_FRAME):  # also catches NaN
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
    """Return the first and the last frame of ascending time codes."""
    check_frame_span(where, times[0], times[-1], samples=len(times))
    return round(times[0]), round(times[-1])
