"""Shapes of two rigs matched by what their names mean, and the linear map that follows.

A motion lies on four cells: left and right, upper and lower. A shape takes each target cell from
the source shape that has it, so that a whole drives its halves in full, and halves drive a whole
together. MetaHuman's raw controls are more than ARKit's shapes; they are matched by Epic's poses,
and back by least squares.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from usdface.core.arrays import FloatArray, index_of
from usdface.core.text import first_few, pluralize
from usdface.model.retarget.shape_names import (
    Cell,
    Meaning,
    has_metahuman_controls,
    mirrored,
    read_meanings,
)
from usdface.model.retarget.shape_vocabulary import METAHUMAN_POSES, ROWS

_SMALLEST_WEIGHT = 1e-9
"""Of a least-squares map: below is rounding."""


@dataclass(frozen=True)
class NameMatch:
    """An expression that both rigs have by name."""

    name: str
    """For people."""
    source: tuple[tuple[str, float], ...]
    target: tuple[tuple[str, float], ...]
    """`source`, `target`: Shapes and their weights."""


@dataclass(frozen=True)
class NameMatching:
    """What names tell of two rigs."""

    matches: tuple[NameMatch, ...]
    ambiguous: tuple[str, ...] = ()
    """Shapes that are left out, each with the reason, for people."""
    by: Mapping[str, str] = field(default_factory=dict)
    """Of each match by its name: ``name``, if the names are the same, or ``meaning``."""


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


def match_names(source: Sequence[str], target: Sequence[str]) -> tuple[NameMatch, ...]:
    """Return the expressions that both rigs have, one pair for each source shape that matches."""
    return name_matching(source, target).matches


def name_matching(source: Sequence[str], target: Sequence[str]) -> NameMatching:
    """Match the shapes of two rigs by name, and name those that could be either of two.

    The left and the right of a motion are matched alike: where one of them is ambiguous, neither
    is matched.
    """
    same = [name for name in source if name in set(target)]
    left, right = read_meanings(source), read_meanings(target)
    doubts: dict[str, str] = {}
    _settle(left, same, doubts, "the source")
    claimed = _claim(right, left, same, doubts)
    by = dict.fromkeys(same, "name")
    here = {name: each for name, each in left.items() if name not in by and name not in doubts}
    there = {name: cells for name, cells in claimed.items() if name not in by}
    if has_metahuman_controls(source) and not has_metahuman_controls(target):
        reverse = _claim(left, right, same, {})
        pulled = {
            name: _partners(right[name].cells & cells, reverse, poses=True)
            for name, cells in there.items()
        }
        found = [NameMatch(name, parts, ((name, 1.0),)) for name, parts in pulled.items() if parts]
    else:
        poses = has_metahuman_controls(target) and not has_metahuman_controls(source)
        pushed = {name: _partners(each.cells, there, poses=poses) for name, each in here.items()}
        found = [NameMatch(name, ((name, 1.0),), parts) for name, parts in pushed.items() if parts]
    exact = [NameMatch(name, ((name, 1.0),), ((name, 1.0),)) for name in same]
    place = index_of([*target, *source])
    alike = _alike([*exact, *found], left, right, doubts)
    ordered = sorted(alike, key=lambda match: place[match.name])
    by |= {match.name: "meaning" for match in found}
    notes = tuple(
        f"{name}: {reason}"
        for name, reason in doubts.items()
        if len(same) < len(source)  # else nothing is left that could drive them
        and (_concerns(name, left, right) or _concerns(name, right, left))
    )
    return NameMatching(tuple(ordered), notes, by)


def _concerns(name: str, own: Mapping[str, Meaning], others: Mapping[str, Meaning]) -> bool:
    """Whether the other rig has a part of what a shape does."""
    return name in own and any(own[name].cells & each.cells for each in others.values())


def transfer_matrix(
    matches: Iterable[NameMatch], source: Sequence[str], target: Sequence[str]
) -> FloatArray:
    """Return the linear map that takes the source side of every match to its target side.

    Returns
    -------
    (source shapes, target shapes) float array
        Of least norm. Matches of one source shape each are taken as they are, to the last bit.
    """
    matches = tuple(matches)
    row_of, column_of = index_of(source), index_of(target)
    left = np.zeros((len(matches), len(source)))
    right = np.zeros((len(matches), len(target)))
    for row, match in enumerate(matches):
        for name, weight in match.source:
            left[row, row_of[name]] = weight
        for name, weight in match.target:
            right[row, column_of[name]] = weight
    singles = ((left != 0).sum(axis=1) == 1).all() and ((left != 0).sum(axis=0) <= 1).all()
    if singles and (left.max(axis=1, initial=1.0) == 1.0).all():
        return np.asarray(left.T @ right)
    found = np.linalg.pinv(left) @ right
    return np.where(np.abs(found) < _SMALLEST_WEIGHT, 0.0, found)


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


def _settle(
    meanings: Mapping[str, Meaning], same: Sequence[str], doubts: dict[str, str], whose: str
) -> None:
    """Find shapes of one rig that mean exactly the same; the best known counts, or none."""
    groups: dict[frozenset[Cell], list[str]] = {}
    for name, meaning in meanings.items():
        groups.setdefault(meaning.cells, []).append(name)
    for names in groups.values():
        if len(names) < 2:
            continue
        ranks = [-1.0 if name in same else meanings[name].rank for name in names]
        best = [name for name, rank in zip(names, ranks, strict=True) if rank == min(ranks)]
        for name in names:
            if name in same:
                continue
            if len(best) > 1:
                others = ", ".join(each for each in names if each != name)
                doubts[name] = (
                    f"means the same as {others} of {whose}; which of them is told by none"
                )
            elif name != best[0]:
                doubts[name] = f"{best[0]} of {whose} is taken for that motion"


def _claim(
    meanings: Mapping[str, Meaning],
    others: Mapping[str, Meaning],
    same: Sequence[str],
    doubts: dict[str, str],
) -> dict[str, frozenset[Cell]]:
    """Return the cells that each shape of a target takes.

    A shape that does just what one of the others does takes all of its cells. Of the rest the
    finest come first: a shape of the whole brow keeps what none of its parts has a shape for.
    """
    _settle(meanings, same, doubts, "the target")
    wanted = {each.cells for each in others.values()}
    claimed = {
        name: meaning.cells
        for name, meaning in meanings.items()
        if name in same or (meaning.cells in wanted and name not in doubts)
    }
    taken = {cell for cells in claimed.values() for cell in cells}

    def fineness(name: str) -> tuple[int, int, float]:
        cells = meanings[name].cells
        return len({cell[0] for cell in cells}), len(cells), meanings[name].rank

    rest = (name for name in meanings if name not in doubts and name not in claimed)
    for name in sorted(rest, key=fineness):
        free = meanings[name].cells - taken
        if free:
            claimed[name] = frozenset(free)
            taken |= free
        else:
            doubts[name] = "other shapes of the target are taken for all that it does"
    return claimed


def _partners(
    cells: frozenset[Cell], targets: Mapping[str, frozenset[Cell]], *, poses: bool
) -> tuple[tuple[str, float], ...]:
    """Return the shapes that follow some cells, each with the share of its own cells."""
    weights: dict[Cell, float] = dict.fromkeys(cells, 1.0)
    for motion, control, weight in METAHUMAN_POSES if poses else ():
        of, _, row = motion.partition("/")
        to, _, to_row = control.partition("/")
        for each, side, own_row in cells:
            if each != of or (row and own_row != ROWS[row]):
                continue
            cell = (to, side, ROWS[to_row] if to_row else own_row)
            weights[cell] = weight if cell in cells else weights.get(cell, 0.0) + weight
    found = []
    for name, own in targets.items():
        share = sum(weights.get(cell, 0.0) for cell in own) / len(own)
        if share:
            found.append((name, share))
    return tuple(found)


def _alike(
    found: list[NameMatch],
    left: Mapping[str, Meaning],
    right: Mapping[str, Meaning],
    doubts: dict[str, str],
) -> list[NameMatch]:
    """Drop matches of one side whose other side, though both rigs have it, has none."""
    meaning_of = {**right, **left}
    here = {each.cells for each in left.values()}
    there = {each.cells for each in right.values()}
    matched = {meaning_of[match.name].cells for match in found}
    kept = []
    for match in found:
        other = mirrored(meaning_of[match.name].cells)
        lonely = other != meaning_of[match.name].cells and other not in matched
        sides = all(
            mirrored(right[name].cells) in there for name, _ in match.target if name in right
        )
        if lonely and other in here and sides:
            doubts[match.name] = "its other side has no counterpart, so neither side is matched"
        else:
            kept.append(match)
    return kept
