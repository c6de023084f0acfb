"""Fit a levelled cloud to a character's face within the plane of symmetry."""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import FloatArray

_AXES_HELD = 0.35
"""[of the cloud's energy] Ridge of each axis' scale towards the common scale."""


@dataclass(frozen=True)
class PlaneFit:
    """``aligned = scale * (levelled @ rotation.T) + shift``."""

    rotation: FloatArray
    """(3, 3): about the X axis (pitch)."""
    scale: FloatArray
    """(3,): character over performer, along the face's axes."""
    shift: FloatArray
    """(3,) [mm]"""

    def apply(self, levelled: FloatArray) -> FloatArray:
        """Return points in the face's frame of the character."""
        return np.asarray(self.scale * (levelled @ self.rotation.T) + self.shift)


def fit_in_plane(
    levelled: FloatArray, targets: FloatArray, spreads: FloatArray, *, rounds: int = 15
) -> PlaneFit:
    """Fit pitch, scales and the two shifts in the sagittal plane to targets, robustly.

    Minimises ``sum |R s y + t - x|^2 / spread^2`` with Cauchy weights; the axes' scales are shrunk
    towards one, since a face's markers are nearly a plane.

    Parameters
    ----------
    levelled : (n, 3) float array
        The plane of symmetry at x = 0 [mm].
    targets : (n, 3) float array
        In the character's frame, its plane of symmetry at x = 0 [mm].
    spreads : (n,) float array
        Standard deviations of the targets [mm].
    """
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
        shift = goal - scale * (rotation @ centre) * in_plane
        fit = PlaneFit(rotation, scale, shift)
        away = np.linalg.norm(fit.apply(levelled) - targets, axis=1) / spreads
        weight = base / (1 + (away / 2.0) ** 2)
    return PlaneFit(rotation, scale, shift)


def pitch_rotation(angle: float) -> FloatArray:
    """Return the rotation about X by an angle [radians]."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
