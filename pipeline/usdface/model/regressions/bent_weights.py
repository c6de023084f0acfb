"""Bent weights: a curve through each shape's weight, in which displacements are nearly linear."""

import numpy as np

from usdface.core.arrays import FloatArray, RealArray


def bend(weights: FloatArray, curve: float) -> FloatArray:
    """Return bent weights ``w + curve w (1 - w)``, extrapolated linearly beyond [0-1].

    At half its weight a shape has often moved the performer's skin by more than half: displacements
    are closer to linear in bent weights. `unbend` is the inverse.

    Parameters
    ----------
    weights : (n, s) float array
        Normalised: [0-1] over each shape's range.
    curve : float
        In [0, 1).
    """
    inside = np.clip(weights, 0.0, 1.0)
    bent: FloatArray = inside + curve * inside * (1 - inside)
    bent += (1 + curve) * np.minimum(weights, 0.0)
    bent += (1 - curve) * np.maximum(weights - 1.0, 0.0)
    return bent


def unbend(bent: FloatArray, curve: float) -> FloatArray:
    """Return weights from bent weights: the inverse of `bend`."""
    inside = np.clip(bent, 0.0, 1.0)
    root = np.sqrt((1 + curve) ** 2 - 4 * curve * inside)
    weights: FloatArray = 2 * inside / (1 + curve + root)
    weights += np.minimum(bent, 0.0) / (1 + curve)
    weights += np.maximum(bent - 1.0, 0.0) / (1 - curve)
    return weights


def unbend_slope(bent: RealArray, curve: float) -> RealArray:
    """Return the derivative of `unbend`."""
    slope: RealArray = 1 / np.sqrt((1 + curve) ** 2 - 4 * curve * np.clip(bent, 0.0, 1.0))
    return slope
