"""What a rig looks like before it moves: finer polygons, what each piece is, and its colours."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from usdface.assets import Float32Array, FloatArray, IntArray, RigMesh
from usdface.errors import InputError
from usdface.media.complexion import paint
from usdface.media.mesh_topology import (
    Sparse,
    check_topology,
    normal_operator,
    vertex_normals,
)
from usdface.media.parts import Part, find_pieces
from usdface.media.subdivision import catmull_clark
from usdface.media.tracing import PATTERNS, Tracer, sky_seen
from usdface.numerics.triangulation import triangulate

COARSE_POINTS = 6000
"""Subdivide a Catmull-Clark cage of fewer points; finer ones look smooth at sheet size."""

EXPOSURE_RAYS = 48


@dataclass(frozen=True)
class Surface:
    """The drawn triangles of a rig and all about them that no pose changes.

    Attributes
    ----------
    matrix : (drawn points, points) sparse array
        Drawn points = matrix @ points; points are those of all meshes in a row.
    triangles : (triangles, 3) int array
    normals : (drawn points, triangles) sparse array
        Adds triangle normals at their corners.
    parts : (triangles,) int array
        A `Part` each.
    albedo : (drawn points, 3) float32 array
        Linear.
    painted : bool
        True where the rig brought its own colours, so that no iris is painted over them.
    rest : (drawn points, 3) float32 array
        [mm]
    eyes : (triangles,) int array
        Row of `eye_centers`, -1 where the triangle is no eye's.
    eye_centers : (eyes, 3) float32 array
        [mm]
    size : float
        Height of the drawn surface at rest [mm]; scales distances of light.
    outward : float
        +1 if normals point out of the head, -1 if the mesh is wound the other way.
    """

    matrix: Sparse
    triangles: IntArray
    normals: Sparse
    parts: IntArray
    albedo: Float32Array
    painted: bool
    rest: Float32Array
    eyes: IntArray
    eye_centers: Float32Array
    size: float
    outward: float


def build_surface(meshes: Sequence[RigMesh]) -> Surface:
    """Prepare the visible meshes of a rig for drawing.

    Parameters
    ----------
    meshes : sequence of RigMesh

    Returns
    -------
    Surface

    Raises
    ------
    InputError
        If no visible mesh has a polygon, or polygons do not fit their points.
    """
    for mesh in meshes:
        check_topology(mesh)
    visible = [mesh for mesh in meshes if mesh.visible and len(mesh.face_counts)]
    if not visible:
        names = ", ".join(f"<{mesh.path}>" for mesh in meshes) or "none"
        raise InputError(f"no visible mesh with polygons to draw among: {names}")
    drawn = _concatenate([_refine(mesh) for mesh in visible])
    exposure, outward = _rest_exposure(visible, drawn)
    pieces = find_pieces(visible, exposure=exposure)
    parts = pieces.parts[pieces.of_point[drawn.corner_of_triangle]]
    eye_rows = {piece: row for row, piece in enumerate(pieces.eyeballs)}
    eyes = np.array([eye_rows.get(p, -1) for p in range(len(pieces.parts))])
    kept = parts != Part.HIDDEN
    triangles = drawn.triangles[kept]
    if not kept.all():  # lash cards and tear lines hid skin that is seen without them
        seen = _Drawn(drawn.matrix, triangles, drawn.corner_of_triangle[kept])
        exposure, outward = _rest_exposure(visible, seen)
    cage = np.concatenate([mesh.points for mesh in visible])
    rest = np.asarray(drawn.matrix @ cage)
    return Surface(
        matrix=drawn.matrix @ _selection(meshes, visible),
        triangles=triangles,
        normals=normal_operator(triangles, point_count=len(rest)),
        parts=parts[kept],
        albedo=np.asarray(drawn.matrix @ paint(visible, pieces, exposure=exposure), np.float32),
        painted=any(mesh.colors is not None for mesh in visible),
        rest=rest.astype(np.float32),
        eyes=eyes[pieces.of_point[drawn.corner_of_triangle[kept]]],
        eye_centers=np.array(
            [ball.center for ball in pieces.eyeballs.values()], np.float32
        ).reshape(-1, 3),
        size=float(max(np.ptp(rest[:, 1]), 1e-6)),
        outward=outward,
    )


@dataclass(frozen=True)
class _Drawn:
    """Triangles over a mesh, finer than its cage where that is coarse."""

    matrix: Sparse
    triangles: IntArray
    corner_of_triangle: IntArray  # a cage point that each triangle belongs to


def _refine(mesh: RigMesh) -> _Drawn:
    count = len(mesh.points)
    counts, indices = mesh.face_counts, mesh.face_indices
    starts = np.cumsum(counts) - counts
    cage_corner = indices[np.minimum(starts, len(indices) - 1)]
    matrix: Sparse = sparse.identity(count, format="csr")
    while mesh.subdivision == "catmullClark" and matrix.shape[0] < COARSE_POINTS:
        step = catmull_clark(counts, indices, point_count=matrix.shape[0])
        if not len(step.face_counts):
            break
        matrix = step.matrix @ matrix
        counts, indices = step.face_counts, step.face_indices
        cage_corner = cage_corner[step.parents]
    triangles, faces = triangulate(counts, indices)
    return _Drawn(sparse.csr_array(matrix), triangles, cage_corner[faces])


def _concatenate(drawn: Sequence[_Drawn]) -> _Drawn:
    rows = np.cumsum([0, *(d.matrix.shape[0] for d in drawn)])
    columns = np.cumsum([0, *(d.matrix.shape[1] for d in drawn)])
    return _Drawn(
        matrix=sparse.csr_array(sparse.block_diag([d.matrix for d in drawn], format="csr")),
        triangles=np.concatenate([d.triangles + r for d, r in zip(drawn, rows, strict=False)]),
        corner_of_triangle=np.concatenate(
            [d.corner_of_triangle + c for d, c in zip(drawn, columns, strict=False)]
        ),
    )


def _selection(meshes: Sequence[RigMesh], visible: Sequence[RigMesh]) -> Sparse:
    """Return the matrix that takes the points of the visible meshes from those of all."""
    shown = {id(mesh) for mesh in visible}
    taken = np.concatenate([np.full(len(m.points), id(m) in shown) for m in meshes])
    columns = np.flatnonzero(taken)
    ones = np.ones(len(columns))
    return sparse.csr_array(
        (ones, (np.arange(len(columns)), columns)), shape=(len(columns), len(taken))
    )


def _rest_exposure(meshes: Sequence[RigMesh], drawn: _Drawn) -> tuple[FloatArray, float]:
    """Return how much sky each point sees, eyes open or shut, and which way normals point.

    A lid that is folded away at rest is skin all the same: it is seen in a blink. What neither
    pose shows is the inside of the mouth and of the sockets.
    """
    rest = np.concatenate([mesh.points for mesh in meshes])
    seen, outward = _exposure(rest, drawn, outward=0.0)
    blink = np.concatenate([_blinking(mesh) for mesh in meshes])
    if np.any(blink != rest):
        seen = np.maximum(seen, _exposure(blink, drawn, outward=outward)[0])
    return seen, outward


def _blinking(mesh: RigMesh) -> FloatArray:
    posed = mesh.points.astype(np.float64, copy=True)
    for shape in mesh.shapes:
        if "blink" in shape.name.lower():
            posed[shape.keys[-1].points] += shape.keys[-1].offsets
    return posed


def _exposure(cage: FloatArray, drawn: _Drawn, *, outward: float) -> tuple[FloatArray, float]:
    fine = np.asarray(drawn.matrix @ cage)
    operator = normal_operator(drawn.triangles, point_count=len(fine))
    # Catmull-Clark keeps the cage's points first, so these rows are theirs after one mesh only;
    # the matrix' largest entry of a column finds them for any number of meshes.
    normals = vertex_normals(fine, drawn.triangles, operator)
    rows = np.asarray(np.abs(drawn.matrix).argmax(axis=0)).reshape(-1)
    points, facing = fine[rows].astype(np.float32), normals[rows].astype(np.float32)
    tracer = Tracer(fine.astype(np.float32), drawn.triangles)
    lift = np.float32(2e-3 * np.ptp(fine[:, 1]))
    results = {}
    for side in (1.0, -1.0) if outward == 0 else (outward,):
        aim = np.float32(side) * facing
        results[side] = sky_seen(
            tracer,
            points + lift * aim,
            aim,
            patterns=np.arange(len(points)) % PATTERNS,
            ray_count=EXPOSURE_RAYS,
            reach=1e6,
        )
    best = max(results, key=lambda side: float(results[side].mean()))
    return results[best].astype(np.float64), best
