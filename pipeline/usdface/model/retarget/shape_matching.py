"""Matching of the shapes of two rigs by deformation.

The similarity of two shapes is the cosine between their fields of displacements over corresponding
points of the faces.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from usdface.core.arrays import FloatArray, IntArray
from usdface.core.assets import Rig
from usdface.core.deformer import Deformer
from usdface.model.placement.shape_parts import shape_parts
from usdface.model.retarget.face_correspondence import correspond, unit_fields
from usdface.model.retarget.shape_names import mirrored, read_meanings
from usdface.numerics.measure.face_regions import gaze_shapes, mirrored_shapes, region_of_shape

_UPPER_FACE, _LOWER_FACE = ("brows", "lids"), ("mouth", "jaw")
"""Regions of which a shape of one is not matched with a shape of the other."""

_LEAST_SIMILARITY = 0.5
"""Cosine below which two shapes are not matched."""

_ONE_SIDE_SIMILARITY = 0.75
"""The same between a shape of one side and one without a side: above sqrt(1/2), the similarity of a
motion of both sides with its half."""


@dataclass(frozen=True)
class ShapeMatch:
    """Two shapes with similar displacements."""

    source: str
    target: str
    similarity: float
    """Cosine between their displacements, at most 1."""
    share: float = 1.0
    """Factor from the source's to the target's weight."""


def match_deformations(
    source: Rig, target: Rig, *, source_shapes: tuple[str, ...], target_shapes: tuple[str, ...]
) -> tuple[ShapeMatch, ...]:
    """Match shapes by similarity, each at most once; the best match first.

    Both sides of a motion, if known from names, are matched alike or not at all. Shapes of gaze are
    matched with each other only, since lids that follow the gaze resemble a blink; those of the
    upper face not with those of the lower.
    """
    if not (source_shapes and target_shapes):
        return ()
    fields = correspond(source, target)
    rows = [source.shapes.index(name) for name in source_shapes]
    columns = [target.shapes.index(name) for name in target_shapes]
    likeness = fields.similarity()[np.ix_(rows, columns)]
    units = _units(source_shapes), _units(target_shapes)
    in_common = _halves(source)[rows][:, None] & _halves(target)[columns]
    likeness = np.where(in_common > 0, likeness, -1.0)
    found = _assign_units(likeness, *units)
    foreign = [
        np.array([not each.understood for each in read_meanings(names).values()])
        for names in (source_shapes, target_shapes)
    ]
    single = np.where(foreign[0][:, None] | foreign[1], likeness, -1.0)
    sided = _sided_units(source_shapes), _sided_units(target_shapes)
    found += _assign_units(single, *_unmatched(found, *sided))
    found += _assign_one_sides(single, *_unmatched(found, *sided))
    found = _with_other_halves(
        found,
        single,
        _mirrored_fields(fields.source[rows], fields.mirror),
        _mirrored_fields(fields.target[columns], fields.mirror),
    )
    matches = (
        ShapeMatch(source_shapes[row], target_shapes[column], float(likeness[row, column]), share)
        for row, column, share in found
    )
    return tuple(sorted(matches, key=lambda each: (-each.similarity, each.source, each.target)))


_Unit = tuple[int, ...]
"""Index of a shape of both sides; or indices of the left and right shape of a motion."""


def _units(names: tuple[str, ...]) -> list[_Unit]:
    """Return units of shapes with understood names."""
    meanings = read_meanings(names)
    place = {(meanings[n].cells, meanings[n].rank): index for index, n in enumerate(names)}
    found: list[_Unit] = []
    for index, name in enumerate(names):
        meaning = meanings[name]
        other = place.get((mirrored(meaning.cells), meaning.rank), -1)
        if not meaning.understood:
            continue
        if mirrored(meaning.cells) == meaning.cells:
            found.append((index,))
        elif other >= 0 and (meaning.side == "L" or meaning.motion.endswith("left")):
            found.append((index, other))
    return found


def _sided_units(names: tuple[str, ...]) -> list[_Unit]:
    """Return units of shapes whose names mirror each other."""
    return [
        (index,) if other == index else (index, other)
        for index, other in enumerate(mirrored_shapes(names).tolist())
        if other >= index
    ]


def _unmatched(
    found: list[tuple[int, int, float]], sources: list[_Unit], targets: list[_Unit]
) -> tuple[list[_Unit], list[_Unit]]:
    """Return units without the matched shapes."""
    rows, columns = {row for row, _, _ in found}, {column for _, column, _ in found}
    remaining = (
        [tuple(index for index in unit if index not in matched) for unit in units]
        for units, matched in ((sources, rows), (targets, columns))
    )
    source_units, target_units = (list(filter(None, units)) for units in remaining)
    return source_units, target_units


def _assign_one_sides(
    likeness: FloatArray, sources: list[_Unit], targets: list[_Unit]
) -> list[tuple[int, int, float]]:
    """Match shapes without a mirror image with one side of a motion."""
    rows, columns = [row for unit in sources for row in unit], [c for unit in targets for c in unit]
    if not (rows and columns):
        return []
    mirrored_pair = [
        np.array([len(unit) > 1 for unit in units for _ in unit]) for units in (sources, targets)
    ]
    scores = np.where(
        mirrored_pair[0][:, None] != mirrored_pair[1], likeness[np.ix_(rows, columns)], -1.0
    )
    # Where the names of one rig tell no sides, as numbers, each of its shapes may be of one side.
    sided = all(any(each) for each in mirrored_pair)
    least = _ONE_SIDE_SIMILARITY if sided else _LEAST_SIMILARITY
    return [
        (rows[i], columns[j], 1.0)
        for i, j in zip(*map(np.ndarray.tolist, linear_sum_assignment(-scores)), strict=True)
        if scores[i, j] >= least
    ]


def _with_other_halves(
    found: list[tuple[int, int, float]],
    likeness: FloatArray,
    source_mirror: IntArray,
    target_mirror: IntArray,
) -> list[tuple[int, int, float]]:
    """Add the other side of shapes of which one side is matched with a motion of both.

    The mirrors are the shape that moves as the mirror image of each, so that names need tell no
    sides; a shape that moves both sides is its own.
    """
    rows, columns = {row for row, _, _ in found}, {column for _, column, _ in found}
    out = []
    for row, column, share in found:
        other = int(source_mirror[row]), int(target_mirror[column])
        halves = other[0] != row, other[1] != column
        free = other[0] not in rows if halves[0] else other[1] not in columns
        if halves[0] != halves[1] and free and likeness[other] >= _LEAST_SIMILARITY:
            share = 0.5 if halves[0] else 1.0
            out.append((*other, share))
        out.append((row, column, share))
    return out


def _mirrored_fields(fields: FloatArray, mirror: IntArray) -> IntArray:
    """Return the shape that moves as the mirror image of each, the shape itself if none does."""
    likeness = unit_fields(fields[:, mirror] * [-1, 1, 1]) @ unit_fields(fields).T
    likeness = np.minimum(likeness, likeness.T)
    best, own = likeness.argmax(axis=1), np.arange(len(fields))
    mutual = (best[best] == own) & (likeness[own, best] >= _LEAST_SIMILARITY)
    return np.asarray(np.where(mutual, best, own))


_UPPER, _LOWER, _GAZE = 1, 2, 4


def _halves(rig: Rig) -> IntArray:
    """Return the halves of the face that each shape may move, as a sum, or gaze."""
    parts = shape_parts(rig, Deformer(rig))
    regions = [region_of_shape(part) for part in parts]
    halves = np.select(
        [np.isin(regions, _UPPER_FACE), np.isin(regions, _LOWER_FACE)],
        [_UPPER, _LOWER],
        _UPPER + _LOWER,
    )
    halves[gaze_shapes(parts)] = _GAZE
    return halves


def differing_sides(
    driven: Mapping[str, Collection[str]], source: Sequence[str], target: Sequence[str]
) -> list[str]:
    """List the matches whose left and right sides differ.

    Parameters
    ----------
    driven : mapping of str to collection of str
        Driven target shapes of each matched source shape.
    source, target : sequence of str
        All shapes of both rigs, with the other sides by name. If no name of a rig has another side,
        as with numbers, its sides are not compared; the number of driven shapes still is.
    """
    source_mirror, target_mirror = (
        {name: names[other] for name, other in zip(names, mirrored_shapes(names), strict=True)}
        for names in (source, target)
    )
    source_sided, target_sided = (
        any(name != other for name, other in mirror.items())
        for mirror in (source_mirror, target_mirror)
    )
    lines = []
    for index, name in enumerate(source):
        other = source_mirror[name]
        targets, other_targets = set(driven.get(name, ())), set(driven.get(other, ()))
        if target_sided and source_sided:
            alike = {target_mirror[n] for n in targets} == other_targets
        else:
            alike = len(targets) == len(other_targets)
        if index > source.index(other) or alike:
            continue
        pair = [name] if other == name else [name, other]
        parts = (f"{n} -> {', '.join(sorted(driven.get(n, ()))) or 'nothing'}" for n in pair)
        lines.append("; ".join(parts))
    return lines


def _assign_units(
    likeness: FloatArray, sources: list[_Unit], targets: list[_Unit]
) -> list[tuple[int, int, float]]:
    """Match units; return source and target index and the factor of each pair of shapes.

    Two sides drive a shape of both by half each, and are driven by it in full. Both must be similar
    to it: a shape of one side is no counterpart of the other.
    """
    if not (sources and targets):
        return []

    def parts(source: _Unit, target: _Unit) -> list[tuple[int, int]]:
        count = max(len(source), len(target))
        ways = [
            [(source[k % len(source)], way[k % len(way)]) for k in range(count)]
            for way in (target, target[::-1])
        ]
        return max(ways, key=lambda way: sum(likeness[pair] for pair in way))

    def score(source: _Unit, target: _Unit) -> float:
        of_parts = [likeness[pair] for pair in parts(source, target)]
        return float(np.mean(of_parts) if len(source) == len(target) else min(of_parts))

    scores = np.array([[score(s, t) for t in targets] for s in sources])
    found = []
    explained = scores * np.abs(scores)  # a cosine's square is the share of the motion
    for i, j in zip(*map(np.ndarray.tolist, linear_sum_assignment(-explained)), strict=True):
        if scores[i, j] >= _LEAST_SIMILARITY:
            share = 0.5 if len(sources[i]) > len(targets[j]) else 1.0
            found += [(row, column, share) for row, column in parts(sources[i], targets[j])]
    return found
