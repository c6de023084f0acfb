"""Triangulation of points from several calibrated cameras.

References
----------
Hartley and Sturm (1997), Triangulation, Computer Vision and Image Understanding 68(2), 146-157: the
linear method and the reprojection error.
"""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import BoolArray, FloatArray
from usdface.numerics.rigid.rigid_alignment import align_rigid

_NEWTON_ROUNDS = 5
_NEAREST_DEPTH = 1e-9
_SMALLEST_ANGLE = 1e-6
"""Smallest over largest eigenvalue of a point's normal equations, below which rays are parallel."""


@dataclass(frozen=True)
class CameraPose:
    """Extrinsic parameters of a camera: the point X of the world is R X + t in its space."""

    rotation: FloatArray
    """R: (3, 3); x to the right, y down, z along the view."""
    translation: FloatArray
    """t: (3,), in the unit of the world."""


def triangulate_points(
    seen: FloatArray, weights: FloatArray, poses: list[CameraPose]
) -> FloatArray:
    """Return the points with the least weighted squared reprojection error: (..., 3).

    The linear method, refined by Gauss-Newton steps. NaN where fewer than two views have a weight,
    or their rays are parallel.

    Parameters
    ----------
    seen : (views, ..., 2) float array
        x / z and y / z in each camera's space, without distortion.
    weights : (views, ...) float array
        Inverse variances, up to a factor; views with 0 or less are ignored.
    poses : list of CameraPose
        Of each view.
    """
    counted = (weights > 0) & np.isfinite(seen).all(axis=-1)
    trust = np.where(counted, weights, 0.0)
    image = np.where(counted[..., None], seen, 0.0)
    shape = seen.shape[1:-1]
    enough = counted.sum(axis=0) >= 2
    normal, right = np.zeros((*shape, 3, 3)), np.zeros((*shape, 3))
    for xy, weight, pose in zip(image, trust, poses, strict=True):
        for axis in range(2):
            row = xy[..., axis, None] * pose.rotation[2] - pose.rotation[axis]
            left = pose.translation[axis] - xy[..., axis] * pose.translation[2]
            _add(normal, right, row, left, weight)
    eigenvalues = np.linalg.eigvalsh(normal)
    enough &= eigenvalues[..., 0] > _SMALLEST_ANGLE * eigenvalues[..., 2]
    points = _solve(normal, right, enough)
    for _ in range(_NEWTON_ROUNDS):
        normal, right = np.zeros((*shape, 3, 3)), np.zeros((*shape, 3))
        for xy, weight, pose in zip(image, trust, poses, strict=True):
            local = points @ pose.rotation.T + pose.translation
            z = np.maximum(local[..., 2], _NEAREST_DEPTH)
            for axis in range(2):
                projected = local[..., axis] / z
                row = (pose.rotation[axis] - projected[..., None] * pose.rotation[2]) / z[..., None]
                _add(normal, right, row, xy[..., axis] - projected, weight)
        points = points + _solve(normal, right, enough)
    points[~enough] = np.nan
    return points


def _add(
    normal: FloatArray, right: FloatArray, row: FloatArray, left: FloatArray, weight: FloatArray
) -> None:
    """Add an equation, row · x = left, to the normal equations."""
    normal += weight[..., None, None] * row[..., :, None] * row[..., None, :]
    right += (weight * left)[..., None] * row


def _solve(normal: FloatArray, right: FloatArray, usable: BoolArray) -> FloatArray:
    regular = np.where(usable[..., None, None], normal, np.eye(3))
    return np.where(usable[..., None], np.linalg.solve(regular, right[..., None])[..., 0], 0.0)


def average_heads(
    points: FloatArray, heads: FloatArray, weights: FloatArray, rigidity: FloatArray
) -> FloatArray:
    """Return the mean of the heads measured by single cameras, aligned with triangulated points.

    Triangulation determines the head pose. Along the line of sight its noise is that of a picture
    over the sine of the angle between two cameras, larger than that of the depth which a face model
    predicts from one picture.

    A face model places a landmark on different skin in different views. The mean difference between
    cameras, point by point, is removed from each, so that the mean does not jump where one of them
    loses the point.

    Parameters
    ----------
    points : (frames, points, 3) float array
        Triangulated, finite.
    heads : (views, frames, points, 3) float array
        In each camera's space; finite, arbitrary where the weight is 0.
    weights : (views, frames, points) float array
    rigidity : (points,) float array
        Weight of each point in the alignment: large where it moves with the skull.
    """
    placed, trust = np.zeros(heads.shape), np.zeros(weights.shape)
    for view, (head, weight) in enumerate(zip(heads, weights, strict=True)):
        # Not by hidden points: which are hidden depends on the head's rotation, and biases it.
        counted = (weight > 0) * rigidity
        pose = align_rigid(points, head, weights=counted)
        turned = head @ np.swapaxes(pose.rotations, 1, 2)
        share = counted / np.maximum(counted.sum(axis=1, keepdims=True), 1e-12)
        centred = turned - (share[..., None] * turned).sum(axis=1, keepdims=True)
        middle = (share[..., None] * points).sum(axis=1, keepdims=True)
        variance = (share[..., None] * centred**2).sum(axis=(1, 2))
        covariance = (share[..., None] * centred * (points - middle)).sum(axis=(1, 2))
        usable = pose.determined & (variance > 0)
        if not usable.any():
            continue
        scale = np.median(covariance[usable] / variance[usable])  # a view's distance is a guess
        placed[view] = scale * centred + middle
        trust[view] = np.where(usable[:, None], weight, 0.0)
    return _mean_without_offsets(placed, trust, otherwise=points)


def _mean_without_offsets(
    values: FloatArray, weights: FloatArray, *, otherwise: FloatArray
) -> FloatArray:
    """Return m (frames, points, 3) of the model x = m + o that minimises Σ w |x - m - o|².

    The offsets o are constant per view and point, and sum to 0 over the views.
    """
    share = weights / np.maximum(weights.sum(axis=0), 1e-12)
    mean = (share[..., None] * values).sum(axis=0)
    coupled = np.einsum("vfp,ufp->pvu", weights, share)
    diagonal = weights.sum(axis=1).T[:, :, None] * np.eye(len(values))
    right = np.einsum("vfp,vfpc->pvc", weights, values - mean)
    offsets = np.linalg.pinv(diagonal - coupled, hermitian=True) @ right
    mean -= np.einsum("vfp,pvc->fpc", share, offsets)
    return np.where(weights.sum(axis=0)[..., None] > 0, mean, otherwise)
