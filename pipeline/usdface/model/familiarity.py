"""How far a frame is from what the references showed."""

from collections.abc import Sequence

import numpy as np
from scipy.spatial.distance import cdist, pdist

from usdface.assets import FloatArray, MotionSpace
from usdface.model.coordinates import noise_variance
from usdface.numerics.regression.cross_validation import Fold

DIMENSIONS = 24
"""Components looked at: beyond these, noise would make every frame a stranger."""

SIGNAL_TO_NOISE = 4.0
"""Least variance of a component looked at, in variances of marker noise."""

NOISE = 1e-3
LINEAR_SHARE = 0.5

LEAST_ERROR = 0.3
"""Of the tolerance: references predict each other well where the face is simple, and say nothing
of what it has not shown."""


def fit_familiarity(
    coordinates: FloatArray,
    motion: MotionSpace,
    *,
    folds: Sequence[Fold],
    error_over_tolerance: float = 1.0,
) -> dict[str, FloatArray]:
    """Learn how much of a frame the references say: the variance of a Gaussian process.

    Parameters
    ----------
    coordinates : (pairs, dimensions) float array
        Of the references.
    motion : MotionSpace
    folds : sequence of Fold
        Of the cross-validation that the error comes from.
    error_over_tolerance : float
        Error of references predicted by other folds, over the error that halves the confidence:
        turns variance into the error to expect.

    Returns
    -------
    dict of str to float array
        What `familiarity` reads, as part of a mapping.
    """
    heard = int((motion.variances > SIGNAL_TO_NOISE * noise_variance(motion)).sum())
    kept = max(1, min(DIMENSIONS, coordinates.shape[1], heard))
    scale = motion.variances[:kept] ** -0.25  # half whitened
    rows = coordinates[:, :kept] * scale
    width = float(np.median(pdist(rows, "sqeuclidean"))) or 1.0
    size = float(np.einsum("ij,ij->", rows, rows)) / len(rows) or 1.0
    settings = np.array([width, size, 1.0])
    covariance = _kernel(rows, rows, settings)
    inverse = np.linalg.inv(covariance + NOISE * np.eye(len(rows)))
    unseen = np.concatenate([_unseen_variance(covariance, fold) for fold in folds])
    settings[2] = float(np.mean(unseen)) / max(error_over_tolerance, LEAST_ERROR) ** 2
    return {
        "familiar_rows": rows,
        "familiar_scale": scale,
        "familiar_inverse": inverse,
        "familiar_settings": settings,
    }


def familiarity(arrays: dict[str, FloatArray], coordinates: FloatArray) -> FloatArray:
    """Rate frames by how well the references cover them.

    Parameters
    ----------
    arrays : dict
        From `fit_familiarity`.
    coordinates : (frames, dimensions) float array

    Returns
    -------
    (frames,) float array
        Near 1 where the error to expect is far below the tolerance, 0.5 where it reaches it,
        towards 0 beyond.
    """
    scale, settings = arrays["familiar_scale"], arrays["familiar_settings"]
    rows = coordinates[:, : len(scale)] * scale
    known = _kernel(rows, arrays["familiar_rows"], settings)
    own = 1.0 + LINEAR_SHARE * np.einsum("ij,ij->i", rows, rows) / settings[1]
    left = own - np.einsum("ij,ij->i", known @ arrays["familiar_inverse"], known)
    rated: FloatArray = 1 / (1 + np.maximum(left, 0.0) / settings[2])
    return rated


def _unseen_variance(covariance: FloatArray, fold: Fold) -> FloatArray:
    """Variance of a fold's tested references, given those it trains on."""
    known = covariance[np.ix_(fold.train, fold.train)] + NOISE * np.eye(len(fold.train))
    shared = covariance[np.ix_(fold.train, fold.test)]
    explained = np.einsum("ij,ij->j", shared, np.linalg.solve(known, shared))
    left: FloatArray = np.maximum(np.diag(covariance)[fold.test] - explained, NOISE)
    return left


def _kernel(left: FloatArray, right: FloatArray, settings: FloatArray) -> FloatArray:
    out: FloatArray = np.exp(-0.5 * cdist(left, right, "sqeuclidean") / settings[0])
    out += LINEAR_SHARE * (left @ right.T) / settings[1]
    return out
