"""Write points and analog channels as a C3D file of any length: Intel byte order, float storage."""

import struct
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from usdface.capture.c3d_layout import BLOCK_BYTES, C3D_MAGIC

_INTEL_PROCESSOR = 84
_LARGEST_UINT16 = 0xFFFF
_LIST_LIMIT = 255
_BLOCK_LIMIT = 255
_CHUNK_FRAMES = 4096


def write_c3d(
    path: Path,
    positions: ArrayLike,
    visible: ArrayLike,
    labels: Sequence[str],
    *,
    rate: Fraction | float,
    first_frame: int = 1,
    analog: ArrayLike | None = None,
    analog_labels: Sequence[str] = (),
) -> None:
    """Write a take of points, also with more than the 65,535 frames of the header's count.

    Parameters
    ----------
    path : Path
        Not replaced atomically.
    positions : (frames, points, 3) array_like
        [mm], Y up, +X to the right of the screen.
    visible : (frames, points) array_like of bool
        Occluded points are written with residual -1 at the origin.
    first_frame : int
        Frame number of the first sample; the format counts from 1.
    analog : (frames * k, channels) array_like, optional
        k samples per frame and channel.
    """
    points = np.asarray(positions, np.float32)
    seen = np.asarray(visible, bool)
    if points.ndim != 3 or points.shape[2] != 3 or seen.shape != points.shape[:2]:
        raise ValueError(
            f"positions {points.shape} and visible {seen.shape} must be (frames, points, 3) and "
            "(frames, points)"
        )
    frame_count, point_count = seen.shape
    if len(labels) != point_count or not 0 < first_frame <= _LARGEST_UINT16:
        raise ValueError(
            f"{len(labels)} labels for {point_count} points, first frame {first_frame}: need one "
            f"label each, and a first frame of 1 to {_LARGEST_UINT16}"
        )
    samples = np.empty((0, 0), np.float32) if analog is None else np.asarray(analog, np.float32)
    per_frame, left_over = divmod(len(samples), frame_count) if frame_count else (0, 1)
    if left_over or samples.ndim != 2 or len(analog_labels) != samples.shape[1]:
        raise ValueError(
            f"analog {samples.shape} must be ({frame_count} * k, {len(analog_labels)})"
        )

    other_groups = _trial_group(first_frame, frame_count) + _analog_group(
        analog_labels, float(rate) * per_frame
    )
    data_block = 2  # the second pass has the length of the section
    for _ in range(2):
        points_group = _points_group(labels, frame_count, float(rate), data_block)
        section = _parameter_section(points_group + other_groups)
        data_block = 2 + len(section) // BLOCK_BYTES
    header = _header(
        point_count, samples.shape[1], per_frame, first_frame, frame_count, data_block, float(rate)
    )
    with path.open("wb") as file:
        file.write(header + section)
        for start in range(0, frame_count, _CHUNK_FRAMES):
            stop = min(start + _CHUNK_FRAMES, frame_count)
            block = np.zeros((stop - start, point_count, 4), "<f4")
            block[..., :3] = np.where(seen[start:stop, :, None], points[start:stop], 0)
            block[..., 3] = np.where(seen[start:stop], 0, -1)
            extra = samples[start * per_frame : stop * per_frame].reshape(stop - start, -1)
            file.write(np.hstack([block.reshape(stop - start, -1), extra.astype("<f4")]).tobytes())
        file.write(bytes(-file.tell() % BLOCK_BYTES))


def _header(
    points: int,
    channels: int,
    per_frame: int,
    first: int,
    frames: int,
    data_block: int,
    rate: float,
) -> bytes:
    last = min(first + frames - 1, _LARGEST_UINT16)
    fields = (points, channels * per_frame, first, last, 10, -1.0, data_block, per_frame, rate)
    return struct.pack("<BB5HfHHf", 2, C3D_MAGIC, *fields).ljust(BLOCK_BYTES, b"\x00")


def _points_group(
    labels: Sequence[str],
    frames: int,
    rate: float,
    data_block: int,
) -> bytes:
    return b"".join(
        (
            _group(1, "POINT"),
            _integers(1, "USED", [len(labels)]),
            _integers(1, "FRAMES", [min(frames, _LARGEST_UINT16)]),
            _floats(1, "LONG_FRAMES", [float(frames)]) if frames > _LARGEST_UINT16 else b"",
            _integers(1, "DATA_START", [data_block]),
            _floats(1, "SCALE", [-1.0]),
            _floats(1, "RATE", [rate]),
            _texts(1, "UNITS", ["mm"]),
            _texts(1, "X_SCREEN", ["+X"]),
            _texts(1, "Y_SCREEN", ["+Y"]),
            _long_texts(1, "LABELS", labels),
            _long_texts(1, "DESCRIPTIONS", [""] * len(labels)),
        )
    )


def _trial_group(first: int, frames: int) -> bytes:
    last = first + frames - 1
    return b"".join(
        (
            _group(2, "TRIAL"),
            _integers(2, "ACTUAL_START_FIELD", [first & _LARGEST_UINT16, first >> 16]),
            _integers(2, "ACTUAL_END_FIELD", [last & _LARGEST_UINT16, last >> 16]),
        )
    )


def _analog_group(labels: Sequence[str], rate: float) -> bytes:
    used = [_group(3, "ANALOG"), _integers(3, "USED", [len(labels)])]
    if labels:
        used += [
            _long_texts(3, "LABELS", labels),
            _long_texts(3, "DESCRIPTIONS", [""] * len(labels)),
            _floats(3, "GEN_SCALE", [1.0]),
            _floats(3, "SCALE", [1.0] * len(labels)),
            _integers(3, "OFFSET", [0] * len(labels)),
            _long_texts(3, "UNITS", [""] * len(labels)),
        ]
    return b"".join([*used, _floats(3, "RATE", [rate])])


def _parameter_section(groups: bytes) -> bytes:
    blocks = -(-(4 + len(groups) + 2) // BLOCK_BYTES)  # two zero bytes end the section
    if blocks > _BLOCK_LIMIT:
        raise ValueError(
            f"labels fill {blocks} blocks, the format has {_BLOCK_LIMIT}; shorten them"
        )
    return (bytes((1, C3D_MAGIC, blocks, _INTEL_PROCESSOR)) + groups).ljust(
        blocks * BLOCK_BYTES, b"\x00"
    )


def _group(number: int, name: str) -> bytes:
    return _record(-number, name, b"")


def _record(number: int, name: str, body: bytes) -> bytes:
    """Encode a record: name, link to the next counted from the link itself, body, description."""
    return (
        struct.pack("<bb", len(name), number)
        + name.encode()
        + struct.pack("<H", len(body) + 3)
        + body
        + b"\x00"
    )


def _integers(number: int, name: str, values: Sequence[int]) -> bytes:
    shape = bytes((1, len(values))) if len(values) != 1 else b"\x00"
    return _record(number, name, b"\x02" + shape + struct.pack(f"<{len(values)}H", *values))


def _floats(number: int, name: str, values: Sequence[float]) -> bytes:
    shape = bytes((1, len(values))) if len(values) != 1 else b"\x00"
    return _record(number, name, b"\x04" + shape + struct.pack(f"<{len(values)}f", *values))


def _long_texts(number: int, name: str, values: Sequence[str]) -> bytes:
    """Encode any number of texts; beyond 255 they continue in ``NAME2`` and so on."""
    parts = [values[at : at + _LIST_LIMIT] for at in range(0, len(values), _LIST_LIMIT)]
    return b"".join(
        _texts(number, name if i == 0 else f"{name}{i + 1}", part) for i, part in enumerate(parts)
    )


def _texts(number: int, name: str, values: Sequence[str]) -> bytes:
    encoded = [value.encode("latin-1", "replace")[:127] for value in values]
    width = max(1, *map(len, encoded)) if encoded else 1
    shape = bytes((2, width, len(values)))
    return _record(number, name, b"\xff" + shape + b"".join(text.ljust(width) for text in encoded))
