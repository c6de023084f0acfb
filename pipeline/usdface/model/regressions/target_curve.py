"""A bend between weights and what they do: skin that moves more at first than at last.

A shape at half its weight has often moved the skin by more than half. Trained on ``t = w + c w
(1 - w)``, lines fit better; the prediction is bent back. Each shape has its bend, as far as
the pairs can tell it from the one that suits all: a lid saturates where a brow does not.
"""

import numpy as np

from usdface.core.arrays import FloatArray

CURVES = (0.0, 0.15, 0.3, 0.45, 0.6, 0.75)
"""Bends tried; 0 is none, 1 would stand still at full weight."""

_SHAPE_DEVIATION = 0.15
"""Standard deviation of the bend of one shape around that of all."""

_LIMIT_MARGIN = 0.05
"""Weights this far from both 0 and 1 count as evidence of a bend."""


def choose_curves(errors: FloatArray, weights: FloatArray, gram: FloatArray) -> FloatArray:
    """Choose a bend for every shape.

    Parameters
    ----------
    errors : (curves, n, s) float array
        Of pairs left out, under each of `CURVES`.
    weights : (n, s) float array
        Normalised: [0-1] over each shape's range.
    gram : (s, s) float array
        What errors do to the surface: chooses the bend that suits all shapes.

    Returns
    -------
    (s,) float array
    """
    curves = np.array(CURVES)
    total = np.einsum("cns,st,cnt->c", errors, gram, errors, optimize=True)
    shared = curves[int(total.argmin())]
    partway = ((weights > _LIMIT_MARGIN) & (weights < 1 - _LIMIT_MARGIN)).sum(axis=0)
    squared = (errors**2).mean(axis=1) + 1e-6
    penalty = 0.5 * partway * np.log(squared)
    penalty += 0.5 * ((curves - shared) / _SHAPE_DEVIATION)[:, None] ** 2
    chosen: FloatArray = curves[penalty.argmin(axis=0)]
    return chosen


def bend(weights: FloatArray, curve: float | FloatArray) -> FloatArray:
    """Bend weights; beyond [0-1] the curve goes on along its ends.

    Parameters
    ----------
    weights : (n, s) float array
        Normalised: [0-1] over each shape's range.
    curve : float or (s,) float array
        In [0, 1).
    """
    inside = np.clip(weights, 0.0, 1.0)
    bent: FloatArray = inside + curve * inside * (1 - inside)
    bent += (1 + curve) * np.minimum(weights, 0.0)
    bent += (1 - curve) * np.maximum(weights - 1.0, 0.0)
    return bent


def unbend(bent: FloatArray, curve: float | FloatArray) -> FloatArray:
    """Undo `bend`."""
    inside = np.clip(bent, 0.0, 1.0)
    root = np.sqrt((1 + curve) ** 2 - 4 * curve * inside)
    weights: FloatArray = 2 * inside / (1 + curve + root)
    weights += np.minimum(bent, 0.0) / (1 + curve)
    weights += np.maximum(bent - 1.0, 0.0) / (1 - curve)
    return weights
