"""Left halves made whole: everything on the head is built once and mirrored exactly."""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import FloatArray, IntArray

ON_MIDLINE = 1e-6
"""Points nearer to the midline than this are shared by both halves [mm]."""


@dataclass(frozen=True)
class Whole:
    """A symmetric mesh.

    Attributes
    ----------
    points : (points, 3) float array
        The left half first, x >= 0.
    faces : (faces, 4) int array
    mirror : (points,) int array
        Index of each point's mirror image; points on the midline are their own.
    source : (points,) int array
        The point of the half that each one was made from.
    """

    points: FloatArray
    faces: IntArray
    mirror: IntArray
    source: IntArray


def mirror_half(points: FloatArray, faces: IntArray) -> Whole:
    """Mirror the left half of a mesh; points on the midline become exact and shared."""
    count = len(points)
    middle = np.abs(points[:, 0]) < ON_MIDLINE
    image = np.where(middle, np.arange(count), count + np.cumsum(~middle) - 1)
    own = np.where(middle[:, None], points * (0.0, 1.0, 1.0), points)
    return Whole(
        points=np.concatenate([own, own[~middle] * (-1.0, 1.0, 1.0)]),
        faces=np.concatenate([faces, image[faces][:, ::-1]]),
        mirror=np.concatenate([image, np.flatnonzero(~middle)]),
        source=np.concatenate([np.arange(count), np.flatnonzero(~middle)]),
    )


def grid_faces(rows: int, columns: int, *, closed: bool = False, flip: bool = False) -> IntArray:
    """Quads over a grid of points; `closed` joins the last column to the first."""
    ids = np.arange(rows * columns).reshape(rows, columns)
    if closed:
        ids = np.concatenate([ids, ids[:, :1]], axis=1)
    quads = np.stack([ids[:-1, :-1], ids[:-1, 1:], ids[1:, 1:], ids[1:, :-1]], axis=-1)
    quads = quads.reshape(-1, 4)
    return quads[:, ::-1] if flip else quads
