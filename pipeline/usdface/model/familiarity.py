"""How far a frame is from what the references showed."""

import numpy as np
from scipy.spatial.distance import cdist, pdist

from usdface.assets import FloatArray, MotionSpace
from usdface.model.coordinates import noise_variance

DIMENSIONS = 24
"""Components looked at: beyond these, noise would make every frame a stranger."""

SIGNAL_TO_NOISE = 4.0
"""Least variance of a component looked at, in variances of marker noise."""

NOISE = 1e-3
LINEAR_SHARE = 0.5


def fit_familiarity(coordinates: FloatArray, motion: MotionSpace) -> dict[str, FloatArray]:
    """Learn how much of a frame the references say: the variance of a Gaussian process.

    Parameters
    ----------
    coordinates : (pairs, dimensions) float array
        Of the references.
    motion : MotionSpace

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
    inverse = np.linalg.inv(_kernel(rows, rows, settings) + NOISE * np.eye(len(rows)))
    # Variance of each reference had it not been one: 1 / inverse_ii - noise.
    unseen = np.maximum(1 / np.diag(inverse) - NOISE, NOISE)
    settings[2] = float(np.median(unseen))
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
        1 at a reference, 0.5 where the frame is as new as the references are to each other,
        towards 0 beyond.
    """
    scale, settings = arrays["familiar_scale"], arrays["familiar_settings"]
    rows = coordinates[:, : len(scale)] * scale
    known = _kernel(rows, arrays["familiar_rows"], settings)
    own = 1.0 + LINEAR_SHARE * np.einsum("ij,ij->i", rows, rows) / settings[1]
    left = own - np.einsum("ij,ij->i", known @ arrays["familiar_inverse"], known)
    rated: FloatArray = 1 / (1 + (np.maximum(left, 0.0) / settings[2]) ** 2)
    return rated


def _kernel(left: FloatArray, right: FloatArray, settings: FloatArray) -> FloatArray:
    out: FloatArray = np.exp(-0.5 * cdist(left, right, "sqeuclidean") / settings[0])
    out += LINEAR_SHARE * (left @ right.T) / settings[1]
    return out
