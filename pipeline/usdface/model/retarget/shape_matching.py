"""Shapes of two rigs matched by what they do: the same motion at the same place of the face.

The outer surfaces are laid onto each other (rotation, translation, one scale per axis), so that
meshes may differ in topology, size and proportions. Then every shape is a field of displacements
over the same samples, and two shapes are alike as the cosine between their fields.

The same correspondence gives the method that S11 (section 6.3) compares with: *position matching*,
non-negative weights of the target whose displacements are nearest to the source's.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial import KDTree

from usdface.core.arrays import FloatArray, IntArray
from usdface.core.assets import Rig
from usdface.core.deformer import Deformer
from usdface.core.errors import InputError
from usdface.model.retarget.shape_names import mirrored, read_meanings
from usdface.numerics.registration.cloud_alignment import align_cloud
from usdface.numerics.registration.outer_surface import (
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


def correspond(source: Rig, target: Rig) -> Correspondence:
    """Lay the source's face onto the target's.

    Raises
    ------
    InputError
        If one of them has no recognisable face, or no alignment is upright.
    """
    one, other = _surface(source), _surface(target)
    stride = max(len(one.samples.positions) // CLOUD_POINTS, 1)
    with _no_face(f"{source.file} on {target.file}"):
        alignment = align_cloud(
            one.samples.positions[::stride],
            other.samples.positions,
            activity=other.activity,
            areas=other.samples.areas,
            amplitude=one.activity[::stride],
        )
    stride = max(len(one.samples.positions) // _SAMPLE_COUNT, 1)
    chosen = np.arange(0, len(one.samples.positions), stride)
    placed = alignment.apply(one.samples.positions[chosen])
    _, nearest = KDTree(other.samples.positions).query(placed)
    return Correspondence(
        source=alignment.apply_to_motion(one.deltas[:, chosen]),
        target=other.deltas[:, np.asarray(nearest, np.int64)],
        residual_mm=alignment.residual_mm,
    )


def match_deformations(
    source: Rig, target: Rig, *, source_shapes: tuple[str, ...], target_shapes: tuple[str, ...]
) -> tuple[ShapeMatch, ...]:
    """Return the shapes that move the faces most alike, each in one match at most, best first.

    Where names say which shapes mirror each other, both sides are matched alike, or neither.

    Raises
    ------
    InputError
        As `correspond`.
    """
    if not (source_shapes and target_shapes):
        return ()
    both = correspond(source, target)
    rows = [source.shapes.index(name) for name in source_shapes]
    columns = [target.shapes.index(name) for name in target_shapes]
    likeness = both.similarity()[np.ix_(rows, columns)]
    partners = _mirror_partners(source_shapes), _mirror_partners(target_shapes)
    both_ways = likeness[np.ix_(*partners)]
    sided = (partners[0] != np.arange(len(rows)))[:, None] & (
        partners[1] != np.arange(len(columns))
    )
    likeness = np.where(sided, (likeness + both_ways) / 2, likeness)
    matched = {
        (row, column)
        for row, column in zip(
            *map(np.ndarray.tolist, linear_sum_assignment(-likeness)), strict=True
        )
        if likeness[row, column] >= _LEAST_SIMILARITY
    }
    found = [
        ShapeMatch(source_shapes[row], target_shapes[column], float(likeness[row, column]))
        for row, column in matched
        if not sided[row, column] or (partners[0][row], partners[1][column]) in matched
    ]
    return tuple(sorted(found, key=lambda each: (-each.similarity, each.source)))


def _mirror_partners(names: tuple[str, ...]) -> IntArray:
    """Return the place of each shape's other side; its own where there is none, or is not told."""
    meanings = read_meanings(names)
    place = {meanings[name].cells: index for index, name in enumerate(names)}
    return np.array(
        [place.get(mirrored(meanings[name].cells), index) for index, name in enumerate(names)],
        np.int64,
    )


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
