"""A C3D file as a take."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from usdface.capture.axes import rotation_from_screen, rotation_to_y_up
from usdface.capture.c3d import C3dFile, open_c3d
from usdface.capture.marker_labels import settle_labels
from usdface.capture.marker_take import (
    Capture,
    CaptureHeader,
    CaptureOptions,
    build_marker_take,
    settle_units,
)
from usdface.core.assets import Event
from usdface.core.errors import InputError
from usdface.core.rates import exact_rate
from usdface.core.text import first_few

_CHUNK_FRAMES = 8192


def is_c3d(head: bytes) -> bool:
    """Tell a C3D file by its first bytes."""
    # 0x50 is also a P: a text that has it second holds no NUL, a header has many.
    return len(head) >= 2 and head[1] == 0x50 and head[0] > 0 and b"\0" in head[:512]


def read_c3d_take(path: Path, options: CaptureOptions) -> Capture:
    """Read the labelled points of a C3D file as markers.

    Raises
    ------
    InputError
        If the file is damaged or ends early, its units or axes are unknown, labels are empty or
        doubled, or nothing is left to use.
    """
    file = open_c3d(path)
    notes = list(file.layout.notes)
    missing = file.layout.point_count - len(file.point_labels)
    if missing:
        notes.append(
            f"the last {missing} of {file.layout.point_count} points have no label, left out"
        )
    if not file.point_labels:
        raise InputError(
            f"{path}: POINT:LABELS is empty for {file.layout.point_count} points; "
            "export labelled markers"
        )
    labels = settle_labels(file.point_labels, where=f"{path} POINT:LABELS")
    if labels.dropped:
        notes.append(
            f"{len(labels.dropped)} unlabelled points were left out: {first_few(labels.dropped)}"
        )
    if labels.subjects:
        notes.append(f"subject prefixes taken off: {first_few(labels.subjects)}")
    scale = settle_units(file.units, options, notes, where=str(path), field="POINT:UNITS")
    to_mm = scale * _rotation(file, options, notes)
    rotation = to_mm.astype(np.float32)
    columns = np.array(labels.columns)

    positions = np.empty((file.frame_count, len(columns), 3), np.float32)
    visible = np.empty((file.frame_count, len(columns)), bool)
    for start in range(0, file.frame_count, _CHUNK_FRAMES):
        rows = slice(start, min(start + _CHUNK_FRAMES, file.frame_count))
        points = file.read_points(rows.start, rows.stop)
        with np.errstate(invalid="ignore", over="ignore"):  # damaged samples are hidden later
            # one long product: a small one for each frame takes several times as long
            turned = points.positions[:, columns].reshape(-1, 3) @ rotation.T
            positions[rows] = turned.reshape(-1, len(columns), 3)
        visible[rows] = points.residuals[:, columns] >= 0
    capture = build_marker_take(
        CaptureHeader(
            path,
            "c3d",
            exact_rate(file.layout.rate, where=f"{path} POINT:RATE"),
            file.layout.first_frame,
            notes=notes,
            to_mm=to_mm,
        ),
        labels.names,
        positions,
        visible,
        options,
    )
    return replace(capture, take=replace(capture.take, events=_events(file)))


def _events(file: C3dFile) -> tuple[Event, ...]:
    """Return the marked moments by frame: second 0 is frame 1, also of a file cut later."""
    rate = file.layout.rate
    found = [
        Event(f"{event.context} {event.label}".strip(), 1 + event.seconds * rate)
        for event in file.events()
        if np.isfinite(event.seconds)
    ]
    return tuple(sorted(found, key=lambda event: event.frame))


def _rotation(file: C3dFile, options: CaptureOptions, notes: list[str]) -> np.ndarray:
    if options.up is not None:
        return rotation_to_y_up(up=options.up, where=f"{file.path} up axis")
    if not file.x_screen or not file.y_screen:
        notes.append(
            "POINT:X_SCREEN and Y_SCREEN do not say which axis is up; "
            "Y assumed, say otherwise with --up"
        )
        return np.eye(3)
    return rotation_from_screen(file.x_screen, file.y_screen, where=f"{file.path} POINT")
