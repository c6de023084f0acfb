"""Parts of the face, and points of the rig's surface that stand for it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from usdface.core.arrays import FloatArray, IntArray
from usdface.model.placement.label_hints import label_hint
from usdface.numerics.measure.face_regions import points_by_region, shapes_by_region

FACE = "face"
"""The first region: everything."""

_SEEN_SHARE = 0.1
"""Of the largest motion of a part's shapes: as much carries over from a part to its neighbour."""

_RIDGE_SHARE = 0.02
"""Ridge per pair on the weights: shapes that act together share the motion."""


def region_points(names: tuple[str, ...], motion: FloatArray) -> dict[str, IntArray]:
    """Give every point to the part of the face whose shapes move it most.

    Parameters
    ----------
    names : tuple of str
        Of the shapes, or their parts as `usdface.model.placement.shape_parts.shape_parts` finds
        them; where none names a part of the face there is only the whole.
    motion : (shapes, points, 3) float array
        What each shape at 1 does [mm].

    Returns
    -------
    dict of str to (n,) int array
        The whole face first.
    """
    from scipy import sparse  # only when wanted: it takes half a second

    everywhere = np.arange(motion.shape[1])
    found = points_by_region(sparse.csr_array(motion.reshape(len(motion), -1)), names)
    return {FACE: everywhere} | found


def marker_motion(weights: FloatArray, markers: FloatArray) -> FloatArray:
    """Learn what each shape does to each marker: (shapes, markers, 3) float array [mm].

    Parameters
    ----------
    weights : (pairs, shapes) float array
    markers : (pairs, markers, 3) float array
    """
    rows = weights - weights.mean(axis=0)
    seen = (markers - markers.mean(axis=0)).reshape(len(markers), -1)
    normal = rows.T @ rows + _RIDGE_SHARE * len(rows) * np.eye(rows.shape[1])
    moved: FloatArray = np.linalg.solve(normal, rows.T @ seen)
    return moved.reshape(rows.shape[1], -1, 3)


def membership(points: dict[str, IntArray], count: int) -> FloatArray:
    """Return which of `count` points each region holds: (regions, count) array of 0 and 1."""
    table = np.zeros((len(points), count))
    for row, members in enumerate(points.values()):
        table[row, members] = 1.0
    return table


def unseen_regions(
    parts: tuple[str, ...], face: Face, labels: Sequence[str], rigid: Sequence[str]
) -> tuple[str, ...]:
    """Return the parts of the face that no marker sees, by where markers are on the rig.

    There the part's shapes move a marker by less than `_SEEN_SHARE` of what they move the skin, and
    no label names the part. Nothing is returned where a marker's place is not known.

    Parameters
    ----------
    parts : tuple of str
        Of the shapes; see `region_points`.
    labels, rigid : sequence of str
        Of all markers, and of those that move with the skull alone.
    """
    if face.skin is None or face.rest is None or face.rest.markers is None:
        return ()
    places = face.rest.markers[[label not in rigid for label in labels]]
    if not len(places) or not np.isfinite(places).all():
        return ()
    hints = {label_hint(label).region for label in labels} - {""}
    nearest = [int(np.linalg.norm(face.rest.points - each, axis=1).argmin()) for each in places]
    length = np.linalg.norm(face.skin, axis=2)
    return tuple(
        region
        for region, shapes in shapes_by_region(parts).items()
        if not any(hint in region for hint in hints)
        and np.linalg.norm(length[shapes][:, nearest].max(axis=1))
        < _SEEN_SHARE * np.linalg.norm(length[shapes].max(axis=1))
    )


if TYPE_CHECKING:
    from scipy import sparse

    from usdface.model.regressions.base import Face

SKIN_POINTS = 1500
"""Most points of the surface that stand for it."""


def skin_points(offsets: FloatArray | sparse.sparray, *, count: int = SKIN_POINTS) -> IntArray:
    """Choose points that stand for a surface: evenly spaced ones of those that shapes move.

    Parameters
    ----------
    offsets : (shapes, points * 3) float array or sparse array
        What each shape at 1 does to the surface [mm], as `BlendShapes.target_offsets` gives it.
    count : int
        Most points to keep.
    """
    from usdface.numerics.solve.blendshapes import moving_points  # with SciPy: half a second

    moving = moving_points(offsets)
    chosen = np.linspace(0, len(moving) - 1, min(count, len(moving))).astype(np.int64)
    return np.asarray(moving[chosen], dtype=np.int64)


def sample_skin(offsets: FloatArray | sparse.sparray, *, count: int = SKIN_POINTS) -> FloatArray:
    """Return what shapes do to the points of `skin_points`: (shapes, kept, 3)."""
    from scipy import sparse  # only when wanted: it takes half a second

    points, table = skin_points(offsets, count=count), sparse.csc_array(offsets)
    columns = (3 * points[:, None] + np.arange(3)).ravel()
    sampled: FloatArray = np.asarray(table[:, columns].toarray(), dtype=np.float64)
    return sampled.reshape(table.shape[0], len(points), 3)


def region_grams(
    gram: FloatArray, skin: FloatArray | None, names: tuple[str, ...], regions: tuple[str, ...]
) -> FloatArray:
    """Return what small errors of weights do to each region: (regions, shapes, shapes) [mm^2].

    Parameters
    ----------
    gram : (shapes, shapes) float array
        Of the whole face; also that of regions of which the skin has no points.
    skin : (shapes, points, 3) float array or None
        [mm]
    names : tuple of str
        Of the shapes.
    regions : tuple of str
        The whole face first.
    """
    grams = np.tile(gram, (len(regions), 1, 1))
    if skin is None:
        return grams
    points = region_points(names, skin)
    for row, region in enumerate(regions[1:], start=1):
        if len(points.get(region, ())):
            moved = skin[:, points[region]].reshape(len(skin), -1)
            grams[row] = moved @ moved.T / len(points[region])
    return grams
