"""Points of a head in pictures, brought back to space: perspective undone, scale set.

A landmark model tells where points appear, and how much nearer each is than the head's middle in
the unit of the picture (weak perspective). The camera makes what is near larger: a nose that comes
closer grows against the ears, and a mapping would take that for expression. With the focal length,
the distance of the head follows from its size, and each point from its own depth.

References
----------
Hartley and Zisserman (2004), Multiple View Geometry in Computer Vision, section 6.1: the pinhole.
Umeyama (1991), Least-squares estimation of transformation parameters between two point patterns,
IEEE PAMI 13(4), equation 42: the scale.
Gower (1975), Generalized Procrustes analysis, Psychometrika 40, 33-51.
"""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import BoolArray, FloatArray, IntArray
from usdface.numerics.rigid.rigid_alignment import align_rigid

_PROCRUSTES_ROUNDS = 5
_PROCRUSTES_FRAMES = 256
"""A mean shape of more frames is no better: their noise is a sixteenth of one's."""
_NEAREST_SHARE = 0.1
"""Of the head's distance: no landmark is nearer to a camera whose picture holds the whole face."""


@dataclass(frozen=True)
class PinholeCamera:
    """A camera without distortion."""

    focal_pixels: float
    """Focal length in pixels of the picture."""
    center: tuple[float, float]
    """Where the optical axis meets the picture: from the left and from the top [pixels]."""


def unproject_head(
    landmarks: FloatArray,
    seen: BoolArray,
    *,
    rigid: IntArray,
    eyes: tuple[IntArray, IntArray],
    eye_distance_mm: float,
    camera: PinholeCamera,
) -> FloatArray:
    """Return landmarks in the camera's space.

    Parameters
    ----------
    landmarks : (frames, landmarks, 3) float array
        x to the right and y down [pixels]; z away from the camera, in the same unit, from any
        origin that moves with the head.
    seen : (frames,) bool array
        Frames with a face.
    rigid : (n,) int array
        Landmarks that move with the skull: their size tells the head's distance.
    eyes : two (n,) int arrays
        Landmarks whose mean is the centre of the right and of the left eye.
    eye_distance_mm : float
        Between the centres of the eyes.

    Returns
    -------
    (frames, landmarks, 3) float array
        [mm], Y up, the camera at the origin and looking along -Z; NaN in frames without a face.
    """
    if not seen.any():
        raise ValueError("no frame has a face")
    image = landmarks[seen] * (1.0, -1.0, -1.0) / camera.focal_pixels
    middle = np.array([camera.center[0], -camera.center[1]]) / camera.focal_pixels
    # Of the head's distance: a landmark's depth, and by similar triangles where it is across.
    depth = 1.0 - (image[..., 2] - image[:, rigid, 2].mean(axis=1, keepdims=True))
    depth = np.maximum(depth, _NEAREST_SHARE)
    rays = np.concatenate([(image[..., :2] - middle) * depth[..., None], -depth[..., None]], axis=2)
    shape = _mean_shape(rays[:, np.concatenate([rigid, *eyes])])
    sides = np.split(shape[len(rigid) :], [len(eyes[0])])
    apart = np.linalg.norm(sides[0].mean(axis=0) - sides[1].mean(axis=0))
    skull = shape[: len(rigid)] * (eye_distance_mm / apart)
    space = np.full(landmarks.shape, np.nan)
    space[seen] = rays / _scales(rays[:, rigid], skull)[:, None, None]
    return space


def _mean_shape(points: FloatArray) -> FloatArray:
    """Return the mean of shapes after each is moved, turned and scaled onto it."""
    rows = np.unique(np.linspace(0, len(points) - 1, _PROCRUSTES_FRAMES).astype(np.int64))
    shapes = points[rows] - points[rows].mean(axis=1, keepdims=True)
    # The picture that the face fills most is sharpest, and any is a good start.
    mean = shapes[int(np.argmax((shapes**2).sum(axis=(1, 2))))]
    size = np.sqrt((mean**2).sum())
    for _ in range(_PROCRUSTES_ROUNDS):
        turn = align_rigid(shapes, mean).rotations
        upright = (shapes / _scales(shapes, mean)[:, None, None]) @ turn
        mean = np.median(upright, axis=0)
        mean *= size / np.sqrt((mean**2).sum())
    return np.asarray(mean)


def _scales(points: FloatArray, shape: FloatArray) -> FloatArray:
    """Return the factor by which the shape fits each frame best: (frames,)."""
    centred = points - points.mean(axis=1, keepdims=True)
    still = shape - shape.mean(axis=0)
    turned = still @ align_rigid(centred, still).rotations.transpose(0, 2, 1)
    factors = (centred * turned).sum(axis=(1, 2)) / (still**2).sum()
    return np.asarray(np.maximum(factors, 1e-6))
