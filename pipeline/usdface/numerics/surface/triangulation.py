"""Polygons cut into triangles."""

import numpy as np

from usdface.core.arrays import IntArray


def triangulate(face_counts: IntArray, face_indices: IntArray) -> tuple[IntArray, IntArray]:
    """Cut polygons into fans of triangles.

    Parameters
    ----------
    face_counts : (faces,) int array
    face_indices : (corners,) int array

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
