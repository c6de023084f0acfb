"""Polygon meshes: open edges and triangles."""

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from usdface.core.arrays import BoolArray, FloatArray, IntArray
from usdface.core.assets import RigMesh
from usdface.numerics.surface.triangulation import (
    Sparse,
    normal_operator,
    polygon_edges,
    triangulate,
    vertex_normals,
)


def border_edges(mesh: RigMesh) -> IntArray:
    """Return the edges of a single polygon: (edges, 2) int array."""
    sides = np.sort(polygon_edges(mesh.face_counts, mesh.face_indices), axis=1)
    edges, uses = np.unique(sides, axis=0, return_counts=True)
    return np.asarray(edges[uses == 1])


LEAST_ANGLE = np.radians(0.5)
"""Angle between the means of opposite normals, below which shading differs by less than a byte."""


@dataclass(frozen=True)
class Cut:
    """Polygons as triangles."""

    middles: Sparse
    """(new points, points): new points = middles @ points, appended to the points."""
    corners: IntArray
    """(new points, 4): each new point is the mean of these."""
    triangles: IntArray
    """(triangles, 3)"""
    faces: IntArray
    """(triangles,): the polygon each triangle comes from."""


def cut_polygons(
    points: FloatArray, face_counts: IntArray, face_indices: IntArray, *, least_edge: float
) -> Cut:
    """Cut polygons into triangles, and long bent quads into four around their centre.

    A quad cut along a diagonal is shaded by two of its corners only: where the normals of the two
    diagonals differ, a row of long quads shows a saw-tooth pattern, for instance between jaw and
    neck. A centre point with the mean normal of all four corners avoids this. Quads without an edge
    longer than `least_edge` are cut along a diagonal.
    """
    triangles, faces = triangulate(face_counts, face_indices)
    bent = _bent(points, triangles, face_counts, face_indices, least_edge)
    kept = ~bent[faces]
    corners = face_indices[np.repeat(bent, face_counts)].reshape(-1, 4)
    count = len(corners)
    own = len(points) + np.arange(count)
    fans = [np.stack([corners[:, k], corners[:, (k + 1) % 4], own], axis=1) for k in range(4)]
    rows = np.repeat(np.arange(count), 4)
    shares = (np.full(4 * count, 0.25), (rows, corners.ravel()))
    return Cut(
        middles=sparse.csr_array(shares, shape=(count, len(points))),
        corners=corners,
        triangles=np.concatenate([triangles[kept], np.stack(fans, axis=1).reshape(-1, 3)]),
        faces=np.concatenate([faces[kept], np.repeat(np.flatnonzero(bent), 4)]),
    )


def _bent(
    points: FloatArray,
    triangles: IntArray,
    face_counts: IntArray,
    face_indices: IntArray,
    least_edge: float,
) -> BoolArray:
    """Return whether each polygon is a long quad whose diagonals have different normals."""
    normals = vertex_normals(points, triangles, normal_operator(triangles, point_count=len(points)))
    rows = np.flatnonzero(face_counts == 4)
    starts = (np.cumsum(face_counts) - face_counts)[rows]
    corners = face_indices[starts[:, None] + np.arange(4)]
    sides = np.linalg.norm(points[corners] - points[np.roll(corners, 1, axis=1)], axis=2)
    one = normals[corners[:, 0]] + normals[corners[:, 2]]
    other = normals[corners[:, 1]] + normals[corners[:, 3]]
    sizes = np.linalg.norm(one, axis=1) * np.linalg.norm(other, axis=1)
    apart = np.einsum("ij,ij->i", one, other) < np.cos(LEAST_ANGLE) * sizes
    bent = np.zeros(len(face_counts), bool)
    bent[rows] = apart & (sides.max(axis=1, initial=0.0) > least_edge)
    return bent
