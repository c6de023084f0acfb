"""C3D, the exchange format of optical capture: points, analog channels and events.

Written for takes of hundreds of thousands of frames: samples are read by ranges, which bounds the
memory, and takes of more than 65,535 frames are read completely.

References
----------
The C3D file format, user guide; https://www.c3d.org
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from usdface.capture.axes import rotation_from_screen, rotation_to_y_up
from usdface.capture.c3d_layout import C3dLayout, read_layout
from usdface.capture.marker_labels import resolve_labels
from usdface.capture.marker_take import (
    Capture,
    CaptureHeader,
    CaptureOptions,
    build_marker_take,
    resolve_units,
)
from usdface.core.arrays import Float32Array, frame_blocks
from usdface.core.assets import Event
from usdface.core.errors import InputError
from usdface.core.rates import exact_rate
from usdface.core.text import first_few

_EVENT_MARK = 12345


@dataclass(frozen=True)
class C3dFile:
    """An opened C3D file: its parameters are read, its samples on demand."""

    path: Path
    layout: C3dLayout
    """Counts, rates, parameters."""
    point_labels: tuple[str, ...]
    """As written, subject prefixes included; shorter than the points when some have no label."""
    analog_labels: tuple[str, ...]

    @property
    def analog_rate(self) -> float:
        """Samples per second of each analog channel; 0 without channels."""
        return self.layout.rate * self.layout.analog_per_frame if self.layout.analog_count else 0.0

    def read_points(
        self, start: int = 0, stop: int | None = None
    ) -> tuple[Float32Array, Float32Array]:
        """Read positions and residuals of frames `start` to `stop` (exclusive), counted from 0.

        In the file's units and axes; (frames, points, 3), as stored also where a point is occluded,
        and (frames, points), negative where a point is occluded, NaN where the stored number is not
        a residual. `InputError` if the file became shorter since it was opened.
        """
        layout = self.layout
        items = self._read_items(range(layout.frame_count)[start:stop])
        samples = items[:, : layout.point_count * 4].reshape(len(items), layout.point_count, 4)
        positions = samples[..., :3].astype(np.float32)
        if layout.scale > 0:
            positions *= np.float32(layout.scale)
        return positions, _residuals(samples[..., 3], abs(layout.scale))

    def read_analog(self, start: int = 0, stop: int | None = None) -> Float32Array:
        """Read the analog samples of frames `start` to `stop` (exclusive), in physical units.

        (frames * analog_per_frame, channels)
        """
        layout = self.layout
        items = self._read_items(range(layout.frame_count)[start:stop])
        shape = (len(items) * layout.analog_per_frame, layout.analog_count)
        stored = items[:, layout.point_count * 4 :].reshape(shape)
        if layout.scale > 0 and self._has_unsigned_analog:
            stored = stored.astype(np.uint16)
        scale, offset = self._analog_calibration()
        return np.asarray((stored.astype(np.float32) - offset) * scale)

    def events(self) -> tuple[Event, ...]:
        """Return the events of the EVENT group, or else of the header, by frame number.

        Second 0 is frame 1, also in a trimmed file.
        """
        parameters = self.layout.parameters
        times, labels = parameters.numbers("EVENT:TIMES"), parameters.texts("EVENT:LABELS")
        labels = labels[: parameters.unsigned("EVENT:USED")]  # some programs write spare ones
        if times.size and labels:
            pairs = times[: times.size // 2 * 2].reshape(-1, 2).tolist()  # minutes, seconds
            # Such as the subject or the side; there may be fewer than labels.
            contexts = (*parameters.texts("EVENT:CONTEXTS"), *("",) * len(labels))
            timed = [
                (f"{context} {label}", 60 * minutes + seconds)
                for label, context, (minutes, seconds) in zip(labels, contexts, pairs, strict=False)
            ]
        else:
            timed = self._header_events()
        events = [
            Event(label.strip(), 1 + seconds * self.layout.rate)
            for label, seconds in timed
            if np.isfinite(seconds)
        ]
        return tuple(sorted(events, key=lambda event: event.frame))

    def _header_events(self) -> list[tuple[str, float]]:
        """Return label and time [s] of the events of the header."""
        header, processor = self.layout.header, self.layout.processor
        mark, count = (int(word) for word in np.frombuffer(header, processor.unsigned, 2, 149 * 2))
        if mark != _EVENT_MARK:
            return []
        times = processor.floats(header[152 * 2 : 188 * 2]).tolist()
        labels = [
            header[at : at + 4].decode("latin-1").strip(" \x00")
            for at in range(198 * 2, 234 * 2, 4)
        ]
        return list(zip(labels, times, strict=True))[:count]

    def _analog_calibration(self) -> tuple[Float32Array, Float32Array]:
        """Return scale and offset per channel; 1 and 0 where not stated."""
        parameters, count = self.layout.parameters, self.layout.analog_count
        scale, offset = np.ones(count, np.float32), np.zeros(count, np.float32)
        general = parameters.number("ANALOG:GEN_SCALE")
        scales, offsets = (
            parameters.numbers("ANALOG:SCALE")[:count],
            parameters.numbers("ANALOG:OFFSET")[:count],
        )
        scale[: scales.size] = scales
        offset[: offsets.size] = offsets
        if self._has_unsigned_analog:
            offset %= 0x10000
        return scale * np.float32(1.0 if general is None else general), offset

    @property
    def _has_unsigned_analog(self) -> bool:
        return self.layout.parameters.text("ANALOG:FORMAT").upper().startswith("UNSIGNED")

    def _read_items(self, frames: range) -> NDArray[np.generic]:
        """Read the stored numbers of some frames: (frames, items)."""
        layout = self.layout
        stride = layout.frame_items * (4 if layout.scale < 0 else 2)
        raw = bytearray(stride * len(frames))
        with self.path.open("rb") as file:
            file.seek(layout.data_start + stride * frames.start)
            size = file.readinto(raw)
        if size < len(raw):
            raise InputError(
                f"{self.path} frame {layout.first_frame + frames.start + size // stride}: "
                "the file ended while it was read; wait until it is fully written and read it again"
            )
        items: NDArray[np.generic]
        if layout.scale < 0:
            items = layout.processor.floats(raw)
        else:
            items = np.frombuffer(raw, layout.processor.integer)
        return items.reshape(len(frames), layout.frame_items)


def open_c3d(path: Path) -> C3dFile:
    """Open a C3D file and check its layout against its size."""
    layout = read_layout(path)
    parameters = layout.parameters
    return C3dFile(
        path=path,
        layout=layout,
        point_labels=parameters.texts("POINT:LABELS")[: layout.point_count],
        analog_labels=parameters.texts("ANALOG:LABELS")[: layout.analog_count],
    )


def _residuals(words: NDArray[np.generic], scale: float) -> Float32Array:
    """Decode the fourth number of a point: cameras in the high byte, the residual in the low one.

    A negative number, also stored as unsigned, means occluded: -1. Beyond 16 bits: NaN.
    """
    values = words.astype(np.float32)
    with np.errstate(invalid="ignore"):
        seen = (values >= 0) & (values < 0x8000)
        not_residual = ~(np.abs(values) <= 0xFFFF)
    packed = np.where(seen, values, 0).astype(np.int32)
    unseen = np.where(not_residual, np.float32(np.nan), np.float32(-1))
    return np.where(seen, (packed & 0xFF) * np.float32(scale), unseen)


_CHUNK_FRAMES = 8192
_MODEL_OUTPUTS = ("ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS", "REACTIONS")
"""Parameters with the labels of points that are other quantities, as Vicon writes them."""


def is_c3d(head: bytes) -> bool:
    """Return whether a file is a C3D file, from its first bytes."""
    # 0x50 is also a P: a text that has it second holds no NUL, a header has many.
    return len(head) >= 2 and head[1] == 0x50 and head[0] > 0 and b"\0" in head[:512]


def read_c3d_take(path: Path, options: CaptureOptions) -> Capture:
    """Read the labelled points of a C3D file as markers."""
    file = open_c3d(path)
    notes, parameters = list(file.layout.notes), file.layout.parameters
    point_count = file.layout.point_count
    if not point_count:
        raise InputError(f"{path}: holds no points, only analog channels; export the markers")
    written = file.point_labels or ("",) * point_count
    if missing := point_count - len(written):
        notes.append(f"the last {missing} of {point_count} points have no label, left out")
    modelled = {text for each in _MODEL_OUTPUTS for text in parameters.texts(f"POINT:{each}")}
    outputs = [text for text in written if modelled & {text, text.rpartition(":")[2]} - {""}]
    if outputs:
        notes.append(f"outputs of a body model, no markers, left out: {first_few(outputs)}")
    labels = resolve_labels(written, where=f"{path} POINT:LABELS", without=outputs)
    notes += labels.notes
    units, field = parameters.text("POINT:UNITS"), "POINT:UNITS"
    scale = resolve_units(units, options, notes, where=str(path), field=field)
    to_mm = scale * _rotation(file, options, notes)
    rotation = to_mm.astype(np.float32)
    columns = np.array(labels.columns)

    positions = np.empty((file.layout.frame_count, len(columns), 3), np.float32)
    visible = np.empty((file.layout.frame_count, len(columns)), bool)
    odd = np.empty_like(visible)
    for rows in frame_blocks(file.layout.frame_count, frames=_CHUNK_FRAMES):
        points, residuals = file.read_points(rows.start, rows.stop)
        with np.errstate(invalid="ignore", over="ignore"):  # damaged samples are hidden later
            # one long product: a small one for each frame takes several times as long
            turned = points[:, columns].reshape(-1, 3) @ rotation.T
            positions[rows] = turned.reshape(-1, len(columns), 3)
        visible[rows] = residuals[:, columns] >= 0
        odd[rows] = np.isnan(residuals[:, columns])
    if odd.any() and not visible.any():
        # Some programs store no residual in any sample.
        visible = odd
        notes.append(
            "no sample has a residual that the format knows; points were taken as seen where they "
            "are not at the origin"
        )
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
    return replace(capture, take=replace(capture.take, events=file.events()))


def _rotation(file: C3dFile, options: CaptureOptions, notes: list[str]) -> np.ndarray:
    if options.up is not None:
        return rotation_to_y_up(up=options.up, where=f"{file.path} up axis")
    right, up = (file.layout.parameters.text(f"POINT:{axis}_SCREEN") for axis in "XY")
    if not right or not up:
        notes.append(
            "POINT:X_SCREEN and Y_SCREEN do not state the up axis; Y assumed, set it with --up"
        )
        return np.eye(3)
    return rotation_from_screen(right, up, where=f"{file.path} POINT")
