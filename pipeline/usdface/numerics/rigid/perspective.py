"""Unprojection of head landmarks: removal of lens distortion and perspective, metric scale.

A landmark model gives image positions, and depths relative to the head in pixels (weak
perspective). Under perspective a nose that comes closer grows relative to the ears, which a mapping
would take for expression. With the focal length, the distance of the head follows from its size,
and the position of each point from its depth.

References
----------
Hartley and Zisserman (2004), Multiple View Geometry in Computer Vision, section 6.1: the pinhole.
Brown (1966), Decentering distortion of lenses, Photogrammetric Engineering 32(3), 444-462.
Umeyama (1991), Least-squares estimation of transformation parameters between two point patterns,
IEEE PAMI 13(4), equation 42: the scale.
Gower (1975), Generalized Procrustes analysis, Psychometrika 40, 33-51.
"""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import BoolArray, FloatArray, IntArray, sample_frames
from usdface.numerics.rigid.rigid_alignment import align_rigid

_PROCRUSTES_ROUNDS = 5
_PROCRUSTES_FRAMES = 256
"""The noise of a mean shape of so many frames is a sixteenth of a frame's."""
_NEAREST_SHARE = 0.1
"""[of the head's distance] Least depth of a landmark of a face that is in the picture."""

_NEWTON_STEPS = 50
_UNDISTORTED_PIXELS = 1e-3
"""Largest error of the distortion of an undistorted point."""


@dataclass(frozen=True)
class PinholeCamera:
    """A pinhole camera with lens distortion by the model of Brown and Conrady."""

    focal_pixels: float
    """Horizontal focal length [pixels]."""
    center: tuple[float, float]
    """Principal point, from the left and from the top [pixels]."""
    distortion: tuple[float, ...] = ()
    """k1, k2, p1, p2, k3 of OpenCV, missing ones 0: with x and y over the focal length and
    r² = x² + y², the distorted x is x (1 + k1 r² + k2 r⁴ + k3 r⁶) + 2 p1 x y + p2 (r² + 2 x²), and
    likewise y."""
    aspect: float = 1.0
    """Vertical over horizontal focal length."""

    def undistort(self, points: FloatArray) -> FloatArray:
        """Return image points without distortion, of `aspect` 1: (..., 2).

        By Newton's method. NaN beyond the radius at which the distortion folds the picture.

        Parameters
        ----------
        points : (..., 2) float array
            x to the right, y down [pixels].
        """
        if not any(self.distortion) and self.aspect == 1:
            return points
        seen = (points - self.center) / (self.focal_pixels, self.focal_pixels * self.aspect)
        ideal, unfolded = seen.copy(), np.ones(seen.shape[:-1], bool)
        for _ in range(_NEWTON_STEPS):
            distorted, (xx, xy, yy) = self._distorted(ideal)
            residual = seen - distorted
            # The Jacobian is symmetric; where its determinant falls to 0 the picture folds.
            determinant = xx * yy - xy**2
            unfolded &= (determinant > 0) & (xx > 0)
            divisor = np.where(unfolded, determinant, 1.0)
            x = (yy * residual[..., 0] - xy * residual[..., 1]) / divisor
            y = (xx * residual[..., 1] - xy * residual[..., 0]) / divisor
            step = np.where(unfolded[..., None], np.stack([x, y], axis=-1), 0.0)
            ideal += step
            if not np.abs(step).max(initial=0.0) * self.focal_pixels > _UNDISTORTED_PIXELS / 1e3:
                break
        error = np.abs(self._distorted(ideal)[0] - seen).max(axis=-1) * self.focal_pixels
        converged = unfolded & (error < _UNDISTORTED_PIXELS)
        return np.where(converged[..., None], ideal * self.focal_pixels + self.center, np.nan)

    def _distorted(self, ideal: FloatArray) -> tuple[FloatArray, tuple[FloatArray, ...]]:
        """Return distorted points over the focal length, and xx, xy, yy of the Jacobian."""
        k1, k2, p1, p2, k3 = (*self.distortion, 0.0, 0.0, 0.0, 0.0, 0.0)[:5]
        x, y = ideal[..., 0], ideal[..., 1]
        square = x**2 + y**2
        radial = 1 + square * (k1 + square * (k2 + square * k3))
        slope = 2 * k1 + square * (4 * k2 + square * 6 * k3)
        distorted = np.stack(
            [
                x * radial + 2 * p1 * x * y + p2 * (square + 2 * x**2),
                y * radial + p1 * (square + 2 * y**2) + 2 * p2 * x * y,
            ],
            axis=-1,
        )
        xx = radial + x**2 * slope + 2 * p1 * y + 6 * p2 * x
        xy = x * y * slope + 2 * p1 * x + 2 * p2 * y
        yy = radial + y**2 * slope + 6 * p1 * y + 2 * p2 * x
        return distorted, (xx, xy, yy)


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

    Returns (frames, landmarks, 3) [mm], Y up, the camera at the origin and looking along -Z; NaN in
    frames without a face.

    Parameters
    ----------
    landmarks : (frames, landmarks, 3) float array
        x to the right, y down, z away from the camera, relative to any origin that moves with the
        head [pixels].
    seen : (frames,) bool array
        Frames with a face, one at least.
    rigid : (n,) int array
        Landmarks that move with the skull, whose size determines the head's distance.
    eyes : two (n,) int arrays
        Landmarks whose mean is the centre of the right and of the left eye.
    eye_distance_mm : float
        Between the centres of the eyes.
    """
    pictured = landmarks[seen].copy()
    straight = camera.undistort(pictured[..., :2])
    # Landmarks extrapolated outside the picture may be beyond the fold of the distortion.
    pictured[..., :2] = np.where(np.isnan(straight), pictured[..., :2], straight)
    image = pictured * (1.0, -1.0, -1.0) / camera.focal_pixels
    middle = np.array([camera.center[0], -camera.center[1]]) / camera.focal_pixels
    # In units of the head's distance: depth, and x and y by similar triangles.
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
    """Return the mean shape by generalised Procrustes analysis, with medians."""
    rows = sample_frames(len(points), _PROCRUSTES_FRAMES)
    shapes = points[rows] - points[rows].mean(axis=1, keepdims=True)
    # Start from the largest face, whose landmarks are most accurate.
    mean = shapes[int(np.argmax((shapes**2).sum(axis=(1, 2))))]
    size = np.sqrt((mean**2).sum())
    for _ in range(_PROCRUSTES_ROUNDS):
        turn = align_rigid(shapes, mean).rotations
        upright = (shapes / _scales(shapes, mean)[:, None, None]) @ turn
        mean = np.median(upright, axis=0)
        mean *= size / np.sqrt((mean**2).sum())
    return mean


def _scales(points: FloatArray, shape: FloatArray) -> FloatArray:
    """Return the least-squares scale of the shape in each frame: (frames,)."""
    centred = points - points.mean(axis=1, keepdims=True)
    still = shape - shape.mean(axis=0)
    turned = still @ align_rigid(centred, still).rotations.transpose(0, 2, 1)
    factors = (centred * turned).sum(axis=(1, 2)) / (still**2).sum()
    return np.maximum(factors, 1e-6)
