"""CSV files exported by Vicon Nexus and Tracker: markers.

Blocks follow each other, each with a title (``Trajectories``, ``Devices``, …), its rate on the next
line, ``subject:marker`` over every third column, ``Frame,Sub Frame,X,Y,Z,…``, units, rows, and an
empty line.
"""

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from itertools import chain
from pathlib import Path

from usdface.capture.marker_take import (
    Capture,
    CaptureHeader,
    CaptureOptions,
    MarkerTable,
    build_table_take,
    space_to_mm,
)
from usdface.capture.sample_times import resolve_frame_numbers
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
from usdface.core.text import first_few

_COLUMNS = re.compile(r'"?Frame"?\s*[,;\t]\s*"?Sub Frame"?', re.IGNORECASE)
_HEAD_LINES = 1000  # a block of events may precede the columns of the first table
_TITLE = "trajectories"


def is_vicon_csv(head: bytes) -> bool:
    """Return whether a file is a Vicon export, from its first bytes."""
    return any(_COLUMNS.match(line) for line in head_lines(head, _HEAD_LINES))


def read_vicon_csv(path: Path, options: CaptureOptions) -> Capture:
    """Read the trajectories of a Vicon export; empty cells are gaps."""
    lines = read_lines(path)
    skipped: list[str] = []
    capture: Capture | None = None
    for line in lines:
        # A title is a line of one cell that begins with a letter.
        cells = without_empty_tail(split_cells(line, sniff_delimiter(line.text) or ","))
        title = cells[0] if len(cells) == 1 and cells[0][:1].isalpha() else None
        if title is None:
            continue
        if title.lower() != _TITLE:
            skipped.append(title)
        elif capture is None:
            capture = _read_block(path, lines, options)
        else:
            raise InputError(
                f"{line.where}: a second block of trajectories; a take is one recording: export "
                "them one by one"
            )
    if capture is None:
        raise InputError(
            f"{path}: no block of trajectories (found {first_few(skipped) or 'none'}); export "
            "labelled trajectories"
        )
    if not skipped:
        return capture
    note = f"blocks left out: {first_few(skipped)}"
    return replace(capture, notes=(note, *capture.notes))


def _read_block(path: Path, lines: Iterator[TableLine], options: CaptureOptions) -> Capture:
    """Read the block whose title has just been read."""
    rate_line, names_line, titles = (
        next_line(lines, path, "the columns of trajectories", empty=True) for _ in range(3)
    )
    if not _COLUMNS.match(titles.text):
        raise InputError(
            f"{titles.where}: begins {titles.text[:24]!r}; this line must begin with Frame and "
            "Sub Frame: export the take again"
        )
    delimiter = sniff_delimiter(titles.text)
    rate = read_rate(split_cells(rate_line, delimiter)[0], rate_line, "the rate")
    axes = without_empty_tail(split_cells(titles, delimiter))
    starts = [at for at in range(2, len(axes) - 2) if axes[at : at + 3] == ["X", "Y", "Z"]]
    if not starts:
        raise InputError(
            f"{titles.where}: no columns X, Y, Z; export the trajectories as positions"
        )
    # `subject:marker` is over every X alone.
    names = [*split_cells(names_line, delimiter), *[""] * len(axes)][: len(axes)]
    unit_line = next_line(lines, path, "their units", empty=True)
    units = split_cells(unit_line, delimiter)
    has_units = not "".join(units[:2])  # else it is the first row
    others = len(axes) - 2 - 3 * len(starts)
    notes = [f"{others} columns other than positions left out"] if others > 0 else []
    table = read_number_table(
        lines if has_units else chain([unit_line], lines),
        [*axes[:2], *(f"{name} {axis}" for name, axis in zip(names[2:], axes[2:], strict=True))],
        path=path,
        delimiter=delimiter,
        gaps=True,
        stop_at_empty=True,
    )
    table = without_repeated_rows(table, notes)
    first_frame, frames = resolve_frame_numbers(table.values[:, 0], table.lines, where=str(path))
    unit = _one_unit(unit_line, units, starts) if has_units else ""
    field, up_note = f"units, line {unit_line.number}", "Vicon's Z taken as up"
    to_mm = space_to_mm(path, options, notes, units=unit, field=field, up="z", up_note=up_note)
    return build_table_take(
        CaptureHeader(path, "vicon-csv", rate, first_frame, notes=notes),
        MarkerTable(
            [names[at] for at in starts], starts, table.values, frames, to_mm, names_line.where
        ),
        options,
    )


def _one_unit(line: TableLine, cells: list[str], starts: list[int]) -> str:
    """Return the unit of all positions."""
    units = Counter(
        cells[at] for start in starts for at in range(start, start + 3) if at < len(cells)
    )
    if len(units) > 1:
        raise InputError(
            f"{line.where}: positions in several units ({first_few(units)}); export them in one"
        )
    return next(iter(units), "")
