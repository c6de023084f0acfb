"""From the marker samples of a file to a take; what was dropped or assumed is reported."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from usdface.capture.axes import mm_per_unit, rotation_to_y_up
from usdface.capture.marker_labels import match_labels, resolve_labels
from usdface.core.arrays import (
    BoolArray,
    Float32Array,
    FloatArray,
    IntArray,
    frame_blocks,
    hold_last_seen,
)
from usdface.core.assets import Markers, Take
from usdface.core.errors import InputError
from usdface.core.rates import exact_rate
from usdface.core.text import first_few, pluralize

MAX_COORDINATE_MM = 1e5
"""Distance from the origin beyond which a sample is damaged: capture volumes are below 100 m."""

_CHUNK_ROWS = 8192
"""Temporary arrays stay small on long takes."""


@dataclass(frozen=True)
class CaptureOptions:
    """The user's statements about a capture; each overrides the file."""

    units: str | None = None
    """``'mm'``, ``'cm'``, ``'m'``, ``'in'``, …"""
    scale: float | None = None
    """Factor on lengths, in addition to the units."""
    up: str | None = None
    """``'y'``, ``'z'``, ``'-x'``, …"""
    rate: float | None = None
    """Frames per second."""
    rigid: tuple[str, ...] = ()
    """Names of the markers that move with the skull only."""
    neutral: int | None = None
    """Frame number of the neutral face."""
    weight_unit: str | None = None
    """Unit of weights: ``'one'`` or ``'percent'``."""
    shapes: Path | None = None
    """File with the names of a matrix's columns."""
    take: str | None = None
    """Name of the take to read from a table of several."""


@dataclass(frozen=True)
class Capture:
    """The content of a capture file."""

    take: Take
    format: str
    """Name of the format, such as ``'c3d'``; ``'weights'`` for all tables of weights."""
    notes: tuple[str, ...] = ()
    """Samples dropped, repairs and assumptions, one sentence each."""
    axes: FloatArray | None = None
    """(3, 3): rotation from the file's axes to Y up; None without markers."""


@dataclass(frozen=True)
class CaptureHeader:
    """Data of a capture other than its samples."""

    path: Path
    """The capture; its stem names the take."""
    format: str
    """Key of the reader."""
    rate: Fraction
    """Frames per second."""
    first_frame: int
    """Frame number of the first sample."""
    timecode_start: str = ""
    """SMPTE timecode of the first frame, empty if unknown."""
    notes: Sequence[str] = ()
    """The reader's notes so far."""
    to_mm: FloatArray | None = None
    """(3, 3): from the file's units and axes to mm, Y up; already applied."""


@dataclass(frozen=True)
class MarkerTable:
    """Markers in columns X, Y, Z of a table."""

    labels: Sequence[str]
    """As in the file, with subject prefixes."""
    columns: Sequence[int]
    """Column of each label's X; Y and Z follow."""
    values: FloatArray
    """(rows, columns): NaN where a marker is occluded."""
    frames: IntArray
    """(rows,): frame of each row from 0, ascending."""
    to_mm: FloatArray
    """(3, 3): from the file's units and axes to mm, Y up."""
    where: str
    """File and line of the labels, for messages."""


def build_marker_take(
    header: CaptureHeader,
    names: Sequence[str],
    positions: Float32Array,
    visible: BoolArray,
    options: CaptureOptions,
) -> Capture:
    """Return a take of markers in mm with Y up.

    Parameters
    ----------
    positions : (frames, markers, 3) float32 array
        [mm]; changed in place. Arbitrary where not visible.
    visible : (frames, markers) bool array
        Changed in place: samples that are not finite, have coordinates of one size, whatever their
        signs, or are beyond `MAX_COORDINATE_MM` become invisible.
    """
    path, first_frame = header.path, header.first_frame
    hidden = _hide_impossible(positions, visible)
    found = [*header.notes, *hidden]
    ever_seen = np.asarray(visible.any(axis=0))
    if not ever_seen.any():
        why = f" ({', '.join(hidden)})" if hidden else ""
        raise InputError(
            f"{path}: none of {len(names)} markers is seen in any of {len(positions)} frames{why}; "
            "export the reconstructed trajectories, in the unit that the file states"
        )
    if not ever_seen.all():
        never = [name for name, seen in zip(names, ever_seen, strict=True) if not seen]
        found.append(f"{pluralize(len(never), 'marker')} never seen, left out: {first_few(never)}")
        positions, visible = positions[:, ever_seen], visible[:, ever_seen]
        names = [name for name, seen in zip(names, ever_seen, strict=True) if seen]
    hold_last_seen(positions, visible)
    neutral_frame = _settle_neutral(path, visible, first_frame, options.neutral, found)
    markers = Markers(
        names=tuple(names),
        positions=positions,
        visible=visible,
        # A broadcast view if all are visible.
        confidence=np.broadcast_to(np.float32(1), visible.shape)
        if visible.all()
        else visible.astype(np.float32),
        rigid=match_labels(options.rigid, names, where=str(path)),
        neutral_frame=neutral_frame,
    )
    take = Take(
        name=path.stem,
        rate=_settle_rate(header, options, found),
        first_frame=first_frame,
        markers=markers,
        timecode_start=header.timecode_start,
    )
    axes = header.to_mm
    if axes is not None:
        axes = axes / np.cbrt(abs(np.linalg.det(axes)))
    return Capture(take, header.format, tuple(found), axes)


def _settle_rate(header: CaptureHeader, options: CaptureOptions, notes: list[str]) -> Fraction:
    """Return the rate stated by the user, or else by the file."""
    if options.rate is None:
        return header.rate
    stated = exact_rate(options.rate, where="--rate")
    if header.rate != stated:
        notes.append(
            f"the file says {float(header.rate):g} frames per second; {float(stated):g} was asked "
            "for and used"
        )
    return stated


def _hide_impossible(positions: Float32Array, visible: BoolArray) -> list[str]:
    """Mark impossible samples as invisible; return notes with their numbers."""
    counts = np.zeros(3, np.int64)
    for rows in frame_blocks(len(positions), frames=_CHUNK_ROWS):
        seen = visible[rows]
        size = np.abs(positions[rows])
        with np.errstate(invalid="ignore"):
            reach = np.maximum(np.maximum(size[..., 0], size[..., 1]), size[..., 2])
            broken = seen & ~np.isfinite(reach)
            # programs write 0, 0, 0 or -9999.99 three times for an occluded marker
            alike = seen & (size[..., 0] == size[..., 1]) & (size[..., 1] == size[..., 2])
            far = seen & ~broken & ~alike & (reach > MAX_COORDINATE_MM)
        counts += [broken.sum(), alike.sum(), far.sum()]
        seen &= ~(broken | alike | far)
    reasons = (
        "not numbers",
        "the same on all three axes, such as the origin",
        f"more than {MAX_COORDINATE_MM / 1000:g} m away",
    )
    return [
        f"{pluralize(count, 'sample')} {reason}, counted as gaps"
        for count, reason in zip(counts.tolist(), reasons, strict=True)
        if count
    ]


def _settle_neutral(
    path: Path, visible: BoolArray, first_frame: int, neutral: int | None, notes: list[str]
) -> int:
    last_frame = first_frame + len(visible) - 1
    if neutral is None:
        neutral = first_frame + int(np.argmax(visible.sum(axis=1)))
        notes.append(
            f"no neutral frame named; frame {neutral}, the first with the most markers seen, used"
        )
    if not first_frame <= neutral <= last_frame:
        raise InputError(
            f"{path}: neutral frame {neutral} is outside the take, {first_frame} to {last_frame}; "
            "name a frame number of the capture with --neutral"
        )
    return neutral


def build_table_take(header: CaptureHeader, table: MarkerTable, options: CaptureOptions) -> Capture:
    """Return a take of the markers of a table.

    Frames without a row are gaps of all markers, and are reported.
    """
    notes = [*header.notes]
    labels = resolve_labels(table.labels, where=table.where)
    notes += labels.notes
    frames = table.frames
    count = int(frames[-1]) + 1
    if count > len(frames):
        notes.append(f"{count - len(frames)} of {count} frames have no row and are gaps")
    starts = np.array([table.columns[index] for index in labels.columns], np.int64)
    positions = np.zeros((count, len(starts), 3), np.float32)
    visible = np.zeros((count, len(starts)), bool)
    axes = starts[:, None] + np.arange(3)
    for rows in frame_blocks(len(frames), frames=_CHUNK_ROWS):
        with np.errstate(invalid="ignore", over="ignore"):  # damaged samples are hidden later
            samples = table.values[rows][:, axes] @ table.to_mm.T
            positions[frames[rows]] = samples
        visible[frames[rows]] = ~np.isnan(samples).any(axis=2)
    return build_marker_take(
        replace(header, notes=notes, to_mm=table.to_mm), labels.names, positions, visible, options
    )


def resolve_units(
    stated: str, options: CaptureOptions, notes: list[str], *, where: str, field: str
) -> float:
    """Return millimetres per unit of the file, times the user's factor."""
    scale = 1.0 if options.scale is None else options.scale
    if options.units is not None:
        if stated and stated.lower() != options.units.lower():
            notes.append(f"{field} says {stated}; {options.units} is used, as requested")
        return scale * mm_per_unit(options.units, where=f"{where} units")
    if not stated and options.scale is None:
        notes.append(f"no unit stated ({field}); mm assumed, set it with --units")
    return scale * mm_per_unit(stated or "mm", where=f"{where} {field}")


def space_to_mm(
    path: Path,
    options: CaptureOptions,
    notes: list[str],
    *,
    units: str,
    field: str,
    up: str = "y",
    up_note: str = "",
) -> FloatArray:
    """Return the matrix from a file's units and axes to mm, Y up: (3, 3).

    Parameters
    ----------
    units, field : str
        The unit that the file states, empty if it states none, and the field in which it does.
    up, up_note : str
        Axis that is up by the format's convention, and a note if only the convention states it.
    """
    scale = resolve_units(units, options, notes, where=str(path), field=field)
    if options.up is None and up_note:
        notes.append(f"{up_note}; set it with --up")
    return scale * rotation_to_y_up(up=options.up or up, where=f"{path} up axis")
