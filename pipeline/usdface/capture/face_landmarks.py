"""Landmarks of MediaPipe's face mesh that are used as markers, with their names.

The mesh has 468 points of the face and 10 of the irises. The markers are those of moving parts
(lips, lids, brows, cheeks, jaw) and of the head's pose; the model has no detail between them.

References
----------
Kartynnik, Ablavatski, Grishchenko and Grundmann (2019), Real-time facial surface geometry from
monocular video on mobile GPUs, CVPR workshop on computer vision for AR/VR.
Ablavatski et al. (2020), Real-time pupil tracking from monocular video for digital puppetry.
"""

import re
from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import IntArray

LANDMARK_COUNT = 478
"""468 of the mesh, then 5 of each iris."""

_MIDDLE = {
    "forehead": (10, 151, 9),
    "brow_centre": (8,),
    "nose_bridge": (168, 6, 197, 195),
    "nose": (5, 4, 19, 94, 2),
    "nose_tip": (1,),
    "lip_upper": (0, 11, 12, 13),
    "lip_lower": (14, 15, 16, 17),
    "lip_below": (18,),
    "chin": (200, 199, 175, 152),
}
_RIGHT_LEFT = {
    "forehead": ((109, 67, 103, 108, 69, 104), (338, 297, 332, 337, 299, 333)),
    "forehead_outer": ((54, 68, 21, 71), (284, 298, 251, 301)),
    "brow_inner": ((107, 55), (336, 285)),
    "brow_middle": ((66, 105, 65, 52), (296, 334, 295, 282)),
    "brow_outer": ((63, 70, 53, 46), (293, 300, 283, 276)),
    "eye_inner": ((133,), (362,)),
    "eye_outer": ((33,), (263,)),
    "lid_upper": ((246, 161, 160, 159, 158, 157, 173), (466, 388, 387, 386, 385, 384, 398)),
    "lid_lower": ((7, 163, 144, 145, 153, 154, 155), (249, 390, 373, 374, 380, 381, 382)),
    "iris": ((468, 469, 470, 471, 472), (473, 476, 475, 474, 477)),
    "nose_side": ((122, 196, 198, 49), (351, 419, 420, 279)),
    "nose_wing": ((129, 64, 98), (358, 294, 327)),
    "mouth_corner": ((61, 78), (291, 308)),
    "lip_upper": ((185, 40, 39, 37, 191, 80, 81, 82), (409, 270, 269, 267, 415, 310, 311, 312)),
    "lip_lower": ((146, 91, 181, 84, 95, 88, 178, 87), (375, 321, 405, 314, 324, 318, 402, 317)),
    "lip_above": ((165,), (391,)),
    "cheek": (
        (50, 101, 36, 205, 206, 203, 118, 117, 187, 192, 212, 210),
        (280, 330, 266, 425, 426, 423, 347, 346, 411, 416, 432, 430),
    ),
    "temple": ((127, 234), (356, 454)),
    "jaw": ((93, 132, 58, 172, 136, 150, 149, 148), (323, 361, 288, 397, 365, 379, 378, 377)),
}
"""Numbers of the performer's right side, then those of the left in the same order."""

RIGID_PARTS = (
    *("nose_bridge", "nose_tip", "nose", "eye_inner", "eye_outer", "temple"),
    *("forehead", "forehead_outer"),
)
"""Parts where skin moves over the skull by at most a millimetre (`label_hints.skin_motion_mm`), for
the distance of the head. Landmark noise is as large, so many points are better than the few with
the least motion."""


@dataclass(frozen=True)
class LandmarkSet:
    """Landmarks of the mesh that are markers, in the order of a take."""

    names: tuple[str, ...]
    """Part of the face, side, and a number within the part, the same on both sides, such as
    ``lip_upper_L4``; no side in the middle: ``nose_bridge_1``."""
    indices: IntArray
    """(markers,): numbers in the mesh."""
    mirror: IntArray
    """(markers,): index in this set of the corresponding landmark on the other side."""

    def columns(self, *parts: str) -> IntArray:
        """Return the indices in this set of the landmarks of some parts, both sides."""
        part_of = [re.sub(r"_[LR]?\d+$", "", name) for name in self.names]
        return np.array([at for at, part in enumerate(part_of) if part in parts], np.int64)

    def column(self, index: int) -> int:
        """Return the index in this set of a landmark of the mesh."""
        return int(np.flatnonzero(self.indices == index)[0])

    @property
    def rigid(self) -> tuple[str, ...]:
        """Names of the markers that move with the skull, within about a millimetre."""
        return tuple(self.names[column] for column in self.columns(*RIGID_PARTS))


def _landmark_set() -> LandmarkSet:
    names, indices, partners = list[str](), list[int](), list[int]()
    for part, middle in _MIDDLE.items():
        names += [f"{part}_{number}" for number in range(1, len(middle) + 1)]
        indices += middle
        partners += middle
    for part, sides in _RIGHT_LEFT.items():
        for number, (right, left) in enumerate(zip(*sides, strict=True), start=1):
            names += [f"{part}_R{number}", f"{part}_L{number}"]
            indices += [right, left]
            partners += [left, right]
    place = {index: column for column, index in enumerate(indices)}
    mirror = [place[index] for index in partners]
    return LandmarkSet(tuple(names), np.array(indices), np.array(mirror))


LANDMARKS = _landmark_set()

_ROWS = (
    (61, 185, 40, 39, 37, 0, 267, 269, 270, 409, 291),
    (61, 146, 91, 181, 84, 17, 314, 405, 321, 375, 291),
    (78, 191, 80, 81, 82, 13, 312, 311, 310, 415, 308),
    (78, 95, 88, 178, 87, 14, 317, 402, 318, 324, 308),
    (33, 246, 161, 160, 159, 158, 157, 173, 133),
    (33, 7, 163, 144, 145, 153, 154, 155, 133),
    (362, 398, 384, 385, 386, 387, 388, 466, 263),
    (362, 382, 381, 380, 374, 373, 390, 249, 263),
    (70, 63, 105, 66, 107),
    (46, 53, 52, 65, 55),
    (336, 296, 334, 293, 300),
    (285, 295, 282, 283, 276),
)
"""Mesh numbers along the outer and inner edges of the lips, the lids and the brows."""

LANDMARK_ROWS = tuple(
    tuple(LANDMARKS.names[LANDMARKS.column(index)] for index in row) for row in _ROWS
)
"""Names of the landmarks along each edge, from the performer's right to the left."""
