"""The head's pose where no set of markers is rigid: every marker counts as far as it stays still.

Skin of the forehead follows the brows, skin of the nose the lip: which markers sit on the skull
changes from take to take. Each marker has a prior, how far it moves over the skull by itself, and a
frame's weights follow what it does.
"""

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import uniform_filter1d

from usdface.core.arrays import FloatArray
from usdface.numerics.rigid.rigid_alignment import (
    RigidAlignment,
    align_rigid,
    alignment_residuals,
)

_IRLS_ROUNDS = 15
_SHARE_OF_PRIOR = 0.7
_WEIGHT_EXPONENT = 1.5
"""A marker weighs ``prior^-2 (1 + r^2 / (0.7 prior)^2)^-1.5``, r its residual: heavier than
Gaussian, lighter than Cauchy tails, so that a forehead that moves for a while loses its say."""

_WINDOW_SECONDS = 0.3
"""Residuals are averaged over this time: a marker that moves does so for some frames."""


def align_by_prior(
    positions: ArrayLike,
    reference: ArrayLike,
    *,
    visible: ArrayLike,
    skin_motion_mm: ArrayLike,
    rate: float,
) -> RigidAlignment:
    """Align a reference to every frame, weighing markers by how little they move by themselves.

    Parameters
    ----------
    positions : (frames, markers, 3) array_like
        [mm] Captured.
    reference : (markers, 3) array_like
        At rest.
    visible : (frames, markers) array_like of bool
    skin_motion_mm : (markers,) array_like
        Standard deviation of each marker's motion over the skull [mm]; positive, infinite for one
        that says nothing.
    rate : float
        Frames per second.
    """
    seen = np.asarray(visible, bool)
    prior = np.asarray(skin_motion_mm, float)
    base: FloatArray = seen / prior**2
    window = max(1, round(_WINDOW_SECONDS * rate))
    weights = base
    alignment = align_rigid(positions, reference, weights=weights)
    share = uniform_filter1d(seen.astype(float), window, axis=0, mode="nearest")
    for _ in range(_IRLS_ROUNDS):
        squared = np.where(seen, alignment_residuals(positions, reference, alignment) ** 2, 0.0)
        usual = uniform_filter1d(squared, window, axis=0, mode="nearest") / np.maximum(share, 1e-9)
        weights = base / (1 + usual / (_SHARE_OF_PRIOR * prior) ** 2) ** _WEIGHT_EXPONENT
        alignment = align_rigid(positions, reference, weights=weights)
    return alignment
