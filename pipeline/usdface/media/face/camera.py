"""A pinhole camera, and automatic framing of a face."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from usdface.core.arrays import Float32Array, FloatArray, row_lengths
from usdface.core.assets import RigMesh, point_slices

FACE_REACH = 0.45
"""Displacement of a point, relative to the largest of the same shape, from which it is of the face.

Relative to each shape, the forehead is included (brows move millimetres) and the neck is not,
although an open jaw moves it further.
"""


_FACE_MARGIN = 1.12
"""Height of the picture over that of the face."""

_HAIR_SHARE = 0.5
"""Height of hair and hats in the picture, relative to the face; more is cut."""


@dataclass(frozen=True)
class Camera:
    """A camera; rows of its pictures run down, columns to the right."""

    eye: tuple[float, float, float]
    target: tuple[float, float, float]
    """`eye`, `target`: [mm]"""
    fov_degrees: float = 16.0
    """Vertical field of view [degrees]; narrow, like a portrait lens."""
    up: tuple[float, float, float] = (0.0, 1.0, 0.0)
    """Direction that is up in the picture."""
    shift: tuple[float, float] = (0.0, 0.0)
    """Lens shift: offset of the picture's centre from the axis, right and up [half heights]."""
    span_mm: float | None = None
    """Height of an orthographic view [mm]; None for perspective."""
    framed_width: float = 1.0
    """Width of the framed points over the picture's height: the narrowest aspect that shows all."""

    def axes(self) -> FloatArray:
        """Return the rows right, up and backward (from the target to the eye), orthonormal."""
        backward = np.subtract(self.eye, self.target)
        backward = backward / np.linalg.norm(backward)
        right = np.cross(self.up, backward)
        right = right / np.linalg.norm(right)
        return np.stack([right, np.cross(backward, right), backward])

    def directions(self, pixels: FloatArray, *, width: int, height: int) -> Float32Array:
        """Return unit directions of the rays through picture positions: (n, 3) float32.

        `pixels`: (n, 2), column and row; the first pixel's centre is at 0.5, 0.5. `width`,
        `height`: of the picture [pixels].
        """
        local = np.full((len(pixels), 3), -1, np.float32)
        local[:, :2] = 0
        if self.span_mm is None:
            half = np.tan(np.radians(self.fov_degrees / 2))
            x, y = self._off_axis(pixels, width, height)
            local[:, 0], local[:, 1] = half * x, half * y
            local /= row_lengths(local)
        return np.asarray(local @ self.axes().astype(np.float32))

    def origins(self, pixels: FloatArray, *, width: int, height: int) -> Float32Array:
        """Return the origins of the rays of `directions`: (n, 3) float32 [mm]."""
        if self.span_mm is None:
            return np.asarray(np.broadcast_to(self.eye, (len(pixels), 3)), np.float32)
        right, up, _ = self.axes()
        x, y = self._off_axis(pixels, width, height)
        across = self.span_mm / 2 * (x[:, None] * right + y[:, None] * up)
        return np.asarray(self.eye + across, np.float32)

    def _off_axis(
        self, pixels: FloatArray, width: int, height: int
    ) -> tuple[FloatArray, FloatArray]:
        """Return picture positions relative to the axis, right and up [half heights]."""
        x = (2 * pixels[:, 0] - width) / height + self.shift[0]
        return x, 1 - 2 * pixels[:, 1] / height + self.shift[1]

    def project(self, points: ArrayLike, *, width: int, height: int) -> FloatArray:
        """Return column, row [pixels] and distance along the view [mm] of each point: (n, 3).

        `points`: (n, 3) [mm]. `width`, `height`: of the picture [pixels].
        """
        local = (np.asarray(points, np.float64) - self.eye) @ self.axes().T
        depth = -local[:, 2]
        half = depth * np.tan(np.radians(self.fov_degrees / 2))
        if self.span_mm is not None:
            half = np.full(len(local), self.span_mm / 2)
        column = width / 2 + (local[:, 0] / half - self.shift[0]) * height / 2
        row = height / 2 - (local[:, 1] / half - self.shift[1]) * height / 2
        return np.stack([column, row, depth], axis=1)


def motion_weights(meshes: Sequence[RigMesh]) -> FloatArray:
    """Return the largest relative displacement of each point, all meshes concatenated: (points,).

    Maximum over the shapes of displacement / largest displacement of the shape [0-1]; 0 for hair,
    shoulders and clothing.
    """
    reach = [np.zeros(len(mesh.points)) for mesh in meshes]
    furthest: dict[str, float] = {}
    for mesh in meshes:
        for shape in mesh.shapes:
            length = np.linalg.norm(shape.keys[-1].offsets, axis=1).max(initial=0.0)
            furthest[shape.name] = max(furthest.get(shape.name, 0.0), float(length))
    for own, mesh in zip(reach, meshes, strict=True):
        for shape in mesh.shapes:
            if furthest[shape.name] > 0:
                key = shape.keys[-1]
                share = np.linalg.norm(key.offsets, axis=1) / furthest[shape.name]
                own[key.points] = np.maximum(own[key.points], share)
    return np.concatenate(reach) if reach else np.zeros(0)


def frame_face(
    points: ArrayLike,
    *,
    weights: ArrayLike | None = None,
    yaw_degrees: float = 0.0,
    aspect: float = 1.0,
    hair: bool = False,
) -> Camera:
    """Return a camera that frames the face; Y is up and the face looks along +Z.

    Parameters
    ----------
    points : (n, 3) array
        [mm]
    weights : (n,) array, optional
        `motion_weights`, which exclude neck, shoulders and hair, or a mask of the points to frame.
        Default, or if all are 0: all points.
    yaw_degrees : float
        Position of the camera around the face, positive to the character's left (+X).
    aspect : float
        Width of the picture over its height.
    hair : bool
        Whether to include hair above the face, up to half the face's height.
    """
    cloud = np.asarray(points, np.float64)
    reach = np.zeros(len(cloud)) if weights is None else np.asarray(weights, np.float64)
    face = cloud[reach > FACE_REACH * reach.max()] if np.any(reach > 0) else cloud
    yaw = np.radians(yaw_degrees)
    backward = np.array([np.sin(yaw), 0.0, np.cos(yaw)])
    axes = Camera(eye=triple(backward), target=(0.0, 0.0, 0.0)).axes()
    low, high = (face @ axes.T).min(axis=0), (face @ axes.T).max(axis=0)
    sides = np.array([low[0], high[0]])
    if hair:
        head = cloud @ axes.T
        head = head[head[:, 1] >= low[1]]
        high[1] = min(head[:, 1].max(), high[1] + _HAIR_SHARE * (high[1] - low[1]))
        sides = np.array([head[:, 0].min(), head[:, 0].max()])
    width, height = np.maximum(high - low, 1e-6)[:2]
    span = _FACE_MARGIN * max(height, width / aspect)
    half = np.tan(np.radians(Camera.fov_degrees / 2))
    # The scale holds at the centre of the depth, close to the plane of the widest part.
    distance = span / 2 / half + (high[2] - low[2]) / 2
    # More room above the forehead than below the chin.
    middle = (low + high) / 2 + [0.0, 0.03 * span, 0.0]
    target = middle @ axes
    across = float(2 * _FACE_MARGIN * np.abs(sides - middle[0]).max() / span)
    return Camera(
        eye=triple(target + distance * backward),
        target=triple(target),
        framed_width=min(across, 1.0),
    )


def frame_rig(meshes: Sequence[RigMesh], *, yaw_degrees: float = 0.0, hair: bool = False) -> Camera:
    """Return a camera that frames a rig's face in all shapes; options as in `frame_face`."""
    rest = np.concatenate([mesh.points for mesh in meshes])
    weights = motion_weights(meshes)
    posed, taken = [rest], [weights]
    for mesh, own in zip(meshes, point_slices(meshes), strict=True):
        for shape in mesh.shapes:
            key = shape.keys[-1]
            posed.append(mesh.points[key.points] + key.offsets)
            taken.append(weights[own][key.points])
    return frame_face(
        np.concatenate(posed), weights=np.concatenate(taken), yaw_degrees=yaw_degrees, hair=hair
    )


def triple(vector: FloatArray) -> tuple[float, float, float]:
    """Return a vector, (3,), as numbers."""
    x, y, z = (float(v) for v in vector)
    return x, y, z
