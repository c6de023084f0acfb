"""Normals that a sculptor authored, turned with the surface as it deforms.

Each is turned by the smallest rotation that takes the smooth normal of its point at rest to that of
the moved surface: hard edges stay hard and sculpted normals keep their lean.
"""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import FloatArray, IntArray
from usdface.numerics.surface.triangulation import triangulate


@dataclass(frozen=True)
class NormalTurner:
    """What turning needs of a mesh at rest; made by `turner_of`.

    Attributes
    ----------
    triangles : (triangles, 3) int array
    smooth : (points, 3) float array
        Unit normals at rest.
    authored : (n, 3) float array
    owners : (n,) int array
        The point of each authored normal.
    """

    triangles: IntArray
    smooth: FloatArray
    authored: FloatArray
    owners: IntArray

    def turn(self, points: FloatArray) -> FloatArray:
        """Return the authored normals on a moved surface: (n, 3) float array, for (points, 3)."""
        now = smooth_normals(points, self.triangles)[self.owners]
        rest = self.smooth[self.owners]
        axis = np.cross(rest, now)
        cosine = np.einsum("ij,ij->i", rest, now)
        across = np.cross(axis, self.authored)
        # Rodrigues' formula for the rotation of one unit vector onto another; it has no value for
        # opposite ones, where a fold of skin is: there the normal turns with half a turn's limit.
        lift = np.cross(axis, across) / np.maximum(1 + cosine, 1e-3)[:, None]
        turned: FloatArray = self.authored + across + lift
        length = np.linalg.norm(turned, axis=1, keepdims=True)
        return np.asarray(turned / np.maximum(length, 1e-12))


def turner_of(
    points: FloatArray,
    face_counts: IntArray,
    face_indices: IntArray,
    authored: FloatArray,
    *,
    per_corner: bool,
) -> NormalTurner:
    """Prepare to turn a mesh's authored normals.

    Parameters
    ----------
    points : (points, 3) float array
        At rest.
    face_counts, face_indices : int arrays
    authored : (n, 3) float array
        One per point, or one per corner of a face.
    per_corner : bool
    """
    triangles, _ = triangulate(face_counts, face_indices)
    owners = face_indices if per_corner else np.arange(len(points))
    return NormalTurner(triangles, smooth_normals(points, triangles), authored, owners)


def smooth_normals(points: FloatArray, triangles: IntArray) -> FloatArray:
    """Return unit normals of points, each face weighted by its area; 0 where there is no face."""
    a, b, c = (points[triangles[:, i]] for i in range(3))
    across = np.cross(b - a, c - a)
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
