"""Rotation of a character's motion at a performer's markers.

Where the skin of two faces slopes differently, it slides in another direction. The rotation of
marker k maximises, over its neighbours j (Kabsch 1976, with a prior at no rotation)::

    sum_j exp(-d_jk^2 / 2 L^2) sum_f y_fj . R m_fj + lambda_k trace(R)

``m``: displacements by the character's shapes; ``y``: of the performer. Amplitudes are not
compared: they cannot be told from those of the weights.
"""

import numpy as np

from usdface.core.arrays import BoolArray, FloatArray
from usdface.numerics.rigid.rigid_alignment import optimal_rotations

_SKIN_MM = 15.0
"""Distance over which neighbouring markers share the rotation of the skin."""

_UNTURNED_SHARE, _UNTURNED_MM = 0.3, 1.0
"""Weight of no rotation: share of the motion, and RMS motion [mm] that counts as much; markers that
hardly move show no direction."""


def skin_rotations(
    neutral: FloatArray, predicted: FloatArray, measured: FloatArray, *, visible: BoolArray
) -> FloatArray:
    """Return the rotation of the motion at each marker, from the character to the performer.

    Returns (markers, 3, 3).

    Parameters
    ----------
    neutral : (markers, 3) float array
        [mm]
    predicted, measured : (frames, markers, 3) float arrays
        Displacements ``m`` by the shapes, for weights solved without rotation, and ``y`` [mm].
    visible : (frames, markers) bool array
        False also for markers that are not used.
    """
    near = np.exp(-0.5 * ((neutral[:, None] - neutral) ** 2).sum(axis=2) / _SKIN_MM**2)
    m, y = (np.where(visible[:, :, None], each, 0.0) for each in (predicted, measured))
    cross = np.tensordot(near, np.einsum("fmi,fmj->mij", y, m, optimize=True), axes=1)
    motion = near @ (m**2).sum(axis=(0, 2)) / 3
    unturned = _UNTURNED_SHARE * motion + _UNTURNED_MM**2 * len(m)
    return optimal_rotations(cross + unturned[:, None, None] * np.eye(3), rank_tolerance=0.0)[0]


def rotate_deltas(deltas: FloatArray, rotations: FloatArray) -> FloatArray:
    """Return displacements of each marker, (shapes, markers, 3), rotated by its rotation."""
    return np.einsum("mij,smj->smi", rotations, deltas, optimize=True)
