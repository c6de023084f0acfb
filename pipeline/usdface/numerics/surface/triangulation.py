"""Triangulation of polygons, areas and normals of triangles, and authored normals under motion.

An authored normal is rotated by the smallest rotation that maps the smooth normal of its point at
rest to that of the moved surface, which preserves hard edges and sculpted normals.
"""

import numpy as np

from usdface.core.arrays import FloatArray, IntArray


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
    return np.asarray(0.5 * np.linalg.norm(_cross_products(points, triangles), axis=1))


def _cross_products(points: FloatArray, triangles: IntArray) -> FloatArray:
    """Return normals (triangles, 3) of twice the triangles' areas in length."""
    a, b, c = (points[triangles[:, i]] for i in range(3))
    return np.cross(b - a, c - a)


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
        self._rest = smooth_normals(points, self._triangles)[self._owners]
        self._authored = authored

    def turn(self, points: FloatArray) -> FloatArray:
        """Return the normals (n, 3) of a moved surface (points, 3)."""
        now = smooth_normals(points, self._triangles)[self._owners]
        axis = np.cross(self._rest, now)
        cosine = np.einsum("ij,ij->i", self._rest, now)
        across = np.cross(axis, self._authored)
        # Rodrigues' formula for the rotation of one unit vector to another, v + a x v +
        # a x (a x v) / (1 + cos); 1 + cos is bounded for opposite vectors, in folds of skin.
        twice = np.cross(axis, across) / np.maximum(1 + cosine, 1e-3)[:, None]
        turned: FloatArray = self._authored + across + twice
        length = np.linalg.norm(turned, axis=1, keepdims=True)
        return np.asarray(turned / np.maximum(length, 1e-12))


def smooth_normals(points: FloatArray, triangles: IntArray) -> FloatArray:
    """Return area-weighted unit normals of points; 0 where there is no face."""
    across = _cross_products(points, triangles)
    normals = np.stack(
        [
            np.bincount(
                triangles.ravel(), weights=np.repeat(across[:, axis], 3), minlength=len(points)
            )
            for axis in range(3)
        ],
        axis=1,
    )
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.asarray(normals / np.maximum(length, 1e-30))
