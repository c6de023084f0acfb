"""Join captures to one take, exchange its sides, cut frames, report padding, extract sound."""

import filecmp
import re
import wave
from collections.abc import Iterable, Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import cast

import numpy as np

from usdface.capture.c3d import C3dFile, is_c3d, open_c3d
from usdface.core.arrays import BoolArray, Float32Array, FloatArray
from usdface.core.assets import Take, WeightsClip
from usdface.core.errors import InputError
from usdface.core.rates import day_seconds, frames_of, frames_within, shift_timecode, timecode_of
from usdface.core.replacing import replacing
from usdface.core.text import pluralize
from usdface.model.placement.label_hints import mirror_partners

_LEAST_FROZEN_SECONDS = 0.25
"""Measured positions are never equal in two frames; a longer run of equal ones is padding."""


def exchange_sides(take: Take, mirrored: str, *, where: object) -> Take:
    """Exchange left and right of a take's markers: names (`labels`) or positions (`axes`)."""
    markers = take.markers
    if markers is None:
        raise InputError(
            f"{where}: has no markers whose sides could be exchanged; leave out --mirrored"
        )
    if mirrored == "axes":
        reflected = markers.positions * np.array([-1, 1, 1], np.float32)
        mirror, motion = np.diag([-1.0, 1.0, 1.0, 1.0]), take.head_motion
        return replace(
            take,
            markers=replace(markers, positions=reflected),
            head_motion=None if motion is None else mirror @ motion @ mirror,
        )
    partners = mirror_partners(markers.names)
    if not partners:
        raise InputError(
            f"{where}: no two labels differ in their side, such as brow_L and brow_R; rename the "
            "markers, or reflect them with --mirrored axes"
        )
    names, rigid = (
        tuple(partners.get(name, name) for name in old) for old in (markers.names, markers.rigid)
    )
    anchor = partners.get(markers.anchor, markers.anchor)
    return replace(take, markers=replace(markers, names=names, rigid=rigid, anchor=anchor))


def cut_frames(take: Take, limits: tuple[int, int], *, where: object) -> Take:
    """Keep the frames within `limits`; timecode and video offset follow."""
    first, last = frames_within(where, limits, take.first_frame, take.last_frame)
    skipped = first - take.first_frame
    rows = slice(skipped, last - take.first_frame + 1)
    markers, source, video = take.markers, take.source, take.video
    if markers is not None:
        visible = markers.visible[rows]
        neutral = markers.neutral_frame
        if not first <= neutral < first + len(visible):  # cut off: take the most complete frame
            neutral = first + int(np.argmax(visible.sum(axis=1)))
        markers = replace(
            markers,
            positions=markers.positions[rows],
            visible=visible,
            confidence=markers.confidence[rows],
            neutral_frame=neutral,
        )
    if source is not None:
        gaps = _within(source.gaps, first, last)
        source = replace(source, values=source.values[rows], first_frame=first, gaps=gaps)
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


def _within(gaps: Iterable[tuple[int, int]], first: int, last: int) -> tuple[tuple[int, int], ...]:
    """Return the parts of frame ranges between two frames."""
    cut = ((max(start, first), min(end, last)) for start, end in gaps)
    return tuple(each for each in cut if each[0] <= each[1])


def padding_notes(take: Take) -> list[str]:
    """Return notes on frames at the ends that hold no marker, or copies of one frame."""
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
    """Return the number of frames at the start that equal the next one."""
    count = 0
    while count + 1 < len(positions) and np.array_equal(positions[count], positions[count + 1]):
        count += 1
    return count


def _padding(take: Take, first: int, last: int, words: str) -> str:
    """Return the note that rows before `first` and after `last` are padding."""
    start, end = take.first_frame, take.last_frame
    keep = (start + first, start + last)
    ends = [f"{a}-{b}" for a, b in ((start, keep[0] - 1), (keep[1] + 1, end)) if a <= b]
    count = take.frame_count - (last - first + 1)
    return (
        f"{pluralize(count, 'frame')} at the ends {words} ({' and '.join(ends)}); leave them out "
        f"with --frames {keep[0]}-{keep[1]}"
    )


SOUND_NAME = re.compile(r"audio|sound|mic|voice|speech", re.IGNORECASE)
LEAST_RATE = 4000.0
"""[Hz] Lowest rate of sound; slower channels are force plates and switches."""

_CHUNK_FRAMES = 1 << 14


def extract_sound(
    sources: Sequence[Path], out: Path, *, channel: str | None, ours: bool, skipped: tuple[int, int]
) -> str | None:
    """Write the analog channel that holds sound as a WAV file; return a note on it.

    `channel`: by default the first whose name suggests sound; None is returned if there is none.
    `ours`: whether an existing file at `out` was made by this step. `skipped`: frames to leave out
    at the start and the end.
    """
    faults = list[str]()
    for source in sources:
        with source.open("rb") as stream:
            if not is_c3d(stream.read(512)):
                continue
        capture = open_c3d(source)
        names = [label.strip() for label in capture.analog_labels]
        faults.append(
            f"{source}: no analog channel {channel!r}; there are {', '.join(names) or 'none'}"
        )
        chosen = channel if channel in names else None
        if channel is None and capture.analog_rate >= LEAST_RATE:
            chosen = next((name for name in names if SOUND_NAME.search(name)), None)
        if chosen is not None:
            frames = range(skipped[0], capture.layout.frame_count - skipped[1])
            _write_wav(out, capture, names.index(chosen), frames, ours=ours)
            rate = capture.analog_rate
            return f"sound extracted from analog channel {chosen} ({rate:g} Hz)"
    if channel is None:
        return None
    if faults:
        raise InputError("\n".join(faults))
    raise InputError(
        f"{', '.join(map(str, sources))}: only C3D carries analog channels; leave "
        "--audio-channel out"
    )


def _write_wav(path: Path, capture: C3dFile, column: int, frames: range, *, ours: bool) -> None:
    """Write 16-bit samples, normalised to full scale, in several passes of bounded memory."""
    starts = frames[::_CHUNK_FRAMES]

    def samples(start: int) -> FloatArray:
        """Return samples, NaN where the file has no finite value."""
        stop = min(start + _CHUNK_FRAMES, frames.stop)
        values = capture.read_analog(start, stop)[:, column].astype(np.float64)
        return np.where(np.isfinite(values), values, np.nan)

    total = sum(float(np.nansum(samples(start))) for start in starts)
    count = max(sum(int(np.isfinite(samples(start)).sum()) for start in starts), 1)
    mean = total / count  # the offset voltage of the capture card

    def sound_from(start: int) -> FloatArray:
        return np.nan_to_num(samples(start) - mean)  # dropped samples become 0

    loudest = max((float(np.abs(sound_from(start)).max()) for start in starts), default=0.0)
    scale = 32767.0 / loudest if loudest > 0 else 0.0
    with replacing(path) as temporary:
        with wave.open(str(temporary), "wb") as stream:
            stream.setnchannels(1)
            stream.setsampwidth(2)
            stream.setframerate(round(capture.analog_rate))
            for start in starts:
                stream.writeframes(np.round(sound_from(start) * scale).astype("<i2").tobytes())
        # An identical file may be left by a run that was killed before it wrote its take.
        if not ours and path.exists() and not filecmp.cmp(path, temporary, shallow=False):
            raise InputError(
                f"{path}: exists and is not the sound of this take, which is to be written there; "
                "move the file, or use it with --audio"
            )


_LONG_SECOND = Fraction(1001, 1000)
"""Duration of 30 labels at 29.97 frames per second, without drop frame."""


def join_captures(takes: list[Take], sources: tuple[Path, ...]) -> tuple[Take, tuple[str, ...]]:
    """Join the markers of one capture and the weights of another to one take; return it with notes.

    Weights are resampled to the markers' frames, aligned by timecode if both have it; otherwise
    they are assumed to start together, and that is noted.
    """
    with_markers = [take for take in takes if take.markers is not None]
    with_weights = [take for take in takes if take.source is not None]
    names = ", ".join(map(str, sources))
    if len(with_markers) > 1 or len(with_weights) > 1:
        repeated = "markers" if len(with_markers) > 1 else "blendshape weights"
        raise InputError(
            f"{names}: more than one has {repeated}; a take is one recording: ingest them one by "
            "one, or choose the captures of a folder with --only, such as --only c3d"
        )
    take = (with_markers or with_weights or takes)[0]
    if not with_markers or not with_weights or with_weights[0] is take:
        return take, ()
    other = with_weights[0]
    clip = cast(WeightsClip, other.source)
    shift, note = _start_difference(take, other)
    resampled, outside = _resample(clip, take, shift)
    if outside == take.frame_count:
        raise InputError(
            f"{names}: do not overlap in time by their timecode ({take.timecode_start}, "
            f"{other.timecode_start}); ingest them as separate takes, or correct the timecode"
        )
    notes = [note, f"weights were resampled from {float(clip.rate):g} frames per second"]
    if outside:
        notes.append(
            f"{pluralize(outside, 'frame')} outside the recording of the weights hold its first or "
            "last weights"
        )
    start = take.timecode_start or _start_at(take, other, notes)
    return replace(take, source=resampled, timecode_start=start), tuple(notes)


def _start_at(take: Take, other: Take, notes: list[str]) -> str:
    """Return the first label of another capture at the rate of a take, as labels count frames."""
    if not other.timecode_start or other.rate == take.rate:
        return other.timecode_start
    try:
        drop = ";" in other.timecode_start and take.rate.denominator == 1001
        frames = round(_reading(other) * _second(take, drop=drop) * take.rate)
        return timecode_of(frames, take.rate, drop=drop)
    except InputError as error:
        notes.append(f"the timecode {other.timecode_start} is not stored: {error}")
        return ""


def _start_difference(take: Take, other: Take) -> tuple[float, str]:
    """Return by how many seconds the other capture started later, and a note on the source."""
    if not take.timecode_start or not other.timecode_start:
        return 0.0, "not both captures have timecode: they are assumed to start together"
    all_drop = ";" in take.timecode_start and ";" in other.timecode_start
    day = day_seconds(take.rate, drop=all_drop) / _second(take, drop=all_drop)
    difference = _reading(other) - _reading(take)
    difference = (difference + day / 2) % day - day / 2  # recorded across midnight, too
    caveat = ""
    if _second(take) == _second(other):
        difference *= _second(take)
    else:
        caveat = (
            f", comparing labels as clock times: at {float(take.rate):g} and "
            f"{float(other.rate):g} frames per second they do not count the same seconds"
        )
    note = f"by timecode the weights start {float(difference):+.3f} s after the markers{caveat}"
    return float(difference), note


def _reading(take: Take) -> Fraction:
    """Return the clock time of the first label, in seconds since midnight.

    A phone synchronised to 29.97 labels without drop frame writes the same labels but counts 30 of
    them a second: labels of two such rates agree as clock times, not as counts.
    """
    return frames_of(take.timecode_start, take.rate) / take.rate / _second(take)


def _second(take: Take, *, drop: bool | None = None) -> Fraction:
    """Return the duration of a second of a take's labels [s], 1 with drop frame."""
    is_drop = ";" in take.timecode_start if drop is None else drop
    return _LONG_SECOND if take.rate.denominator == 1001 and not is_drop else Fraction(1)


def _resample(clip: WeightsClip, take: Take, shift: float) -> tuple[WeightsClip, int]:
    """Return weights at a take's frames, and how many frames lie outside their recording."""
    times = np.arange(take.frame_count) / float(take.rate)
    clip_times = np.arange(len(clip.values)) / float(clip.rate) + shift
    values: FloatArray = np.stack(
        [np.interp(times, clip_times, column) for column in clip.values.T.astype(np.float64)],
        axis=1,
    )
    outside = int(((times < clip_times[0]) | (times > clip_times[-1])).sum())

    def number(frame: int) -> int:
        seconds = (frame - clip.first_frame) / clip.rate + shift
        return take.first_frame + round(seconds * take.rate)

    gaps = ((number(first), number(last)) for first, last in clip.gaps)
    resampled = WeightsClip(
        clip.names,
        values.astype(np.float32),
        take.first_frame,
        take.rate,
        _within(gaps, take.first_frame, take.last_frame),
    )
    return resampled, outside
