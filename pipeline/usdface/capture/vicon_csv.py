"""CSV as Vicon Nexus and Tracker export it: markers.

Blocks stand one below the other, each with a title (``Trajectories``, ``Devices``, …), its rate on
the next line, ``subject:marker`` over every third column, ``Frame,Sub Frame,X,Y,Z,…``, units, rows,
and an empty line at the end.
"""

import re
from collections import Counter
from collections.abc import Iterator
from itertools import chain
from pathlib import Path

from usdface.capture.marker_labels import list_some
from usdface.capture.marker_table import build_table_take, settle_space
from usdface.capture.marker_take import Capture, CaptureOptions
from usdface.capture.sample_times import settle_frame_numbers
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

_COLUMNS = re.compile(r'"?Frame"?\s*[,;\t]\s*"?Sub Frame"?', re.IGNORECASE)
_HEAD_LINES = 12
_TITLE = "trajectories"


def is_vicon_csv(head: bytes) -> bool:
    """Tell a Vicon export by its first bytes."""
    return any(_COLUMNS.match(line) for line in head_lines(head, _HEAD_LINES))


def read_vicon_csv(path: Path, options: CaptureOptions) -> Capture:
    """Read the trajectories of a Vicon export; empty cells are gaps.

    Raises
    ------
    InputError
        If there is no block of trajectories, or two; if its header or a row is damaged, its rate
        or units are unknown, or nothing is left to use.
    """
    lines = read_lines(path)
    skipped: list[str] = []
    capture: Capture | None = None
    for line in lines:
        title = _title(line)
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
            f"{path}: no block of trajectories (found {list_some(skipped) or 'none'}); export "
            "labelled trajectories"
        )
    if not skipped:
        return capture
    note = f"blocks left out: {list_some(skipped)}"
    return Capture(capture.take, capture.format, (note, *capture.notes))


def _title(line: TableLine) -> str | None:
    """Return a block's title: a line of one cell that begins with a letter."""
    cells = without_empty_tail(split_cells(line, sniff_delimiter(line.text) or ","))
    return cells[0] if len(cells) == 1 and cells[0][:1].isalpha() else None


def _read_block(path: Path, lines: Iterator[TableLine], options: CaptureOptions) -> Capture:
    """Read the block whose title was the line before."""
    rate_line = _next(lines, path)
    names = _next(lines, path)
    titles = _next(lines, path)
    if not _COLUMNS.match(titles.text):
        raise InputError(
            f"{titles.where}: begins {titles.text[:24]!r}; this line must begin with Frame and "
            "Sub Frame: export the take again"
        )
    delimiter = sniff_delimiter(titles.text)
    rate_text = split_cells(rate_line, delimiter)[0]
    try:
        rate = exact_rate(float(rate_text.replace(",", ".")), where=f"{rate_line.where} (the rate)")
    except ValueError as error:
        raise InputError(
            f"{rate_line.where}: {rate_text[:24]!r} where the rate of the trajectories is "
            "expected; export the take again"
        ) from error

    axes = without_empty_tail(split_cells(titles, delimiter))
    starts = [at for at in range(2, len(axes) - 2) if axes[at : at + 3] == ["X", "Y", "Z"]]
    if not starts:
        raise InputError(
            f"{titles.where}: no columns X, Y, Z; export the trajectories as positions"
        )
    over = split_cells(names, delimiter)
    labels = [over[at] if at < len(over) else "" for at in starts]
    notes = []
    if len(axes) - 2 > 3 * len(starts):
        notes.append(f"{len(axes) - 2 - 3 * len(starts)} columns other than positions left out")

    units = _next(lines, path)
    unit_cells = split_cells(units, delimiter)
    has_units = not "".join(unit_cells[:2])
    unit = _one_unit(units, unit_cells, starts) if has_units else ""
    columns = [
        *axes[:2],
        *(f"{over[at] if at < len(over) else ''} {axes[at]}" for at in range(2, len(axes))),
    ]
    table = read_number_table(
        lines if has_units else chain([units], lines),
        columns,
        path=path,
        delimiter=delimiter,
        gaps=True,
        stop_at_empty=True,
    )
    first_frame, frames = settle_frame_numbers(table.values[:, 0], table.lines, where=str(path))
    to_mm = settle_space(
        unit,
        "z",
        options,
        notes,
        where=str(path),
        field=f"units, line {units.number}",
        up_note="Vicon's Z taken as up",
    )
    return build_table_take(
        path,
        labels,
        table.values,
        starts,
        frames=frames,
        first_frame=first_frame,
        rate=rate,
        to_mm=to_mm,
        options=options,
        notes=notes,
        format_name="vicon-csv",
        where=names.where,
    )


def _one_unit(line: TableLine, cells: list[str], starts: list[int]) -> str:
    """Return the unit of all positions."""
    units = Counter(
        cells[at] for start in starts for at in range(start, start + 3) if at < len(cells)
    )
    if len(units) > 1:
        raise InputError(
            f"{line.where}: positions in several units ({list_some(list(units))}); "
            "export them in one"
        )
    return next(iter(units), "")


def _next(lines: Iterator[TableLine], path: Path) -> TableLine:
    for line in lines:
        return line
    raise InputError(f"{path}: the file ends within the header of its trajectories; copy it again")
