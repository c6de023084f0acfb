"""CSV files exported by OptiTrack Motive: markers.

The first line holds keys and values. The header rows depend on the version: kinds (``Marker``,
``Rigid Body``, …), names, identifiers, parents, ``Position`` or ``Rotation``; the last begins with
``Frame`` and holds the axes. An empty cell is an occluded marker.
"""

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from pathlib import Path

from usdface.capture.marker_take import (
    Capture,
    CaptureHeader,
    CaptureOptions,
    MarkerTable,
    build_table_take,
    space_to_mm,
)
from usdface.capture.sample_times import check_rate, rate_of_times, resolve_frame_numbers
from usdface.capture.text_table import (
    TableLine,
    head_lines,
    read_lines,
    read_number_table,
    read_rate,
    sniff_delimiter,
    split_cells,
    without_empty_tail,
    without_repeated_rows,
)
from usdface.core.errors import InputError
from usdface.core.rates import valid_timecode
from usdface.core.text import first_few

_MOST_HEADER_ROWS = 12
_RATES = ("Export Frame Rate", "Capture Frame Rate")
"""Of the exported rows, or else of the capture."""
_STATED = (*_RATES, "Length Units")
_TIMECODE = re.compile(r"(\d\d:\d\d:\d\d[:;]\d\d)(?:\.(\d+))?")


def is_motive_csv(head: bytes) -> bool:
    """Return whether a file is a Motive export, from its first bytes."""
    lines = head_lines(head, 1)
    return bool(lines) and lines[0].lstrip('"').startswith("Format Version")


@dataclass(frozen=True)
class _Header:
    """The header rows, padded to one length."""

    first_line: TableLine
    stated: dict[str, str]
    kinds: list[str]
    names: list[str]
    values: list[str]
    axes: list[str]
    names_line: TableLine
    axes_line: TableLine
    delimiter: str


def read_motive_csv(path: Path, options: CaptureOptions) -> Capture:
    """Read the measured markers of a Motive export.

    Rigid bodies, bones and the markers solved from them are left out: they are not measurements.
    """
    lines = read_lines(path)
    header = _read_header(lines)
    starts = [
        at
        for at in range(len(header.axes) - 2)
        if header.kinds[at] == "Marker"
        and header.values[at] == "Position"
        and header.axes[at : at + 3] == ["X", "Y", "Z"]
    ]
    others = Counter(kind for kind in header.kinds if kind not in ("", "Type", "Marker"))
    if not starts:
        raise InputError(
            f"{header.axes_line.where}: no measured markers (found "
            f"{first_few(others) or 'none'}); export with Markers switched on"
        )
    notes = [f"left out, solved and not measured: {first_few(others)}"] if others else []
    stamps = [at for at, title in enumerate(header.axes) if title.lower() == "timecode"]
    columns = [
        f"{name} {axis}".strip() for name, axis in zip(header.names, header.axes, strict=True)
    ]
    table = read_number_table(
        lines, columns, path=path, delimiter=header.delimiter, gaps=True, texts=stamps
    )
    table = without_repeated_rows(table, notes)
    first_frame, frames = resolve_frame_numbers(table.values[:, 0], table.lines, where=str(path))
    key = next((key for key in _RATES if header.stated.get(key)), None)
    if key is not None:
        rate = read_rate(header.stated[key], header.first_line, key)
        if options.rate is None:
            check_rate(rate, "the first line", table.values[:, 1], frames, where=str(path))
    else:
        rate = rate_of_times(table.values[:, 1], frames, where=str(path))
        notes.append(f"the first line states no rate; {float(rate):g} taken from the times")
    stamp = table.texts[stamps[0]][0] if stamps and table.texts[stamps[0]] else ""
    timecode_start = _timecode(stamp, rate, notes)
    units, field = header.stated.get("Length Units", ""), "Length Units"
    to_mm = space_to_mm(path, options, notes, units=units, field=field)
    labels, where = [header.names[at] for at in starts], header.names_line.where
    return build_table_take(
        CaptureHeader(path, "motive-csv", rate, first_frame, timecode_start, notes),
        MarkerTable(labels, starts, table.values, frames, to_mm, where),
        options,
    )


def _read_header(lines: Iterator[TableLine]) -> _Header:
    first = next(lines)
    delimiter = sniff_delimiter(first.text) or ","
    # A take's name may contain commas, so that keys are searched for.
    stated = {
        key: value for key, value in pairwise(split_cells(first, delimiter)) if key in _STATED
    }
    rows: list[tuple[TableLine, list[str]]] = []
    for line in lines:
        cells = split_cells(line, delimiter)
        if not any(cells):
            continue
        rows.append((line, cells))
        if cells[0].lower() == "frame" or len(rows) > _MOST_HEADER_ROWS:
            break
    line, axes = rows[-1] if rows else (first, [""])
    if axes[0].lower() != "frame":
        raise InputError(
            f"{line.where}: no line that begins with Frame and Time within the header; export the "
            "take again with its header"
        )
    axes = without_empty_tail(axes)
    width = len(axes)
    above = rows[:-1]
    kinds_at = _row_with({"Marker", "Rigid Body", "Bone"}, above)
    values_at = _row_with({"Position"}, above)
    if kinds_at is None or values_at is None or values_at <= kinds_at + 1:
        raise InputError(
            f"{line.where}: the rows above do not say which columns are the positions of markers; "
            "export the take again with its header"
        )

    def padded(at: int) -> list[str]:
        return [*above[at][1], *[""] * width][:width]

    return _Header(
        first,
        stated,
        padded(kinds_at),
        padded(kinds_at + 1),
        padded(values_at),
        axes,
        above[kinds_at + 1][0],
        line,
        delimiter,
    )


def _row_with(wanted: set[str], rows: list[tuple[TableLine, list[str]]]) -> int | None:
    """Return the first of the rows with one of these cells."""
    return next((at for at, (_, cells) in enumerate(rows) if wanted.intersection(cells)), None)


def _timecode(stamp: str, rate: Fraction, notes: list[str]) -> str:
    """Return the SMPTE timecode of the first frame; empty, with a note, if it is invalid."""
    match = _TIMECODE.fullmatch(stamp)
    if match is None:
        if stamp:
            notes.append(f"the timecode column is not used: it begins {stamp[:24]!r}")
        return ""
    label, faults = valid_timecode(match[1], rate)
    notes += faults
    if label and int(match[2] or 0):
        notes.append(
            f"the take begins at sub-frame {match[2]} of the label {label}, which names whole "
            "frames: the sub-frame is left out"
        )
    return label
