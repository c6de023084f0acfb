"""Saved streams of the iFacialMocap app: weights, head and eye rotations.

A frame is ``name-value|…|=head#six numbers|rightEye#three|leftEye#three|``, weights from 0 to 100,
angles in degrees; a line break or ``___iFacialMocap`` ends it. Version 2 of the protocol writes
``&`` for ``-``. Frames have no times: the app sends 60 per second.
"""

import re
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

import numpy as np

from usdface.capture.channel_take import build_channel_take, start_notes
from usdface.capture.marker_take import Capture, CaptureOptions
from usdface.capture.sample_times import SampleTimes
from usdface.capture.text_table import TableLine, check_columns, head_lines, parse_cells, read_lines
from usdface.core.errors import InputError
from usdface.core.text import pluralize

_VALUE = r"-?[\d.]+(?:[eE][-+]?\d+)?"
_WEIGHT = re.compile(rf"([A-Za-z]\w*)\s*[-&]\s*({_VALUE})", re.ASCII)
_START = re.compile(rf"\s*[A-Za-z]\w*[-&]{_VALUE}\|", re.ASCII)
_FRAME_END = "___iFacialMocap"
_RATE = Fraction(60)
_STATUS = "trackingStatus"  # 1 while the app sees a face
_PARTS = {"head": 6, "rightEye": 3, "leftEye": 3}
_ROTATIONS = {part: [f"{part}Rotation{axis}" for axis in "XYZ"] for part in _PARTS}


def is_ifacialmocap(head: bytes) -> bool:
    """Return whether a file is a saved iFacialMocap stream, from its first bytes."""
    lines = head_lines(head, 1)
    return bool(lines) and _START.match(lines[0]) is not None and "=head#" in lines[0]


def read_ifacialmocap(path: Path, options: CaptureOptions) -> Capture:
    """Read weights, divided by 100, and rotations as channels."""
    names: list[str] = []
    rows: list[list[float]] = []
    places: list[int] = []
    for place, frame in enumerate(_frames(path)):
        found = _read_frame(frame)
        if found.pop(_STATUS, 1.0) == 0:
            continue
        if not rows:
            names = list(found)
        elif found.keys() != set(names):
            differing = sorted(found.keys() ^ set(names))
            raise InputError(
                f"{frame.where}: {len(found)} channels, {len(names)} in the first frame "
                f"(differing: {differing[0]}); the frame is cut off: delete it, or save the stream "
                "again"
            )
        rows.append([found[name] for name in names])
        places.append(place)
    if not rows:
        raise InputError(f"{path}: no frame that shows a face; save the stream again")
    times = SampleTimes(_RATE, np.array(places, dtype=np.float64) - places[0], even=True)
    lost = places[-1] - places[0] + 1 - len(places)
    return build_channel_take(
        path,
        names,
        np.array(rows),
        times,
        notes=[
            f"the stream holds no times; {_RATE} frames per second assumed",
            "head and eye rotations are kept as channels, in radians; the head's position, whose "
            "unit the stream does not state, is left out",
            *([f"{pluralize(lost, 'frame')} without a face, interpolated"] if lost else []),
            *start_notes(places[0], _RATE),
        ],
        format_name="ifacialmocap",
    )


def _frames(path: Path) -> Iterator[TableLine]:
    for line in read_lines(path):
        for text in line.text.split(_FRAME_END):
            if text.strip():
                yield TableLine(path, line.number, text)


def _read_frame(frame: TableLine) -> dict[str, float]:
    """Return weights [0-1] and rotations [rad] by name."""
    weights, equals, poses = frame.text.partition("=")
    if not equals:
        raise InputError(
            f"{frame.where}: no '=' between weights and head; the frame is cut off: delete it, or "
            "save the stream again"
        )
    names: list[str] = []
    cells: list[str] = []
    for cell in filter(None, (cell.strip() for cell in weights.split("|"))):
        match = _WEIGHT.fullmatch(cell)
        if match is None:
            raise InputError(
                f"{frame.where}: {cell[:24]!r}; a weight must be NAME-VALUE: delete the frame, or "
                "save the stream again"
            )
        names.append(match[1])
        cells.append(match[2])
    values = [0.01 * value for value in _numbers(cells, names, frame)]
    for part in filter(None, (part.strip() for part in poses.split("|"))):
        name, _, triple = part.partition("#")
        if name not in _PARTS:
            raise InputError(
                f"{frame.where}: {part[:24]!r}; only {', '.join(_PARTS)} may follow '=': delete "
                "the frame, or save the stream again"
            )
        columns = [f"{name}[{index}]" for index in range(_PARTS[name])]
        angles = _numbers(triple.split(","), columns, frame)[:3]
        names += _ROTATIONS[name]
        values += np.radians(angles).tolist()
    check_columns(names, frame)
    return dict(zip(names, values, strict=True))


def _numbers(cells: list[str], columns: list[str], frame: TableLine) -> list[float]:
    return parse_cells(cells, columns, frame, delimiter="|", gaps=False)
