"""Read source weights from a take, a performance or a capture, and match them to other shapes.

Names are matched by meaning, or by a table of pairs of shapes, as `usdface names` writes it.
"""

import csv
import io
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from usdface.capture.channel_take import with_stated_rate
from usdface.capture.sniff import read_capture
from usdface.capture.text_table import csv_rows
from usdface.core.arrays import FloatArray, columns_by_name, index_of
from usdface.core.assets import Take
from usdface.core.deformer import Deformer
from usdface.core.errors import InputError
from usdface.core.rates import frames_within, shift_timecode
from usdface.core.replacing import write_text
from usdface.core.sidecars import is_usd_name
from usdface.core.text import first_few, json_text, pluralize, read_json
from usdface.model.retarget.head_pose import is_angle, look_shapes
from usdface.model.retarget.name_matching import Transfer, meaning_notes, transfer_by_names
from usdface.steps.inputs.weight_tables import read_weight_table
from usdface.usdio.performance.exported_weights import has_channels_per_mesh
from usdface.usdio.performance.read import PerformanceReader
from usdface.usdio.rig.read import read_rig
from usdface.usdio.take.read import TakeReader, is_take

_LEAST_GAP_SECONDS = 0.1
"""Shortest gap that is reported, the length of a blink."""

MOVING_WEIGHT = 0.02
"""Weight above which a shape counts as moving."""


@dataclass(frozen=True)
class SourceMotion:
    """Source weights over consecutive frames."""

    names: tuple[str, ...]
    weights: FloatArray
    """(frames, shapes)"""
    first_frame: int
    rate: Fraction
    timecode_start: str = ""
    """SMPTE timecode of the first frame, empty when unknown."""
    emotion: str = ""
    """Of the take, empty when unknown."""
    driven: frozenset[str] = frozenset()
    """Shapes that others drive, on the source's rig or the target's; they need no counterpart."""
    notes: tuple[str, ...] = ()
    """Assumptions of a capture's reader."""
    gaps: tuple[tuple[int, int], ...] = ()
    """First and last frame of gaps of at least `_LEAST_GAP_SECONDS`."""
    rig: tuple[Path, str] | None = None
    """File and SkelRoot of the source's rig, if known."""

    @property
    def last_frame(self) -> int:
        """Frame number of the last row."""
        return self.first_frame + len(self.weights) - 1

    @property
    def free(self) -> tuple[str, ...]:
        """Shapes that no others drive, without rotations of the head and the eyes."""
        return tuple(each for each in self.names if each not in self.driven and not is_angle(each))

    @property
    def moving(self) -> tuple[str, ...]:
        """Free shapes that move."""
        used = np.abs(self.weights).max(axis=0, initial=0.0) > MOVING_WEIGHT
        still = {name for name, each in zip(self.names, used, strict=True) if not each}
        return tuple(name for name in self.free if name not in still)

    @cached_property
    def shares(self) -> dict[str, float]:
        """Share of each moving shape in the face's motion, the largest first; 0 for gaze.

        Mean square of its weight times, if the rig is known, the squared displacement of its
        surface.
        """
        motion = (self.weights**2).mean(axis=0) * self._squared_displacements()
        looks = look_shapes(self.names)
        named = dict(zip(self.names, motion.tolist(), strict=True))
        of_face = {name: 0.0 if name in looks else named[name] for name in self.moving}
        total = sum(of_face.values()) or 1.0
        return {
            name: each / total for name, each in sorted(of_face.items(), key=lambda item: -item[1])
        }

    def _squared_displacements(self) -> FloatArray:
        """Return those of the rig's surface, summed over points, by each shape; 1 without a rig."""
        if self.rig is None or not self.rig[0].is_file():
            return np.ones(len(self.names))
        rig = read_rig(self.rig[0], prim=self.rig[1])
        offsets = Deformer(rig).shapes.target_offsets()
        squares = np.asarray(offsets.multiply(offsets).sum(axis=1)).reshape(1, -1)
        return columns_by_name(squares, rig.shapes, self.names)[0]


def read_source_motion(
    path: Path, frames: tuple[int, int] | None = None, **stated: Any
) -> SourceMotion:
    """Read the weights of a take, of a performance with its edits, or of a capture file.

    `**stated`: options of a capture file, or None: fields of `CaptureOptions`.
    """
    stated = {name: value for name, value in stated.items() if value is not None}
    is_layer = is_usd_name(path)
    capture = None if is_layer else read_capture(path, **stated)
    if capture is not None and capture.format != "weights" and "rate" in stated:
        capture = with_stated_rate(capture, stated.pop("rate"), where=path)
    if stated and (capture is None or capture.format != "weights"):
        option = next(iter(stated)).replace("_", "-")
        raise InputError(
            f"{path}: --{option} is for tables of weights, and this file states it; leave it out"
        )
    if capture is not None:
        take = capture.take
        first, last = frames_within(path, frames, take.first_frame, take.last_frame)
        start = shift_timecode(take.timecode_start, first - take.first_frame, take.rate)
        motion = _of_take(path, replace(take, timecode_start=start), first, last)
        return replace(motion, notes=capture.notes)
    if is_take(path):
        reader = TakeReader(path)
        first, last = reader.frames_within(frames)
        return _of_take(path, reader.read(first, last), first, last)
    performance = PerformanceReader(path)
    first, last = frames_within(path, frames, performance.first_frame, performance.last_frame)
    if has_channels_per_mesh(path):
        table = read_weight_table(path)
        rows = slice(first - performance.first_frame, last + 1 - performance.first_frame)
        start = performance.timecode_at(first)
        return SourceMotion(table.names, table.weights[rows], first, performance.rate, start)
    return SourceMotion(
        names=performance.names,
        weights=performance.edited(first, last).astype(np.float64),
        first_frame=first,
        rate=performance.rate,
        timecode_start=performance.timecode_at(first),
        driven=frozenset(each.shape for each in performance.combinations),
        gaps=_gaps(performance.header.gaps, first, last, performance.rate),
        rig=_rig_of(performance),
    )


_BY_TABLE = (
    "write a table of pairs with `usdface names RIG SOURCE --out FILE.csv`, edit it and give it "
    "with --names",
    "pair them with --names, or leave them out",
)
_BY_PAIRS = (
    "give a performance of the source of these pairs or sequences",
    "add pairs or sequences with them, or leave them out",
)
"""`_BY_TABLE`, `_BY_PAIRS`: remedies if no shape has a counterpart, and if some have none."""


def source_transfer(
    path: Path,
    motion: SourceMotion,
    wanted: tuple[str, ...],
    names: Path | None = None,
    *,
    remedies: tuple[str, str] = _BY_TABLE,
) -> tuple[Transfer, tuple[str, ...]]:
    """Return the transfer from a motion's shapes to others, and notes.

    Equal names are matched first, the others by meaning: Live Link's ``EyeBlinkLeft`` drives a
    rig's ``eyeBlink_L``.

    `names`: table of pairs to use instead.
    """
    if names is None:
        transfer = transfer_by_names(motion.names, wanted)
        check_no_name_twice(path, motion.moving, transfer)
    else:
        transfer = transfer_by_table(names, motion.names, wanted)
    matched, moving = set(transfer.matched), motion.moving
    if not matched or (moving and not matched & set(moving)):
        unmatched = moving if matched else motion.names
        what = pluralize(len(unmatched), "moving shape" if matched else "shape")
        raise InputError(
            f"{path}: none of its {what} ({first_few(unmatched, most=3)}) "
            f"has a counterpart among {first_few(wanted, most=3)}, so nothing would move; "
            + remedies[0]
            + "".join(f". {note}" for note in meaning_notes(transfer))
        )
    notes = meaning_notes(transfer)
    unmatched = unmatched_moving(transfer, motion)
    if unmatched:
        share = sum(motion.shares[name] for name in unmatched)
        of_motion = f" ({share:.0%} of the motion)" if share >= 0.01 else ""
        notes.append(
            f"{path.name}: no counterpart for {pluralize(len(unmatched), 'moving shape')}"
            f"{of_motion}: {first_few(unmatched)}; {remedies[1]}"
        )
    return transfer, tuple(notes)


def source_columns(
    path: Path, motion: SourceMotion, wanted: tuple[str, ...]
) -> tuple[FloatArray, tuple[str, ...]]:
    """Return a motion's weights in the order of other names, as `source_transfer` matches them."""
    transfer, notes = source_transfer(path, motion, wanted, None, remedies=_BY_PAIRS)
    return motion.weights @ transfer.matrix, notes


def unmatched_moving(transfer: Transfer, motion: SourceMotion) -> tuple[str, ...]:
    """Return moving shapes without a counterpart, the largest motion first."""
    unmatched = set(motion.moving) - set(transfer.matched)
    return tuple(name for name in motion.shares if name in unmatched) if unmatched else ()


def _rig_of(performance: PerformanceReader) -> tuple[Path, str] | None:
    try:
        return performance.rig()
    except InputError:  # no rig, or its file is missing
        return None


def _of_take(path: Path, take: Take, first: int, last: int) -> SourceMotion:
    if take.source is None:
        raise InputError(
            f"{path}: the take has no blendshape weights; map it with `usdface map` and retarget "
            "the performance"
        )
    start = first - take.source.first_frame
    return SourceMotion(
        names=take.source.names,
        weights=take.source.values[start : start + last - first + 1].astype(np.float64),
        first_frame=first,
        rate=take.rate,
        timecode_start=take.timecode_start,
        emotion=take.emotion,
        gaps=_gaps(take.source.gaps, first, last, take.rate),
    )


def _gaps(
    stretches: tuple[tuple[int, int], ...], first: int, last: int, rate: Fraction
) -> tuple[tuple[int, int], ...]:
    """Return the parts between two frames of the frame ranges that are long enough to report."""
    least = _LEAST_GAP_SECONDS * rate
    long = (each for each in stretches if each[1] - each[0] + 1 >= least)
    within = ((max(start, first), min(end, last)) for start, end in long)
    return tuple((start, end) for start, end in within if start <= end)


LARGEST_NAMES_BYTES = 16 << 20
COLUMNS = ("source", "target", "weight")
_LARGEST_WEIGHT = 10.0
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


_FORMULA, _QUOTED = re.compile("^(?=[-=+@])"), re.compile("^'(?=[-=+@])")
"""Start of a name that a spreadsheet would evaluate, and of one that is quoted against it."""


def write_name_table(path: Path, transfer: Transfer) -> None:
    """Write a transfer as an editable CSV or JSON table."""
    rows = transfer.rows()
    if path.suffix.lower() == ".json":
        text = json_text({"pairs": rows})
    else:
        lines = io.StringIO()
        writer = csv.DictWriter(lines, (*COLUMNS, "by"), lineterminator="\n")
        writer.writeheader()
        for row in rows:
            names = {key: _FORMULA.sub("'", str(row[key])) for key in COLUMNS[:2]}
            writer.writerow({**row, **names})
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
    source, target = (_QUOTED.sub("", str(row.get(name) or "").strip()) for name in COLUMNS[:2])
    if not source or not target:
        raise InputError(f"{path} {where}: a pair needs a source and a target; complete the row")
    given = row.get("weight")
    try:
        weight = 1.0 if given in (None, "") else float(str(given))
    except ValueError:
        weight = math.nan
    if not abs(weight) <= _LARGEST_WEIGHT:
        raise InputError(
            f"{path} {where}: weight {given!r} of {source} is no number from "
            f"-{_LARGEST_WEIGHT:g} to {_LARGEST_WEIGHT:g}; 1 keeps the weight"
        )
    return where, source, target, weight
