"""Pictures of a posed face, ray-cast on the CPU with soft shadow and ambient occlusion."""

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from usdface.core.arrays import ByteImage, Float32Array, FloatArray, row_lengths
from usdface.core.assets import RigMesh
from usdface.core.errors import InputError
from usdface.media.face.camera import Camera
from usdface.media.face.raycast import RAY_COUNTS, View, draw
from usdface.media.face.surface import build_surface
from usdface.media.face.tracing import Tracer, traced_triangles
from usdface.media.picture.color import bytes_from_linear, heat_ramp
from usdface.media.picture.image import DisplayView

Quality = Literal["draft", "final"]

_MAX_PIXELS = 8192 * 8192

_LEAST_KNOWN = 0.5
"""Least total weight of known values at a drawn point; below, its value is unknown."""


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
        self.point_count = sum(len(mesh.points) for mesh in meshes)
        """Number of points of all meshes, drawn or not."""
        self._surface = build_surface(meshes)
        self._triangles = traced_triangles(self._surface.triangles)
        self._traced: tuple[Float32Array, Tracer] | None = None
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
        surface = self._surface
        cage = _finite(points.astype(np.float64), "points")
        fine = np.asarray(surface.matrix @ cage)
        colors = surface.albedo
        if values is not None:
            fine_values = self._subdivided(np.asarray(values, np.float64))
            low, high = value_range
            colors = heat_ramp(fine_values, low=low, high=high).astype(np.float32)
        normals = surface.normals_at(fine.astype(np.float32))
        if sculpted is not None:
            normals = normals + surface.matrix @ sculpted
            normals /= np.maximum(row_lengths(normals), 1e-9)
        view = View(
            surface=surface,
            camera=camera,
            width=width,
            height=height,
            ray_counts=RAY_COUNTS[quality],
            points=fine,
            tracer=self._tracer(fine.astype(np.float32)),
            normals=normals.astype(np.float32),
            colors=colors,
            heat=values is not None,
            paper=self._paper,
        )
        return (bytes_from_linear if view.heat else self._display)(draw(view))

    def _tracer(self, fine: Float32Array) -> Tracer:
        """Return a tracer of a pose; the last is cached, for a picture and its heat map."""
        if self._traced is None or not np.array_equal(self._traced[0], fine):
            self._traced = fine, Tracer(fine, self._triangles)
        return self._traced[1]

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
