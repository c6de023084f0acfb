"""Lips and brows of a face without colours, found by what its shapes do.

A mouth is a line in plain skin, and a raised brow a shade on it: neither can be judged. Lips lie
along the line at which the opening jaw parts the skin, brows along the ridge of what the shapes of
the brows move, above the eyes. How thick they are is a share of the mouth and of the eyes'
distance, as in most adults.
"""

from collections.abc import Iterable, Sequence

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from usdface.core.arrays import BoolArray, FloatArray
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
_RIDGE_POWER = 4
"""Of the share of a shape's largest motion: the ridge counts, not its slopes."""
_LEAST_LINE = 6
"""Points of a line of the mouth, or of a brow's ridge, that tell where it runs."""


def paint_features(
    colors: FloatArray, meshes: Sequence[RigMesh], eyeballs: Iterable[Eyeball], skin: BoolArray
) -> None:
    """Paint lips and brows, where they are found, over plain skin.

    Parameters
    ----------
    colors : (points, 3) float array
        Of the points of all meshes in a row, linear; changed in place.
    skin : (points,) bool array
        Where it may be painted.
    """
    points = np.concatenate([mesh.points for mesh in meshes])
    names, offsets = _offsets(meshes)
    shades = (
        (_lips(points, names, offsets), shading.LIPS),
        (_brows(points, names, offsets, list(eyeballs), skin), shading.BROWS),
    )
    for share, color in shades:
        colors += np.where(skin, share, 0.0)[:, None] * (color - colors)


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


def _lips(points: FloatArray, names: tuple[str, ...], offsets: sparse.csr_array) -> FloatArray:
    """Return the share of lip in each point's colour."""
    none, jaw = np.zeros(len(points)), jaw_opener(names)
    mouth = shapes_by_region(names).get("mouth")
    if jaw is None or mouth is None:
        return none
    pairs = find_lip_pairs(points, offsets, jaw_open=jaw, mouth=mouth, to_corners=True)
    if pairs is None or len(pairs.lower) < _LEAST_LINE:
        return none
    line = (points[pairs.lower] + points[pairs.upper]) / 2
    if not np.ptp(line[:, 0]) > 0:
        return none
    gap = np.abs(points[pairs.upper, 1] - points[pairs.lower, 1])
    middle = (line[:, 0].min() + line[:, 0].max()) / 2
    opened = np.asarray(offsets[[jaw]].toarray(), float).reshape(-1, 3)
    opening = np.linalg.norm(opened[pairs.upper] - opened[pairs.lower], axis=1)
    fall, widest = np.polyfit((line[:, 0] - middle) ** 2, opening, 1).tolist()
    if not fall < 0 < widest:
        return none
    half = float(np.sqrt(-widest / fall))  # where the opening falls to zero
    across = (line[:, 0] - middle) / half
    along = (points[:, 0] - middle) / half
    height, depth = (np.polyfit(across, line[:, axis], 2) for axis in (1, 2))
    away = points[:, 1] - np.polyval(height, np.clip(along, -1, 1))
    before = points[:, 2] > np.polyval(depth, np.clip(along, -1, 1)) - half / 2
    taper = np.maximum(1 - along**2, 0.0) ** 0.8
    reach = half * np.where(away > 0, _UPPER_LIP, _LOWER_LIP) * taper + np.median(gap) / 2
    red = _falling(np.abs(away) - reach, half * _LIP_EDGE)
    return np.asarray(np.where(before & (taper > 0), red, 0.0))


def _brows(
    points: FloatArray,
    names: tuple[str, ...],
    offsets: sparse.csr_array,
    eyeballs: list[Eyeball],
    skin: BoolArray,
) -> FloatArray:
    """Return the share of brow in each point's colour."""
    share = np.zeros(len(points))
    shapes = shapes_by_region(names).get("brows")
    if shapes is None or len(eyeballs) != 2:
        return share
    motion = np.array([_motion(offsets, int(shape)) for shape in shapes])
    largest = motion.max(axis=1, keepdims=True)
    moved = (motion / np.maximum(largest, 1e-9)).max(axis=0) ** _RIDGE_POWER
    centers = np.array([ball.center for ball in eyeballs])
    apart = float(np.linalg.norm(centers[1] - centers[0]))
    for center, other in (centers, centers[::-1]):
        out = (points[:, 0] - center[0]) * np.sign(center[0] - other[0]) / apart
        up = (points[:, 1] - center[1]) / apart
        here = skin & (out > _BROW_INNER) & (out < _BROW_OUTER) & (points[:, 2] > center[2])
        band = np.flatnonzero(here & (up > _BROW_BAND[0]) & (up < _BROW_BAND[1]))
        band = band[moved[band] > 0]
        if len(band) < _LEAST_LINE or not np.ptp(out[band]) > 0:
            continue
        nearest = np.asarray(cKDTree(points[band]).query(points[band], k=2)[0])
        if np.median(nearest[:, 1]) > 2 * _BROW_HALF * apart:
            continue  # the colours of points would make a blot of it
        arch = np.polyfit(out[band], up[band], 2, w=np.sqrt(moved[band]))
        along = (out - _BROW_INNER) / (_BROW_OUTER - _BROW_INNER)
        half = _BROW_HALF * np.clip(1.4 * (1 - along), 0.25, 1.0)
        share = np.maximum(
            share,
            np.where(here, _falling(np.abs(up - np.polyval(arch, out)) - half, _BROW_EDGE), 0.0)
            * _falling(np.abs(along - 0.5) - 0.4, 0.2),
        )
    return share


def _falling(beyond: FloatArray, edge: float) -> FloatArray:
    """Fall smoothly from 1 to 0 about 0, over an edge."""
    limited = np.clip(0.5 - beyond / edge, 0, 1)
    return np.asarray(limited**2 * (3 - 2 * limited))
