"""Where the samples of a C3D file lie, checked against its size."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from usdface.capture.c3d_parameters import PROCESSORS, Parameters, Processor, parse_parameters
from usdface.core.errors import InputError

BLOCK_BYTES = 512
C3D_MAGIC = 0x50
_LARGEST_UINT16 = 0xFFFF
"""What a 16-bit frame count shows when the take is longer."""
_REPAIR = "export the take again from the capture software, or copy the file again"


@dataclass(frozen=True)
class C3dLayout:
    """Everything needed to read any stretch of samples."""

    processor: Processor
    parameters: Parameters
    header: bytes
    """The first block; holds the events of old files."""
    point_count: int
    analog_count: int
    """`point_count`, `analog_count`: Points per frame; analog channels."""
    analog_per_frame: int
    """Analog samples of each channel per point frame."""
    first_frame: int
    frame_count: int
    rate: float
    """Point frames per second, as stored."""
    scale: float
    """Negative when samples are stored as floats, else the unit of the integers."""
    data_start: int
    """Byte offset of the first frame."""
    notes: tuple[str, ...]
    """Contradictions that were settled."""

    @property
    def item_size(self) -> int:
        """Bytes of one stored number."""
        return 4 if self.scale < 0 else 2

    @property
    def frame_items(self) -> int:
        """Stored numbers of one frame: x, y, z and residual of each point, then analog samples."""
        return self.point_count * 4 + self.analog_count * self.analog_per_frame


def read_layout(path: Path) -> C3dLayout:
    """Read header and parameters of a C3D file.

    Raises
    ------
    InputError
        If the file is not a C3D file, is damaged, or ends before the samples it promises.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        header = file.read(BLOCK_BYTES)
        if len(header) < BLOCK_BYTES or header[1] != C3D_MAGIC:
            raise InputError(
                f"{path}: not a C3D file: {len(header)} bytes of header, second byte "
                f"{header[1:2].hex() or 'missing'} instead of 50; choose the capture's .c3d export"
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
        file.seek(section_start)
        section = file.read(
            _section_size(prefix[2], section_start, int(words[8]) * BLOCK_BYTES, size)
        )
    parameters = parse_parameters(section, processor=processor)
    return _settle_layout(path, size, header, processor, parameters)


def _section_size(blocks: int, start: int, data_start: int, file_size: int) -> int:
    """Return how many bytes to parse: some writers leave the block count 0 or too small."""
    return min(max(blocks * BLOCK_BYTES, data_start - BLOCK_BYTES - start), file_size - start)


def _settle_layout(
    path: Path, size: int, header: bytes, processor: Processor, parameters: Parameters
) -> C3dLayout:
    """Combine header and parameters; where they differ the note says which was believed."""
    words = [int(word) for word in np.frombuffer(header, processor.unsigned, 10)]
    header_floats = processor.floats(header[:24])
    notes = list(parameters.notes)

    points = _settle(notes, "points per frame", parameters.unsigned("POINT:USED"), words[1])
    scale = _finite(parameters.number("POINT:SCALE")) or _finite(float(header_floats[3]))
    rate = _finite(parameters.number("POINT:RATE")) or _finite(float(header_floats[5]))
    if scale is None or rate is None or rate <= 0:
        raise InputError(
            f"{path}: POINT:SCALE {parameters.number('POINT:SCALE')}, "
            f"POINT:RATE {parameters.number('POINT:RATE')}: both must be numbers other than 0 and "
            f"the rate above 0; {_REPAIR}"
        )
    channels, per_frame = _settle_analog(notes, parameters, words[2], words[9], rate)
    block = words[8] or parameters.unsigned("POINT:DATA_START") or 0
    data_start = (block - 1) * BLOCK_BYTES
    items = points * 4 + channels * per_frame
    scale = _settle_scale(
        notes, scale, float(header_floats[3]), size - data_start, items * (words[4] - words[3] + 1)
    )
    stride = items * (4 if scale < 0 else 2)
    if data_start < BLOCK_BYTES or data_start > size or stride == 0:
        raise InputError(
            f"{path}: data at block {block} of {size // BLOCK_BYTES}, {points} points and "
            f"{channels} analog channels per frame: nothing can be read; {_REPAIR}"
        )
    capacity = (size - data_start) // stride
    first_frame, frame_count = _settle_frames(
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


def _settle(notes: list[str], what: str, parameter: int | None, header: int) -> int:
    if parameter is None:
        return header
    if parameter != header:
        notes.append(
            f"{what}: the parameters say {parameter}, the header {header}; {parameter} used"
        )
    return parameter


def _settle_scale(notes: list[str], scale: float, header: float, room: int, items: int) -> float:
    """Return the scale with the sign that the samples have: negative where they are floats.

    Where parameters and header differ in it, the room that the file has for its `items` tells.
    """
    if not math.isfinite(header) or header * scale >= 0 or items <= 0:
        return scale
    floats = room >= 4 * items
    notes.append(
        f"POINT:SCALE {scale:g} and the header's {header:g} differ in sign; the samples take the "
        f"room of {'floats' if floats else 'integers'} and are read as such"
    )
    return min(scale, header) if floats else max(scale, header)


def _settle_analog(
    notes: list[str], parameters: Parameters, per_frame_total: int, per_frame: int, rate: float
) -> tuple[int, int]:
    """Return analog channels and samples per frame; the header has their product."""
    if per_frame_total == 0:
        return 0, 0
    channels = parameters.unsigned("ANALOG:USED") or 0
    if channels and per_frame_total % channels == 0:
        analog_rate = _finite(parameters.number("ANALOG:RATE"))
        if analog_rate and round(analog_rate / rate) != per_frame_total // channels:
            notes.append(
                f"analog rate {analog_rate:g} does not fit {per_frame_total} samples per frame "
                f"over {channels} channels; the samples were believed"
            )
        return channels, per_frame_total // channels
    if per_frame and per_frame_total % per_frame == 0:
        channels_from_header = per_frame_total // per_frame
    else:
        channels_from_header, per_frame = per_frame_total, 1
    notes.append(
        f"analog channels: the parameters say {channels}, the header {channels_from_header}; "
        f"{channels_from_header} used"
    )
    return channels_from_header, per_frame


def _settle_frames(
    notes: list[str],
    parameters: Parameters,
    first: int,
    last: int,
    capacity: int,
    *,
    padding: int,
) -> tuple[int, int]:
    """Return the first frame's number and how many frames there are.

    The header counts in 16 bits. Longer takes say their length in TRIAL:ACTUAL_END_FIELD or in
    POINT:LONG_FRAMES; where neither does, a count that is full or that has wrapped around is
    recognised by the room the file has, less the `padding` frames that its last block may hold.
    A library that cuts a take may leave TRIAL as it was: then the header counts.
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
    """Tell whether 16 bits may show a number like this: its low bits, or as many as there are."""
    return word in (number & _LARGEST_UINT16, min(number, _LARGEST_UINT16))
