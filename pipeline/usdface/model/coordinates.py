"""Markers to coordinates of the motion space, with or without all markers."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from usdface.assets import BoolArray, FloatArray, MotionSpace

NOISE_FLOOR_MM = 0.05
"""Least noise assumed of a marker's coordinate: optical systems resolve about this."""


@dataclass(frozen=True)
class Coordinates:
    """Frames as coordinates of the motion space.

    Attributes
    ----------
    values : (frames, dimensions) float array
        [mm]
    certainty : (frames,) float array
        Share of the markers that are seen times the share of the face's motion that they
        determine [0-1].
    residual_mm : (frames,) float array
        Root mean square distance of the markers seen from what the motion space can say [mm].
    """

    values: FloatArray
    certainty: FloatArray
    residual_mm: FloatArray


def noise_variance(motion: MotionSpace) -> float:
    """Variance of one marker coordinate that the components leave over [mm^2]."""
    left = motion.components.shape[1] - len(motion.components)
    unexplained = motion.total_variance - float(motion.variances.sum())
    return float(max(unexplained / max(left, 1), NOISE_FLOOR_MM**2))


def marker_coordinates(
    motion: MotionSpace,
    positions: NDArray[np.float32] | NDArray[np.float64],
    *,
    visible: BoolArray | None = None,
) -> Coordinates:
    """Project frames onto the motion space; unseen markers by their conditional mean.

    Where markers are unseen, the coordinates are those most probable given the others, under the
    Gaussian that the motion space describes: probabilistic PCA (Tipping and Bishop 1999) with
    missing data. Frames with the same markers unseen share one small solve.

    Parameters
    ----------
    motion : MotionSpace
    positions : (frames, markers, 3) float array
        In the motion space's head space [mm]; what is not visible is not read.
    visible : (frames, markers) bool array, optional
        By default all are.
    """
    frames, markers = positions.shape[:2]
    seen = np.ones((frames, markers), dtype=bool) if visible is None else visible
    offsets = positions.reshape(frames, -1).astype(np.float64)
    offsets -= motion.mean
    offsets[~np.repeat(seen, 3, axis=1)] = 0.0  # also what keeps NaN out
    values = offsets @ motion.components.T
    certainty = np.ones(frames)
    for pattern, rows in _patterns(seen):
        values[rows], certainty[rows] = _conditional(motion, offsets[rows], pattern)
    away = offsets - values @ motion.components
    away[~np.repeat(seen, 3, axis=1)] = 0.0
    squared = np.einsum("ij,ij->i", away, away) / np.maximum(seen.sum(axis=1), 1)
    return Coordinates(values, certainty, np.sqrt(squared))


def _patterns(seen: BoolArray) -> list[tuple[BoolArray, NDArray[np.int64]]]:
    """Frames with something unseen, grouped by what."""
    partial = np.flatnonzero(~seen.all(axis=1))
    if not len(partial):
        return []
    packed = np.packbits(seen[partial], axis=1)
    _, first, place = np.unique(packed, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(place, kind="stable")
    ends = np.cumsum(np.bincount(place))
    return [
        (seen[partial[first[k]]], partial[order[ends[k] - size : ends[k]]])
        for k, size in enumerate(np.bincount(place))
    ]


def _conditional(
    motion: MotionSpace, offsets: FloatArray, pattern: BoolArray
) -> tuple[FloatArray, float]:
    basis = motion.components[:, np.repeat(pattern, 3)]
    noise = noise_variance(motion)
    prior = noise / np.maximum(motion.variances, 1e-6 * noise)
    precision = basis @ basis.T + np.diag(prior)
    values = np.linalg.solve(precision, basis @ offsets[:, np.repeat(pattern, 3)].T).T
    left = noise * float(np.trace(np.linalg.inv(precision)))
    held = noise * float((1 / (1 + prior)).sum())  # what stays unknown even with all markers
    total = float(motion.variances.sum())
    determined = float(np.clip(1 - (left - held) / max(total, 1e-300), 0.0, 1.0))
    return values.astype(np.float64), determined * float(pattern.mean())
