"""Tables of pairs of shapes: reading, writing, and checks of ambiguous names."""

import csv
import io
import math
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from usdface.capture.text_table import csv_rows
from usdface.core.arrays import index_of
from usdface.core.errors import InputError
from usdface.core.replacing import write_text
from usdface.core.text import first_few, json_text, pluralize, read_json
from usdface.model.retarget.name_matching import Transfer

LARGEST_NAMES_BYTES = 16 << 20
COLUMNS = ("source", "target", "weight")
LARGEST_SHARE = 10.0
"""Largest weight in a table; larger ones are percent or typing errors."""


def check_no_name_twice(path: Path, names: Iterable[str], transfer: Transfer) -> None:
    """Refuse ambiguous names that differ only in capitals and separators."""
    spelled: dict[str, str] = {}
    doubtful = {each.partition(": ")[0] for each in transfer.ambiguous}
    for name in names:
        # Double separators are kept: FACEGOOD's `Scale__X` is the inverse of `Scale_X`.
        letters = re.sub(r"(?<![\W_])[\W_](?![\W_])", "", name).lower()
        other = spelled.setdefault(letters, name)
        if other != name and {name, other} & doubtful:
            raise InputError(
                f"{path}: {other} and {name} are two spellings of one name; remove one, or pair "
                "them with --names"
            )


def transfer_by_table(path: Path, source: Sequence[str], target: Sequence[str]) -> Transfer:
    """Return the transfer of a table written by `usdface names`, possibly edited."""
    rows = _read_rows(path)
    row_of, column_of = index_of(source), index_of(target)
    matrix = np.zeros((len(source), len(target)))
    stated: dict[tuple[str, str], str] = {}
    absent = []
    for where, first, second, weight in rows:
        if second not in column_of:
            raise InputError(
                f"{path} {where}: {second!r} is no shape of the target (it has "
                f"{first_few(target, most=3)}); correct the name, or leave the row out"
            )
        if (first, second) in stated:
            raise InputError(
                f"{path} {where}: {first} and {second} are a pair in {stated[first, second]} too; "
                "keep one row"
            )
        stated[first, second] = where
        if first in row_of:
            matrix[row_of[first], column_of[second]] = weight
        else:
            absent.append(first)
    if not matrix.any():
        raise InputError(
            f"{path}: none of its {pluralize(len(rows), 'row')} names a shape of the source, which "
            f"has {first_few(source, most=3)}; give the table of this source"
        )
    notes = tuple(f"{name}, of {path.name}: is no shape of this source" for name in absent)
    by = dict.fromkeys((first for _, first, _, _ in rows), "table")
    return Transfer(tuple(source), tuple(target), matrix, by, notes)


def write_name_table(path: Path, transfer: Transfer) -> None:
    """Write a transfer as an editable CSV or JSON table."""
    rows = transfer.rows()
    if path.suffix.lower() == ".json":
        text = json_text({"pairs": rows})
    else:
        lines = io.StringIO()
        writer = csv.DictWriter(lines, (*COLUMNS, "by"), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
        text = lines.getvalue()
    write_text(path, text)


def _read_rows(path: Path) -> list[tuple[str, str, str, float]]:
    is_json = path.suffix.lower() == ".json"
    rows = _json_rows(path) if is_json else csv_rows(path, COLUMNS[:2])
    if not rows:
        raise InputError(f"{path}: holds no pair of names; write one with `usdface names --out`")
    return [_checked(path, where, row) for where, row in rows]


def _json_rows(path: Path) -> list[tuple[str, dict[str, object]]]:
    data = read_json(path, LARGEST_NAMES_BYTES)
    listed = data.get("pairs") if isinstance(data, dict) else data
    if not isinstance(listed, list) or not all(isinstance(row, dict) for row in listed):
        raise InputError(
            f"{path}: must hold a list `pairs` of rows with source, target and weight, as `usdface "
            "names --json` prints it"
        )
    return [(f"pairs[{index}]", row) for index, row in enumerate(listed)]


def _checked(path: Path, where: str, row: dict[str, object]) -> tuple[str, str, str, float]:
    source, target = (str(row.get(name) or "").strip() for name in COLUMNS[:2])
    if not source or not target:
        raise InputError(f"{path} {where}: a pair needs a source and a target; complete the row")
    given = row.get("weight")
    try:
        weight = 1.0 if given in (None, "") else float(str(given))
    except ValueError:
        weight = math.nan
    if not abs(weight) <= LARGEST_SHARE:
        raise InputError(
            f"{path} {where}: weight {given!r} of {source} is no number from -{LARGEST_SHARE:g} to "
            f"{LARGEST_SHARE:g}; 1 keeps the weight"
        )
    return where, source, target, weight
