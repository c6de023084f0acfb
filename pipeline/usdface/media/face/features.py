"""Lips and brows of a face without colours, located by its shapes.

In plain skin, a mouth is a line and a raised brow a slight shade, which are hard to judge. Lips lie
along the line where the jaw opener parts the skin, brows along the largest motion of the brow
shapes above the eyes. Their thickness is a share of the mouth's width and of the eyes' distance,
typical of adults.

Both are bands of colour on the resting face, evaluated per pixel: sharp at any resolution of the
mesh, and moving with the skin.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from usdface.core.arrays import BoolArray, Float32Array, FloatArray, smoothstep
from usdface.core.assets import Rig, RigMesh
from usdface.core.deformer import Deformer
from usdface.media.face import shading
from usdface.media.face.parts import Eyeball
from usdface.numerics.measure.face_regions import jaw_opener, shapes_by_region
from usdface.numerics.measure.performance_error import find_lip_pairs

_UPPER_LIP, _LOWER_LIP = 0.26, 0.32
"""Height of the lips in the middle [half widths of the mouth]."""
_LIP_EDGE = 0.10
"""Width of the transition to skin [half widths of the mouth]."""
_BROW_INNER, _BROW_OUTER = -0.21, 0.33
"""Ends of a brow, from the eye's centre outwards [distances of the eyes]."""
_BROW_BAND = (0.16, 0.75)
"""Range above the eye's centre that is searched for a brow [distances of the eyes]."""
_BROW_HALF = 0.045
"""Half of a brow's largest height [distances of the eyes]."""
_BROW_EDGE = 0.06
"""Width of the transition to skin [distances of the eyes]."""
_RIDGE_POWER = 8
"""Exponent of the relative motion in the fit, which gives weight to its maximum."""
_LEAST_LINE = 6
"""Points needed to fit the line of a mouth or of a brow."""
BAND_ROWS = 17
"""Samples of a band from end to end, as in the shader of pages."""


@dataclass(frozen=True)
class ColorBand:
    """A band of colour along a curve on the resting face."""

    ends: tuple[float, float]
    """The least and the largest x [mm]."""
    rows: Float32Array
    """(BAND_ROWS, 4) [mm]: at equal steps of x: y of the curve, reach of the colour above and below
    it, and least z."""
    edge: float
    """Width over which the colour fades, centred on the reach [mm]."""
    color: Float32Array
    """(3,): linear."""

    def meets(self, corners: FloatArray) -> BoolArray:
        """Return the triangles that may meet the band, from (n, 3, 3) corners at rest [mm]."""
        curve, above, below, least = self.rows.T
        room = self.edge / 2
        low = (self.ends[0], float((curve - below).min()) - room, float(least.min()))
        high = (self.ends[1], float((curve + above).max()) + room, np.inf)
        reaches = (corners.max(axis=1) > low) & (corners.min(axis=1) < high)
        return np.asarray(reaches.all(axis=1))

    def share(self, rest: Float32Array) -> Float32Array:
        """Return the opacity of the colour at points of the resting face [0-1].

        `rest`: (n, 3) [mm].
        """
        x, y, z = rest.T
        along = (x - self.ends[0]) / (self.ends[1] - self.ends[0])
        at = np.clip(along, 0, 1) * (BAND_ROWS - 1)
        low = np.minimum(at.astype(np.int64), BAND_ROWS - 2)
        toward = (at - low)[:, None]
        curve, above, below, least = ((1 - toward) * self.rows[low] + toward * self.rows[low + 1]).T
        beyond = np.abs(y - curve) - np.where(y > curve, above, below)
        here = (along > 0) & (along < 1) & (z > least)
        return np.asarray(np.where(here, smoothstep(0.5 - beyond / self.edge), 0), np.float32)


def find_bands(
    meshes: Sequence[RigMesh], eyeballs: Iterable[Eyeball], skin: BoolArray
) -> tuple[ColorBand, ...]:
    """Return the bands of the lips and the brows that can be located.

    `skin`: (points,), points of skin, all meshes concatenated.
    """
    points = np.concatenate([mesh.points for mesh in meshes])
    names, offsets = _offsets(meshes)
    lips = _lips(points, names, offsets)
    return (*lips, *_brows(points, names, offsets, list(eyeballs), skin))


def _band(x: FloatArray, rows: Sequence[ArrayLike], edge: float, color: Float32Array) -> ColorBand:
    """Return a band of samples in ascending or descending x, with zero height at its ends."""
    order = np.argsort(x)
    curve, above, below, least = (np.broadcast_to(row, x.shape) for row in rows)
    inner = (np.arange(len(x)) > 0) & (np.arange(len(x)) < len(x) - 1)
    above, below = (np.where(inner, row, -edge / 2) for row in (above, below))
    table = np.stack([curve, above, below, least], axis=1)[order].astype(np.float32)
    return ColorBand((float(x.min()), float(x.max())), table, edge, color)


def _offsets(meshes: Sequence[RigMesh]) -> tuple[tuple[str, ...], sparse.csr_array]:
    """Return the names of all shapes, and their offsets at weight 1: (shapes, 3 * points)."""
    names = tuple(dict.fromkeys(shape.name for mesh in meshes for shape in mesh.shapes))
    ranges = np.tile([0.0, 1.0], (len(names), 1))
    return names, Deformer(Rig(Path(), "", names, tuple(meshes), ranges)).shapes.target_offsets()


def _moved_by(offsets: sparse.csr_array, shape: int) -> FloatArray:
    """Return the displacement of each point by a shape: (points, 3) [mm]."""
    return np.asarray(offsets[[shape]].toarray(), float).reshape(-1, 3)


def _lips(
    points: FloatArray, names: tuple[str, ...], offsets: sparse.csr_array
) -> tuple[ColorBand, ...]:
    jaw = jaw_opener(names)
    mouth = shapes_by_region(names).get("mouth")
    if jaw is None or mouth is None:
        return ()
    pairs = find_lip_pairs(points, offsets, jaw_open=jaw, mouth=mouth, to_corners=True)
    if pairs is None or len(pairs.lower) < _LEAST_LINE:
        return ()
    line = (points[pairs.lower] + points[pairs.upper]) / 2
    if not np.ptp(line[:, 0]) > 0:
        return ()
    gap = np.abs(points[pairs.upper, 1] - points[pairs.lower, 1])
    middle = (line[:, 0].min() + line[:, 0].max()) / 2
    opened = _moved_by(offsets, jaw)
    opening = np.linalg.norm(opened[pairs.upper] - opened[pairs.lower], axis=1)
    fall, widest = np.polyfit((line[:, 0] - middle) ** 2, opening, 1).tolist()
    if not fall < 0 < widest:
        return ()
    half = float(np.sqrt(-widest / fall))  # where the opening falls to zero
    across = (line[:, 0] - middle) / half
    height, depth = (np.polyfit(across, line[:, axis], 2) for axis in (1, 2))
    along = np.linspace(-1, 1, BAND_ROWS)
    taper = half * (1 - along**2) ** 0.8
    rows = (
        np.polyval(height, along),
        _UPPER_LIP * taper + np.median(gap) / 2,
        _LOWER_LIP * taper + np.median(gap) / 2,
        np.polyval(depth, along) - half / 2,
    )
    return (_band(middle + half * along, rows, half * _LIP_EDGE, shading.LIPS),)


def _brows(
    points: FloatArray,
    names: tuple[str, ...],
    offsets: sparse.csr_array,
    eyeballs: list[Eyeball],
    skin: BoolArray,
) -> list[ColorBand]:
    shapes = shapes_by_region(names).get("brows")
    if shapes is None or len(eyeballs) != 2:
        return []
    motion = np.array(
        [np.linalg.norm(_moved_by(offsets, shape), axis=1) for shape in shapes.tolist()]
    )
    largest = motion.max(axis=1, keepdims=True)
    moved = (motion / np.maximum(largest, 1e-9)).max(axis=0) ** _RIDGE_POWER
    centers = np.array([ball.center for ball in eyeballs])
    apart = float(np.linalg.norm(centers[1] - centers[0]))
    along = np.linspace(0, 1, BAND_ROWS)
    across = _BROW_INNER + (_BROW_OUTER - _BROW_INNER) * along
    half = apart * _BROW_HALF * np.minimum(1.4 * (1 - along), np.minimum(0.3 + 6 * along, 1.0))
    bands = []
    for center, other in (centers, centers[::-1]):
        side = float(np.sign(center[0] - other[0]))
        out = (points[:, 0] - center[0]) * side / apart
        up = (points[:, 1] - center[1]) / apart
        here = skin & (out > _BROW_INNER) & (out < _BROW_OUTER) & (points[:, 2] > center[2])
        band = np.flatnonzero(here & (up > _BROW_BAND[0]) & (up < _BROW_BAND[1]) & (moved > 0))
        if len(band) < _LEAST_LINE or not np.ptp(out[band]) > 0:
            continue
        arch = np.polyfit(out[band], up[band], 2, w=np.sqrt(moved[band]))
        rows = (center[1] + apart * np.polyval(arch, across), half, half, center[2])
        x = center[0] + side * apart * across
        bands.append(_band(x, rows, apart * _BROW_EDGE, shading.BROWS))
    return bands
