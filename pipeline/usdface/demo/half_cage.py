"""The left half of a cage, its mirror image, and subdivision.

The head is built for x >= 0 and mirrored exactly.
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from scipy import sparse

from usdface.core.arrays import FloatArray, IntArray
from usdface.media.face.subdivision import catmull_clark


class Mark(IntEnum):
    """Columns of the attributes of the cage's points."""

    SETTLE = 0
    """1 for points projected to the sculpted form, 0 for points that stay."""
    MOUTH_RING = 1
    """0 where the lips meet, 1 fullest lip, 2 border of the lip, 4 outermost; below 0 inside."""
    MOUTH_SIDE = 2
    """+1 upper lip, -1 lower lip, 0 corner and elsewhere."""
    EYE_RING = 3
    """0 on the edge of the lid, 1 middle of the lid, 2 crease, 4 outermost; below 0 behind."""
    EYE_SIDE = 4
    """+1 upper lid, -1 lower lid, 0 corners and elsewhere."""
    NOSTRIL = 5
    """1 deep in the nostril."""


NO_RING = 9.0
"""Ring number of points outside all rings."""


class HalfCage:
    """Collects the points and quads of the left half of a cage."""

    def __init__(self) -> None:
        self.points: list[FloatArray] = []
        self.marks: list[FloatArray] = []
        self.faces: list[tuple[int, int, int, int]] = []

    def point(self, position: FloatArray, **marks: float) -> int:
        """Add a point with marks by lower-case name; return its index."""
        values = np.zeros(len(Mark))
        values[Mark.SETTLE] = 1.0
        values[[Mark.MOUTH_RING, Mark.EYE_RING]] = NO_RING
        for name, value in marks.items():
            values[Mark[name.upper()]] = value
        self.points.append(np.asarray(position, float))
        self.marks.append(values)
        return len(self.points) - 1

    def strip(self, first: list[int], second: list[int]) -> None:
        """Join two rows of the same length by quads that face outwards if the second is above."""
        for k in range(len(first) - 1):
            self.faces.append((first[k], first[k + 1], second[k + 1], second[k]))


MIDLINE_TOLERANCE = 1e-6
"""Distance from the midline below which points are shared by both halves [mm]."""


@dataclass(frozen=True)
class Whole:
    """A symmetric mesh."""

    points: FloatArray
    """(points, 3): the left half first, x >= 0."""
    faces: IntArray
    """(faces, 4)"""
    mirror: IntArray
    """(points,): index of each point's mirror image; itself on the midline."""
    source: IntArray
    """(points,): index of each point in the half."""


def mirror_half(points: FloatArray, faces: IntArray) -> Whole:
    """Mirror the left half of a mesh; points on the midline are set to x = 0 and shared."""
    count = len(points)
    middle = np.abs(points[:, 0]) < MIDLINE_TOLERANCE
    image = np.where(middle, np.arange(count), count + np.cumsum(~middle) - 1)
    left = np.where(middle[:, None], points * (0.0, 1.0, 1.0), points)
    return Whole(
        points=np.concatenate([left, left[~middle] * (-1.0, 1.0, 1.0)]),
        faces=np.concatenate([faces, image[faces][:, ::-1]]),
        mirror=np.concatenate([image, np.flatnonzero(~middle)]),
        source=np.concatenate([np.arange(count), np.flatnonzero(~middle)]),
    )


def grid_faces(rows: int, columns: int, *, closed: bool = False, flip: bool = False) -> IntArray:
    """Return the quads of a grid of points; `closed` joins the last column to the first."""
    ids = np.arange(rows * columns).reshape(rows, columns)
    if closed:
        ids = np.concatenate([ids, ids[:, :1]], axis=1)
    quads = np.stack([ids[:-1, :-1], ids[:-1, 1:], ids[1:, 1:], ids[1:, :-1]], axis=-1)
    quads = quads.reshape(-1, 4)
    return quads[:, ::-1] if flip else quads


REFINEMENT_LEVELS = 2


def refine(faces: IntArray, mirror: IntArray) -> tuple[sparse.csr_array, IntArray, IntArray]:
    """Subdivide a cage by Catmull and Clark's rules, with borders as creases.

    Returns the matrix, (fine points, points), for positions and attributes, whose rows sum to 1;
    the fine faces, (fine faces, 4); and the index of each fine point's mirror image.

    `faces`: (faces, 4). `mirror`: (points,); the topology must be symmetric under it.
    """
    count = len(mirror)
    matrix = sparse.eye_array(count, format="csr")
    for _ in range(REFINEMENT_LEVELS):
        step = catmull_clark(
            np.full(len(faces), 4, np.int64), faces.ravel(), point_count=matrix.shape[0]
        )
        matrix = sparse.csr_array(step.matrix @ matrix)
        faces = step.face_indices.reshape(-1, 4)
    # Random labels of the cage identify mirror images: both have the same weights, mirrored.
    label = np.random.default_rng(0).random(count)
    labels, images = (np.asarray(matrix @ values) for values in (label, label[mirror]))
    by_label, by_image = np.argsort(labels), np.argsort(images)
    partner = np.empty(len(by_label), np.int64)
    partner[by_image] = by_label
    return matrix, faces, partner
