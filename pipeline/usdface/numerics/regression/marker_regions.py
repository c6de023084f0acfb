"""What part of the face each shape moves, and features that look at that part alone.

The jaw moves centimetres and a lid millimetres. Seen over all markers, the lid drowns; seen over
the markers that its shapes move, it does not. Which markers those are is learned from all frames
of a take through weights that a first, plain mapping gives them.
"""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import FloatArray

_RIDGE = 0.02  # of the frames, on standardised weights: shapes that act together share the motion


@dataclass(frozen=True)
class RegionalFeatures:
    """Coordinates that measure distance over one region.

    Attributes
    ----------
    projection : (D, D) float array
        ``coordinates @ projection`` are uncorrelated over the sample, the largest variance first.
    variances : (D,) float array
    """

    projection: FloatArray
    variances: FloatArray


def marker_relevance(
    sample: FloatArray,
    weights: FloatArray,
    components: FloatArray,
    *,
    sharpness: float = 1.0,
    floor: float = 0.05,
) -> FloatArray:
    """How much each marker has to do with each shape.

    Markers are regressed on weights; a marker's relevance is how far it moves with the shape,
    against the marker that moves most.

    Parameters
    ----------
    sample : (frames, D) float array
        Coordinates in the motion space.
    weights : (frames, s) float array
        Of the same frames, from any mapping.
    components : (D, markers * 3) float array
    sharpness : float
        2 squares the fall-off.
    floor : float
        Least relevance: no marker is ignored wholly.

    Returns
    -------
    (s, markers) float array
        In [floor, 1].
    """
    centred = weights - weights.mean(axis=0)
    standard = centred / (centred.std(axis=0) + 1e-4)
    normal = standard.T @ standard + _RIDGE * len(standard) * np.eye(standard.shape[1])
    moves = np.linalg.solve(normal, standard.T @ (sample - sample.mean(axis=0))) @ components
    length = np.linalg.norm(moves.reshape(len(moves), -1, 3), axis=2)
    share = length / np.maximum(length.max(axis=1, keepdims=True), 1e-12)
    relevance: FloatArray = np.maximum(share**sharpness, floor)
    return relevance


def regional_features(
    components: FloatArray, covariance: FloatArray, relevance: FloatArray
) -> RegionalFeatures:
    """Principal axes of the motion under a metric that weighs markers by relevance.

    Parameters
    ----------
    components : (D, markers * 3) float array
    covariance : (D, D) float array
        Of the coordinates over all frames [mm^2].
    relevance : (markers,) float array
    """
    seen = components * np.repeat(relevance, 3)
    metric = seen @ seen.T
    metric += 1e-9 * np.trace(metric) * np.eye(len(metric))
    factor = np.linalg.cholesky(metric)
    values, vectors = np.linalg.eigh(factor.T @ covariance @ factor)
    variances = np.maximum(values[::-1], 1e-9 * values[-1])
    return RegionalFeatures(factor @ vectors[:, ::-1], variances)
