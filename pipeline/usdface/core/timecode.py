"""SMPTE timecode: labels of frames, drop frame included, for any capture rate.

A label counts at a base rate of at most 30 (24, 25 or 30, whole or over 1.001); a faster capture
counts several frames to a label, as recorders do: at 120 frames per second four.
"""

import re
from fractions import Fraction

from usdface.core.errors import InputError

LABEL = re.compile(r"^(\d\d):(\d\d):(\d\d)([:;])(\d\d)$")
FASTEST_BASE = 30


def label_rate(rate: Fraction) -> tuple[int, int]:
    """Return (labels per nominal second, frames per label) of a capture rate.

    Raises
    ------
    InputError
        If the rate is no multiple of a rate that timecode knows.
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


def frames_of(timecode: str, rate: Fraction) -> int:
    """Return how many capture frames lie between midnight and the frame a label names.

    Raises
    ------
    InputError
        If the label does not exist at this rate.
    """
    base, per_label = label_rate(rate)
    match = LABEL.match(timecode)
    if match is None:
        raise InputError(f"timecode {timecode!r} is not hh:mm:ss:ff or hh:mm:ss;ff")
    hours, minutes, seconds, frames = (int(match[group]) for group in (1, 2, 3, 5))
    if minutes > 59 or seconds > 59 or frames >= base:
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
    """Return the label of the frame that lies so many capture frames after midnight."""
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


def shift_timecode(start: str, frames: int, rate: Fraction) -> str:
    """Return the label of the frame so many capture frames after the one `start` names."""
    if not start:
        return ""
    return timecode_of(frames_of(start, rate) + frames, rate, drop=";" in start)


def _check_drop_rate(what: str, rate: Fraction, base: int) -> None:
    if base != 30 or rate.denominator != 1001:
        raise InputError(
            f"{what}: drop frame exists only at multiples of 29.97, not at {float(rate):g}"
        )
