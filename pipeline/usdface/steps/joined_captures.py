"""Several captures of one moment, such as markers and Live Link, joined into one take."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from usdface.assets import FloatArray, Take, WeightsClip
from usdface.errors import InputError
from usdface.timecode import frames_of, timecode_of
from usdface.wording import counted

DAY_SECONDS = 86_400.0


@dataclass(frozen=True)
class Joined:
    """One take, and what should be known about how it came together.

    Attributes
    ----------
    take : Take
    notes : tuple of str
    """

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
            f"{names}: more than one has {what}; a take is one recording: ingest them one by one"
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
            f"outside the weights' recording, and holding its ends: {counted(outside, 'frame')}"
        )
    start = take.timecode_start or _start_at(take, other, notes)
    return Joined(replace(take, source=resampled, timecode_start=start), tuple(notes))


def _start_at(take: Take, other: Take, notes: list[str]) -> str:
    """Return the other's first label as a take of this one's rate has it: labels count frames."""
    if not other.timecode_start or other.rate == take.rate:
        return other.timecode_start
    try:
        seconds = frames_of(other.timecode_start, other.rate) / other.rate
        drop = ";" in other.timecode_start and take.rate.denominator == 1001
        return timecode_of(round(seconds * take.rate), take.rate, drop=drop)
    except InputError as error:
        notes.append(f"the timecode {other.timecode_start} was left out: {error}")
        return ""


def _start_difference(take: Take, other: Take) -> tuple[float, str]:
    """Return by how many seconds the other capture started later, and how that is known."""
    if not take.timecode_start or not other.timecode_start:
        return 0.0, "not both captures carry timecode: they are taken to start together"
    starts = [
        frames_of(each.timecode_start, each.rate) / float(each.rate) for each in (take, other)
    ]
    difference = starts[1] - starts[0]
    if abs(difference) > DAY_SECONDS / 2:  # recorded across midnight
        difference -= np.sign(difference) * DAY_SECONDS
    return float(difference), f"by timecode the weights start {difference:+.3f} s after the markers"


def _resample(clip: WeightsClip, take: Take, shift: float) -> tuple[WeightsClip, int]:
    own = np.arange(take.frame_count) / float(take.rate)
    given = np.arange(len(clip.values)) / float(clip.rate) + shift
    values: FloatArray = np.stack(
        [np.interp(own, given, column) for column in clip.values.T.astype(np.float64)], axis=1
    )
    outside = int(((own < given[0]) | (own > given[-1])).sum())
    resampled = WeightsClip(clip.names, values.astype(np.float32), take.first_frame, take.rate)
    return resampled, outside
