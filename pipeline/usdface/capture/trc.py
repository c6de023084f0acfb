"""TRC files (track row column) of Motion Analysis and OpenSim: markers.

Five header lines: kind of file, names and values of its properties, marker names over every third
column, and axes of the columns. The delimiter is detected in the second line.
"""

import re
from collections.abc import Iterator
from pathlib import Path

from usdface.capture.marker_take import (
    Capture,
    CaptureHeader,
    CaptureOptions,
    MarkerTable,
    build_table_take,
    space_to_mm,
)
from usdface.capture.sample_times import check_rate, resolve_frame_numbers
from usdface.capture.text_table import (
    TableLine,
    head_lines,
    next_line,
    read_lines,
    read_number_table,
    read_rate,
    sniff_delimiter,
    split_cells,
    without_empty_tail,
    without_repeated_rows,
)
from usdface.core.errors import InputError
from usdface.core.text import pluralize

_AXIS = re.compile(r"[XYZ]\d*", re.IGNORECASE)


def is_trc(head: bytes) -> bool:
    """Return whether a file is a TRC file, from its first bytes."""
    lines = head_lines(head, 1)
    return bool(lines) and lines[0].startswith("PathFileType")


def read_trc(path: Path, options: CaptureOptions) -> Capture:
    """Read the markers of a TRC file; empty cells and ``NaN`` are gaps."""
    lines = read_lines(path)
    next_line(lines, path, "PathFileType")
    keys = next_line(lines, path, "names of the header values, DataRate first")
    delimiter = sniff_delimiter(keys.text)
    stated = next_line(lines, path, "values of the header")
    header = _header(split_cells(keys, delimiter), split_cells(stated, delimiter))
    titles = next_line(lines, path, "marker names")
    axes = next_line(lines, path, "X1 Y1 Z1 and so on")
    labels = _labels(titles, axes, delimiter)
    columns = ["Frame#", "Time"] + [f"{label}.{axis}" for label in labels for axis in "XYZ"]
    unnamed: list[int] = []
    rows = _without_unnamed(lines, len(columns), delimiter, unnamed)
    table = read_number_table(rows, columns, path=path, delimiter=delimiter, gaps=True)
    most = max(unnamed, default=0)
    notes = _check_counts(header, len(labels), most, len(table.values))
    table = without_repeated_rows(table, notes)
    first_frame, frames = resolve_frame_numbers(table.values[:, 0], table.lines, where=str(path))
    rate = read_rate(header.get("DataRate") or str(options.rate or ""), stated, "DataRate")
    if options.rate is None:
        check_rate(rate, "DataRate", table.values[:, 1], frames, where=str(path))
    units, up_note = header.get("Units", ""), "TRC does not state the up axis; Y assumed"
    to_mm = space_to_mm(path, options, notes, units=units, field="Units", up_note=up_note)
    return build_table_take(
        CaptureHeader(path, "trc", rate, first_frame, notes=notes),
        MarkerTable(labels, range(2, len(columns), 3), table.values, frames, to_mm, titles.where),
        options,
    )


def _labels(titles: TableLine, axes: TableLine, delimiter: str | None) -> list[str]:
    """Return the marker names, which are over every third column after frame and time."""
    names = split_cells(titles, delimiter)
    marks = [cell for cell in split_cells(axes, delimiter) if cell]
    in_order = all(
        _AXIS.fullmatch(mark) and mark[0].upper() == "XYZ"[at % 3] for at, mark in enumerate(marks)
    )
    if not marks or len(marks) % 3 or not in_order:
        raise InputError(
            f"{axes.where}: begins {axes.text.strip()[:24]!r}; this line must hold X1, Y1, Z1 and "
            "so on, in this order, three for each marker: export the take again"
        )
    count = len(marks) // 3
    if [name.lower() for name in names[:2]] != ["frame#", "time"]:
        raise InputError(
            f"{titles.where}: begins {titles.text.strip()[:24]!r}; this line must begin with "
            "Frame# and Time: export the take again"
        )
    labels = names[2:] if delimiter is None else names[2::3]
    if any(names[at] for at in range(2, len(names)) if (at - 2) % 3) and delimiter is not None:
        labels = [name for name in names[2:] if name]  # doubled delimiters: only the order counts
    if len(without_empty_tail(labels)) > count:
        raise InputError(
            f"{titles.where}: {len(without_empty_tail(labels))} marker names over {count} markers; "
            "export the take again"
        )
    return [*labels, *[""] * count][:count]


def _without_unnamed(
    lines: Iterator[TableLine], columns: int, delimiter: str | None, counts: list[int]
) -> Iterator[TableLine]:
    """Yield rows without the columns of unnamed markers, whose number in such a row is appended.

    Cortex and EVaRT append the visible ones to each row. A multiple of three extra cells is
    distinguished from a damaged row; not with comma delimiters, where each decimal comma adds a
    cell.
    """
    for line in lines:
        # counting is faster than splitting
        if delimiter and delimiter != "," and line.text.count(delimiter) >= columns:
            cells = without_empty_tail(split_cells(line, delimiter))
            count, rest = divmod(len(cells) - columns, 3)
            if count > 0 and rest == 0:
                counts.append(count)
                line = TableLine(line.path, line.number, delimiter.join(cells[:columns]))
        yield line


def _header(keys: list[str], values: list[str]) -> dict[str, str]:
    """Return the header's values by name; doubled delimiters are merged if counts then agree."""
    keys, values = without_empty_tail(keys), without_empty_tail(values)
    stated = [value for value in values if value]
    if len(values) != len(keys) or not all(keys):
        keys = [key for key in keys if key]
        values = stated if len(stated) == len(keys) else values
    return dict(zip(keys, values, strict=False))


def _check_counts(header: dict[str, str], markers: int, unnamed: int, rows: int) -> list[str]:
    notes = []
    if unnamed:
        notes.append(f"up to {pluralize(unnamed, 'marker')} a row without a name, left out")
    elif not _states_count(header.get("NumMarkers", ""), markers):
        notes.append(
            f"NumMarkers says {header['NumMarkers']}, {markers} found: the file may be cut off"
        )
    if not _states_count(header.get("NumFrames", ""), rows):
        notes.append(f"NumFrames says {header['NumFrames']}, {rows} found: the file may be cut off")
    return notes


def _states_count(text: str, count: int) -> bool:
    """Return whether a header's cell is empty or equals `count`."""
    try:
        return not text or float(text) == count
    except ValueError:
        return False
