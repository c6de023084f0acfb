"""Ray tracing of triangles (Embree): visible shares of the sky and the key light, and denoising.

Directions come from low-discrepancy tables rather than a random generator: the same pose gives the
same bytes on every machine.
"""

from dataclasses import dataclass

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from usdface.core.arrays import BoolArray, Float32Array, FloatArray, IntArray, row_lengths

PATTERN_COUNT = 16
"""Sets of directions: one per pixel of a 4 by 4 block, averaged by the denoiser."""


@dataclass(frozen=True)
class RayHits:
    """First hit of each ray; rays without a hit are omitted."""

    rays: IntArray
    """(n,): indices of the rays."""
    triangles: IntArray
    """(n,)"""
    barycentric: Float32Array
    """(n, 3): weight of each corner."""
    positions: Float32Array
    """(n, 3) [mm]"""


def traced_triangles(triangles: IntArray) -> NDArray[np.object_]:
    """Return (n, 3) triangles as (n,) tuples, which embreex reads twice as fast."""
    rows = np.empty(len(triangles), dtype=object)
    rows[:] = list(zip(*triangles.T.tolist(), strict=True))
    return rows


class Tracer:
    """Ray tracer of one pose of a surface: points, (points, 3) [mm], and `traced_triangles`."""

    def __init__(self, points: Float32Array, triangles: NDArray[np.object_]) -> None:
        self._scene = EmbreeScene(robust=False)  # watertight to rounding costs a tenth of a picture
        TriangleMesh(self._scene, np.ascontiguousarray(points, np.float32), triangles)

    def find(self, origins: Float32Array, directions: Float32Array) -> RayHits:
        """Return the first hit of each ray; both (n, 3), unit directions."""
        origins = np.ascontiguousarray(origins)
        met = self._scene.run(origins, np.ascontiguousarray(directions), output=1)
        rays = np.flatnonzero(met["primID"] >= 0)
        u, v = met["u"][rays], met["v"][rays]
        return RayHits(
            rays=rays,
            triangles=met["primID"][rays].astype(np.int64),
            barycentric=np.stack([1 - u - v, u, v], axis=1),
            positions=np.take(origins, rays, axis=0)
            + met["tfar"][rays, None] * np.take(directions, rays, axis=0),
        )

    def blocked(
        self, origins: Float32Array, directions: Float32Array, *, reach: float
    ) -> BoolArray:
        """Return whether each ray has a hit within `reach` lengths of its direction."""
        distances = np.full(len(origins), reach, np.float32)
        met = self._scene.run(origins, directions, dists=distances, query="OCCLUDED")
        return np.asarray(met != -1)


def sky_seen(
    tracer: Tracer,
    positions: Float32Array,
    normals: Float32Array,
    *,
    patterns: IntArray,
    ray_count: int,
    reach: float,
) -> Float32Array:
    """Return the unoccluded share of cosine-weighted rays from each point [0-1]: (n,) float32.

    Parameters
    ----------
    positions, normals : (n, 3) float32 arrays
        Positions slightly above the surface.
    patterns : (n,) int array
        Set of directions of each point, below `PATTERN_COUNT`.
    reach : float
        Largest distance of occluders [mm].
    """
    table = _sphere_table(ray_count)
    free = np.zeros(len(positions), np.float32)
    for rays in table.transpose(1, 0, 2):
        # Normal plus a point on the unit sphere is cosine-weighted; 0.99 avoids zero length.
        directions = normals + np.take(np.float32(0.99) * rays, patterns, axis=0)
        directions /= row_lengths(directions)
        free += ~tracer.blocked(positions, directions, reach=reach)
    return free / np.float32(ray_count)


def light_seen(
    tracer: Tracer,
    positions: Float32Array,
    *,
    direction: Float32Array,
    spread: float,
    patterns: IntArray,
    ray_count: int,
) -> Float32Array:
    """Return the visible share of a distant disc light from each point [0-1]: (n,) float32.

    `direction`: unit vector towards the light's centre. `spread`: the light's radius over its
    distance. `positions`, `patterns`: as in `sky_seen`.
    """
    side = np.cross(direction, [0.0, 1.0, 0.0] if abs(direction[1]) < 0.9 else [1.0, 0.0, 0.0])
    side /= np.linalg.norm(side)
    u, v = _sequence(ray_count)
    radius, angle = spread * np.sqrt(u), 2 * np.pi * v
    across = np.stack([side, np.cross(direction, side)])
    offsets = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1) @ across
    table = (direction + offsets).astype(np.float32)
    free = np.zeros(len(positions), np.float32)
    for rays in table.transpose(1, 0, 2):
        free += ~tracer.blocked(positions, np.take(rays, patterns, axis=0), reach=1e6)
    return free / np.float32(ray_count)


def _sequence(ray_count: int) -> tuple[FloatArray, FloatArray]:
    """Return (patterns, rays) coordinates of low-discrepancy points."""
    index = np.arange(PATTERN_COUNT)[:, None] + PATTERN_COUNT * np.arange(ray_count)[None, :]
    # Permuted so that patterns of neighbours in a block differ most.
    index = (index * 7) % (PATTERN_COUNT * ray_count) if ray_count % 7 else index
    return r2_points(index)


def r2_points(index: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return the coordinates of points of the low-discrepancy sequence R2 (Roberts 2018) [0-1]."""
    plastic = 1.32471795724474602596
    return (0.5 + index / plastic) % 1.0, (0.5 + index / plastic**2) % 1.0


def _sphere_table(ray_count: int) -> Float32Array:
    u, v = _sequence(ray_count)
    z, angle = 2 * u - 1, 2 * np.pi * v
    ring = np.sqrt(np.maximum(1 - z**2, 0))
    table = np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=-1)
    return np.asarray(table, np.float32)


_LEAST_COSINE = 0.8  # between normals of pixels that are averaged
# Weights over five pixels that count every pattern of a 4 by 4 block equally.
_TAPER = {0: 1.0, 1: 1.0, 2: 0.5}


def denoise(
    values: Float32Array,
    *,
    rays: IntArray,
    normals: Float32Array,
    positions: Float32Array,
    shape: tuple[int, int],
    tolerance: float,
) -> Float32Array:
    """Average values over blocks of pixels, except across edges of the surface: (n, k) float32.

    Parameters
    ----------
    values : (n, k) float32 array
    rays : (n,) int array
        Pixel of each value, row by row.
    normals, positions : (n, 3) float32 arrays
        [mm]
    shape : tuple of int
        Height and width of the picture.
    tolerance : float
        Largest distance of a neighbour from a pixel's tangent plane [mm].
    """
    if not len(rays):
        return values
    rows, columns = np.divmod(rays, shape[1])
    box = (slice(rows.min(), rows.max() + 1), slice(columns.min(), columns.max() + 1))
    grid = (rows - rows.min(), columns - columns.min())
    height, width = box[0].stop - box[0].start, box[1].stop - box[1].start
    # Slices of image planes align neighbours without a copy. Pixels without a hit have a zero
    # normal, which fails the test of the cosine.
    normal = np.zeros((3, height, width), np.float32)
    place = np.zeros((3, height, width), np.float32)
    given = np.ones((values.shape[1] + 1, height, width), np.float32)  # the last sums weights
    normal[:, *grid], place[:, *grid], given[:-1, *grid] = normals.T, positions.T, values.T
    total = given.copy()
    for dy in range(3):
        for dx in range(-2, 3):
            if dy == 0 and dx <= 0:
                continue  # every pair once, in both directions
            share = np.float32(_TAPER[dy] * _TAPER[abs(dx)])
            here, there = _aligned(dy, dx, height, width)
            n, m = normal[:, *here], normal[:, *there]
            step = place[:, *there] - place[:, *here]
            alike = np.einsum("kij,kij->ij", n, m) > _LEAST_COSINE
            off_plane = np.abs(np.einsum("kij,kij->ij", step, n + m))
            share = share * (alike & (off_plane < 2 * tolerance))
            total[:, *here] += share * given[:, *there]
            total[:, *there] += share * given[:, *here]
    return np.asarray((total[:-1] / total[-1])[:, *grid].T)


def _aligned(
    dy: int, dx: int, height: int, width: int
) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Return slices of each pixel and of its neighbour dy below and dx to the right."""
    left, right = max(-dx, 0), max(dx, 0)
    here = (slice(0, max(height - dy, 0)), slice(left, max(width - right, left)))
    there = (slice(dy, max(height, dy)), slice(right, max(width - left, right)))
    return here, there
