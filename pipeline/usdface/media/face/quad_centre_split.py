"""Long quads over a bend, cut about a middle of their own.

Cut along a diagonal, a quad takes the light of two of its corners and not of the others: where the
normals of the two pairs differ, a row of long quads looks like a comb, as it does between jaw and
neck. With a point in the middle, lit as the mean of all four, it looks like the bend it is.
"""

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from usdface.core.arrays import BoolArray, FloatArray, IntArray
from usdface.media.face.mesh_topology import Sparse, normal_operator, vertex_normals
from usdface.numerics.surface.triangulation import triangulate

LEAST_ANGLE = np.radians(0.5)
"""Between the means of opposite normals; light then steps by less than a byte."""


@dataclass(frozen=True)
class Cut:
    """Polygons as triangles."""

    middles: Sparse
    """(new points, points): new points = middles @ points; they are counted on from the last
    point."""
    corners: IntArray
    """(new points, 4): the points whose mean each is."""
    triangles: IntArray
    """(triangles, 3)"""
    faces: IntArray
    """(triangles,): the polygon each triangle comes from."""


def cut_polygons(
    points: FloatArray, face_counts: IntArray, face_indices: IntArray, *, least_edge: float
) -> Cut:
    """Cut polygons into triangles, long quads over a bend about their middle.

    Parameters
    ----------
    points : (points, 3) float array
        At rest.
    face_counts : (faces,) int array
    face_indices : (corners,) int array
    least_edge : float
        Quads without a longer edge are cut along a diagonal, as all other polygons are.
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
    """Return which polygons are long quads whose diagonals are lit differently."""
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
