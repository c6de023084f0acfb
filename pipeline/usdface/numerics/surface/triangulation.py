"""Triangles and edges of polygons, smooth normals, and authored normals under motion.

An authored normal is rotated by the smallest rotation that maps the smooth normal of its point at
rest to that of the moved surface, which preserves hard edges and sculpted normals.
"""

from typing import Any

import numpy as np
from scipy import sparse

from usdface.core.arrays import FloatArray, IntArray, row_lengths

Sparse = Any
"""A SciPy CSR array, which is untyped."""


def triangulate(face_counts: IntArray, face_indices: IntArray) -> tuple[IntArray, IntArray]:
    """Triangulate polygons as fans.

    Returns
    -------
    triangles : (triangles, 3) int array
    faces : (triangles,) int array
        The polygon each triangle comes from.
    """
    fans = np.maximum(face_counts - 2, 0)
    faces = np.repeat(np.arange(len(face_counts)), fans)
    first = (np.cumsum(face_counts) - face_counts)[faces]
    step = np.arange(len(faces)) - (np.cumsum(fans) - fans)[faces]
    corners = np.stack([first, first + step + 1, first + step + 2], axis=1)
    return face_indices[corners].reshape(-1, 3), faces


def triangle_areas(points: FloatArray, triangles: IntArray) -> FloatArray:
    """Return the area of each triangle, in the points' unit squared."""
    return np.asarray(0.5 * np.linalg.norm(triangle_normals(points, triangles), axis=1))


def triangle_normals(points: FloatArray, triangles: IntArray) -> FloatArray:
    """Return the normal of each triangle, twice its area long: (triangles, 3)."""
    # Twice as fast as an index
    a, b, c = (np.take(points, triangles[:, k], axis=0) for k in range(3))
    return np.asarray(np.cross(b - a, c - a))


def polygon_edges(face_counts: IntArray, face_indices: IntArray) -> IntArray:
    """Return both points of each side of each polygon, in the order of the corners: (corners, 2).

    Edges between two polygons occur twice.
    """
    following = face_indices[following_corners(face_counts)]
    return np.stack([face_indices, following], axis=1)


def following_corners(face_counts: IntArray) -> IntArray:
    """Return the index of the next corner of the same polygon, for each corner: (corners,)."""
    ends = np.cumsum(face_counts)
    following = np.arange(1, int(face_counts.sum()) + 1)
    filled = face_counts > 0
    following[ends[filled] - 1] = (ends - face_counts)[filled]
    return following


def normal_operator(triangles: IntArray, *, point_count: int) -> Sparse:
    """Return the (points, triangles) matrix that sums triangle normals at their corners."""
    count = len(triangles)
    columns = np.repeat(np.arange(count), 3)
    ones = np.ones(3 * count, np.float32)
    return sparse.csr_array((ones, (triangles.ravel(), columns)), shape=(point_count, count))


def vertex_normals(points: FloatArray, triangles: IntArray, operator: Sparse) -> FloatArray:
    """Return unit normals: area-weighted means of the triangles at each point.

    Parameters
    ----------
    points : (points, 3) float array
    triangles : (triangles, 3) int array
    operator : (points, triangles) sparse array
        From `normal_operator`.

    Returns
    -------
    (points, 3) float array
        Zero for points without a triangle of positive area.
    """
    summed = np.asarray(operator @ triangle_normals(points, triangles))
    length = row_lengths(summed)
    return np.asarray(np.divide(summed, length, out=np.zeros_like(summed), where=length > 0))


class NormalTurner:
    """Rotates the authored normals of a mesh.

    Parameters
    ----------
    points : (points, 3) float array
        At rest.
    face_counts, face_indices : int arrays
        Polygons as USD stores them.
    authored : (n, 3) float array
        Normals.
    per_corner : bool
        Whether `authored` has one normal per corner of a face, or one per point.
    """

    def __init__(
        self,
        points: FloatArray,
        face_counts: IntArray,
        face_indices: IntArray,
        authored: FloatArray,
        *,
        per_corner: bool,
    ) -> None:
        self._triangles, _ = triangulate(face_counts, face_indices)
        self._owners = face_indices if per_corner else np.arange(len(points))
        self._operator = normal_operator(self._triangles, point_count=len(points))
        self._rest = vertex_normals(points, self._triangles, self._operator)[self._owners]
        self._authored = authored

    def turn(self, points: FloatArray) -> FloatArray:
        """Return the normals (n, 3) of a moved surface (points, 3)."""
        now = vertex_normals(points, self._triangles, self._operator)[self._owners]
        axis = np.cross(self._rest, now)
        cosine = np.einsum("ij,ij->i", self._rest, now)
        across = np.cross(axis, self._authored)
        # Rodrigues' formula for the rotation of one unit vector to another, v + a x v +
        # a x (a x v) / (1 + cos); 1 + cos is bounded for opposite vectors, in folds of skin.
        twice = np.cross(axis, across) / np.maximum(1 + cosine, 1e-3)[:, None]
        turned: FloatArray = self._authored + across + twice
        length = np.linalg.norm(turned, axis=1, keepdims=True)
        return np.asarray(turned / np.maximum(length, 1e-12))
