"""A bend between weights and what they do: skin that moves more at first than at last.

A shape at half its weight has often moved the skin by more than half. Trained on ``t = w + c w
(1 - w)``, lines fit better; the prediction is bent back.
"""

import numpy as np

from usdface.core.arrays import FloatArray


def bend(weights: FloatArray, curve: float) -> FloatArray:
    """Bend weights; beyond [0-1] the curve goes on along its ends.

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
    """Undo `bend`."""
    inside = np.clip(bent, 0.0, 1.0)
    root = np.sqrt((1 + curve) ** 2 - 4 * curve * inside)
    weights: FloatArray = 2 * inside / (1 + curve + root)
    weights += np.minimum(bent, 0.0) / (1 + curve)
    weights += np.maximum(bent - 1.0, 0.0) / (1 - curve)
    return weights
