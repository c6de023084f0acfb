"""Logarithm and exponential map of rotations about a mean rotation.

Rotation vectors relative to a mean are nearly linear well within half a turn of it, which holds for
the joints of a face, and every vector is a rotation. Neither holds for quaternions or Euler angles,
so regressions use these vectors.
"""

import numpy as np

from usdface.core.arrays import FloatArray, row_lengths

_SMALL_HALF_ANGLE = 1e-8
"""[rad] Below it the sine over the angle is 1 to rounding."""


def mean_rotation(quaternions: FloatArray) -> FloatArray:
    """Return Markley's mean of rotations, which does not depend on the signs of the quaternions.

    Returns (..., 4).

    Parameters
    ----------
    quaternions : (n, ..., 4) float array
        w first, unit length.

    References
    ----------
    Markley, Cheng, Crassidis and Oshman (2007), *Averaging quaternions*.
    """
    moment = np.einsum("n...i,n...j->...ij", quaternions, quaternions)
    mean: FloatArray = np.linalg.eigh(moment)[1][..., -1]
    return np.where(mean[..., :1] < 0, -mean, mean)


def rotation_vectors(quaternions: FloatArray, mean: FloatArray) -> FloatArray:
    """Return the rotation vectors from the mean to each rotation: (..., 3) [rad]."""
    turn = multiply_quaternions(mean * [1.0, -1.0, -1.0, -1.0], quaternions)
    turn = np.where(turn[..., :1] < 0, -turn, turn)  # angles up to half a turn
    sine = np.linalg.norm(turn[..., 1:], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, turn[..., :1])
    per_sine = np.where(sine > _SMALL_HALF_ANGLE, angle / np.maximum(sine, _SMALL_HALF_ANGLE), 2.0)
    return np.asarray(turn[..., 1:] * per_sine)


def rotations_at(vectors: FloatArray, mean: FloatArray) -> FloatArray:
    """Return the mean rotated by rotation vectors: (..., 4) unit quaternions, w first."""
    half = 0.5 * row_lengths(vectors)
    ratio = 0.5 * np.where(
        half > _SMALL_HALF_ANGLE, np.sin(half) / np.maximum(half, _SMALL_HALF_ANGLE), 1.0
    )
    return multiply_quaternions(mean, np.concatenate([np.cos(half), vectors * ratio], axis=-1))


def multiply_quaternions(left: FloatArray, right: FloatArray) -> FloatArray:
    """Return the Hamilton product, the rotation `right` followed by `left`; w first."""
    w, x, y, z = np.moveaxis(np.asarray(left), -1, 0)
    a, b, c, d = np.moveaxis(np.asarray(right), -1, 0)
    return np.stack(
        [
            w * a - x * b - y * c - z * d,
            w * b + x * a + y * d - z * c,
            w * c - x * d + y * a + z * b,
            w * d + x * c - y * b + z * a,
        ],
        axis=-1,
    )


def normalize_quaternions(quaternions: FloatArray) -> FloatArray:
    """Return quaternions at unit length."""
    length = np.linalg.norm(quaternions, axis=-1, keepdims=True)
    if not (np.isfinite(length).all() and (length > 0).all()):
        raise ValueError("a quaternion is zero or not finite, so it is no rotation")
    return np.asarray(quaternions / length)
