"""The control cage of the head: edge loops round the eyes, the mouth and the nostrils.

Half a head of quads, x >= 0. A grid of rows (neck to crown) and columns (midline round the ear to
the nape) has two blocks cut out; each is filled with rings that run round the eye and the mouth, as
a modeller lays them, so that lids and lips open along loops. Ring by ring the points carry the
attributes that the shapes need later: how far from the lips, upper or lower side, and so on.
"""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import FloatArray, IntArray
from usdface.demo.cage_grid import lay_grid, lay_grid_faces
from usdface.demo.cage_rings import lay_eye, lay_mouth
from usdface.demo.half_cage import HalfCage
from usdface.demo.halves import mirror_half
from usdface.demo.proportions import Style
from usdface.demo.sculpt import Form


@dataclass(frozen=True)
class Cage:
    """A whole cage, left half first.

    Attributes
    ----------
    points : (points, 3) float array
        [mm]
    faces : (faces, 4) int array
    marks : (points, len(Mark)) float array
    mirror : (points,) int array
    """

    points: FloatArray
    faces: IntArray
    marks: FloatArray
    mirror: IntArray


def build_cage(style: Style, form: Form) -> Cage:
    """Lay the cage of a style over its sculpted form."""
    half = HalfCage()
    grid = lay_grid(half, style, form)
    lay_grid_faces(half, grid)
    lay_mouth(half, style, form, grid)
    lay_eye(half, style, form, grid)
    return _mirrored(half)


def _mirrored(half: HalfCage) -> Cage:
    whole = mirror_half(np.array(half.points), np.array(half.faces))
    return Cage(whole.points, whole.faces, np.array(half.marks)[whole.source], whole.mirror)
