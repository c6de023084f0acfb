"""Layout of the samples in a C3D file, checked against the file's size."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from usdface.capture.c3d_parameters import PROCESSORS, Parameters, Processor, parse_parameters
from usdface.core.confinement import check_may_open
from usdface.core.errors import InputError

BLOCK_BYTES = 512
C3D_MAGIC = 0x50
_LARGEST_UINT16 = 0xFFFF
"""Value of a 16-bit frame count if the take is longer."""
_REPAIR = "export the take again from the capture software, or copy the file again"


@dataclass(frozen=True)
class C3dLayout:
    """Counts, types and offsets needed to read samples."""

    processor: Processor
    parameters: Parameters
    header: bytes
    """The first block; holds the events of old files."""
    point_count: int
    analog_count: int
    """`point_count`, `analog_count`: points per frame, analog channels."""
    analog_per_frame: int
    """Analog samples of each channel per point frame."""
    first_frame: int
    frame_count: int
    rate: float
    """Point frames per second, as stored."""
    scale: float
    """Negative if samples are stored as floats, else the unit of the integers."""
    data_start: int
    """Byte offset of the first frame."""
    notes: tuple[str, ...]
    """Contradictions and the reading that was chosen."""

    @property
    def frame_items(self) -> int:
        """Stored numbers of one frame: x, y, z and residual of each point, then analog samples."""
        return self.point_count * 4 + self.analog_count * self.analog_per_frame


def read_layout(path: Path) -> C3dLayout:
    """Read header and parameters of a C3D file."""
    check_may_open(path)
    size = path.stat().st_size
    with path.open("rb") as file:
        header = file.read(BLOCK_BYTES)
        if header[1:2] != bytes([C3D_MAGIC]):
            raise InputError(
                f"{path}: not a C3D file: its second byte is {header[1:2].hex() or 'missing'} "
                "instead of 50; choose the capture's .c3d export"
            )
        if len(header) < BLOCK_BYTES:
            raise InputError(
                f"{path}: ends after {len(header)} of the {BLOCK_BYTES} bytes of a C3D header; "
                f"{_REPAIR}"
            )
        section_start = (max(header[0], 1) - 1) * BLOCK_BYTES
        file.seek(section_start)
        prefix = file.read(4)
        if section_start == 0 or len(prefix) < 4 or prefix[3] not in PROCESSORS:
            raise InputError(
                f"{path}: parameter section at block {header[0]}: "
                f"processor type {prefix[3] if len(prefix) == 4 else 'missing'}, expected 84, 85 "
                f"or 86; {_REPAIR}"
            )
        processor = PROCESSORS[prefix[3]]
        words = np.frombuffer(header, processor.unsigned)
        # Up to the data: some programs write a block count that is too small.
        wanted = max(prefix[2] * BLOCK_BYTES, (int(words[8]) - 1) * BLOCK_BYTES - section_start)
        file.seek(section_start)
        section = file.read(min(wanted, size - section_start))
    parameters = parse_parameters(section, processor=processor)
    return _settle_layout(path, size, header, processor, parameters)


def _settle_layout(
    path: Path, size: int, header: bytes, processor: Processor, parameters: Parameters
) -> C3dLayout:
    """Combine header and parameters; where they differ, a note states which was used."""
    words = [int(word) for word in np.frombuffer(header, processor.unsigned, 10)]
    header_floats = processor.floats(header[:24])
    notes = list(parameters.notes)

    scale = _finite(parameters.number("POINT:SCALE")) or _finite(float(header_floats[3]))
    rate = _finite(parameters.number("POINT:RATE")) or _finite(float(header_floats[5]))
    if scale is None or rate is None or rate <= 0:
        raise InputError(
            f"{path}: POINT:SCALE {parameters.number('POINT:SCALE')}, "
            f"POINT:RATE {parameters.number('POINT:RATE')}: both must be numbers other than 0 and "
            f"the rate above 0; {_REPAIR}"
        )
    block = words[8] or parameters.unsigned("POINT:DATA_START") or 0
    data_start = (block - 1) * BLOCK_BYTES
    frame = _settle_frame_layout(
        notes, parameters, words, size - data_start, scale, float(header_floats[3])
    )
    points, channels, per_frame, scale = frame
    stride = _stride(frame)
    if data_start < BLOCK_BYTES or data_start > size or stride == 0:
        raise InputError(
            f"{path}: data at block {block} of {size // BLOCK_BYTES}, {points} points and "
            f"{channels} analog channels per frame: nothing can be read; {_REPAIR}"
        )
    capacity = (size - data_start) // stride
    first_frame, frame_count = _settle_frame_range(
        notes, parameters, words[3], words[4], capacity, padding=(BLOCK_BYTES - 1) // stride
    )
    if frame_count > capacity:
        raise InputError(
            f"{path}: the header promises {frame_count} frames of {stride} bytes from byte "
            f"{data_start}, the file ends after {capacity} at byte {size}; {_REPAIR}"
        )
    if frame_count < 1:
        raise InputError(f"{path}: no frames ({frame_count}); {_REPAIR}")
    return C3dLayout(
        processor=processor,
        parameters=parameters,
        header=header,
        point_count=points,
        analog_count=channels,
        analog_per_frame=per_frame,
        first_frame=first_frame,
        frame_count=frame_count,
        rate=rate,
        scale=scale,
        data_start=data_start,
        notes=tuple(notes),
    )


def _finite(number: float | None) -> float | None:
    return number if number is not None and math.isfinite(number) and number != 0 else None


class _Frame(NamedTuple):
    """A candidate for the layout of one frame."""

    points: int
    channels: int
    per_frame: int
    """Analog samples of each channel."""
    scale: float
    """Negative for floats."""


def _stride(frame: _Frame) -> int:
    """Return the bytes of one frame."""
    items = frame.points * 4 + frame.channels * frame.per_frame
    return items * (4 if frame.scale < 0 else 2)


def _settle_frame_layout(
    notes: list[str],
    parameters: Parameters,
    words: list[int],
    room: int,
    scale: float,
    header_scale: float,
) -> _Frame:
    """Return the layout of one frame.

    Header and parameters both state it, and programs write either wrong. The first candidate whose
    samples end in the last block of the file is chosen; `room` is the size of the data [bytes].
    """
    point_counts = [words[1]]
    if (used := parameters.unsigned("POINT:USED")) is not None:
        point_counts = list(dict.fromkeys([used, words[1]]))
    scales = [scale]
    if math.isfinite(header_scale) and header_scale * scale < 0:
        scales = [min(scale, header_scale), max(scale, header_scale)]
    stated = _analog_stated(parameters)
    analog = _analog_readings(stated, parameters, words[2], words[9])
    readings = [
        _Frame(points, channels, per_frame, signed_scale)
        for points in point_counts
        for channels, per_frame in analog
        for signed_scale in scales
    ]
    counts = _frame_counts(parameters, words)
    fitting = [
        reading
        for reading in readings
        if any(0 <= room - count * _stride(reading) < BLOCK_BYTES for count in counts)
    ]
    # If none fits, the sign follows from the size: floats take twice the bytes of integers.
    roomy = [reading for reading in readings if counts and counts[0] * _stride(reading) <= room]
    chosen = (fitting or (roomy if len(scales) > 1 else []) or readings)[0]
    by_size = " by the file's size" if fitting else ""
    if len(point_counts) > 1:
        parameter, header = point_counts
        notes.append(
            f"points per frame: the parameters say {parameter}, the header {header}; "
            f"{chosen.points} used{by_size}"
        )
    read = (chosen.channels, chosen.per_frame)
    if (stated is not None and stated != analog[0]) or read != analog[0]:
        notes.append(
            f"analog samples: the header says {_analog_text(analog[0])}, the parameters "
            f"{_analog_text(stated or (0, 0))}; {_analog_text(read)} used{by_size}"
        )
    if len(scales) > 1:
        notes.append(
            f"POINT:SCALE {scale:g} and the header's {header_scale:g} differ in sign; the samples "
            f"take the room of {'floats' if chosen.scale < 0 else 'integers'} and are read as such"
        )
    return chosen


def _analog_text(reading: tuple[int, int]) -> str:
    return f"{reading[0]} channels x {reading[1]} a frame"


def _frame_counts(parameters: Parameters, words: list[int]) -> list[int]:
    """Return the frame counts that the file states, the header's first."""
    first = parameters.long("TRIAL:ACTUAL_START_FIELD")
    last = parameters.long("TRIAL:ACTUAL_END_FIELD")
    counts = (
        words[4] - words[3] + 1,
        parameters.unsigned("POINT:FRAMES") or 0,
        int(_finite(parameters.number("POINT:LONG_FRAMES")) or 0),
        0 if first is None or last is None else last - first + 1,
    )
    return [count for count in counts if count > 0]


def _analog_stated(parameters: Parameters) -> tuple[int, int] | None:
    """Return channels and samples per frame from the parameters, if they state both."""
    channels = parameters.unsigned("ANALOG:USED") or 0
    point_rate = _finite(parameters.number("POINT:RATE"))
    analog_rate = _finite(parameters.number("ANALOG:RATE"))
    if not channels or not point_rate or not analog_rate:
        return None
    ratio = round(analog_rate / point_rate)
    return (channels, ratio) if ratio > 0 else None


def _analog_readings(
    stated: tuple[int, int] | None, parameters: Parameters, total: int, per_frame: int
) -> list[tuple[int, int]]:
    """Return the candidates for channels and samples per frame, the header's first.

    In the format, the header's third word, `total`, is the product of both; some programs write
    the channels only.
    """
    channels = parameters.unsigned("ANALOG:USED") or 0
    if total == 0:
        readings = [(0, 0)]
    elif channels and total % channels == 0:
        readings = [(channels, total // channels)]
    elif per_frame and total % per_frame == 0:
        readings = [(total // per_frame, per_frame)]
    else:
        readings = [(total, 1)]
    if stated is not None:
        readings.append(stated)
    if total and per_frame:
        readings.append((total, per_frame))
    return list(dict.fromkeys(readings))


def _settle_frame_range(
    notes: list[str], parameters: Parameters, first: int, last: int, capacity: int, *, padding: int
) -> tuple[int, int]:
    """Return the number of the first frame and the frame count.

    The header counts in 16 bits. Longer takes state their length in TRIAL:ACTUAL_END_FIELD or in
    POINT:LONG_FRAMES; without these, a saturated or wrapped count is detected from the file's size,
    less the `padding` frames that its last block may hold. Programs that trim a take may leave
    TRIAL unchanged: then the header is used.
    """
    frames = parameters.unsigned("POINT:FRAMES")
    counted = last - first + 1
    long_first, long_last = (
        parameters.long("TRIAL:ACTUAL_START_FIELD"),
        parameters.long("TRIAL:ACTUAL_END_FIELD"),
    )
    long_frames = _finite(parameters.number("POINT:LONG_FRAMES"))
    if long_first is not None and long_last is not None and long_last >= long_first:
        same = long_last - long_first + 1 == counted or (
            _cut_short(long_first, first) and _cut_short(long_last, last)
        )
        if same or not 0 < counted <= capacity or frames not in (None, counted):
            return long_first, long_last - long_first + 1
        notes.append(
            f"frames: TRIAL says {long_first} to {long_last}, the header {first} to {last}; "
            "the header's read"
        )
        return first, counted
    if long_frames is not None:
        return first, int(long_frames)
    count = max(frames or 0, counted)
    if (
        frames is not None
        and counted not in (frames, 0)
        and last >= first
        and last != _LARGEST_UINT16
    ):
        count = min(frames, counted) if count > capacity else count
        notes.append(
            f"frames: POINT:FRAMES says {frames}, the header {first} to {last}; {count} read"
        )
    wraps = (capacity - count) // (_LARGEST_UINT16 + 1)
    if wraps > 0:
        count = (
            capacity
            if count >= _LARGEST_UINT16 or last == _LARGEST_UINT16
            else count + wraps * (_LARGEST_UINT16 + 1)
        )
        notes.append(f"the frame count has wrapped; {count} frames read by the file's length")
    elif capacity > count and (
        count == _LARGEST_UINT16 or (last == _LARGEST_UINT16 and capacity > count + padding)
    ):
        count = capacity
        notes.append(f"the frame count is full; {count} frames read by the file's length")
    return first, count


def _cut_short(number: int, word: int) -> bool:
    """Return whether `word` is `number` in 16 bits: wrapped or saturated."""
    return word in (number & _LARGEST_UINT16, min(number, _LARGEST_UINT16))
