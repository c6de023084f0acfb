"""Denoising of light: averages over neighbouring pixels of the same surface."""

import numpy as np

from usdface.core.arrays import Float32Array, IntArray

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
