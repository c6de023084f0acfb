"""Several captures of one moment, such as markers and Live Link, joined into one take."""

from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from usdface.core.arrays import FloatArray
from usdface.core.assets import Take, WeightsClip
from usdface.core.errors import InputError
from usdface.core.text import pluralize
from usdface.core.timecode import frames_of, timecode_of

DAY_SECONDS = Fraction(86_400)
DROP_DAY_SECONDS = Fraction(86_400 * 30 - 2 * (24 * 60 - 24 * 6)) * Fraction(1001, 30_000)
"""What a day of drop-frame labels lasts."""
_LONG_SECOND = Fraction(1001, 1000)
"""What 30 labels last at 29.97 frames per second, none left out."""


@dataclass(frozen=True)
class Joined:
    """One take, and what should be known about how it came together."""

    take: Take
    notes: tuple[str, ...]


def join_captures(takes: list[Take], sources: tuple[Path, ...]) -> Joined:
    """Put the markers of one capture and the blendshape weights of another into one take.

    Weights are resampled to the markers' frames. Where both carry timecode it says how they lie
    to each other; otherwise they are taken to start together, and that is noted.

    Raises
    ------
    InputError
        If more than one has markers, or more than one has weights, or they share no moment.
    """
    with_markers = [take for take in takes if take.markers is not None]
    with_weights = [take for take in takes if take.source is not None]
    names = ", ".join(map(str, sources))
    if len(with_markers) > 1 or len(with_weights) > 1:
        what = "markers" if len(with_markers) > 1 else "blendshape weights"
        raise InputError(
            f"{names}: more than one has {what}; a take is one recording: ingest them one by one, "
            "or choose the captures of a folder with --only, such as --only c3d"
        )
    take = (with_markers or with_weights or takes)[0]
    if not with_markers or not with_weights or with_weights[0] is take:
        return Joined(take, ())
    other = with_weights[0]
    if other.source is None:
        raise InputError(f"{names}: no blendshape weights to join")
    shift, note = _start_difference(take, other)
    resampled, outside = _resample(other.source, take, shift)
    if outside == take.frame_count:
        raise InputError(
            f"{names}: by their timecode ({take.timecode_start}, {other.timecode_start}) they "
            "share no moment; are they of one take?"
        )
    notes = [note, f"weights were resampled from {float(other.source.rate):g} frames per second"]
    if outside:
        notes.append(
            f"outside the weights' recording, and holding its ends: {pluralize(outside, 'frame')}"
        )
    start = take.timecode_start or _start_at(take, other, notes)
    return Joined(replace(take, source=resampled, timecode_start=start), tuple(notes))


def _start_at(take: Take, other: Take, notes: list[str]) -> str:
    """Return the other's first label as a take of this one's rate has it: labels count frames."""
    if not other.timecode_start or other.rate == take.rate:
        return other.timecode_start
    try:
        drop = ";" in other.timecode_start and take.rate.denominator == 1001
        frames = round(_reading(other) * _second(take, drop=drop) * take.rate)
        return timecode_of(frames, take.rate, drop=drop)
    except InputError as error:
        notes.append(f"the timecode {other.timecode_start} was left out: {error}")
        return ""


def _start_difference(take: Take, other: Take) -> tuple[float, str]:
    """Return by how many seconds the other capture started later, and how that is known."""
    if not take.timecode_start or not other.timecode_start:
        return 0.0, "not both captures carry timecode: they are taken to start together"
    all_drop = ";" in take.timecode_start and ";" in other.timecode_start
    day = DROP_DAY_SECONDS if all_drop else DAY_SECONDS
    apart = _reading(other) - _reading(take)
    apart = (apart + day / 2) % day - day / 2  # recorded across midnight, too
    caveat = ""
    if _second(take) == _second(other):
        apart *= _second(take)
    else:
        caveat = (
            f", as the labels read: {float(take.rate):g} and {float(other.rate):g} frames per "
            "second do not count the same seconds"
        )
    difference = float(apart)
    note = f"by timecode the weights start {difference:+.3f} s after the markers{caveat}"
    return difference, note


def _reading(take: Take) -> Fraction:
    """Return what the first label reads as a clock, in seconds since midnight.

    A phone that is jammed to 29.97 labels without drop frame writes the same labels and counts 30
    of them a second: labels of two such rates agree as they read, not as they are counted.
    """
    return frames_of(take.timecode_start, take.rate) / take.rate / _second(take)


def _second(take: Take, *, drop: bool | None = None) -> Fraction:
    """Return how long a second lasts by a take's labels [s]; dropped labels keep it true."""
    left_out = ";" in take.timecode_start if drop is None else drop
    return _LONG_SECOND if take.rate.denominator == 1001 and not left_out else Fraction(1)


def _resample(clip: WeightsClip, take: Take, shift: float) -> tuple[WeightsClip, int]:
    own = np.arange(take.frame_count) / float(take.rate)
    given = np.arange(len(clip.values)) / float(clip.rate) + shift
    values: FloatArray = np.stack(
        [np.interp(own, given, column) for column in clip.values.T.astype(np.float64)], axis=1
    )
    outside = int(((own < given[0]) | (own > given[-1])).sum())
    resampled = WeightsClip(clip.names, values.astype(np.float32), take.first_frame, take.rate)
    return resampled, outside
