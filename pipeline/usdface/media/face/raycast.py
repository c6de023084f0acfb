"""Ray casting of one pose of a face.

One ray per pixel finds the surface; occlusion and shadow are averaged over neighbours on the same
surface; pixels on edges are supersampled.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage, sparse

from usdface.core.arrays import BoolArray, Float32Array, FloatArray, IntArray, row_lengths
from usdface.media.face import shading
from usdface.media.face.camera import Camera
from usdface.media.face.surface import Surface
from usdface.media.face.tracing import (
    PATTERN_COUNT,
    RayHits,
    Tracer,
    denoise,
    light_seen,
    r2_points,
    sky_seen,
)

IRIS_ANGLE = 0.50
"""Half angle of the iris at the eyeball's centre [rad]: 11.7 mm across for a radius of 12 mm."""
PUPIL_ANGLE = 0.20


@dataclass(frozen=True)
class RayCounts:
    """Rays per pixel to the sky and the key light, and samples and rays on edges."""

    sky_rays: int
    light_rays: int
    edge_samples: int
    edge_sky_rays: int
    edge_light_rays: int


RAY_COUNTS = {"draft": RayCounts(2, 1, 4, 2, 1), "final": RayCounts(4, 2, 8, 3, 2)}
_CONTRAST_STEP = 0.08  # difference between neighbours from which a pixel is supersampled
_TOP, _BOTTOM = 0.060, 0.022  # background, linear
_BACK_ALBEDO = 0.04  # factor on the albedo of a back face
_HOLE_LIGHT = 0.006  # light in an eye hole without an eye


@dataclass(frozen=True)
class View:
    """Inputs of one picture."""

    surface: Surface
    camera: Camera
    width: int
    height: int
    """`width`, `height`: [pixels]"""
    ray_counts: RayCounts
    points: FloatArray
    """(drawn points, 3) [mm]: posed."""
    tracer: Tracer
    """Of the posed points."""
    normals: Float32Array
    colors: Float32Array
    """`normals`, `colors`: (drawn points, 3): unit normals; linear colours."""
    heat: bool
    """Whether the colours are a heat map."""
    paper: bool = False
    """Whether the background is white."""

    def background(self, width: int) -> Float32Array:
        """Return columns of the background, (height, width, 3): linear light."""
        wall = background(self.height, width)
        return np.ones_like(wall) if self.paper else wall

    @property
    def tolerance(self) -> float:
        """Largest distance of neighbours from each other's tangent plane [mm]."""
        return 4e-3 * self.surface.size

    @property
    def key(self) -> Float32Array:
        """Unit direction towards the key light in world space."""
        world = shading.KEY_DIRECTION.astype(np.float64) @ self.camera.axes()
        return np.asarray(world / np.linalg.norm(world), np.float32)


@dataclass(frozen=True)
class _Samples:
    """Surface samples at ray hits, before colours and lighting."""

    found: RayHits
    corners: IntArray
    normals: Float32Array
    views: Float32Array
    away: BoolArray
    """(n,): whether the back of the surface is seen."""


@dataclass(frozen=True)
class FirstHits:
    """What the first ray of each pixel meets, whatever its colours."""

    samples: _Samples
    rays: IntArray
    """(n,): pixel of each sample."""
    seen: Float32Array
    """(n, 2): visible shares of sky and key light, denoised."""
    slots: IntArray
    """(pixels,): sample of each pixel, or -1."""
    holes: BoolArray
    """(height, width): pixels without a hit that the surface surrounds."""


def cast_first(view: View) -> FirstHits:
    """Cast a ray through the centre of each pixel, and rays to the lights from its hit."""
    height, width = view.height, view.width
    pixels = _framed_pixels(view)
    rows, columns = np.divmod(pixels, width)
    samples = _sample(view, np.stack([columns, rows], axis=1) + 0.5)
    rays = pixels[samples.found.rays]
    pattern = (columns % 4 + 4 * (rows % 4))[samples.found.rays]
    ray_counts = view.ray_counts
    positions, normals = samples.found.positions, samples.normals
    seen = _occlusion(
        view, positions, normals, pattern, sky=ray_counts.sky_rays, light=ray_counts.light_rays
    )
    seen = denoise(
        seen,
        rays=rays,
        normals=normals,
        positions=positions,
        shape=(height, width),
        tolerance=view.tolerance,
    )
    slots = np.full(height * width, -1, np.int64)
    slots[rays] = np.arange(len(rays))
    hit = (slots >= 0).reshape(height, width)
    holes = ndimage.binary_fill_holes(hit) & ~hit
    return FirstHits(samples, rays, seen, slots, holes)


def draw(view: View, first: FirstHits) -> Float32Array:
    """Draw a view: (height, width, 3), linear light [0-1]."""
    picture = view.background(view.width)
    picture[first.holes] = _HOLE_LIGHT
    flat = picture.reshape(-1, 3)
    flat[first.rays] = _light(view, first.samples, first.seen)
    edges = np.flatnonzero(_edges(picture))
    if len(edges):
        flat[edges] += _resample(view, edges, first)
        flat[edges] /= view.ray_counts.edge_samples
    return picture


def _framed_pixels(view: View) -> IntArray:
    """Return the pixels in the bounding box of the projected surface, row by row."""
    height, width = view.height, view.width
    depth = (view.camera.eye - view.points) @ view.camera.axes()[2]
    if depth.min() <= 0:  # points behind the eye have no projection
        return np.arange(height * width)
    column, row, _ = view.camera.project(view.points, width=width, height=height).T
    rows = np.arange(max(int(row.min()) - 1, 0), min(int(row.max()) + 2, height))
    columns = np.arange(max(int(column.min()) - 1, 0), min(int(column.max()) + 2, width))
    return np.asarray((rows[:, None] * width + columns).ravel())


def _sample(view: View, pixels: FloatArray) -> _Samples:
    """Cast rays through picture positions and sample the surface at their hits."""
    directions = view.camera.directions(pixels, width=view.width, height=view.height)
    origins = view.camera.origins(pixels, width=view.width, height=view.height)
    found = view.tracer.find(origins, directions)
    corners = np.take(view.surface.triangles, found.triangles, axis=0)
    normals = _mix(view.normals, corners, found.barycentric)
    normals /= np.maximum(row_lengths(normals), np.float32(1e-9))
    views = -np.take(directions, found.rays, axis=0)
    facing = view.surface.outward * np.einsum("ij,ij->i", normals, views)
    normals[view.surface.outward * facing < 0] *= -1
    return _Samples(found, corners, normals, views, facing < -0.2)


def _albedo(view: View, samples: _Samples) -> Float32Array:
    found, corners = samples.found, samples.corners
    albedo = _mix(view.colors, corners, found.barycentric)
    if not view.heat:
        own = np.flatnonzero(~np.isnan(view.surface.painted[found.triangles, 0]))
        albedo[own] = view.surface.painted[found.triangles[own]]
    # Back of the skin, visible through an eye hole.
    albedo[samples.away] *= _BACK_ALBEDO
    if not view.heat:
        _paint_irises(view.surface, found, corners, albedo)
        _paint_bands(view.surface, found, corners, albedo)
    return albedo


def _mix(values: Float32Array, corners: IntArray, shares: Float32Array) -> Float32Array:
    """Interpolate values of points (points, k) at places in triangles: (n, k)."""
    starts = np.arange(0, corners.size + 1, 3)
    matrix = sparse.csr_array(
        (shares.ravel(), corners.ravel(), starts), shape=(len(corners), len(values))
    )
    return np.asarray(matrix @ values)


def _paint_irises(
    surface: Surface, found: RayHits, corners: IntArray, albedo: Float32Array
) -> None:
    """Colour eyes by the angle from the gaze at rest, independently of the mesh's resolution."""
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


def _paint_bands(surface: Surface, found: RayHits, corners: IntArray, albedo: Float32Array) -> None:
    """Colour lips and brows by position on the resting face."""
    if not surface.bands:
        return
    rows = np.flatnonzero(surface.band_opacity[corners].any(axis=1))
    corners, shares = corners[rows], found.barycentric[rows]
    rest = _mix(surface.rest, corners, shares)
    bare = _mix(surface.band_opacity[:, None], corners, shares)
    for band in surface.bands:
        albedo[rows] += bare * band.share(rest)[:, None] * (band.color - albedo[rows])


def _occlusion(
    view: View,
    positions: Float32Array,
    normals: Float32Array,
    patterns: IntArray,
    *,
    sky: int,
    light: int,
) -> Float32Array:
    """Return the visible shares of sky and key light of each sample: (n, 2)."""
    size = view.surface.size
    start = positions + np.float32(1.5e-3 * size) * normals
    seen = np.zeros((len(start), 2), np.float32)
    seen[:, 0] = sky_seen(
        view.tracer, start, normals, patterns=patterns, ray_count=sky, reach=0.28 * size
    )
    facing = np.flatnonzero(normals @ view.key > -0.1)
    seen[facing, 1] = light_seen(
        view.tracer,
        start[facing],
        direction=view.key,
        spread=shading.KEY_SPREAD,
        patterns=patterns[facing],
        ray_count=light,
    )
    return seen


def _light(view: View, samples: _Samples, seen: Float32Array) -> Float32Array:
    axes = view.camera.axes().astype(np.float32).T
    facing = samples.normals @ view.key
    # Beyond the terminator, subsurface light replaces the cast shadow, whose edge would be hard.
    sure = np.clip((facing + 0.05) / 0.25, 0, 1)
    openness, lit = seen[:, 0], seen[:, 1]
    hits = shading.Hits(
        normals=samples.normals @ axes,
        views=samples.views @ axes,
        albedo=_albedo(view, samples),
        parts=view.surface.parts[samples.found.triangles],
        openness=openness,
        lit=lit * sure + openness**2 * (1 - sure),
    )
    return shading.shade(hits, plain=view.heat)


def background(height: int, width: int) -> Float32Array:
    """Return the background of all tiles, a vertical gradient: linear light."""
    column = np.linspace(_TOP, _BOTTOM, height, dtype=np.float32)
    tint = np.array([0.96, 1.0, 1.06], np.float32)
    return np.ascontiguousarray(
        np.broadcast_to((column[:, None] * tint)[:, None, :], (height, width, 3))
    )


def _edges(picture: Float32Array) -> BoolArray:
    """Return the pixels whose encoded light differs from a neighbour's."""
    shown = np.sqrt(np.clip(picture, 0, 1))
    mask = np.zeros(picture.shape[:2], bool)
    down = _largest_channel(np.abs(np.diff(shown, axis=0))) > _CONTRAST_STEP
    mask[1:] |= down
    mask[:-1] |= down
    across = _largest_channel(np.abs(np.diff(shown, axis=1))) > _CONTRAST_STEP
    mask[:, 1:] |= across
    mask[:, :-1] |= across
    return mask


def _largest_channel(colors: Float32Array) -> Float32Array:
    red, green, blue = np.moveaxis(colors, -1, 0)  # faster than max(axis=-1)
    return np.asarray(np.maximum(np.maximum(red, green), blue))


def _resample(view: View, edges: IntArray, first: FirstHits) -> Float32Array:
    """Return the sum of the samples of each of the given pixels, without that of its centre."""
    near_hole = ndimage.binary_dilation(first.holes, iterations=2).ravel()
    steps = np.arange(1, view.ray_counts.edge_samples)  # 0 is the centre
    spread = np.stack(r2_points(steps), axis=1)
    corners = np.stack([edges % view.width, edges // view.width], axis=1).astype(np.float64)
    pixels = (corners[:, None, :] + spread).reshape(-1, 2)
    owner = np.repeat(edges, len(steps))
    edge_numbers = np.arange(len(edges)) * view.ray_counts.edge_samples
    patterns = (5 * np.add.outer(edge_numbers, steps).ravel() + owner) % PATTERN_COUNT
    samples = _sample(view, pixels)
    rays = samples.found.rays
    seen, unknown = _borrow(view, samples, owner[rays], first)
    seen[unknown] = _occlusion(
        view,
        samples.found.positions[unknown],
        samples.normals[unknown],
        patterns[rays[unknown]],
        sky=view.ray_counts.edge_sky_rays,
        light=view.ray_counts.edge_light_rays,
    )
    light = view.background(1)[owner // view.width, 0]
    light[near_hole[owner]] = _HOLE_LIGHT
    light[rays] = _light(view, samples, seen)
    return np.asarray(light.reshape(len(edges), len(steps), 3).sum(axis=1), np.float32)


def _borrow(
    view: View, samples: _Samples, owner: IntArray, known: FirstHits
) -> tuple[Float32Array, IntArray]:
    """Copy shares of light from the pixel or a neighbour on the same surface.

    Returns the shares, (n, 2), and the samples without such a pixel.
    """
    seen = np.zeros((len(owner), 2), np.float32)
    open_rows = np.arange(len(owner))
    last = len(known.slots) - 1
    for step in (0, 1, -1, view.width, -view.width):
        slot = known.slots[np.clip(owner[open_rows] + step, 0, last)]
        offset = known.samples.found.positions[slot] - samples.found.positions[open_rows]
        normals = samples.normals[open_rows]
        same = (
            (slot >= 0)
            & (np.abs(np.einsum("ij,ij->i", offset, normals)) < view.tolerance)
            & (np.einsum("ij,ij->i", known.samples.normals[slot], normals) > 0.8)
        )
        seen[open_rows[same]] = known.seen[slot[same]]
        open_rows = open_rows[~same]
    return seen, open_rows
