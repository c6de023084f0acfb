"""Fit a levelled cloud to a character's face within the plane of symmetry."""

import numpy as np

from usdface.core.arrays import FloatArray
from usdface.numerics.registration.cloud_alignment import Alignment

_AXES_HELD = 0.35
"""[of the cloud's energy] Ridge of each axis' scale towards the common scale."""

_LARGEST_RATIO = 2.0
"""Of an axis' scale to that of the whole: wrong targets would make it negative."""


def fit_in_plane(
    levelled: FloatArray,
    targets: FloatArray,
    spreads: FloatArray,
    *,
    centre_x: float,
    rounds: int = 15,
) -> Alignment:
    """Fit pitch, scales and the two shifts in the sagittal plane to targets, robustly.

    Minimises ``sum |R s y + t - x|^2 / spread^2`` with Cauchy weights; the axes' scales are shrunk
    towards one, since a face's markers are nearly a plane.

    Parameters
    ----------
    levelled : (n, 3) float array
        The plane of symmetry at x = 0 [mm].
    targets : (n, 3) float array
        In the character's frame [mm].
    spreads : (n,) float array
        Standard deviations of the targets [mm].
    centre_x : float
        X of the character's plane of symmetry [mm].
    """
    centre_of_character = np.array([centre_x, 0.0, 0.0])
    targets = targets - centre_of_character
    base = 1 / spreads**2
    weight = base
    rotation, scale, shift = np.eye(3), np.ones(3), np.zeros(3)
    in_plane = np.array([0.0, 1.0, 1.0])
    for _ in range(rounds):
        share = weight / weight.sum()
        centre, goal = share @ levelled * in_plane, share @ targets * in_plane
        y, x = levelled - centre, targets - goal
        sine = share @ (x[:, 2] * y[:, 1] - x[:, 1] * y[:, 2])
        cosine = share @ (x[:, 1] * y[:, 1] + x[:, 2] * y[:, 2])
        rotation = pitch_rotation(float(np.arctan2(sine, cosine)))
        turned = y @ rotation.T
        energy = share @ turned**2
        common = (share @ (turned * x).sum(axis=1)) / energy.sum()
        held = _AXES_HELD * energy.mean()
        scale = (share @ (turned * x) + held * common) / (energy + held)
        size = np.sqrt((share @ x**2).sum() / energy.sum())
        scale = np.clip(scale, size / _LARGEST_RATIO, size * _LARGEST_RATIO)
        shift = goal - scale * (rotation @ centre) * in_plane
        placed = scale * (levelled @ rotation.T) + shift
        away = np.linalg.norm(placed - targets, axis=1) / spreads
        weight = base / (1 + (away / 2.0) ** 2)
    return Alignment(scale, rotation, shift + centre_of_character)


def pitch_rotation(angle: float) -> FloatArray:
    """Return the rotation about X by an angle [radians]."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
