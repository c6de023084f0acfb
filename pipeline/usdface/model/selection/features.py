"""The space in which faces are compared when references are chosen: every region counts alike.

Over all markers the jaw, which moves centimetres, drowns the lids, which move millimetres; a
selection that looks at the whole face leaves blinks to chance. Here each part of the face is seen
through the markers that its shapes move, and brought to the size of the others. The parts stand
side by side, so that a combination, a blink under a lowered brow, is a place of its own.
"""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import Float32Array, FloatArray, IntArray
from usdface.core.assets import MotionSpace
from usdface.numerics.measure.face_regions import shapes_by_region
from usdface.numerics.regression.reference_design import whiten
from usdface.numerics.regression.regional_process import marker_relevance, regional_features

Features = Float32Array | FloatArray
"""Of an hour they are kept in single precision; what is reckoned with is double."""

REGION_DIMENSIONS = 10
"""Principal axes of each region: beyond these a region differs by noise."""

WHITENING_POWER = 0.5
"""0 leaves axes as they are, which see only the largest motion; 1 makes all equal, noise too."""

WHOLE_FACE = "face"


@dataclass(frozen=True)
class SelectionSpace:
    """Features of frames from coordinates in the motion space."""

    projection: FloatArray
    """(dimensions, features)"""
    offset: FloatArray
    """(features,): so that the mean face lies at 0."""
    regions: tuple[str, ...]
    columns: tuple[tuple[int, int], ...]
    """Columns of the features of each region, first and one past the last."""
    relevance: FloatArray
    """(regions, markers): how much each marker has to do with each region [0-1]."""

    def features(self, coordinates: FloatArray) -> FloatArray:
        """Return features of frames: (frames, dimensions) to (frames, features)."""
        return np.asarray(coordinates @ self.projection - self.offset)


def features_at(features: Features, rows: IntArray) -> FloatArray:
    """Return features of some frames, to reckon with."""
    return np.asarray(features[rows], dtype=np.float64)


def selection_space(
    motion: MotionSpace, weights: FloatArray, shape_names: tuple[str, ...]
) -> SelectionSpace:
    """Learn what each region is from weights of the motion space's sample.

    Parameters
    ----------
    weights : (sample frames, shapes) float array
        Of `motion.sample`, from the rig's geometry or any mapping: they need only tell which
        markers move with which shapes.
    shape_names : tuple of str
        Names tell the regions; where they do not, the whole face is one.
    """
    mean = motion.sample.mean(axis=0)
    covariance = np.cov(motion.sample.T) if len(motion.sample) > 1 else np.diag(motion.variances)
    covariance = np.atleast_2d(covariance)
    markers = motion.components.shape[1] // 3
    found = shapes_by_region(shape_names)
    moving = np.ptp(weights, axis=0) > 0
    found = {region: columns[moving[columns]] for region, columns in found.items()}
    regions = tuple(region for region, columns in found.items() if len(columns))
    if len(regions) < 2:
        regions, relevance = (WHOLE_FACE,), np.ones((1, markers))
    else:
        each = marker_relevance(motion.sample, weights, motion.components)
        relevance = np.stack([each[found[region]].max(axis=0) for region in regions])
    kept = min(REGION_DIMENSIONS if len(regions) > 1 else 32, len(motion.variances))
    parts = []
    for row in relevance:
        axes = regional_features(motion.components, covariance, row)
        scaled = whiten(axes.projection[:, :kept], axes.variances[:kept], power=WHITENING_POWER)
        size = np.sqrt(np.mean(np.sum(((motion.sample - mean) @ scaled) ** 2, axis=1)))
        parts.append(scaled / max(float(size), 1e-300))
    projection = np.concatenate(parts, axis=1)
    columns = tuple((start, start + kept) for start in range(0, kept * len(regions), kept))
    return SelectionSpace(projection, mean @ projection, regions, columns, relevance)
