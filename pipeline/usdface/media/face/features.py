"""Lips and brows of a face without colours, found by what its shapes do.

A mouth is a line in plain skin, and a raised brow a shade on it: neither can be judged. Lips lie
along the line at which the opening jaw parts the skin, brows along the ridge of what the shapes of
the brows move, above the eyes. How thick they are is a share of the mouth and of the eyes'
distance, as in most adults.

Both are bands of colour on the resting face. Pictures and pages look up where on it each pixel
lies, so that a band is as sharp on few points as on many, and moves with the skin.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from usdface.core.arrays import BoolArray, Float32Array, FloatArray
from usdface.core.assets import RigMesh
from usdface.media.face import shading
from usdface.media.face.parts import Eyeball
from usdface.numerics.measure.face_regions import jaw_opener, shapes_by_region
from usdface.numerics.measure.performance_error import find_lip_pairs

_UPPER_LIP, _LOWER_LIP = 0.26, 0.32
"""[of the mouth's half width] Height of the red in the middle."""
_LIP_EDGE = 0.10
"""[of the same] Over which red becomes skin."""
_BROW_INNER, _BROW_OUTER = -0.21, 0.33
"""[of the eyes' distance] Ends of a brow, from the eye's middle outwards."""
_BROW_BAND = (0.16, 0.75)
"""[of the same] Above the eye's middle: where a brow is looked for."""
_BROW_HALF = 0.045
"""[of the same] Half of a brow's height, at its thickest."""
_BROW_EDGE = 0.06
"""[of the same] Over which it becomes skin."""
_RIDGE_POWER = 8
"""Of the share of a shape's largest motion: the ridge counts, not its slopes."""
_LEAST_LINE = 6
"""Points of a line of the mouth, or of a brow's ridge, that tell where it runs."""
BAND_ROWS = 17
"""Samples of a band from end to end; the pages' shader has as many."""


@dataclass(frozen=True)
class ColorBand:
    """A band of colour along a curve on the resting face."""

    ends: tuple[float, float]
    """The least and the largest x [mm]."""
    rows: Float32Array
    """(BAND_ROWS, 4) [mm]: at equal steps of x, y of the curve, how far the colour reaches above
    and below it, and z that it lies before."""
    edge: float
    """[mm] Over which the colour fades, half of it beyond the reach."""
    color: Float32Array
    """(3,): linear."""

    def meets(self, corners: FloatArray) -> BoolArray:
        """Return which triangles the band may lie on, from (n, 3, 3) corners at rest [mm]."""
        curve, above, below, least = self.rows.T
        room = self.edge / 2
        low = (self.ends[0], float((curve - below).min()) - room, float(least.min()))
        high = (self.ends[1], float((curve + above).max()) + room, np.inf)
        reaches = (corners.max(axis=1) > low) & (corners.min(axis=1) < high)
        return np.asarray(reaches.all(axis=1))

    def share(self, rest: Float32Array) -> Float32Array:
        """Return how much of the colour there is at points of the resting face [0-1].

        Parameters
        ----------
        rest : (n, 3) float32 array
            [mm]
        """
        x, y, z = rest.T
        along = (x - self.ends[0]) / (self.ends[1] - self.ends[0])
        at = np.clip(along, 0, 1) * (BAND_ROWS - 1)
        low = np.minimum(at.astype(np.int64), BAND_ROWS - 2)
        toward = (at - low)[:, None]
        curve, above, below, least = ((1 - toward) * self.rows[low] + toward * self.rows[low + 1]).T
        beyond = np.abs(y - curve) - np.where(y > curve, above, below)
        faded = np.clip(0.5 - beyond / self.edge, 0, 1)
        here = (along > 0) & (along < 1) & (z > least)
        return np.asarray(np.where(here, faded**2 * (3 - 2 * faded), 0), np.float32)


def find_bands(
    meshes: Sequence[RigMesh], eyeballs: Iterable[Eyeball], skin: BoolArray
) -> tuple[ColorBand, ...]:
    """Return the lips and the brows that are found.

    Parameters
    ----------
    skin : (points,) bool array
        Where they may lie, of the points of all meshes in a row.
    """
    points = np.concatenate([mesh.points for mesh in meshes])
    names, offsets = _offsets(meshes)
    lips = _lips(points, names, offsets)
    return (*lips, *_brows(points, names, offsets, list(eyeballs), skin))


def _band(x: FloatArray, rows: Sequence[ArrayLike], edge: float, color: Float32Array) -> ColorBand:
    """Make a band of samples from one end to the other, either way; nothing is left at its ends."""
    order = np.argsort(x)
    curve, above, below, least = (np.broadcast_to(row, x.shape) for row in rows)
    inner = (np.arange(len(x)) > 0) & (np.arange(len(x)) < len(x) - 1)
    above, below = (np.where(inner, row, -edge / 2) for row in (above, below))
    table = np.stack([curve, above, below, least], axis=1)[order].astype(np.float32)
    return ColorBand((float(x.min()), float(x.max())), table, edge, color)


def _offsets(meshes: Sequence[RigMesh]) -> tuple[tuple[str, ...], sparse.csr_array]:
    """Return the names of all shapes, and what each at 1 does to all points."""
    names = tuple(dict.fromkeys(shape.name for mesh in meshes for shape in mesh.shapes))
    row_of, first = {name: row for row, name in enumerate(names)}, 0
    rows, columns, values = [np.zeros(0, int)], [np.zeros(0, int)], [np.zeros(0)]
    for mesh in meshes:
        for shape in mesh.shapes:
            key = shape.keys[-1]
            at = (3 * (first + key.points)[:, None] + np.arange(3)).ravel()
            rows.append(np.full(len(at), row_of[shape.name]))
            columns.append(at)
            values.append(np.asarray(key.offsets, float).ravel())
        first += len(mesh.points)
    given = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
    return names, sparse.csr_array(given, shape=(len(names), 3 * first))


def _motion(offsets: sparse.csr_array, shape: int) -> FloatArray:
    """Return how far a shape moves each point [mm]."""
    moved = np.asarray(offsets[[shape]].toarray(), float).reshape(-1, 3)
    return np.asarray(np.linalg.norm(moved, axis=1))


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
    opened = np.asarray(offsets[[jaw]].toarray(), float).reshape(-1, 3)
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
    motion = np.array([_motion(offsets, int(shape)) for shape in shapes])
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
