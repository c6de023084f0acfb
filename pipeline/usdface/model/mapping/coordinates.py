"""Markers to coordinates of the motion space, with or without all markers."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usdface.core.arrays import BoolArray, FloatArray
from usdface.core.assets import MotionSpace

NOISE_FLOOR_MM = 0.05
"""Least noise assumed of a marker's coordinate: optical systems resolve about this."""


@dataclass(frozen=True)
class Coordinates:
    """Frames as coordinates of the motion space."""

    values: FloatArray
    """(frames, dimensions) [mm]"""
    certainty: FloatArray
    """(frames,): share of the markers that are seen times the share of the face's motion that they
    determine [0-1]."""


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
    positions : (frames, markers, 3) float array
        In the motion space's head space [mm]; what is not visible is not read.
    visible : (frames, markers) bool array, optional
        By default all are.
    """
    frames = len(positions)
    certainty = np.ones(frames)
    # Takes are in single precision, and so is this, at half the time. What the mean loses by it is
    # made good in the product: coordinates are within a millionth of a millimetre.
    kind = positions.dtype
    mean: NDArray[Any] = motion.mean.astype(kind)
    rounding: FloatArray = mean - motion.mean
    offsets: NDArray[Any] = positions.reshape(frames, -1) - mean
    unseen = visible is not None and not visible.all()
    if visible is not None and unseen:
        offsets[~np.repeat(visible, 3, axis=1)] = 0.0  # also what keeps NaN out
    values = (offsets @ motion.components.T.astype(kind)).astype(np.float64)
    values += rounding @ motion.components.T
    if visible is None or not unseen:
        return Coordinates(values, certainty)
    for pattern, rows in _patterns(visible):
        seen = offsets[rows] + rounding
        values[rows], certainty[rows] = _conditional(motion, seen, pattern)
    return Coordinates(values, certainty)


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
    unknown = noise * float((1 / (1 + prior)).sum())  # what stays unknown even with all markers
    total = float(motion.variances.sum())
    determined = float(np.clip(1 - (left - unknown) / max(total, 1e-300), 0.0, 1.0))
    return values.astype(np.float64), determined * float(pattern.mean())
