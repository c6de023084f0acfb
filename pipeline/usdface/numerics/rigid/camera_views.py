"""Points that several calibrated cameras see, brought to space.

References
----------
Hartley and Sturm (1997), Triangulation, Computer Vision and Image Understanding 68(2), 146-157: the
linear method, its weights by depth, and the reprojection error that is least.
"""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import BoolArray, FloatArray
from usdface.numerics.rigid.rigid_alignment import align_frames

_LINEAR_ROUNDS = 3
_NEWTON_ROUNDS = 5
_NEAREST_DEPTH = 1e-9
_SMALLEST_ANGLE = 1e-6
"""Reciprocal condition of the equations of a point; rays that are parallel meet nowhere."""


@dataclass(frozen=True)
class CameraPose:
    """How a camera stands: a point X of the world lies at R X + t in its space."""

    rotation: FloatArray
    """R: (3, 3); x to the right, y down, z along the view."""
    translation: FloatArray
    """t: (3,), in the unit of the world."""


def triangulate_points(
    seen: FloatArray, weights: FloatArray, poses: list[CameraPose]
) -> FloatArray:
    """Return the points whose weighted squared reprojection error is least: (..., 3).

    NaN where fewer than two views weigh anything, or their rays are parallel.

    Parameters
    ----------
    seen : (views, ..., 2) float array
        x / z and y / z in each camera's space, without distortion.
    weights : (views, ...) float array
        Inverse variance of each, up to a factor; 0 or less where a view does not count.
    poses : list of CameraPose
        Of each view.
    """
    counted = (weights > 0) & np.isfinite(seen).all(axis=-1)
    trust = np.where(counted, weights, 0.0)
    place = np.where(counted[..., None], seen, 0.0)
    shape = seen.shape[1:-1]
    points = np.zeros((*shape, 3))
    depth = [np.ones(shape) for _ in poses]
    enough = counted.sum(axis=0) >= 2
    for _ in range(_LINEAR_ROUNDS):
        normal, right = np.zeros((*shape, 3, 3)), np.zeros((*shape, 3))
        for xy, weight, pose, z in zip(place, trust, poses, depth, strict=True):
            for axis in range(2):
                row = xy[..., axis, None] * pose.rotation[2] - pose.rotation[axis]
                left = pose.translation[axis] - xy[..., axis] * pose.translation[2]
                _add(normal, right, row, left, weight / z**2)
        enough &= _is_regular(normal)
        points = _solve(normal, right, enough)
        depth = [np.maximum(_into(pose, points)[..., 2], _NEAREST_DEPTH) for pose in poses]
    for _ in range(_NEWTON_ROUNDS):
        normal, right = np.zeros((*shape, 3, 3)), np.zeros((*shape, 3))
        for xy, weight, pose in zip(place, trust, poses, strict=True):
            local = _into(pose, points)
            z = np.maximum(local[..., 2], _NEAREST_DEPTH)
            for axis in range(2):
                shown = local[..., axis] / z
                row = (pose.rotation[axis] - shown[..., None] * pose.rotation[2]) / z[..., None]
                _add(normal, right, row, xy[..., axis] - shown, weight)
        points = points + _solve(normal, right, enough)
    points[~enough] = np.nan
    return points


def _into(pose: CameraPose, points: FloatArray) -> FloatArray:
    return np.asarray(points @ pose.rotation.T + pose.translation)


def _add(
    normal: FloatArray, right: FloatArray, row: FloatArray, left: FloatArray, weight: FloatArray
) -> None:
    """Add an equation, row · x = left, to the normal equations."""
    normal += weight[..., None, None] * row[..., :, None] * row[..., None, :]
    right += (weight * left)[..., None] * row


def _is_regular(normal: FloatArray) -> BoolArray:
    values = np.linalg.eigvalsh(normal)
    return np.asarray(values[..., 0] > _SMALLEST_ANGLE * values[..., 2])


def _solve(normal: FloatArray, right: FloatArray, usable: BoolArray) -> FloatArray:
    regular = np.where(usable[..., None, None], normal, np.eye(3))
    return np.where(usable[..., None], np.linalg.solve(regular, right[..., None])[..., 0], 0.0)


def average_heads(
    points: FloatArray, heads: FloatArray, weights: FloatArray, steadiness: FloatArray
) -> FloatArray:
    """Return the mean of what each camera by itself measures of a head, where points are.

    Triangulated points tell where the head is and how it is turned. Across the line of sight they
    have the noise of one picture, along it that over the sine of the angle between two cameras:
    more than the depth that a model of faces tells from one picture.

    A model puts a landmark on other skin as the face is seen from another side. What two cameras
    differ by throughout, point by point, is taken from both, half each, so that the mean does not
    jump where one of them loses the point.

    Parameters
    ----------
    points : (frames, points, 3) float array
        Triangulated, finite.
    heads : (views, frames, points, 3) float array
        In each camera's space; finite, anything where nothing weighs.
    weights : (views, frames, points) float array
        What each counts.
    steadiness : (points,) float array
        What each point counts for how a head lies on the points: much where it moves with the
        skull.
    """
    placed, trust = np.zeros(heads.shape), np.zeros(weights.shape)
    for view, (head, weight) in enumerate(zip(heads, weights, strict=True)):
        # Not by what is hidden: that follows the head's turn, and would bend the pose with it.
        counted = (weight > 0) * steadiness
        pose = align_frames(points, head, weights=counted)
        turned = head @ np.swapaxes(pose.rotations, 1, 2)
        share = counted / np.maximum(counted.sum(axis=1, keepdims=True), 1e-12)
        own = turned - (share[..., None] * turned).sum(axis=1, keepdims=True)
        middle = (share[..., None] * points).sum(axis=1, keepdims=True)
        spread = (share[..., None] * own**2).sum(axis=(1, 2))
        sizes = (share[..., None] * own * (points - middle)).sum(axis=(1, 2))
        usable = pose.determined & (spread > 0)
        if not usable.any():
            continue
        scale = np.median(sizes[usable] / spread[usable])  # the camera's distance is its own guess
        placed[view] = scale * own + middle
        trust[view] = np.where(usable[:, None], weight, 0.0)
    return _mean_without_offsets(placed, trust, otherwise=points)


def _mean_without_offsets(
    values: FloatArray, weights: FloatArray, *, otherwise: FloatArray
) -> FloatArray:
    """Return m (frames, points, 3) of values x = m + o of views, least Σ w |x - m - o|².

    The offsets o are constant per view and point, their sum over the views 0.
    """
    share = weights / np.maximum(weights.sum(axis=0), 1e-12)
    mean = (share[..., None] * values).sum(axis=0)
    coupled = np.einsum("vfp,ufp->pvu", weights, share)
    own = weights.sum(axis=1).T[:, :, None] * np.eye(len(values))
    right = np.einsum("vfp,vfpc->pvc", weights, values - mean)
    offsets = np.linalg.pinv(own - coupled, hermitian=True) @ right
    mean -= np.einsum("vfp,pvc->fpc", share, offsets)
    return np.where(weights.sum(axis=0)[..., None] > 0, mean, otherwise)
