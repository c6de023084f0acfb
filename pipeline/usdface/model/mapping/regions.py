"""Regions of the face, and samples of the rig's surface."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from usdface.core.arrays import FloatArray, IntArray, coordinates_of, sample_frames
from usdface.model.placement.label_hints import face_region, label_hint
from usdface.numerics.measure.face_regions import (
    REGIONS,
    gaze_and_tongue_shapes,
    points_by_region,
    shapes_by_region,
)

if TYPE_CHECKING:
    from scipy import sparse

    from usdface.model.regressions.base import Face

FACE = "face"
"""Name of the first region, the whole face."""

SKIN_POINTS = 1500
"""Largest number of points in a sample of the surface."""

_SEEN_SHARE = 0.1
"""Motion at a marker, relative to the largest of a region's shapes, from which the marker shows the
region: as much extends from a region to its neighbour."""

_RIDGE_SHARE = 0.02
"""Ridge per pair on the weights, which divides the motion between correlated shapes."""


def region_points(names: tuple[str, ...], motion: FloatArray) -> dict[str, IntArray]:
    """Assign every point to the region whose shapes move it most.

    Returns the indices of each region's points, the whole face first.

    Parameters
    ----------
    names : tuple of str
        Names of the shapes, or their parts from
        `usdface.model.placement.shape_parts.shape_parts`; if none names a part of the face, the
        whole is the only region.
    motion : (shapes, points, 3) float array
        Displacements by each shape at 1 [mm].
    """
    from scipy import sparse  # importing takes half a second

    regions = points_by_region(sparse.csr_array(motion.reshape(len(motion), -1)), names)
    return {FACE: np.arange(motion.shape[1])} | regions


def marker_motion(weights: FloatArray, markers: FloatArray) -> FloatArray:
    """Fit the displacement of markers by each shape: (shapes, markers, 3) [mm].

    Of weights (pairs, shapes) and markers (pairs, markers, 3).
    """
    rows = weights - weights.mean(axis=0)
    deviations = (markers - markers.mean(axis=0)).reshape(len(markers), -1)
    normal = rows.T @ rows + _RIDGE_SHARE * len(rows) * np.eye(rows.shape[1])
    basis: FloatArray = np.linalg.solve(normal, rows.T @ deviations)
    return basis.reshape(rows.shape[1], -1, 3)


def membership(points: dict[str, IntArray], count: int) -> FloatArray:
    """Return the indicator matrix of points in regions: (regions, count) array of 0 and 1."""
    return np.array([np.isin(np.arange(count), each) for each in points.values()], np.float64)


def regions_without_markers(
    parts: tuple[str, ...], face: Face, labels: Sequence[str], rigid: Sequence[str]
) -> tuple[str, ...]:
    """Return the regions that no marker shows, by the positions of the markers on the rig.

    The shapes of such a region move the skin at every marker by less than `_SEEN_SHARE` of their
    largest displacement, and no marker is named after it. Empty if a marker's position is unknown.

    Parameters
    ----------
    parts : tuple of str
        Part of the face of each shape; see `region_points`.
    labels, rigid : sequence of str
        Names of all markers, and of those that move with the skull alone.
    """
    if face.skin is None or face.rest is None or face.rest.markers is None:
        return ()
    positions = face.rest.markers[[label not in rigid for label in labels]]
    if not len(positions) or not np.isfinite(positions).all():
        return ()
    hints = {label_hint(label).region for label in labels} - {""}
    nearest = [
        int(np.linalg.norm(face.rest.points - position, axis=1).argmin()) for position in positions
    ]
    length = np.linalg.norm(face.skin, axis=2)
    return tuple(
        region
        for region, shapes in shapes_by_region(parts).items()
        if not any(hint in region for hint in hints)
        and np.linalg.norm(length[shapes][:, nearest].max(axis=1))
        < _SEEN_SHARE * np.linalg.norm(length[shapes].max(axis=1))
    )


def regions_without_shapes(
    parts: tuple[str, ...], labels: Sequence[str], rigid: Sequence[str]
) -> tuple[str, ...]:
    """Return the regions that markers are labelled after and that the rig has no shapes for.

    Empty if the region of a shape is unknown, as it may be one of these.

    Parameters
    ----------
    parts : tuple of str
        Part of the face of each shape; see `region_points`.
    labels, rigid : sequence of str
        Names of all markers, and of those that move with the skull alone.
    """
    known, hidden = shapes_by_region(parts), gaze_and_tongue_shapes(parts)
    if sum(map(len, known.values())) + len(hidden) < len(parts):
        return ()
    named = {face_region(label) for label in labels if label not in rigid}
    return tuple(region for region in REGIONS if region in named and region not in known)


def skin_points(offsets: FloatArray | sparse.sparray) -> IntArray:
    """Sample a surface: points evenly spaced in the order of those that shapes move.

    `offsets`: displacements by each shape at 1, (shapes, points * 3) [mm].
    """
    from usdface.numerics.solve.blendshapes import moving_points  # imports SciPy: half a second

    moving = moving_points(offsets)
    return np.asarray(moving[sample_frames(len(moving), SKIN_POINTS)], dtype=np.int64)


def offsets_at(offsets: FloatArray | sparse.sparray, points: IntArray) -> FloatArray:
    """Return the displacements of points: (shapes, points, 3) [mm]."""
    from scipy import sparse  # importing takes half a second

    table = sparse.csc_array(offsets)
    sampled: FloatArray = np.asarray(table[:, coordinates_of(points)].toarray(), dtype=np.float64)
    return sampled.reshape(table.shape[0], len(points), 3)


def region_grams(
    gram: FloatArray, skin: FloatArray | None, names: tuple[str, ...], regions: tuple[str, ...]
) -> FloatArray:
    """Return the Gram matrix of the shapes' displacements per region: (regions, shapes, shapes).

    Parameters
    ----------
    gram : (shapes, shapes) float array
        Of the whole face; also used for regions without points of the skin [mm^2].
    skin : (shapes, points, 3) float array or None
        Displacements by each shape at 1 [mm].
    names : tuple of str
        As of `region_points`.
    regions : tuple of str
        The whole face first.
    """
    grams = np.tile(gram, (len(regions), 1, 1))
    if skin is None:
        return grams
    points = region_points(names, skin)
    for row, region in enumerate(regions[1:], start=1):
        if len(points.get(region, ())):
            offsets = skin[:, points[region]].reshape(len(skin), -1)
            grams[row] = offsets @ offsets.T / len(points[region])
    return grams
