"""Shapes of two rigs matched by what they do: the same motion at the same place of the face.

The outer surfaces are laid onto each other (rotation, translation, one scale per axis), so that
meshes may differ in topology, size and proportions. Then every shape is a field of displacements
over the same samples, and two shapes are alike as the cosine between their fields.

The same correspondence gives the method that S11 (section 6.3) compares with: *position matching*,
non-negative weights of the target whose displacements are nearest to the source's.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial import KDTree

from usdface.core.arrays import BoolArray, FloatArray
from usdface.core.assets import Rig
from usdface.core.deformer import Deformer
from usdface.core.errors import InputError
from usdface.model.placement.shape_parts import shape_parts
from usdface.model.retarget.shape_names import mirrored, read_meanings
from usdface.numerics.measure.face_regions import gaze_shapes, mirrored_shapes
from usdface.numerics.registration.cloud_alignment import Alignment, align_cloud
from usdface.numerics.registration.face_skin import (
    SurfaceSamples,
    facing_direction,
    sample_outer_surface,
)
from usdface.numerics.solve.bounded_least_squares import solve_bounded_least_squares

CLOUD_POINTS = 400
"""Points of the source that are laid onto the target; few, for each is sought in every start."""

_SAMPLE_COUNT = 1500
"""Places where both faces are compared."""

_LEAST_SIMILARITY = 0.5
"""Cosine below which two shapes are not proposed as the same."""

_ONE_SIDE_SIMILARITY = 0.75
"""The same for a shape without a mirror image and one side of a motion: half of a motion of both
sides is like the whole by sqrt(1/2), and is not it."""

RIDGE_SHARE = 1e-3
"""Ridge of position matching, as a share of the mean square of the displacements."""


@dataclass(frozen=True)
class Correspondence:
    """What the shapes of two rigs do at the same places of the face."""

    source: FloatArray
    target: FloatArray
    """`source`, `target`: (shapes, samples, 3): displacements at weight 1, the source's in the
    target's space and proportions [mm]."""
    residual_mm: float
    """How far the surfaces lie apart once aligned."""

    def similarity(self) -> FloatArray:
        """Return the cosine between every source and every target shape: (ns, nt)."""
        return np.asarray(_unit(self.source) @ _unit(self.target).T)


@dataclass(frozen=True)
class ShapeMatch:
    """Two shapes that move the face alike."""

    source: str
    target: str
    similarity: float
    """Cosine between their displacements, at most 1."""
    share: float = 1.0
    """Of the source's weight that the target takes."""


def correspond(source: Rig, target: Rig) -> Correspondence:
    """Lay the source's face onto the target's.

    Each is laid onto the other, and the better of the two counts: which one is called the source
    then makes no difference to where they meet.

    Raises
    ------
    InputError
        If one of them has no recognisable face, or no alignment is upright.
    """
    one, other = _surface(source), _surface(target)
    with _no_face(f"{source.file} on {target.file}"):
        forth, forth_error = _laid_onto(one, other)
        back, back_error = _laid_onto(other, one)
    by_inverse = back_error < forth_error
    place = back.undo if by_inverse else forth.apply
    move = back.undo_motion if by_inverse else forth.apply_to_motion
    stride = max(len(one.samples.positions) // _SAMPLE_COUNT, 1)
    chosen = np.arange(0, len(one.samples.positions), stride)
    _, nearest = KDTree(other.samples.positions).query(place(one.samples.positions[chosen]))
    return Correspondence(
        source=move(one.deltas[:, chosen]),
        target=other.deltas[:, np.asarray(nearest, np.int64)],
        residual_mm=min(forth_error, back_error) * other.size_mm,
    )


def _laid_onto(one: "_Surface", other: "_Surface") -> tuple[Alignment, float]:
    """Return how one face lies on another, and its residual as a share of the other's size."""
    stride = max(len(one.samples.positions) // CLOUD_POINTS, 1)
    found = align_cloud(
        one.samples.positions[::stride],
        other.samples.positions,
        activity=other.activity,
        areas=other.samples.areas,
        amplitude=one.activity[::stride],
    )
    return found, found.residual_mm / other.size_mm


def match_deformations(
    source: Rig, target: Rig, *, source_shapes: tuple[str, ...], target_shapes: tuple[str, ...]
) -> tuple[ShapeMatch, ...]:
    """Return the shapes that move the faces most alike, each in one match at most, best first.

    Where names say which shapes mirror each other, both sides are matched alike, or neither. What
    turns an eye is matched with what turns an eye alone, since lids that follow look like a blink.
    """
    if not (source_shapes and target_shapes):
        return ()
    both = correspond(source, target)
    rows = [source.shapes.index(name) for name in source_shapes]
    columns = [target.shapes.index(name) for name in target_shapes]
    likeness = both.similarity()[np.ix_(rows, columns)]
    units = _units(source_shapes), _units(target_shapes)
    turns = [_turns_an_eye(rig)[at] for rig, at in ((source, rows), (target, columns))]
    likeness = np.where(turns[0][:, None] == turns[1], likeness, -1.0)
    found = _assign_units(likeness, *units)
    foreign = [~_understood(names) for names in (source_shapes, target_shapes)]
    single = np.where(foreign[0][:, None] | foreign[1], likeness, -1.0)
    sided = _sided_units(source_shapes), _sided_units(target_shapes)
    found += _assign_units(single, *_unmatched(found, *sided))
    found += _assign_one_sides(single, *_unmatched(found, *sided))
    matches = (
        ShapeMatch(source_shapes[row], target_shapes[column], float(likeness[row, column]), share)
        for row, column, share in found
    )
    return tuple(sorted(matches, key=lambda each: (-each.similarity, each.source, each.target)))


_Unit = tuple[int, ...]
"""Places of a shape of the middle or of both sides; or of the left and the right of a motion."""


def _units(names: tuple[str, ...]) -> list[_Unit]:
    """Return the shapes whose names are understood, both sides of a motion as one unit."""
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
    """Return shapes as units, those whose names mirror each other together."""
    return [
        (index,) if other == index else (index, other)
        for index, other in enumerate(mirrored_shapes(names).tolist())
        if other >= index
    ]


def _unmatched(
    found: list[tuple[int, int, float]], sources: list[_Unit], targets: list[_Unit]
) -> tuple[list[_Unit], list[_Unit]]:
    """Return what is left of units."""
    rows, columns = {row for row, _, _ in found}, {column for _, column, _ in found}
    left, right = (
        [tuple(place for place in unit if place not in used) for unit in units]
        for units, used in ((sources, rows), (targets, columns))
    )
    return list(filter(None, left)), list(filter(None, right))


def _assign_one_sides(
    likeness: FloatArray, sources: list[_Unit], targets: list[_Unit]
) -> list[tuple[int, int, float]]:
    """Return shapes without a mirror image and the one side of a motion that each is like."""
    rows, columns = [row for unit in sources for row in unit], [c for unit in targets for c in unit]
    if not (rows and columns):
        return []
    of_two = [
        np.array([len(unit) > 1 for unit in units for _ in unit]) for units in (sources, targets)
    ]
    scores = np.where(of_two[0][:, None] != of_two[1], likeness[np.ix_(rows, columns)], -1.0)
    return [
        (rows[i], columns[j], 1.0)
        for i, j in zip(*map(np.ndarray.tolist, linear_sum_assignment(-scores)), strict=True)
        if scores[i, j] >= _ONE_SIDE_SIMILARITY
    ]


def _turns_an_eye(rig: Rig) -> BoolArray:
    turns = np.zeros(len(rig.shapes), dtype=np.bool_)
    turns[gaze_shapes(shape_parts(rig, Deformer(rig)))] = True
    return turns


def differing_sides(
    driven: Mapping[str, Collection[str]], source: Sequence[str], target: Sequence[str]
) -> list[str]:
    """Say of which matches the left and the right are not alike.

    Parameters
    ----------
    driven : mapping of str to collection of str
        Shapes of the target that each matched shape of the source drives.
    source, target : sequence of str
        All shapes of both, among which names tell the other side.
    """
    here, there = (
        {name: names[other] for name, other in zip(names, mirrored_shapes(names), strict=True)}
        for names in (source, target)
    )
    found = []
    for index, name in enumerate(source):
        other = here[name]
        one, two = set(driven.get(name, ())), set(driven.get(other, ()))
        if index > source.index(other) or {there[each] for each in one} == two:
            continue
        pair = [name] if other == name else [name, other]
        said = (f"{n} -> {', '.join(sorted(driven.get(n, ()))) or 'nothing'}" for n in pair)
        found.append("; ".join(said))
    return found


def _understood(names: tuple[str, ...]) -> BoolArray:
    meanings = read_meanings(names)
    return np.array([meanings[name].understood for name in names], dtype=np.bool_)


def _assign_units(
    likeness: FloatArray, sources: list[_Unit], targets: list[_Unit]
) -> list[tuple[int, int, float]]:
    """Return pairs of shapes and the share that passes, both sides of a motion alike.

    Halves drive a whole by half each, a whole drives its halves in full.
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

    scores = np.array(
        [[np.mean([likeness[pair] for pair in parts(s, t)]) for t in targets] for s in sources]
    )
    found = []
    for i, j in zip(*map(np.ndarray.tolist, linear_sum_assignment(-scores)), strict=True):
        if scores[i, j] >= _LEAST_SIMILARITY:
            share = 0.5 if len(sources[i]) > len(targets[j]) else 1.0
            found += [(row, column, share) for row, column in parts(sources[i], targets[j])]
    return found


def match_positions(both: Correspondence, weights: FloatArray) -> FloatArray:
    """Solve for weights, not negative, whose displacements are nearest to the source's.

    Parameters
    ----------
    weights : (frames, source shapes) float array

    Returns
    -------
    (frames, target shapes) float array
    """
    matrix = both.target.reshape(len(both.target), -1).T
    wanted = weights @ both.source.reshape(len(both.source), -1)
    return solve_bounded_least_squares(
        matrix,
        wanted,
        lower=np.zeros(len(both.target)),
        upper=np.full(len(both.target), np.inf),
        ridge=RIDGE_SHARE * float((matrix**2).sum(axis=0).mean()),
    ).x


@dataclass(frozen=True)
class _Surface:
    samples: SurfaceSamples
    deltas: FloatArray
    activity: FloatArray

    @property
    def size_mm(self) -> float:
        """Root mean square distance of the samples from their middle."""
        return float(np.linalg.norm(self.samples.positions.std(axis=0)))


def _surface(rig: Rig) -> _Surface:
    deformer = Deformer(rig)
    deltas = deformer.shapes.target_offsets().toarray().reshape(len(rig.shapes), -1, 3)
    activity = np.linalg.norm(deltas, axis=2).max(axis=0)
    with _no_face(str(rig.file)):
        facing = facing_direction(deformer.neutral, deformer.triangles, activity)
        samples = sample_outer_surface(
            deformer.neutral, deformer.triangles, facing=facing, activity=activity
        )
    at = np.einsum("spkc,pk->spc", deltas[:, samples.corners], samples.weights)
    return _Surface(samples, at, np.linalg.norm(at, axis=2).max(axis=0))


@contextmanager
def _no_face(where: str) -> Iterator[None]:
    """Say of a surface that has no extent, or no part that moves, that it is no face."""
    try:
        with np.errstate(divide="raise", invalid="raise"):
            yield
    except FloatingPointError as error:
        raise InputError(f"{where}: the surface is too small or too flat for a face") from error
    except ValueError as error:
        raise InputError(f"{where}: {error}") from error


def _unit(fields: FloatArray) -> FloatArray:
    flat = fields.reshape(len(fields), -1)
    return np.asarray(flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-12))
