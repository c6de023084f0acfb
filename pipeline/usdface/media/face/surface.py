"""The drawn surface of a rig at rest: refined polygons, parts and colours."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy import sparse

from usdface.core.arrays import BoolArray, Float32Array, FloatArray, IntArray, index_of, row_lengths
from usdface.core.assets import RigMesh
from usdface.core.errors import InputError
from usdface.core.last_result import cache_last_result
from usdface.media.face.complexion import (
    LEAST_OPACITY,
    colored_by_light,
    faces_painted,
    is_plain_eye,
    paint,
)
from usdface.media.face.features import ColorBand
from usdface.media.face.mesh_topology import cut_polygons
from usdface.media.face.parts import FacePart, Pieces, find_pieces
from usdface.media.face.stand_in_eyes import blink_offsets, fit_stand_in_eyes
from usdface.media.face.subdivision import catmull_clark
from usdface.media.face.tracing import PATTERN_COUNT, Tracer, sky_seen, traced_triangles
from usdface.numerics.surface.triangulation import Sparse, normal_operator, vertex_normals

COARSE_POINTS = 6000
"""Catmull-Clark cages of fewer points are subdivided; finer ones look smooth at sheet size."""

_EXPOSURE_RAYS = 48  # for colours: with fewer, the edge of the mouth's inside is ragged
_SORTING_RAYS = 12  # for the classification of pieces by their median
_PROBE_COUNT = 2000  # points that determine the orientation of normals


LONG_EDGE = 0.02
"""Length of a long quad edge, relative to the height of the drawn meshes."""


@dataclass(frozen=True)
class QuadCentres:
    """Drawn points at the centre of a quad, with the mean normal of its corners."""

    points: IntArray
    """(n,)"""
    corners: IntArray
    """(n, 4)"""


@dataclass(frozen=True)
class Surface:
    """The drawn triangles of a rig and their properties independent of the pose."""

    matrix: Sparse
    """(drawn points, points): drawn points = matrix @ points, all meshes concatenated."""
    triangles: IntArray
    """(triangles, 3)"""
    normals: Sparse
    """(drawn points, triangles): sums triangle normals at their corners."""
    middles: QuadCentres
    parts: IntArray
    """(triangles,): `FacePart` of each."""
    albedo: Float32Array
    """(drawn points, 3): linear."""
    painted: Float32Array
    """(triangles, 3): colour by material; NaN where `albedo` applies."""
    bands: tuple[ColorBand, ...]
    """Lips and brows, over `albedo`."""
    band_opacity: Float32Array
    """(drawn points,): opacity of the bands [0-1]; 0 away from them."""
    rest: Float32Array
    """(drawn points, 3) [mm]"""
    eyes: IntArray
    """(triangles,): row of `eye_centers` on eyes without their own iris, else -1."""
    eye_centers: Float32Array
    """(eyes, 3) [mm]"""
    size: float
    """Height of the drawn surface at rest [mm]; scales the reach of occlusion."""
    outward: float
    """+1 if normals point out of the head, -1 if the winding is reversed."""
    has_stand_in_eyes: bool
    """Whether stand-in eyes were added."""

    def normals_at(self, fine: FloatArray) -> FloatArray:
        """Return unit normals of the drawn points in a pose; zero for points without a triangle.

        `fine`: (drawn points, 3) [mm].
        """
        normals = vertex_normals(fine, self.triangles, self.normals)
        summed = normals[self.middles.corners].sum(axis=1)
        length = row_lengths(summed)
        normals[self.middles.points] = summed / np.maximum(length, 1e-12)
        return normals


@cache_last_result
def build_surface(meshes: Sequence[RigMesh]) -> Surface:
    """Prepare the visible meshes of a rig for drawing."""
    visible = [mesh for mesh in meshes if mesh.visible and len(mesh.face_counts)]
    if not visible:
        names = ", ".join(f"<{mesh.path}>" for mesh in meshes) or "none"
        raise InputError(f"no visible mesh with polygons to draw among: {names}")
    kept = {id(mesh) for mesh in visible}
    taken = np.repeat([id(mesh) in kept for mesh in meshes], [len(mesh.points) for mesh in meshes])
    selection = sparse.eye_array(len(taken), format="csr")[np.flatnonzero(taken)]
    drawn, pieces = _recognise(visible)
    stand_ins = None if np.any(pieces.parts == FacePart.EYE) else fit_stand_in_eyes(visible)
    if stand_ins is not None:
        balls, attached = stand_ins
        visible = [*visible, *balls]
        selection = sparse.vstack([selection, attached @ selection])
        drawn, pieces = _recognise(visible)
    parts = pieces.parts[pieces.of_point[drawn.corner_of_triangle]]
    eye_rows = index_of(pieces.eyeballs)
    eyes = np.array([eye_rows.get(p, -1) for p in range(len(pieces.parts))])
    faces = drawn.face_of_triangle
    painted = np.concatenate([faces_painted(mesh) for mesh in visible])[faces]
    piece_of_triangle = pieces.of_point[drawn.corner_of_triangle]
    for piece in pieces.eyeballs:
        if not _plain_eye(visible, pieces, piece, painted[piece_of_triangle == piece]):
            eyes[piece] = -1
    clear = np.concatenate([_clear(mesh) for mesh in visible])[faces]
    kept = (parts != FacePart.HIDDEN) & ~clear
    if not kept.any():
        kept = parts != FacePart.HIDDEN
    triangles, painted = drawn.triangles[kept], painted[kept]
    # Lash cards and tear lines would occlude visible skin.
    shown = replace(drawn, triangles=triangles, corner_of_triangle=drawn.corner_of_triangle[kept])
    lit = np.flatnonzero(colored_by_light(visible, pieces))
    exposure, outward = _rest_exposure(visible, shown, lit, rays=_EXPOSURE_RAYS)
    cage = np.concatenate([mesh.points for mesh in visible])
    rest = np.asarray(drawn.matrix @ cage)
    complexion = paint(visible, pieces, exposure=exposure)
    band_opacity = drawn.matrix @ complexion.band_opacity
    near = np.zeros(len(band_opacity), bool)
    for band in complexion.bands:
        near[triangles[band.meets(rest[triangles])]] = True
    return Surface(
        matrix=drawn.matrix @ selection,
        triangles=triangles,
        normals=normal_operator(triangles, point_count=len(rest)),
        middles=drawn.middles,
        parts=parts[kept],
        albedo=_of_points_too(drawn.matrix @ complexion.colors, triangles, painted),
        painted=painted.astype(np.float32),
        bands=complexion.bands,
        band_opacity=np.asarray(np.where(near, band_opacity, 0.0), np.float32),
        rest=rest.astype(np.float32),
        eyes=eyes[piece_of_triangle[kept]],
        eye_centers=np.array(
            [ball.center for ball in pieces.eyeballs.values()], np.float32
        ).reshape(-1, 3),
        size=float(max(np.ptp(rest[:, 1]), 1e-6)),
        outward=outward,
        has_stand_in_eyes=stand_ins is not None,
    )


@dataclass(frozen=True)
class _Drawn:
    """Triangles of a mesh, subdivided if its cage is coarse."""

    matrix: Sparse
    triangles: IntArray
    corner_of_triangle: IntArray  # a cage point of the piece of each triangle
    face_of_triangle: IntArray  # the cage polygon of each triangle
    face_count: int
    row_of_point: IntArray  # the drawn point of each cage point
    middles: QuadCentres


def _recognise(meshes: Sequence[RigMesh]) -> tuple[_Drawn, Pieces]:
    """Refine the meshes and classify their pieces."""
    heights = np.concatenate([mesh.points[:, 1] for mesh in meshes])
    least = LONG_EDGE * float(np.ptp(heights))
    drawn = _concatenate([_refine(mesh, least_edge=least) for mesh in meshes])
    every = np.arange(len(heights))
    exposure = cache(lambda: _rest_exposure(meshes, drawn, every, rays=_SORTING_RAYS)[0])
    return drawn, find_pieces(meshes, exposure=exposure)


def _clear(mesh: RigMesh) -> BoolArray:
    """Return whether each polygon is transparent."""
    if mesh.face_colors is None:
        return np.zeros(len(mesh.face_counts), bool)
    return np.asarray(mesh.face_colors[:, 3] < LEAST_OPACITY)


def _plain_eye(meshes: Sequence[RigMesh], pieces: Pieces, piece: int, painted: FloatArray) -> bool:
    """Return whether an eye has no iris in the colours of its points and faces."""
    colors = np.concatenate(
        [
            np.full(mesh.points.shape, np.nan) if mesh.colors is None else mesh.colors
            for mesh in meshes
        ]
    )
    return is_plain_eye(colors[pieces.of_point == piece]) and is_plain_eye(painted)


def _of_points_too(albedo: FloatArray, triangles: IntArray, painted: FloatArray) -> Float32Array:
    """Return `albedo` with the mean colour of the painted triangles at their points, for pages."""
    known = np.flatnonzero(~np.isnan(painted[:, 0]))
    if len(known):
        corners = triangles[known].ravel()
        uses = np.bincount(corners, minlength=len(albedo))
        for axis in range(3):
            summed = np.bincount(corners, np.repeat(painted[known, axis], 3), minlength=len(albedo))
            albedo[:, axis] = np.where(uses > 0, summed / np.maximum(uses, 1), albedo[:, axis])
    return np.asarray(albedo, np.float32)


def _refine(mesh: RigMesh, *, least_edge: float) -> _Drawn:
    count = len(mesh.points)
    counts, indices = mesh.face_counts, mesh.face_indices
    starts = np.cumsum(counts) - counts
    cage_corner = indices[np.minimum(starts, len(indices) - 1)]
    cage_face = np.arange(len(counts))
    matrix: Sparse = sparse.identity(count, format="csr")
    while mesh.subdivision == "catmullClark" and matrix.shape[0] < COARSE_POINTS:
        step = catmull_clark(counts, indices, point_count=matrix.shape[0])
        if not len(step.face_counts):
            break
        matrix = step.matrix @ matrix
        counts, indices = step.face_counts, step.face_indices
        cage_corner, cage_face = cage_corner[step.parents], cage_face[step.parents]
    cut = cut_polygons(np.asarray(matrix @ mesh.points), counts, indices, least_edge=least_edge)
    first = matrix.shape[0]
    matrix = sparse.vstack([matrix, cut.middles @ matrix])
    return _Drawn(
        sparse.csr_array(matrix),
        cut.triangles,
        cage_corner[cut.faces],
        cage_face[cut.faces],
        len(mesh.face_counts),
        np.arange(count),  # subdivision and cutting keep the cage's points first
        QuadCentres(first + np.arange(len(cut.corners)), cut.corners),
    )


def _concatenate(drawn: Sequence[_Drawn]) -> _Drawn:
    rows = np.cumsum([0, *(d.matrix.shape[0] for d in drawn)])
    columns = np.cumsum([0, *(d.matrix.shape[1] for d in drawn)])
    faces = np.cumsum([0, *(d.face_count for d in drawn)])

    def shifted(indices: Iterable[IntArray], starts: IntArray) -> IntArray:
        return np.concatenate([each + first for each, first in zip(indices, starts, strict=False)])

    return _Drawn(
        matrix=sparse.csr_array(sparse.block_diag([d.matrix for d in drawn], format="csr")),
        triangles=shifted((d.triangles for d in drawn), rows),
        corner_of_triangle=shifted((d.corner_of_triangle for d in drawn), columns),
        face_of_triangle=shifted((d.face_of_triangle for d in drawn), faces),
        face_count=int(faces[-1]),
        row_of_point=shifted((d.row_of_point for d in drawn), rows),
        middles=QuadCentres(
            shifted((d.middles.points for d in drawn), rows),
            shifted((d.middles.corners for d in drawn), rows),
        ),
    )


def _rest_exposure(
    meshes: Sequence[RigMesh], drawn: _Drawn, which: IntArray, *, rays: int
) -> tuple[FloatArray, float]:
    """Return the visible share of the sky of some cage points, 1 at others, and `Surface.outward`.

    The maximum of the pose at rest and of a blink: lids folded away at rest are skin; occluded in
    both are the inside of the mouth and of the sockets.
    """
    rest = np.concatenate([mesh.points for mesh in meshes])
    posed = _Posed(rest, drawn)
    few = np.arange(len(rest))[:: max(len(rest) // _PROBE_COUNT, 1)]
    out, into = (posed.sky_over(few, outward=side, rays=PATTERN_COUNT).mean() for side in (1, -1))
    outward = 1.0 if out >= into else -1.0
    seen = np.ones(len(rest))
    if not len(which):
        return seen, outward
    seen[which] = posed.sky_over(which, outward=outward, rays=rays)
    blink = rest + np.concatenate([blink_offsets(mesh) for mesh in meshes])
    folded = which[np.any(blink[which] != rest[which], axis=1)]
    if len(folded):
        shut = _Posed(blink, drawn).sky_over(folded, outward=outward, rays=rays)
        seen[folded] = np.maximum(seen[folded], shut)
    return seen, outward


class _Posed:
    """A pose of the cage, ready for rays."""

    def __init__(self, cage: FloatArray, drawn: _Drawn) -> None:
        fine = np.asarray(drawn.matrix @ cage)
        operator = normal_operator(drawn.triangles, point_count=len(fine))
        normals = vertex_normals(fine, drawn.triangles, operator)
        self._aim = normals[drawn.row_of_point].astype(np.float32)
        self._points = fine[drawn.row_of_point].astype(np.float32)
        self._lift = np.float32(2e-3 * np.ptp(fine[:, 1]))
        self._tracer = Tracer(fine.astype(np.float32), traced_triangles(drawn.triangles))

    def sky_over(self, which: IntArray, *, outward: float, rays: int) -> FloatArray:
        """Return the visible share of the sky of some cage points [0-1]."""
        aim = np.float32(outward) * self._aim[which]
        seen = sky_seen(
            self._tracer,
            self._points[which] + self._lift * aim,
            aim,
            patterns=which % PATTERN_COUNT,
            ray_count=rays,
            reach=1e6,
        )
        return seen.astype(np.float64)
