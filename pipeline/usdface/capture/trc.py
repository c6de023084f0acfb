"""TRC, the track-row-column text of Motion Analysis and OpenSim: markers.

Five header lines: the kind of file, names and values of what it holds, marker names over every
third column, and the columns' axes. The delimiter is told from the second line.
"""

import re
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

from usdface.capture.marker_take import (
    Capture,
    CaptureHeader,
    CaptureOptions,
    MarkerTable,
    build_table_take,
    settle_space,
)
from usdface.capture.sample_times import check_rate, settle_frame_numbers
from usdface.capture.text_table import (
    TableLine,
    head_lines,
    read_lines,
    read_number_table,
    sniff_delimiter,
    split_cells,
    without_empty_tail,
)
from usdface.core.errors import InputError
from usdface.core.rates import exact_rate

_AXIS = re.compile(r"[XYZ]\d*", re.IGNORECASE)


def is_trc(head: bytes) -> bool:
    """Tell a TRC file by its first bytes."""
    lines = head_lines(head, 1)
    return bool(lines) and lines[0].startswith("PathFileType")


def read_trc(path: Path, options: CaptureOptions) -> Capture:
    """Read the markers of a TRC file; empty cells and ``NaN`` are gaps.

    Raises
    ------
    InputError
        If the header or a row is damaged, the rate or units are unknown, or nothing is left to use.
    """
    lines = read_lines(path)
    _next(lines, path, "PathFileType")
    keys = _next(lines, path, "names of the header values, DataRate first")
    delimiter = sniff_delimiter(keys.text)
    stated = _next(lines, path, "values of the header")
    header = dict(zip(split_cells(keys, delimiter), split_cells(stated, delimiter), strict=False))
    titles = _next(lines, path, "marker names")
    axes = _next(lines, path, "X1 Y1 Z1 and so on")
    labels = _labels(titles, axes, delimiter)
    columns = ["Frame#", "Time"] + [f"{label}.{axis}" for label in labels for axis in "XYZ"]
    table = read_number_table(lines, columns, path=path, delimiter=delimiter, gaps=True)

    notes = _check_counts(header, len(labels), len(table.values))
    first_frame, frames = settle_frame_numbers(table.values[:, 0], table.lines, where=str(path))
    rate = _data_rate(header, stated)
    if options.rate is None:
        check_rate(rate, "DataRate", table.values[:, 1], frames, where=str(path))
    to_mm = settle_space(
        header.get("Units", ""),
        "y",
        options,
        notes,
        where=str(path),
        field="Units",
        up_note="TRC does not say which axis is up; Y assumed",
    )
    return build_table_take(
        CaptureHeader(path, "trc", rate, first_frame, notes=notes),
        MarkerTable(
            labels, range(2, len(columns), 3), table.values, frames, to_mm, where=titles.where
        ),
        options,
    )


def _labels(titles: TableLine, axes: TableLine, delimiter: str | None) -> list[str]:
    """Return the marker names; they stand over every third column after frame and time."""
    names = split_cells(titles, delimiter)
    marks = [cell for cell in split_cells(axes, delimiter) if cell]
    if not marks or len(marks) % 3 or not all(_AXIS.fullmatch(mark) for mark in marks):
        raise InputError(
            f"{axes.where}: begins {axes.text.strip()[:24]!r}; this line must hold X1, Y1, Z1 and "
            "so on, three for each marker: export the take again"
        )
    count = len(marks) // 3
    if [name.lower() for name in names[:2]] != ["frame#", "time"]:
        raise InputError(
            f"{titles.where}: begins {titles.text.strip()[:24]!r}; this line must begin with "
            "Frame# and Time: export the take again"
        )
    labels = names[2:] if delimiter is None else names[2::3]
    if len(without_empty_tail(labels)) > count:
        raise InputError(
            f"{titles.where}: {len(without_empty_tail(labels))} marker names over {count} markers; "
            "export the take again"
        )
    return [*labels, *[""] * count][:count]


def _check_counts(header: dict[str, str], markers: int, rows: int) -> list[str]:
    return [
        f"{key} says {header[key]}, {found} found: the file may be cut off"
        for key, found in (("NumMarkers", markers), ("NumFrames", rows))
        if not _states_count(header.get(key, ""), found)
    ]


def _states_count(text: str, count: int) -> bool:
    """Tell whether a header's cell is this count, however it is written, or nothing."""
    try:
        return not text or float(text) == count
    except ValueError:
        return False


def _data_rate(header: dict[str, str], line: TableLine) -> Fraction:
    """Return the rate that the header states."""
    text = header.get("DataRate", "")
    try:
        rate = float(text.replace(",", "."))
    except ValueError as error:
        raise InputError(
            f"{line.where}: DataRate is {text[:24]!r}; it must be frames per second: export the "
            "take again"
        ) from error
    return exact_rate(rate, where=f"{line.where} DataRate")


def _next(lines: Iterator[TableLine], path: Path, expected: str) -> TableLine:
    """Return the next line that is not empty."""
    for line in lines:
        if line.text.strip():
            return line
    raise InputError(f"{path}: the file ends before its header does ({expected}); copy it again")
