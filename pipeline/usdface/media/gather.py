"""Share noisy light between neighbouring pixels that look at the same bit of surface."""

import numpy as np

from usdface.assets import Float32Array, IntArray

_REACH = (0.5, 1.0, 1.0, 1.0, 0.5)  # weights that add up every direction of a 4 by 4 block once


def share_between_neighbours(
    values: Float32Array,
    *,
    rays: IntArray,
    normals: Float32Array,
    positions: Float32Array,
    shape: tuple[int, int],
    tolerance: float,
) -> Float32Array:
    """Average values over blocks of pixels, never across an edge of the form.

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
        How far off a pixel's tangent plane a neighbour may lie [mm].

    Returns
    -------
    (n, k) float32 array
    """
    height, width = shape
    pad = 2
    slot = np.full((height + 2 * pad, width + 2 * pad), -1, np.int64)
    rows, columns = rays // width + pad, rays % width + pad
    slot[rows, columns] = np.arange(len(rays))
    total = values.copy()
    weight = np.ones(len(values), np.float32)
    for dy, vertical in zip(range(-pad, pad + 1), _REACH, strict=True):
        for dx, horizontal in zip(range(-pad, pad + 1), _REACH, strict=True):
            if dy == dx == 0:
                continue
            other = slot[rows + dy, columns + dx]
            here = np.flatnonzero(other >= 0)
            there = other[here]
            offset = positions[there] - positions[here]
            plane = np.abs(np.einsum("ij,ij->i", offset, normals[here]))
            alike = np.einsum("ij,ij->i", normals[there], normals[here])
            share = np.float32(vertical * horizontal) * ((plane < tolerance) & (alike > 0.8))
            total[here] += share[:, None] * values[there]
            weight[here] += share
    return total / weight[:, None]
