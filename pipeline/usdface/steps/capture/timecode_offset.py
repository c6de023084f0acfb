"""What two timecodes say of when a video starts in a take."""

from dataclasses import dataclass
from fractions import Fraction

from usdface.core.errors import InputError
from usdface.core.timecode import frames_of, label_rate

_DAY_SECONDS = 86400


@dataclass(frozen=True)
class TimecodeShift:
    """When a video starts in a take, by the labels of both."""

    offset: float | None
    """[s]; None where the labels cannot be compared."""
    tolerance: float = 0.0
    """How far the truth may be from it: each label names its frame, not the moment in it [s]."""
    reason: str = ""
    """Why they cannot be compared."""


def timecode_shift(
    take_start: str,
    take_rate: Fraction,
    video_start: str,
    video_rate: Fraction | None,
    *,
    first_picture: float = 0.0,
) -> TimecodeShift:
    """Compare the timecode of a take's first frame with that of a video's first picture.

    Parameters
    ----------
    take_start, video_start : str
        SMPTE labels; empty where there is none.
    take_rate : Fraction
        Frames per second of the capture.
    video_rate : Fraction or None
        Frames per second of the video; None where it varies.
    first_picture : float
        When the first picture appears on the video's clock [s].
    """
    missing = [name for name, label in (("take", take_start), ("video", video_start)) if not label]
    if missing:
        verb = "carries" if len(missing) == 1 else "carry"
        return TimecodeShift(None, reason=f"the {' and the '.join(missing)} {verb} no timecode")
    if video_rate is None:
        return TimecodeShift(None, reason="the video's frames are not evenly spaced")
    drop = tuple(";" in label for label in (take_start, video_start))
    if drop[0] != drop[1] or take_rate.denominator != video_rate.denominator:
        # 23.976 and 24 both count 24 labels a second, of another second.
        return TimecodeShift(
            None,
            reason=f"timecode at {_named(take_rate, drop[0])} and {_named(video_rate, drop[1])} "
            "does not count the same seconds",
        )
    try:
        take_time = frames_of(take_start, take_rate) / take_rate
        video_time = frames_of(video_start, video_rate) / video_rate
    except InputError as error:
        return TimecodeShift(None, reason=str(error))
    day = _DAY_SECONDS * (Fraction(1001, 1000) if take_rate.denominator == 1001 else 1)
    apart = (video_time - take_time + day / 2) % day - day / 2  # across midnight too
    tolerance = sum((_label_seconds(rate) for rate in (take_rate, video_rate)), Fraction(0))
    return TimecodeShift(float(apart) - first_picture, float(tolerance))


def _label_seconds(rate: Fraction) -> Fraction:
    return label_rate(rate)[1] / rate


def _named(rate: Fraction, drop: bool) -> str:
    return f"{float(rate):.6g}{' drop frame' if drop else ''}"
