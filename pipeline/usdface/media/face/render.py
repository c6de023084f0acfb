"""Pictures of a posed face, ray-cast on the CPU with soft shadow and ambient occlusion."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from usdface.core.arrays import ByteImage, Float32Array, FloatArray, row_lengths
from usdface.core.assets import RigMesh
from usdface.core.errors import InputError
from usdface.media.face.camera import Camera
from usdface.media.face.raycast import RAY_COUNTS, FirstHits, View, cast_first, draw
from usdface.media.face.surface import build_surface
from usdface.media.face.tracing import Tracer, traced_triangles
from usdface.media.picture.color import bytes_from_linear, heat_ramp
from usdface.media.picture.image import DisplayView

Quality = Literal["draft", "final"]

_MAX_PIXELS = 8192 * 8192

_LEAST_KNOWN = 0.5
"""Least total weight of known values at a drawn point; below, its value is unknown."""


@dataclass(frozen=True)
class _Pose:
    """A posed surface, and what was seen of it."""

    cage: FloatArray
    sculpted: FloatArray
    """`cage`, `sculpted`: (points, 3); the latter may be empty."""
    fine: FloatArray
    normals: Float32Array
    """`fine`, `normals`: (drawn points, 3)"""
    tracer: Tracer
    first: dict[tuple[Camera, int, int, Quality], FirstHits] = field(default_factory=dict)
    """First hits of the last camera."""


class FaceRenderer:
    """Draws a rig in any pose; data independent of the pose is computed once.

    Hidden meshes are skipped. Coarse Catmull-Clark cages are subdivided. In meshes without colours,
    eyes, teeth, lashes and the inside of the mouth are recognised.

    `display`: encodes light as bytes, see `display_view`; by default sRGB, which heat maps always
    use. `paper`: a white background, for print.
    """

    def __init__(
        self, meshes: Sequence[RigMesh], *, display: DisplayView | None = None, paper: bool = False
    ) -> None:
        self._surface = build_surface(meshes)
        self._triangles = traced_triangles(self._surface.triangles)
        self._poses: tuple[_Pose, ...] = ()
        self._display = display or bytes_from_linear
        self._paper = paper

    @property
    def has_stand_in_eyes(self) -> bool:
        """Whether stand-in eyes were added to a rig with lids and no eyes."""
        return self._surface.has_stand_in_eyes

    def render(
        self,
        points: FloatArray | Float32Array,
        *,
        camera: Camera,
        width: int,
        height: int,
        quality: Quality = "final",
        values: ArrayLike | None = None,
        value_range: tuple[float, float] = (0.0, 1.0),
        sculpted: FloatArray | None = None,
    ) -> ByteImage:
        """Draw one pose: (height, width, 3) uint8 array, sRGB.

        Parameters
        ----------
        points : (points, 3) array
            [mm]; all meshes of the rig, in order.
        width, height : int
            [pixels]
        quality : {'draft', 'final'}
            Draft for movies and previews, final for still pictures.
        values : (points,) array, optional
            Drawn as a heat map in place of colours; NaN is grey.
        value_range : tuple of float
            Values of the ramp's first and last colour.
        sculpted : (points, 3) array, optional
            Added to the surface's unit normals, see `SculptedNormals`.
        """
        if width * height > _MAX_PIXELS:
            raise InputError(
                f"a picture of {width} × {height} pixels cannot be drawn; ask for less"
            )
        colors, pose = self._surface.albedo, self._pose(points, sculpted)
        if values is not None:
            fine_values = self._subdivided(np.asarray(values, np.float64))
            low, high = value_range
            colors = heat_ramp(fine_values, low=low, high=high).astype(np.float32)
        view = View(
            surface=self._surface,
            camera=camera,
            width=width,
            height=height,
            ray_counts=RAY_COUNTS[quality],
            points=pose.fine,
            tracer=pose.tracer,
            normals=pose.normals,
            colors=colors,
            heat=values is not None,
            paper=self._paper,
        )
        framing = camera, width, height, quality
        if framing not in pose.first:
            pose.first.clear()  # they are large, and a camera may turn around a pose
            pose.first[framing] = cast_first(view)
        picture = draw(view, pose.first[framing])
        return (bytes_from_linear if view.heat else self._display)(picture)

    def _pose(self, points: FloatArray | Float32Array, sculpted: FloatArray | None) -> _Pose:
        """Return a pose; the last two are cached, for pictures with heat maps beside others."""
        cage, surface = _finite(points.astype(np.float64), "points"), self._surface
        offsets = np.zeros(0) if sculpted is None else sculpted
        for known in self._poses:
            if np.array_equal(known.cage, cage) and np.array_equal(known.sculpted, offsets):
                return known
        fine = np.asarray(surface.matrix @ cage)
        normals = surface.normals_at(fine.astype(np.float32))
        if len(offsets):
            normals = normals + surface.matrix @ offsets
            normals /= np.maximum(row_lengths(normals), 1e-9)
        tracer = Tracer(fine.astype(np.float32), self._triangles)
        pose = _Pose(cage, offsets, fine, normals.astype(np.float32), tracer)
        self._poses = pose, *self._poses[:1]
        return pose

    def _subdivided(self, values: FloatArray) -> FloatArray:
        """Interpolate values at the drawn points: means of the known, NaN where most are not."""
        known = ~np.isnan(values)
        given = _finite(np.where(known, values, 0.0), "values")
        if known.all():
            return np.asarray(self._surface.matrix @ given)
        share = np.asarray(self._surface.matrix @ known.astype(np.float64))
        means = np.asarray(self._surface.matrix @ given) / np.maximum(share, _LEAST_KNOWN)
        return np.where(share < _LEAST_KNOWN, np.nan, means)


def _finite(array: FloatArray, name: str) -> FloatArray:
    if not np.isfinite(array).all():
        bad = int(np.flatnonzero(~np.isfinite(array.reshape(len(array), -1)).all(axis=1))[0])
        raise InputError(f"{name} to draw: number {bad} is {array[bad]}; repair its deformation")
    return array
