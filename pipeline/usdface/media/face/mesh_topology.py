"""Polygons as triangles, components and smooth normals: what does not change with the pose."""

from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from usdface.core.arrays import FloatArray, IntArray
from usdface.core.assets import RigMesh
from usdface.core.errors import InputError

Sparse = Any
"""A scipy CSR array; its stubs cannot say of what."""


def check_topology(mesh: RigMesh) -> None:
    """Refuse a mesh whose polygons do not fit its points."""
    corners = int(np.sum(mesh.face_counts))
    if corners != len(mesh.face_indices) or np.any(mesh.face_counts < 0):
        raise InputError(
            f"<{mesh.path}>: the polygons need {corners} corners and have "
            f"{len(mesh.face_indices)}; repair faceVertexCounts and faceVertexIndices"
        )
    if len(mesh.face_indices) and (
        mesh.face_indices.min() < 0 or mesh.face_indices.max() >= len(mesh.points)
    ):
        raise InputError(
            f"<{mesh.path}>: faceVertexIndices run from {mesh.face_indices.min()} to "
            f"{mesh.face_indices.max()} and there are {len(mesh.points)} points; repair the mesh"
        )


def polygon_edges(face_counts: IntArray, face_indices: IntArray) -> IntArray:
    """Return the two points of every side of every polygon, in the order of the corners.

    Parameters
    ----------
    face_counts : (faces,) int array
    face_indices : (corners,) int array

    Returns
    -------
    (corners, 2) int array
        An edge between two polygons is there twice.
    """
    starts = np.cumsum(face_counts) - face_counts
    corner = np.arange(len(face_indices))
    faces = np.repeat(np.arange(len(face_counts)), face_counts)
    last = corner - starts[faces] == face_counts[faces] - 1
    following = np.where(last, starts[faces], corner + 1)
    return np.stack([face_indices, face_indices[following]], axis=1)


def components(face_counts: IntArray, face_indices: IntArray, *, point_count: int) -> IntArray:
    """Return the number of the connected piece that each point belongs to: (points,) int array.

    Parameters
    ----------
    face_counts : (faces,) int array
    face_indices : (corners,) int array
    """
    filled = face_counts > 0
    starts = (np.cumsum(face_counts) - face_counts)[filled]
    first = np.repeat(face_indices[starts], face_counts[filled])
    links = sparse.coo_array(
        (np.ones(len(first), np.int8), (first, face_indices)), shape=(point_count, point_count)
    )
    _, labels = connected_components(links, directed=False)
    return np.asarray(labels, np.int64)


def normal_operator(triangles: IntArray, *, point_count: int) -> Sparse:
    """Return the (points, triangles) matrix that adds triangle normals at their corners."""
    count = len(triangles)
    columns = np.repeat(np.arange(count), 3)
    ones = np.ones(3 * count, np.float32)
    return sparse.csr_array((ones, (triangles.ravel(), columns)), shape=(point_count, count))


def vertex_normals(points: FloatArray, triangles: IntArray, operator: Sparse) -> FloatArray:
    """Return unit normals, the mean of the triangles about a point weighted by their area.

    Parameters
    ----------
    points : (points, 3) float array
    triangles : (triangles, 3) int array
    operator : (points, triangles) sparse array
        From `normal_operator`.

    Returns
    -------
    (points, 3) float array
        Zero where no triangle with an area meets the point.
    """
    a, b, c = (points[triangles[:, k]] for k in range(3))
    summed = np.asarray(operator @ np.cross(b - a, c - a))
    length = np.linalg.norm(summed, axis=1, keepdims=True)
    return np.asarray(np.divide(summed, length, out=np.zeros_like(summed), where=length > 0))
