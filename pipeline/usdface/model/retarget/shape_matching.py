"""Matching of the shapes of two rigs by deformation.

The faces are aligned (rotation, translation, one scale per axis), so that meshes may differ in
topology, size and proportions: by the landmarks of eyes and mouth, or, on a rig without them, by
their outer surfaces. Every shape is then a field of displacements over the same samples, and the
similarity of two shapes is the cosine between their fields.

The same correspondence serves *position matching*, the method of comparison of S11 (section 6.3):
non-negative weights of the target whose displacements are nearest to the source's.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial import KDTree

from usdface.core.arrays import FloatArray, IntArray
from usdface.core.assets import Rig
from usdface.core.deformer import Deformer
from usdface.core.errors import InputError
from usdface.model.placement.rig_landmarks import find_landmarks
from usdface.model.placement.shape_parts import shape_parts
from usdface.model.retarget.shape_names import mirrored, read_meanings
from usdface.numerics.measure.face_regions import gaze_shapes, mirrored_shapes, region_of_shape
from usdface.numerics.registration.cloud_alignment import (
    UNMOVED,
    Alignment,
    align_cloud,
    align_pairs,
)
from usdface.numerics.registration.face_skin import TYPICAL_SIZE_MM, FaceSkin
from usdface.numerics.solve.bounded_least_squares import solve_bounded_least_squares

CLOUD_POINTS = 400
"""Points of the source for the alignment, which are searched from every start."""

_SAMPLE_COUNT = 1500
"""Samples on which both faces are compared."""

_ALIGNING_LANDMARKS = ("lid_upper_L", "lid_upper_R", "mouth_middle")
"""Landmarks without which two faces are aligned by their surfaces."""

_UPPER_FACE, _LOWER_FACE = ("brows", "lids"), ("mouth", "jaw")
"""Regions of which a shape of one is not matched with a shape of the other."""

_LEAST_DEPTH = 1e-3
"""Least extent of a face along its shortest axis, relative to its longest."""

_SAME_SHARE = 1e-3
"""[of the face's size] Largest distance between the points of the same head."""

_LEAST_SIMILARITY = 0.5
"""Cosine below which two shapes are not matched."""

_ONE_SIDE_SIMILARITY = 0.75
"""The same between a shape of one side and one without a side: above sqrt(1/2), the similarity of a
motion of both sides with its half."""

RIDGE_SHARE = 1e-3
"""Ridge of position matching, as a share of the mean square of the displacements."""


@dataclass(frozen=True)
class Correspondence:
    """Displacements by the shapes of two rigs at corresponding points."""

    source: FloatArray
    target: FloatArray
    """`source`, `target`: (shapes, samples, 3): displacements at weight 1 in the frame of the
    target's face, the source's in its proportions [mm]."""
    mirror: IntArray
    """(samples,): the sample nearest to the mirror image of each."""

    def similarity(self) -> FloatArray:
        """Return the cosine between every source and every target shape: (ns, nt)."""
        return np.asarray(unit_fields(self.source) @ unit_fields(self.target).T)


@dataclass(frozen=True)
class ShapeMatch:
    """Two shapes with similar displacements."""

    source: str
    target: str
    similarity: float
    """Cosine between their displacements, at most 1."""
    share: float = 1.0
    """Factor from the source's to the target's weight."""


def correspond(source: Rig, target: Rig) -> Correspondence:
    """Align two faces.

    The same head, with other shapes, is not moved. Else each is aligned to the other, and the
    alignment with the smaller residual is used, so that the result does not depend on which one is
    the source.

    Raises
    ------
    InputError
        If one of them has no recognisable face, or no alignment is upright.
    """
    one, other = _find_face(source), _find_face(target)
    with _surface_errors(f"{source.file} on {target.file}"):
        forward, forward_error = _align(one, other)
        backward, backward_error = _align(other, one)
    by_inverse = backward_error < forward_error
    place = backward.undo if by_inverse else forward.apply
    move = backward.undo_motion if by_inverse else forward.apply_to_motion
    (skin, _), (other_skin, _) = one, other
    chosen = np.arange(0, len(skin.positions), max(len(skin.positions) // _SAMPLE_COUNT, 1))
    _, nearest = KDTree(other_skin.positions).query(place(skin.positions[chosen]))
    at = other_skin.positions[np.asarray(nearest, np.int64)]
    _, opposite = KDTree(at).query(at * [-1, 1, 1] + [2 * at[:, 0].mean(), 0, 0])
    return Correspondence(
        source=move(skin.deltas[:, chosen].astype(np.float64)),
        target=other_skin.deltas[:, np.asarray(nearest, np.int64)].astype(np.float64),
        mirror=np.asarray(opposite, np.int64),
    )


_Face = tuple[FaceSkin, dict[str, FloatArray]]
"""Skin and landmarks."""


def _align(one: _Face, other: _Face) -> tuple[Alignment, float]:
    """Return the alignment of a face to another, and its residual over the other's size."""
    (skin, landmarks), (other_skin, other_landmarks) = one, other
    rest, other_rest = skin.positions, other_skin.positions
    if rest.shape == other_rest.shape:
        if np.abs(rest - other_rest).max() < _SAME_SHARE * TYPICAL_SIZE_MM:
            return UNMOVED, 0.0
    common = sorted(landmarks.keys() & other_landmarks.keys())
    if set(_ALIGNING_LANDMARKS) <= set(common):
        places, targets = (np.array([each[1][name] for name in common]) for each in (one, other))
        found = align_pairs(places, targets, weight=np.ones(len(common)))
    else:
        stride = max(len(rest) // CLOUD_POINTS, 1)
        found = align_cloud(
            rest[::stride],
            other_rest,
            activity=other_skin.activity(),
            areas=other_skin.areas,
            amplitude=skin.activity()[::stride],
        )
    return found, found.residual_mm / TYPICAL_SIZE_MM


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


def match_positions(both: Correspondence, weights: FloatArray) -> FloatArray:
    """Return non-negative target weights whose displacements are nearest to the source's.

    Returns (frames, target shapes), from weights (frames, source shapes).
    """
    matrix = both.target.reshape(len(both.target), -1).T
    displacements = weights @ both.source.reshape(len(both.source), -1)
    return solve_bounded_least_squares(
        matrix,
        displacements,
        lower=np.zeros(len(both.target)),
        upper=np.full(len(both.target), np.inf),
        ridge=RIDGE_SHARE * float((matrix**2).sum(axis=0).mean()),
    )


def _find_face(rig: Rig) -> _Face:
    deformer = Deformer(rig)
    with _surface_errors(str(rig.file)):
        skin = deformer.face_skin()
    extents = np.linalg.svd(skin.positions - skin.positions.mean(axis=0), compute_uv=False)
    if extents[-1] < _LEAST_DEPTH * extents[0]:
        raise InputError(f"{rig.file}: the surface is too flat for a face")
    return skin, find_landmarks(skin, rig.shapes)


@contextmanager
def _surface_errors(where: str) -> Iterator[None]:
    """Report a surface without extent, or without moving parts, as bad input."""
    try:
        with np.errstate(divide="raise", invalid="raise"):
            yield
    except FloatingPointError as error:
        raise InputError(f"{where}: the surface is too small or too flat for a face") from error
    except ValueError as error:
        raise InputError(f"{where}: {error}") from error


def unit_fields(fields: FloatArray) -> FloatArray:
    """Return fields (n, samples, 3) as unit vectors (n, 3 * samples); 0 where nothing moves."""
    flat = fields.reshape(len(fields), -1)
    return np.asarray(flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-12))
