"""Matching of the shapes of two rigs by the meaning of their names, and the resulting linear map.

A motion covers up to four cells: left and right, upper and lower. A target shape takes each of its
cells from the source shape that covers it: a shape of both sides drives its halves in full, and
halves drive a whole together. MetaHuman's raw controls, which are finer than ARKit's shapes, are
matched by Epic's poses, and in the other direction by least squares.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from os.path import commonprefix

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
"""Weights of a least-squares map below this are rounding errors."""


@dataclass(frozen=True)
class NameMatch:
    """An expression of both rigs, matched by name."""

    name: str
    """For messages."""
    source: tuple[tuple[str, float], ...]
    target: tuple[tuple[str, float], ...]
    """`source`, `target`: Shapes and their weights."""


@dataclass(frozen=True)
class NameMatching:
    """Matches of two rigs by name."""

    matches: tuple[NameMatch, ...]
    ambiguous: tuple[str, ...] = ()
    """Unmatched shapes, each with the reason, for messages."""
    by: Mapping[str, str] = field(default_factory=dict)
    """``name`` (equal names) or ``meaning``, by the name of the match."""


@dataclass(frozen=True)
class Transfer:
    """A linear map from the shapes of a source to those of a target."""

    source: tuple[str, ...]
    target: tuple[str, ...]
    matrix: FloatArray
    """(source shapes, target shapes)"""
    by: dict[str, str] = field(default_factory=dict)
    """``name``, ``meaning``, ``deformation`` or ``table``, by source shape."""
    ambiguous: tuple[str, ...] = ()
    """Ambiguous shapes, each with the reason."""

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


def match_names(source: Sequence[str], target: Sequence[str]) -> NameMatching:
    """Match the shapes of two rigs by name, and list ambiguous shapes.

    If one side of a motion is ambiguous, neither side is matched. A prefix of all names of a rig,
    such as `bs_`, is no difference if more names are equal without it, and mean the same with it:
    `L_smile` is not `R_smile`.
    """
    source_meanings, target_meanings = read_meanings(source), read_meanings(target)
    own, other = (
        dict(zip(_without_prefix(names), names, strict=True)) for names in (source, target)
    )
    shared = own.keys() & other.keys()
    if len(shared) > len(set(source).intersection(target)) and all(
        _cells(source_meanings, own[name]) == _cells(target_meanings, other[name])
        for name in shared
    ):
        return _with_names(match_names(list(own), list(other)), own, other)
    same = [name for name in source if name in set(target)]
    excluded: dict[str, str] = {}
    _exclude_duplicates(source_meanings, same, excluded, "the source")
    assigned = _assign_cells(target_meanings, source_meanings, same, excluded)
    by = dict.fromkeys(same, "name")
    unmatched = source_meanings.keys() - by.keys() - excluded.keys()
    sources = {name: each for name, each in source_meanings.items() if name in unmatched}
    targets = {name: cells for name, cells in assigned.items() if name not in by}
    if has_metahuman_controls(source) and not has_metahuman_controls(target):
        reverse = _assign_cells(source_meanings, target_meanings, same, {})
        drivers = {
            name: _driven_shapes(target_meanings[name].cells & cells, reverse, poses=True)
            for name, cells in targets.items()
        }
        found = [NameMatch(name, parts, ((name, 1.0),)) for name, parts in drivers.items() if parts]
    else:
        poses = has_metahuman_controls(target) and not has_metahuman_controls(source)
        driven = {
            name: _driven_shapes(each.cells, targets, poses=poses) for name, each in sources.items()
        }
        found = [NameMatch(name, ((name, 1.0),), parts) for name, parts in driven.items() if parts]
    exact = [NameMatch(name, ((name, 1.0),), ((name, 1.0),)) for name in same]
    order = index_of([*target, *source])
    symmetric = _drop_one_sided([*exact, *found], source_meanings, target_meanings, excluded)
    ordered = sorted(symmetric, key=lambda match: order[match.name])
    by |= {match.name: "meaning" for match in found}
    notes = tuple(
        f"{name}: {reason}"
        for name, reason in excluded.items()
        if len(same) < len(source)  # else all source shapes are matched
        and (
            _shares_cells(name, source_meanings, target_meanings)
            or _shares_cells(name, target_meanings, source_meanings)
        )
    )
    return NameMatching(tuple(ordered), notes, by)


def _cells(meanings: Mapping[str, Meaning], name: str) -> frozenset[Cell]:
    return meanings[name].cells if name in meanings else frozenset()


def _without_prefix(names: Sequence[str]) -> list[str]:
    """Return names without what all have in common up to a separator."""
    common = commonprefix(list(names))  # noqa: RUF071 (names are no paths)
    start = max(common.rfind(separator) for separator in "_.:") + 1
    return [name[start:] for name in names]


def _with_names(
    matching: NameMatching, source: Mapping[str, str], target: Mapping[str, str]
) -> NameMatching:
    """Return a matching with other names of the shapes of its matches."""
    matches = tuple(
        NameMatch(
            match.name,
            tuple((source[name], weight) for name, weight in match.source),
            tuple((target[name], weight) for name, weight in match.target),
        )
        for match in matching.matches
    )
    return replace(matching, matches=matches)


def _shares_cells(name: str, own: Mapping[str, Meaning], others: Mapping[str, Meaning]) -> bool:
    """Whether a shape of the other rig has a cell of this shape."""
    return name in own and any(own[name].cells & each.cells for each in others.values())


def expression_rows(
    expressions: Sequence[Sequence[tuple[str, float]]], names: Sequence[str]
) -> FloatArray:
    """Return the weights of expressions, each of shapes and weights: (expressions, names)."""
    column_of = index_of(names)
    rows = np.zeros((len(expressions), len(names)))
    for row, expression in zip(rows, expressions, strict=True):
        for name, weight in expression:
            row[column_of[name]] = weight
    return rows


def transfer_matrix(
    matches: Iterable[NameMatch], source: Sequence[str], target: Sequence[str]
) -> FloatArray:
    """Return the linear map from the source to the target side of every match.

    Returns (source shapes, target shapes), of least norm; exact if each match has one source shape.
    """
    matches = tuple(matches)
    left = expression_rows([match.source for match in matches], source)
    right = expression_rows([match.target for match in matches], target)
    singles = ((left != 0).sum(axis=1) == 1).all() and ((left != 0).sum(axis=0) <= 1).all()
    if singles and (left.max(axis=1, initial=1.0) == 1.0).all():
        return np.asarray(left.T @ right)
    found = np.linalg.pinv(left) @ right
    return np.where(np.abs(found) < _SMALLEST_WEIGHT, 0.0, found)


def transfer_by_names(
    source: Sequence[str], target: Sequence[str], *, matching: NameMatching | None = None
) -> Transfer:
    """Return the linear map between shapes matched by name."""
    found = match_names(source, target) if matching is None else matching
    matrix = transfer_matrix(found.matches, source, target)
    by = {
        name: found.by.get(match.name, "meaning")
        for match in found.matches
        for name, _ in match.source
    }
    return Transfer(tuple(source), tuple(target), matrix, by, found.ambiguous)


def meaning_notes(transfer: Transfer) -> list[str]:
    """Return notes on shapes matched by meaning, and on ambiguous ones."""
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


def _exclude_duplicates(
    meanings: Mapping[str, Meaning], same: Sequence[str], excluded: dict[str, str], whose: str
) -> None:
    """Exclude shapes of one rig with equal meaning, except one of uniquely lowest rank."""
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
                excluded[name] = f"means the same as {others} of {whose}; neither name is preferred"
            elif name != best[0]:
                excluded[name] = f"{best[0]} of {whose} is used for that motion"


def _assign_cells(
    meanings: Mapping[str, Meaning],
    others: Mapping[str, Meaning],
    same: Sequence[str],
    excluded: dict[str, str],
) -> dict[str, frozenset[Cell]]:
    """Return the cells assigned to each target shape.

    A shape with exactly the cells of a source shape gets all of them. The others are assigned in
    the order of their size, so that a shape of the whole brow gets the cells without a finer shape.
    """
    _exclude_duplicates(meanings, same, excluded, "the target")
    source_cells = {each.cells for each in others.values()}
    assigned = {
        name: meaning.cells
        for name, meaning in meanings.items()
        if name in same or (meaning.cells in source_cells and name not in excluded)
    }
    taken = {cell for cells in assigned.values() for cell in cells}

    def fineness(name: str) -> tuple[int, int, float]:
        cells = meanings[name].cells
        return len({cell[0] for cell in cells}), len(cells), meanings[name].rank

    rest = (name for name in meanings if name not in excluded and name not in assigned)
    for name in sorted(rest, key=fineness):
        free = meanings[name].cells - taken
        if free:
            assigned[name] = frozenset(free)
            taken |= free
        else:
            excluded[name] = "other shapes of the target are used for its motion"
    return assigned


def _driven_shapes(
    cells: frozenset[Cell], targets: Mapping[str, frozenset[Cell]], *, poses: bool
) -> tuple[tuple[str, float], ...]:
    """Return the shapes that some cells drive, each with the driven share of its cells."""
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


def _drop_one_sided(
    found: list[NameMatch],
    source_meanings: Mapping[str, Meaning],
    target_meanings: Mapping[str, Meaning],
    excluded: dict[str, str],
) -> list[NameMatch]:
    """Drop matches of one side if the other side, which both rigs have, is unmatched."""
    meanings = {**target_meanings, **source_meanings}
    cells_of = {name: meaning.cells for name, meaning in meanings.items()}
    source_cells = {each.cells for each in source_meanings.values()}
    target_cells = {each.cells for each in target_meanings.values()}
    matched = {cells_of[match.name] for match in found}
    remaining = []
    for match in found:
        other = mirrored(cells_of[match.name])
        one_sided = other != cells_of[match.name] and other not in matched
        in_both = other in source_cells and all(
            mirrored(target_meanings[name].cells) in target_cells
            for name, _ in match.target
            if name in target_meanings
        )
        if one_sided and in_both:
            excluded[match.name] = "its other side has no counterpart, so neither side is matched"
        else:
            remaining.append(match)
    return remaining
