"""Write points as a minimal C3D file: Intel byte order, float storage, up to 255 points."""

import struct
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from usdface.capture.c3d_layout import BLOCK_BYTES, C3D_MAGIC

_INTEL_PROCESSOR = 84


def write_c3d(
    path: Path,
    positions: ArrayLike,
    visible: ArrayLike,
    labels: Sequence[str],
    *,
    rate: Fraction | float,
    first_frame: int = 1,
) -> None:
    """Write a take of at most 255 points and 65,535 frames.

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
    """
    seen = np.asarray(visible, bool)
    frames, points = seen.shape
    last = first_frame + frames - 1
    data_block = 2  # the second pass has the length of the section
    for _ in range(2):
        section = _parameter_section(labels, frames, first_frame, last, float(rate), data_block)
        data_block = 2 + len(section) // BLOCK_BYTES
    fields = (points, 0, first_frame, last, 10, -1.0, data_block, 0, float(rate))
    header = struct.pack("<BB5HfHHf", 2, C3D_MAGIC, *fields).ljust(BLOCK_BYTES, b"\x00")
    samples = np.empty((frames, points, 4), "<f4")
    samples[..., :3] = np.where(seen[..., None], positions, 0)
    samples[..., 3] = np.where(seen, 0, -1)
    content = header + section + samples.tobytes()
    path.write_bytes(content + bytes(-len(content) % BLOCK_BYTES))


def _parameter_section(
    labels: Sequence[str], frames: int, first: int, last: int, rate: float, data_block: int
) -> bytes:
    records = (
        _record(-1, "POINT", b""),
        _integers(1, "USED", [len(labels)]),
        _integers(1, "FRAMES", [frames]),
        _integers(1, "DATA_START", [data_block]),
        _float(1, "SCALE", -1.0),
        _float(1, "RATE", rate),
        _texts(1, "UNITS", ["mm"]),
        _texts(1, "X_SCREEN", ["+X"]),
        _texts(1, "Y_SCREEN", ["+Y"]),
        _texts(1, "LABELS", labels),
        _texts(1, "DESCRIPTIONS", [""] * len(labels)),
        _record(-2, "TRIAL", b""),
        _integers(2, "ACTUAL_START_FIELD", [first, 0]),
        _integers(2, "ACTUAL_END_FIELD", [last, 0]),
        _record(-3, "ANALOG", b""),
        _integers(3, "USED", [0]),
        _float(3, "RATE", 0.0),
    )
    groups = b"".join(records)
    blocks = -(-(4 + len(groups) + 2) // BLOCK_BYTES)  # two zero bytes end the section
    section = bytes((1, C3D_MAGIC, blocks, _INTEL_PROCESSOR)) + groups
    return section.ljust(blocks * BLOCK_BYTES, b"\x00")


def _record(number: int, name: str, body: bytes) -> bytes:
    """Encode a record: name, link to the next counted from the link itself, body, description."""
    head = struct.pack("<bb", len(name), number) + name.encode()
    return head + struct.pack("<H", len(body) + 3) + body + b"\x00"


def _integers(number: int, name: str, values: Sequence[int]) -> bytes:
    shape = bytes((1, len(values))) if len(values) != 1 else b"\x00"
    return _record(number, name, b"\x02" + shape + struct.pack(f"<{len(values)}H", *values))


def _float(number: int, name: str, value: float) -> bytes:
    return _record(number, name, b"\x04\x00" + struct.pack("<f", value))


def _texts(number: int, name: str, values: Sequence[str]) -> bytes:
    encoded = [value.encode("latin-1", "replace") for value in values]
    width = max(1, *map(len, encoded))
    shape = bytes((2, width, len(values)))
    return _record(number, name, b"\xff" + shape + b"".join(text.ljust(width) for text in encoded))
