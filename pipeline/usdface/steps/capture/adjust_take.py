"""Sides that are exchanged, frames that are left out, and the padding of a take."""

from dataclasses import replace
from fractions import Fraction

import numpy as np

from usdface.core.arrays import BoolArray, Float32Array
from usdface.core.assets import Markers, Take
from usdface.core.errors import InputError
from usdface.core.text import pluralize
from usdface.core.timecode import shift_timecode
from usdface.model.placement.label_hints import mirrored_label

_LEAST_FROZEN_SECONDS = 0.25
"""Measured positions are never equal in two frames; a longer run of copies is padding."""


def exchange_sides(take: Take, what: str, *, where: object) -> Take:
    """Exchange left and right of a take's markers, by their names or by their positions.

    Parameters
    ----------
    what : {'labels', 'axes'}
        `labels` exchanges the names of partners; `axes` reflects positions across the YZ plane.

    Raises
    ------
    InputError
        If there are no markers, or no label has a partner on the other side.
    """
    markers = take.markers
    if markers is None:
        raise InputError(
            f"{where}: has no markers whose sides could be exchanged; leave --mirrored"
        )
    if what == "axes":
        reflected = markers.positions * np.array([-1, 1, 1], np.float32)
        return replace(take, markers=replace(markers, positions=reflected))
    partners = {
        name: partner
        for name in markers.names
        for partner in mirrored_label(name)
        if partner in markers.names
    }
    if not partners:
        raise InputError(
            f"{where}: no label names a side that another label mirrors, as brow_L and brow_R do; "
            "rename the markers, or reflect them with --mirrored axes"
        )
    names, rigid = (
        tuple(partners.get(name, name) for name in old) for old in (markers.names, markers.rigid)
    )
    anchor = partners.get(markers.anchor, markers.anchor)
    return replace(take, markers=replace(markers, names=names, rigid=rigid, anchor=anchor))


def cut_frames(take: Take, limits: tuple[int, int], *, where: object) -> Take:
    """Keep the frames from the first to the last of `limits`; timecode and video stay in time.

    Raises
    ------
    InputError
        If they are not all in the take.
    """
    first, last = limits
    end = take.first_frame + take.frame_count - 1
    if not take.first_frame <= first <= last <= end:
        raise InputError(
            f"{where}: --frames {first}-{last} are not all in the take, which has "
            f"{take.first_frame}-{end}"
        )
    skipped = first - take.first_frame
    rows = slice(skipped, last - take.first_frame + 1)
    markers, source, video = take.markers, take.source, take.video
    if markers is not None:
        markers = _cut_markers(markers, rows, first)
    if source is not None:
        source = replace(source, values=source.values[rows], first_frame=first)
    if video is not None:
        video = replace(video, offset=video.offset - float(Fraction(skipped) / take.rate))
    return replace(
        take,
        first_frame=first,
        markers=markers,
        source=source,
        video=video,
        head_motion=None if take.head_motion is None else take.head_motion[rows],
        timecode_start=shift_timecode(take.timecode_start, skipped, take.rate),
        events=tuple(event for event in take.events if first <= event.frame <= last),
    )


def _cut_markers(markers: Markers, rows: slice, first: int) -> Markers:
    """Keep rows of the markers; a neutral frame that is gone is chosen as readers choose it."""
    visible = markers.visible[rows]
    neutral = markers.neutral_frame
    if not first <= neutral < first + len(visible):
        neutral = first + int(np.argmax(visible.sum(axis=1)))
    return replace(
        markers,
        positions=markers.positions[rows],
        visible=visible,
        confidence=markers.confidence[rows],
        neutral_frame=neutral,
    )


def padding_notes(take: Take) -> list[str]:
    """Say which frames at the ends hold no marker, or copies of one frame."""
    if take.markers is None or not take.markers.visible.any():
        return []
    seen: BoolArray = np.asarray(take.markers.visible.any(axis=1), np.bool_)
    rows = np.flatnonzero(seen)
    first, last = int(rows[0]), int(rows[-1])
    notes = [_padding(take, first, last, "hold no marker")] if last - first + 1 < len(seen) else []
    positions = take.markers.positions[first : last + 1]
    head, tail = _frozen(positions), _frozen(positions[::-1])
    least = _LEAST_FROZEN_SECONDS * float(take.rate)
    if head + tail < len(positions) - 1 and max(head, tail) >= least:
        head, tail = (run if run >= least else 0 for run in (head, tail))
        notes.append(_padding(take, first + head, last - tail, "are copies of one frame"))
    return notes


def _frozen(positions: Float32Array) -> int:
    """Return how many frames equal the one after them, from the first on."""
    count = 0
    while count + 1 < len(positions) and np.array_equal(positions[count], positions[count + 1]):
        count += 1
    return count


def _padding(take: Take, first: int, last: int, words: str) -> str:
    """Return the note that rows before `first` and after `last` are padding."""
    start, end = take.first_frame, take.first_frame + take.frame_count - 1
    keep = (start + first, start + last)
    ends = [f"{a}-{b}" for a, b in ((start, keep[0] - 1), (keep[1] + 1, end)) if a <= b]
    count = take.frame_count - (last - first + 1)
    return (
        f"{pluralize(count, 'frame')} at the ends {words} ({' and '.join(ends)}); leave them out "
        f"with --frames {keep[0]}-{keep[1]}"
    )
