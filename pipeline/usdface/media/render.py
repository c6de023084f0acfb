"""Draw a posed face: ray-cast, softly lit, with shadow and ambient occlusion. No GPU, no window."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from usdface.assets import BoolArray, Float32Array, FloatArray, IntArray, RigMesh
from usdface.errors import InputError
from usdface.media import shading
from usdface.media.camera import Camera
from usdface.media.color import ByteImage, bytes_from_linear, heat_ramp
from usdface.media.gather import share_between_neighbours
from usdface.media.mesh_topology import vertex_normals
from usdface.media.surface import Surface, build_surface
from usdface.media.tracing import PATTERNS, Found, Tracer, light_seen, sky_seen

Quality = Literal["draft", "final"]

IRIS_ANGLE = 0.50
"""Half angle of the iris from the eyeball's middle [rad]: 11.7 mm across on a 12 mm eye."""
PUPIL_ANGLE = 0.20

MAX_PIXELS = 8192 * 8192


@dataclass(frozen=True)
class _Effort:
    sky_rays: int
    light_rays: int
    edge_samples: int
    edge_sky_rays: int
    edge_light_rays: int


_EFFORT = {
    "draft": _Effort(2, 1, 3, 2, 1),
    "final": _Effort(6, 3, 8, 3, 2),
}
_CONTRAST = 0.05  # step of linear light between neighbours from which a pixel is sampled again
_TOP, _BOTTOM = 0.060, 0.022  # background, linear
_INSIDE = 0.04  # albedo of a back face
_HOLE = 0.006  # seen through an eye hole that has no eye behind it


class FaceRenderer:
    """A rig ready to be drawn in any pose; keeps all that no pose changes.

    Parameters
    ----------
    meshes : sequence of RigMesh
        Hidden meshes are left out. Coarse Catmull-Clark cages are subdivided. Where a mesh has no
        colours, pieces that are eyes, teeth, lashes or the inside of the mouth are recognised.

    Raises
    ------
    InputError
        If there is nothing to draw or polygons do not fit their points.
    """

    def __init__(self, meshes: Sequence[RigMesh]) -> None:
        self._sizes = [len(mesh.points) for mesh in meshes]
        self._surface: Surface = build_surface(meshes)

    @property
    def point_count(self) -> int:
        """Number of points of all meshes in a row, drawn or not."""
        return sum(self._sizes)

    def render(
        self,
        points: Sequence[ArrayLike] | ArrayLike,
        *,
        camera: Camera,
        width: int,
        height: int,
        quality: Quality = "final",
        values: ArrayLike | None = None,
        value_range: tuple[float, float] = (0.0, 1.0),
    ) -> ByteImage:
        """Draw one pose.

        Parameters
        ----------
        points : (points, 3) array or sequence of one such array per mesh
            [mm]; of every mesh the renderer was given, in its order.
        camera : Camera
        width, height : int
            [pixels]
        quality : {'draft', 'final'}
            Draft for movies and previews, final for what is looked at long.
        values : (points,) array, optional
            Painted in place of colours, as a heat map.
        value_range : tuple of float
            Values drawn in the ramp's first and last colour.

        Returns
        -------
        (height, width, 3) uint8 array
            sRGB.

        Raises
        ------
        InputError
            If points or values do not fit the rig, are not finite, or the size is absurd.
        """
        _check_size(width, height)
        surface = self._surface
        cage = self._gather(points)
        fine = np.asarray(surface.matrix @ cage)
        colors = surface.albedo
        if values is not None:
            given = _finite(np.asarray(values, np.float64), (self.point_count,), "values")
            fine_values = np.asarray(surface.matrix @ given)
            low, high = value_range
            colors = heat_ramp(fine_values, low=low, high=high).astype(np.float32)
        view = _View(
            surface=surface,
            camera=camera,
            width=width,
            height=height,
            effort=_EFFORT[quality],
            tracer=Tracer(fine.astype(np.float32), surface.triangles),
            normals=_normals(fine, surface),
            colors=colors,
            heat=values is not None,
        )
        return bytes_from_linear(_draw(view))

    def _gather(self, points: Sequence[ArrayLike] | ArrayLike) -> FloatArray:
        """Put the points of all meshes in a row and check them."""
        shape = (self.point_count, 3)
        if isinstance(points, np.ndarray) and points.shape == shape:
            return _finite(points.astype(np.float64), shape, "points")
        parts = [np.asarray(part, np.float64) for part in points]  # type: ignore[union-attr]
        if len(self._sizes) == 1 and len(parts) != 1:
            return _finite(np.asarray(points, np.float64), shape, "points")
        if [part.shape for part in parts] != [(size, 3) for size in self._sizes]:
            raise InputError(
                f"points to draw have shapes {[part.shape for part in parts]} and the rig's meshes "
                f"have {self._sizes} points; pass the points of every mesh of the rig"
            )
        return _finite(np.concatenate(parts), shape, "points")


def _finite(array: FloatArray, shape: tuple[int, ...], name: str) -> FloatArray:
    if array.shape != shape:
        raise InputError(f"{name} to draw have shape {array.shape} and the rig needs {shape}")
    if not np.isfinite(array).all():
        bad = int(np.flatnonzero(~np.isfinite(array.reshape(len(array), -1)).all(axis=1))[0])
        raise InputError(f"{name} to draw: number {bad} is {array[bad]}; repair what deforms it")
    return array


def _check_size(width: int, height: int) -> None:
    if width < 1 or height < 1 or width * height > MAX_PIXELS:
        raise InputError(f"a picture of {width} × {height} pixels cannot be drawn; ask for less")


def _normals(fine: FloatArray, surface: Surface) -> Float32Array:
    return vertex_normals(fine.astype(np.float32), surface.triangles, surface.normals).astype(
        np.float32
    )


@dataclass(frozen=True)
class _View:
    """All that one picture is drawn from."""

    surface: Surface
    camera: Camera
    width: int
    height: int
    effort: _Effort
    tracer: Tracer
    normals: Float32Array
    colors: Float32Array
    heat: bool

    @property
    def key(self) -> Float32Array:
        """Direction towards the key light, in the world."""
        world = shading.KEY_DIRECTION.astype(np.float64) @ self.camera.axes()
        return np.asarray(world / np.linalg.norm(world), np.float32)


@dataclass(frozen=True)
class _Samples:
    """Where rays met the face, before light."""

    found: Found
    normals: Float32Array
    views: Float32Array
    albedo: Float32Array
    parts: IntArray


def _draw(view: _View) -> Float32Array:
    """Draw with one ray through each pixel, then sample again where neighbours differ."""
    height, width = view.height, view.width
    rows, columns = np.mgrid[:height, :width]
    centers = np.stack([columns.ravel(), rows.ravel()], axis=1) + 0.5
    pattern = (columns % 4 + 4 * (rows % 4)).ravel()
    samples = _sample(view, centers)
    rays = samples.found.rays
    effort = view.effort
    openness, lit = _occlusion(
        view, samples, pattern[rays], sky=effort.sky_rays, light=effort.light_rays
    )
    openness, lit = share_between_neighbours(
        np.stack([openness, lit], axis=1),
        rays=rays,
        normals=samples.normals,
        positions=samples.found.positions,
        shape=(height, width),
        tolerance=4e-3 * view.surface.size,
    ).T
    hit = np.zeros(height * width, bool)
    hit[rays] = True
    holes = ndimage.binary_fill_holes(hit.reshape(height, width)) & ~hit.reshape(height, width)
    picture = _background(height, width)
    picture[holes] = _HOLE
    flat = picture.reshape(-1, 3)
    flat[rays] = _light(view, samples, openness, lit)
    edges = np.flatnonzero(_edges(picture))
    if len(edges):
        near_hole = ndimage.binary_dilation(holes, iterations=2).ravel()
        flat[edges] = _resample(view, edges, flat, near_hole)
    return picture


def _sample(view: _View, pixels: FloatArray) -> _Samples:
    """Cast rays through picture positions and read the surface where they meet it."""
    directions = view.camera.directions(pixels, width=view.width, height=view.height)
    found = view.tracer.find(view.camera.eye, directions)
    corners = view.surface.triangles[found.triangles]
    normals = _mix(view.normals, corners, found.barycentric)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.float32(1e-9))
    views = -directions[found.rays]
    facing = view.surface.outward * np.einsum("ij,ij->i", normals, views)
    normals[view.surface.outward * facing < 0] *= -1
    away = facing < -0.2
    albedo = _mix(view.colors, corners, found.barycentric)
    # The back of the skin, seen through an eye hole: inside of the head, no surface to judge.
    albedo[away] *= _INSIDE
    if not view.heat and not view.surface.painted:
        _paint_irises(view.surface, found, corners, albedo)
    return _Samples(found, normals, views, albedo, view.surface.parts[found.triangles])


def _mix(values: Float32Array, corners: IntArray, shares: Float32Array) -> Float32Array:
    mixed = values[corners[:, 0]] * shares[:, :1]
    mixed += values[corners[:, 1]] * shares[:, 1:2]
    mixed += values[corners[:, 2]] * shares[:, 2:]
    return mixed


def _paint_irises(surface: Surface, found: Found, corners: IntArray, albedo: Float32Array) -> None:
    """Colour eyes by the angle from their gaze at rest: sharp on the coarsest eyeball."""
    which = surface.eyes[found.triangles]
    rows = np.flatnonzero(which >= 0)
    if not len(rows):
        return
    rest = _mix(surface.rest, corners[rows], found.barycentric[rows])
    local = rest - surface.eye_centers[which[rows]]
    angle = np.arctan2(np.hypot(local[:, 0], local[:, 1]), local[:, 2])
    around = np.arctan2(local[:, 1], local[:, 0])
    iris = shading.IRIS * (1 + 0.25 * np.cos(23 * around) * np.cos(9 * around))[:, None]
    iris = iris * np.clip(1.25 - ((angle - 0.33) / 0.19) ** 2, 0.25, 1)[:, None]
    color = albedo[rows]
    color = np.where((angle < IRIS_ANGLE)[:, None], iris, color)
    color = np.where((angle < PUPIL_ANGLE)[:, None], shading.PUPIL, color)
    albedo[rows] = color


def _occlusion(
    view: _View, samples: _Samples, patterns: IntArray, *, sky: int, light: int
) -> tuple[Float32Array, Float32Array]:
    """Return the share of sky and of key light that each sample sees."""
    size = view.surface.size
    start = samples.found.positions + np.float32(1.5e-3 * size) * samples.normals
    openness = sky_seen(
        view.tracer,
        start,
        samples.normals,
        patterns=patterns,
        ray_count=sky,
        reach=0.28 * size,
    )
    lit = np.zeros(len(start), np.float32)
    facing = np.flatnonzero(samples.normals @ view.key > -0.1)
    lit[facing] = light_seen(
        view.tracer,
        start[facing],
        direction=view.key,
        spread=shading.KEY_SPREAD,
        patterns=patterns[facing],
        ray_count=light,
    )
    return openness, lit


def _light(
    view: _View, samples: _Samples, openness: Float32Array, lit: Float32Array
) -> Float32Array:
    axes = view.camera.axes().astype(np.float32).T
    facing = samples.normals @ view.key
    # Behind the terminator skin glows through; there a cast shadow would cut a hard line.
    sure = np.clip((facing + 0.05) / 0.25, 0, 1)
    hits = shading.Hits(
        normals=samples.normals @ axes,
        views=samples.views @ axes,
        albedo=samples.albedo,
        parts=samples.parts,
        openness=openness,
        lit=lit * sure + openness**2 * (1 - sure),
    )
    return shading.shade(hits, plain=view.heat)


def _background(height: int, width: int) -> Float32Array:
    column = np.linspace(_TOP, _BOTTOM, height, dtype=np.float32)
    tint = np.array([0.96, 1.0, 1.06], np.float32)
    return np.ascontiguousarray(
        np.broadcast_to((column[:, None] * tint)[:, None, :], (height, width, 3))
    )


def _edges(picture: Float32Array) -> BoolArray:
    """Return where light steps between neighbours, in display terms."""
    shown = np.sqrt(np.clip(picture, 0, 1))
    mask = np.zeros(picture.shape[:2], bool)
    down = np.abs(np.diff(shown, axis=0)).max(axis=2) > _CONTRAST
    mask[1:] |= down
    mask[:-1] |= down
    across = np.abs(np.diff(shown, axis=1)).max(axis=2) > _CONTRAST
    mask[:, 1:] |= across
    mask[:, :-1] |= across
    return mask


def _resample(
    view: _View, edges: IntArray, flat: Float32Array, near_hole: BoolArray
) -> Float32Array:
    """Average several samples in each of the given pixels."""
    count = view.effort.edge_samples
    plastic = 1.32471795724474602596
    steps = np.arange(count)
    spread = np.stack([(0.5 + steps / plastic) % 1, (0.5 + steps / plastic**2) % 1], axis=1)
    corners = np.stack([edges % view.width, edges // view.width], axis=1).astype(np.float64)
    pixels = (corners[:, None, :] + spread).reshape(-1, 2)
    owner = np.repeat(np.arange(len(edges)), count)
    samples = _sample(view, pixels)
    rays = samples.found.rays
    openness, lit = _occlusion(
        view,
        samples,
        (rays + 5 * owner[rays]) % PATTERNS,
        sky=view.effort.edge_sky_rays,
        light=view.effort.edge_light_rays,
    )
    light = _background(view.height, view.width)[edges // view.width, 0][owner]
    light[near_hole[edges][owner]] = _HOLE
    light[rays] = _light(view, samples, openness, lit)
    return np.asarray(light.reshape(len(edges), count, 3).mean(axis=1), np.float32)
