"""Markers from the columns of a table, made into a take."""

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from usdface.capture.axes import mm_per_unit, rotation_to_y_up
from usdface.capture.marker_labels import settle_labels
from usdface.capture.marker_take import Capture, CaptureOptions, build_marker_take

_CHUNK_ROWS = 8192


def build_table_take(
    path: Path,
    labels: Sequence[str],
    values: NDArray[np.float64],
    columns: Sequence[int],
    *,
    frames: NDArray[np.int64],
    first_frame: int,
    rate: Fraction,
    to_mm: NDArray[np.float64],
    options: CaptureOptions,
    notes: Sequence[str],
    format_name: str,
    where: str,
    timecode_start: str = "",
) -> Capture:
    """Make a take of markers that stand in columns X, Y, Z of a table.

    Frames without a row are gaps of every marker, and are reported.

    Parameters
    ----------
    path : Path
    labels : sequence of str
        As written, subject prefixes included.
    values : (rows, columns) float64 array
        NaN where a marker was not seen.
    columns : sequence of int
        Column of each label's X; Y and Z follow.
    frames : (rows,) int array
        Frame of each row from 0, ascending.
    first_frame : int
    rate : Fraction
    to_mm : (3, 3) float array
        Brings the table's units and axes to mm, Y up.
    options : CaptureOptions
    notes : sequence of str
    format_name : str
    where : str
        File and place of the labels, for messages.
    timecode_start : str

    Raises
    ------
    InputError
        As `settle_labels` and `build_marker_take`.
    """
    found = list(notes)
    settled = settle_labels(labels, where=where)
    found += settled.notes()
    count = int(frames[-1]) + 1
    if count > len(frames):
        found.append(f"{count - len(frames)} of {count} frames have no row and are gaps")
    starts = np.array([columns[index] for index in settled.columns], np.int64)
    positions = np.zeros((count, len(starts), 3), np.float32)
    visible = np.zeros((count, len(starts)), bool)
    axes = starts[:, None] + np.arange(3)
    for start in range(0, len(frames), _CHUNK_ROWS):  # temporaries stay small on long takes
        rows = slice(start, start + _CHUNK_ROWS)
        with np.errstate(invalid="ignore", over="ignore"):  # damaged samples are hidden later
            samples = values[rows][:, axes] @ to_mm.T
            positions[frames[rows]] = samples
        visible[frames[rows]] = ~np.isnan(samples).any(axis=2)
    return build_marker_take(
        path,
        settled.names,
        positions,
        visible,
        rate=rate,
        first_frame=first_frame,
        options=options,
        notes=found,
        format_name=format_name,
        timecode_start=timecode_start,
    )


def settle_space(
    stated_units: str,
    assumed_up: str,
    options: CaptureOptions,
    notes: list[str],
    *,
    where: str,
    field: str,
    up_note: str = "",
) -> NDArray[np.float64]:
    """Return the matrix to mm with Y up, from what the file states, assumes or the user says.

    Parameters
    ----------
    stated_units : str
        Empty where the file does not say; then mm.
    assumed_up : {'y', 'z'}
        The format's convention.
    options : CaptureOptions
    notes : list of str
        Added to.
    where, field : str
        File, and what its units are called there, for notes and messages.
    up_note : str
        Added to `notes` when the convention decides; nothing when empty.

    Raises
    ------
    InputError
        If the units or the axis are not known.
    """
    if options.units is not None:
        if stated_units and stated_units.lower() != options.units.lower():
            notes.append(f"{field} says {stated_units}; {options.units} was asked for and used")
        scale = mm_per_unit(options.units, where=f"{where} units")
    else:
        if not stated_units:
            notes.append(f"no unit stated ({field}); mm assumed, say otherwise with --units")
        scale = mm_per_unit(stated_units or "mm", where=f"{where} {field}")
    if options.up is None and up_note:
        notes.append(f"{up_note}; say otherwise with --up")
    up = assumed_up if options.up is None else options.up
    return scale * rotation_to_y_up(up=up, where=f"{where} up axis")
