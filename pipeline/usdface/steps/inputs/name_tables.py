"""Which source shape drives which target shape: by what names mean, or by an edited table."""

import csv
import io
import json
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from usdface.core.arrays import FloatArray, index_of
from usdface.core.errors import InputError
from usdface.core.text import first_few, pluralize, read_json, read_text
from usdface.model.retarget.name_matching import NameMatching, name_matching, transfer_matrix

LARGEST_NAMES_BYTES = 16 << 20
COLUMNS = ("source", "target", "weight")
LARGEST_SHARE = 10.0
"""Of a source's weight that a target takes; beyond it a table holds percent, or a slip."""


@dataclass(frozen=True)
class Transfer:
    """A linear map from the shapes of a source to those of a target."""

    source: tuple[str, ...]
    target: tuple[str, ...]
    matrix: FloatArray
    """(source shapes, target shapes)"""
    by: dict[str, str] = field(default_factory=dict)
    """What a source shape was matched by: ``name``, ``meaning``, ``deformation`` or ``table``."""
    ambiguous: tuple[str, ...] = ()
    """Shapes that could be either of two, each with the reason."""

    @property
    def matched(self) -> tuple[str, ...]:
        """Source shapes that drive something."""
        return tuple(np.array(self.source, object)[(self.matrix != 0).any(axis=1)].tolist())

    @property
    def driven(self) -> tuple[str, ...]:
        """Target shapes that something drives."""
        return tuple(np.array(self.target, object)[(self.matrix != 0).any(axis=0)].tolist())

    def rows(self) -> list[dict[str, object]]:
        """Return the map as rows of a table."""
        return [
            {
                "source": self.source[i],
                "target": self.target[j],
                "weight": float(self.matrix[i, j]),
                "by": self.by.get(self.source[i], "meaning"),
            }
            for i, j in np.argwhere(self.matrix != 0).tolist()
        ]


def meaning_notes(transfer: Transfer) -> list[str]:
    """Return what to tell of shapes that were matched by meaning, or could be either of two."""
    notes = []
    meant = [row for row in transfer.rows() if row["by"] == "meaning"]
    if meant:
        shapes = dict.fromkeys(row["source"] for row in meant)
        notes.append(
            f"matched by the meaning of their names: {pluralize(len(shapes), 'shape')}, such as "
            f"{meant[0]['source']} to {meant[0]['target']}; `usdface names` lists them"
        )
    if transfer.ambiguous:
        notes.append(f"not matched: {first_few(transfer.ambiguous, most=3)}")
    return notes


def check_no_name_twice(path: Path, names: Iterable[str], transfer: Transfer) -> None:
    """Refuse names that differ in capitals and separators alone, where one keeps another out.

    Raises
    ------
    InputError
        With both names.
    """
    spelled: dict[str, str] = {}
    doubtful = {each.partition(": ")[0] for each in transfer.ambiguous}
    for name in names:
        # A double one may be a sign: FACEGOOD's `Scale__X` is the way back of `Scale_X`.
        letters = re.sub(r"(?<![\W_])[\W_](?![\W_])", "", name).lower()
        other = spelled.setdefault(letters, name)
        if other != name and {name, other} & doubtful:
            raise InputError(
                f"{path}: {other} and {name} are one name twice, and which of them is meant cannot "
                "be told; take one out, or pair them with --names"
            )


def transfer_by_names(
    source: Sequence[str], target: Sequence[str], *, matching: NameMatching | None = None
) -> Transfer:
    """Match by what names mean."""
    found = name_matching(source, target) if matching is None else matching
    matrix = transfer_matrix(found.matches, source, target)
    by = {
        name: found.by.get(match.name, "meaning")
        for match in found.matches
        for name, _ in match.source
    }
    return Transfer(tuple(source), tuple(target), matrix, by, found.ambiguous)


def transfer_by_table(path: Path, source: Sequence[str], target: Sequence[str]) -> Transfer:
    """Match as a table says that `usdface names` wrote and somebody edited.

    Raises
    ------
    InputError
        If the file is no such table, names a shape that the target lacks or none that the source
        has, or says two weights of one pair.
    """
    rows = _read_rows(path)
    row_of, column_of = index_of(source), index_of(target)
    matrix = np.zeros((len(source), len(target)))
    stated: dict[tuple[str, str], str] = {}
    absent = []
    for where, theirs, ours, weight in rows:
        if ours not in column_of:
            raise InputError(
                f"{path} {where}: {ours!r} is no shape of the target (it has "
                f"{first_few(target, most=3)}); correct the name, or leave the row out"
            )
        if (theirs, ours) in stated:
            raise InputError(
                f"{path} {where}: {theirs} and {ours} are a pair in {stated[theirs, ours]} too; "
                "keep one row"
            )
        stated[theirs, ours] = where
        if theirs in row_of:
            matrix[row_of[theirs], column_of[ours]] = weight
        else:
            absent.append(theirs)
    if not matrix.any():
        raise InputError(
            f"{path}: none of its {pluralize(len(rows), 'row')} is of a shape of the source, which "
            f"has {first_few(source, most=3)}; is it the table of another source?"
        )
    notes = tuple(f"{name}, of {path.name}: is no shape of this source" for name in absent)
    by = dict.fromkeys((theirs for _, theirs, _, _ in rows), "table")
    return Transfer(tuple(source), tuple(target), matrix, by, notes)


def write_name_table(path: Path, transfer: Transfer) -> None:
    """Write a map as CSV or JSON, to be edited and given back."""
    rows = transfer.rows()
    if path.suffix.lower() == ".json":
        text = json.dumps({"pairs": rows}, indent=2, ensure_ascii=False) + "\n"
    else:
        lines = io.StringIO()
        writer = csv.DictWriter(lines, (*COLUMNS, "by"), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
        text = lines.getvalue()
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from error


def _read_rows(path: Path) -> list[tuple[str, str, str, float]]:
    if path.suffix.lower() == ".json":
        rows = _json_rows(path)
    else:
        text = read_text(path, LARGEST_NAMES_BYTES)
        first = text.partition("\n")[0]
        delimiter = ";" if first.count(";") > first.count(",") else ","
        reader = csv.DictReader(io.StringIO(text), delimiter=delimiter)
        missing = [name for name in COLUMNS[:2] if name not in (reader.fieldnames or ())]
        if missing:
            raise InputError(
                f"{path} line 1: has no `{missing[0]}` column; write `{','.join(COLUMNS)}`, as "
                "`usdface names --out` does"
            )
        rows = [(f"line {reader.line_num}", dict(row)) for row in reader]
    if not rows:
        raise InputError(f"{path}: holds no pair of names")
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
            f"{LARGEST_SHARE:g}; 1 passes a weight on as it is"
        )
    return where, source, target, weight
