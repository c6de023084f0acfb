"""Text files of Bannaflak's Face Cap app: weights, head and eye rotations.

Lines begin with ``info``, ``bs`` (names of the shapes) or ``k`` (a sample): time, head position,
head rotation, rotations of the left and the right eye, weights. Times are in milliseconds, although
the file says nanoseconds.
"""

from pathlib import Path

import numpy as np

from usdface.capture.channel_take import build_channel_take
from usdface.capture.marker_take import Capture, CaptureOptions
from usdface.capture.sample_times import resolve_device_times
from usdface.capture.text_table import (
    check_columns,
    head_lines,
    parse_cells,
    read_lines,
    split_cells,
    without_empty_tail,
)
from usdface.core.errors import InputError

_ROTATIONS = (
    *(f"headRotation{axis}" for axis in "XYZ"),
    *(f"leftEyeRotation{axis}" for axis in "XY"),
    *(f"rightEyeRotation{axis}" for axis in "XY"),
)
_BEFORE_WEIGHTS = ("time", *(f"headPosition{axis}" for axis in "XYZ"), *_ROTATIONS)
_ROTATIONS_AT = slice(4, 11)
_HEAD_LINES = 8
_SECONDS_PER_MS = 1e-3


def is_face_cap(head: bytes) -> bool:
    """Return whether a file is a Face Cap recording, from its first bytes."""
    lines = head_lines(head, _HEAD_LINES)
    return (
        bool(lines)
        and lines[0].startswith(("info,", "bs,"))
        and any(line.startswith("bs,") for line in lines)
    )


def read_face_cap(path: Path, options: CaptureOptions) -> Capture:
    """Read weights and rotations as channels."""
    names: list[str] = []
    samples: list[list[float]] = []
    numbers: list[int] = []
    for line in read_lines(path):
        cells = split_cells(line, ",")
        if not any(cells) or cells[0] == "info":
            continue
        if cells[0] == "bs" and not names:
            names = without_empty_tail(cells[1:])
            check_columns([*_BEFORE_WEIGHTS, *names], line)
        elif cells[0] == "k" and names:
            columns = [*_BEFORE_WEIGHTS, *names]
            samples.append(
                parse_cells(cells[1:], columns, line, delimiter=",", gaps=False, first_column=1)
            )
            numbers.append(line.number)
        else:
            raise InputError(
                f"{line.where}: begins {line.text[:24]!r}; a line must begin with info, bs (once, "
                "before the samples) or k: export the recording again"
            )
    if not samples:
        raise InputError(
            f"{path}: no sample, a line that begins with k; export the recording again"
        )
    table = np.array(samples)
    times = resolve_device_times(
        table[:, 0] * _SECONDS_PER_MS, np.array(numbers), where=f"{path} times (milliseconds)"
    )
    return build_channel_take(
        path,
        [*names, *_ROTATIONS],
        np.hstack([table[:, len(_BEFORE_WEIGHTS) :], np.radians(table[:, _ROTATIONS_AT])]),
        times,
        notes=[
            "head and eye rotations are kept as channels, in radians; "
            "the head's position, whose unit the file does not state, is left out"
        ],
        format_name="face-cap",
    )
