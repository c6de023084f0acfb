"""Text files of capture programs: encodings, size limits, cells and tables of numbers.

Every fault is an `InputError` with the file, line, column and value.
"""

import csv
import io
import math
import re
from array import array
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path

import numpy as np

from usdface.core.arrays import FloatArray, IntArray
from usdface.core.confinement import check_may_open
from usdface.core.errors import InputError
from usdface.core.rates import exact_rate
from usdface.core.text import first_few, pluralize, read_text, repeated, text_encoding

LARGEST_BYTES = 4 << 30
"""About four hours of 100 markers at 120 frames per second, with nine characters a number."""
LONGEST_LINE = 1 << 20
MOST_LINES = 10_000_000
DELIMITERS = ("\t", ",", ";")
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?", re.ASCII)
_NOT_A_NUMBER = re.compile(r"[+-]?(?:nan|inf|infinity)", re.IGNORECASE)
_MISSING = re.compile(
    r"(?:n/?a|#n/a|null|none|[+-]?(?:nan\((?:s|q)?nan\)|nan\(ind\)|1\.#(?:[sq]nan|ind)0*))?",
    re.IGNORECASE,
)
"""Missing values as written by R, pandas, SPSS, spreadsheets and C on Windows."""
_LONGEST_QUOTE = 40


@dataclass(frozen=True)
class TableLine:
    """One line of a file, without its line break; `number` counts from 1."""

    path: Path
    number: int
    text: str

    @property
    def where(self) -> str:
        """The file and the line, for a message."""
        return f"{self.path} line {self.number}"


@dataclass(frozen=True)
class NumberTable:
    """Rows of numbers under named columns."""

    values: FloatArray
    """(rows, columns): NaN where a cell is empty or missing; undefined in text columns."""
    lines: IntArray
    """(rows,): line of each row in its file."""
    texts: dict[int, list[str]] = field(default_factory=dict)
    """Cells of the text columns, by column."""


def head_lines(head: bytes, count: int) -> list[str]:
    """Return the first lines of `head` as text; none if it is not text."""
    text = head.decode(text_encoding(head), errors="replace")
    return [] if "\0" in text else text.splitlines()[:count]


def head_titles(head: bytes) -> list[str]:
    """Return the cells of the first line of `head`; none if it is not text."""
    lines = head_lines(head, 1)
    cells = lines[0].split(sniff_delimiter(lines[0]) or ",") if lines else []
    return [cell.strip('" ') for cell in cells]


def read_lines(path: Path) -> Iterator[TableLine]:
    """Yield all lines of a text file: UTF-8 or UTF-16, with any line ends."""
    check_may_open(path)
    size = path.stat().st_size
    if size == 0:
        raise InputError(f"{path}: the file is empty (0 bytes); export the take again")
    if size > LARGEST_BYTES:
        raise InputError(
            f"{path}: {size / 2**30:.1f} GiB of text, more than {LARGEST_BYTES >> 30} GiB; "
            "export the take in parts, or as C3D"
        )
    with path.open("rb") as file:
        encoding = text_encoding(file.read(4))
    with path.open(encoding=encoding, errors="replace") as stream:
        number = 0
        while text := stream.readline(LONGEST_LINE):
            number += 1
            line = TableLine(path, number, text.rstrip("\n"))
            _check_line(line, encoding)
            yield line
        if number == 0:  # a byte order mark alone
            raise InputError(f"{path}: the file holds no text; export the take again")


def split_cells(line: TableLine, delimiter: str | None) -> list[str]:
    """Split a line at a delimiter, or at white space if None; quotes are removed."""
    if delimiter is None:
        return line.text.split()
    if '"' not in line.text:
        return [cell.strip() for cell in line.text.split(delimiter)]
    try:
        cells = next(csv.reader([line.text], delimiter=delimiter), [])
    except csv.Error as error:
        raise InputError(f"{line.where}: {error}; export the take again") from error
    return [cell.strip() for cell in cells]


def without_empty_tail(cells: Sequence[str]) -> list[str]:
    """Return the cells up to the last that is not empty."""
    count = len(cells)
    while count and not cells[count - 1]:
        count -= 1
    return list(cells[:count])


def sniff_delimiter(text: str) -> str | None:
    """Return the most frequent delimiter of a header; None if it has white space only."""
    best = max(DELIMITERS, key=text.count)
    return best if best in text else None


def next_line(
    lines: Iterator[TableLine], path: Path, expected: str, *, empty: bool = False
) -> TableLine:
    """Return the next line of a header, by default the next that is not empty."""
    for line in lines:
        if empty or line.text.strip():
            return line
    raise InputError(f"{path}: the file ends before its header does ({expected}); copy it again")


def read_header(lines: Iterator[TableLine]) -> tuple[TableLine, str, list[str]]:
    """Read the first line of a table: the line, the delimiter and the columns' titles."""
    header = next(lines)
    delimiter = sniff_delimiter(header.text) or ","
    titles = without_empty_tail(split_cells(header, delimiter))
    check_columns(titles, header)
    return header, delimiter, titles


def read_rate(text: str, line: TableLine, title: str) -> Fraction:
    """Read frames per second from a header, also with a decimal comma."""
    try:
        rate = float(text.replace(",", "."))
    except ValueError as error:
        raise InputError(
            f"{line.where}: {title} is {text[:24]!r}; it must be frames per second: export the "
            "take again"
        ) from error
    return exact_rate(rate, where=f"{line.where} {title}")


def check_columns(columns: Sequence[str], line: TableLine) -> None:
    """Refuse empty and repeated column names."""
    seen: dict[str, int] = {}
    for index, name in enumerate(columns):
        if not name:
            raise InputError(
                f"{line.where}, column {index + 1}: the column has no name; export the take again"
            )
        if name in seen:
            raise InputError(
                f"{line.where}: column {name!r} appears twice, as columns {seen[name] + 1} and "
                f"{index + 1}; export the take again, or delete the wrong one"
            )
        seen[name] = index


def parse_cells(
    cells: Sequence[str],
    columns: Sequence[str],
    line: TableLine,
    *,
    delimiter: str | None,
    gaps: bool,
    first_column: int = 0,
) -> list[float]:
    """Read the numbers of one row.

    Parameters
    ----------
    columns : sequence of str
        Name of each cell's column, for messages.
    delimiter : str or None
        Unless it is a comma, numbers may have a decimal comma.
    gaps : bool
        Whether an empty cell, ``NaN`` or ``NA`` is a gap; else it is refused.
    first_column : int
        Column of the line of the first cell, from 0; for messages.
    """
    if len(cells) != len(columns):
        if len(without_empty_tail(cells)) > len(columns) or len(cells) < len(columns):
            raise InputError(
                f"{line.where}: {first_column + len(cells)} cells, "
                f"{first_column + len(columns)} expected; the line is cut off or has a stray "
                "delimiter: export the take again, or delete the line"
            )
        cells = cells[: len(columns)]
    try:
        # float() accepts '1_0', which is refused below.
        numbers = [float(cell) for cell in cells] if "_" not in line.text else []
    except ValueError:
        numbers = []
    if len(numbers) != len(cells):
        numbers = [
            _number(cell, delimiter, _cell_location(line, columns, index, first_column), gaps)
            for index, cell in enumerate(cells)
        ]
    if not gaps and not math.isfinite(math.fsum(0.0 * number for number in numbers)):
        bad = next(index for index, number in enumerate(numbers) if not math.isfinite(number))
        raise InputError(
            f"{_cell_location(line, columns, bad, first_column)}: {cells[bad]!r} is not a finite "
            "number; export the take again, or delete the line"
        )
    return numbers


def read_number_table(
    lines: Iterable[TableLine],
    columns: Sequence[str],
    *,
    path: Path,
    delimiter: str | None,
    gaps: bool,
    texts: Sequence[int] = (),
    stop_at_empty: bool = False,
) -> NumberTable:
    """Read rows of numbers.

    Parameters
    ----------
    lines : iterable of TableLine
        After the header; empty lines are skipped.
    texts : sequence of int
        Columns to read as text.
    stop_at_empty : bool
        Whether an empty line ends the table.
    """
    values = array("d")
    numbers: list[int] = []
    kept: dict[int, list[str]] = {column: [] for column in texts}
    for line in lines:
        cells = split_cells(line, delimiter)
        if not any(cells):
            if stop_at_empty:
                break
            continue
        for column, found in kept.items():
            if column < len(cells):
                found.append(cells[column])
                cells[column] = "nan" if gaps else "0"
        values.extend(parse_cells(cells, columns, line, delimiter=delimiter, gaps=gaps))
        numbers.append(line.number)
    if not numbers:
        raise InputError(f"{path}: no data rows after the header; export the take again")
    table = np.frombuffer(values, np.float64).reshape(len(numbers), len(columns))
    return NumberTable(table, np.array(numbers, np.int64), kept)


def without_repeated_rows(table: NumberTable, notes: list[str]) -> NumberTable:
    """Remove rows identical to the one before, including the frame number; note the lines."""
    same = np.zeros(len(table.values), dtype=bool)
    before, after = table.values[:-1], table.values[1:]
    same[1:] = ((before == after) | (np.isnan(before) & np.isnan(after))).all(axis=1)
    if not same.any():
        return table
    rows, lines = np.flatnonzero(~same), first_few(table.lines[same].tolist(), most=3)
    notes.append(f"{pluralize(int(same.sum()), 'row')} written twice, read once: line {lines}")
    texts = {at: [cells[row] for row in rows] for at, cells in table.texts.items()}
    return NumberTable(table.values[rows], table.lines[rows], texts)


def _check_line(line: TableLine, encoding: str) -> None:
    if line.number > MOST_LINES:
        raise InputError(f"{line.path}: more than {MOST_LINES} lines; export the take in parts")
    if len(line.text) >= LONGEST_LINE:
        raise InputError(
            f"{line.where}: longer than {LONGEST_LINE} characters; this is not a table of samples"
        )
    if "\0" in line.text:
        raise InputError(
            f"{line.where}, character {line.text.index(chr(0)) + 1}: a NUL byte; the file is "
            "damaged or not text: export the take again as UTF-8"
        )
    if not line.text.isascii() and "\ufffd" in line.text:
        raise InputError(
            f"{line.where}, character {line.text.index(chr(0xFFFD)) + 1}: not "
            f"{'UTF-16' if encoding == 'utf-16' else 'UTF-8'}; save the file as UTF-8, or rename "
            "markers that have letters outside ASCII"
        )


def _cell_location(line: TableLine, columns: Sequence[str], index: int, first_column: int) -> str:
    return f"{line.where}, column {first_column + index + 1} ({columns[index][:_LONGEST_QUOTE]})"


def _number(cell: str, delimiter: str | None, place: str, gaps: bool) -> float:
    if delimiter != "," and "." not in cell:
        cell = cell.replace(",", ".", 1)
    if _NUMBER.fullmatch(cell) or _NOT_A_NUMBER.fullmatch(cell):
        return float(cell)
    if gaps and _MISSING.fullmatch(cell):
        return math.nan
    found = repr(cell[:_LONGEST_QUOTE]) if cell else "an empty cell"
    raise InputError(
        f"{place}: {found} where a number is expected; export the take again, or correct the cell"
    )


_LARGEST_CSV_BYTES = 1 << 30


def csv_rows(path: Path, columns: Sequence[str]) -> list[tuple[str, dict[str, object]]]:
    """Read the rows of a table that must have `columns`, each with its line for messages."""
    text = read_text(path, _LARGEST_CSV_BYTES)
    # Lines of a file: `str.splitlines` also cuts cells at form feeds and Unicode separators.
    lines = io.StringIO(text, newline=None)
    delimiter = sniff_delimiter(lines.readline()) or ","
    lines.seek(0)
    reader = csv.DictReader(lines, delimiter=delimiter)
    header = reader.fieldnames or []
    missing = [name for name in columns if name not in header]
    if missing:
        raise InputError(
            f"{path} line 1: has no `{missing[0]}` column; the first line must name the columns"
        )
    if twice := repeated(header):
        raise InputError(f"{path} line 1: column {min(twice)!r} is repeated; keep one")
    rows: list[tuple[str, dict[str, object]]] = []
    try:
        for row in reader:
            surplus = row.pop(None, None) or []
            if any(value.strip() for value in surplus):  # the other cells may be shifted
                raise InputError(
                    f"{path} line {reader.line_num}: has {len(header) + len(surplus)} values for "
                    f"{len(header)} columns; write decimals with a point, not a comma"
                )
            rows.append((f"line {reader.line_num}", dict(row)))
        return rows
    except csv.Error as error:
        raise InputError(f"{path} line {reader.line_num}: {error}") from error
