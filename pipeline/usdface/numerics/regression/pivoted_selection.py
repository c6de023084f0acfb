"""Rows that differ most: each adds what those before it cannot make up between them."""

import numpy as np

from usdface.core.arrays import FloatArray, IntArray

_LEAST_SHARE = 1e-3
"""Of the largest row's length: what is left of a row below this is no difference."""


def most_different_rows(rows: FloatArray, count: int) -> IntArray:
    """Choose rows by pivoted orthogonalisation.

    The longest row first; then always the one furthest from the span of those chosen. So a half
    smile is not chosen beside the full one: as a shape it would be the same shape again.

    Parameters
    ----------
    rows : (n, k) float array
        Differences from the origin.
    count : int

    Returns
    -------
    (m,) int array
        In the order chosen; fewer than `count` where the rows span less.
    """
    left = np.array(rows, dtype=np.float64)
    energy = np.einsum("nk,nk->n", left, left)
    least = _LEAST_SHARE**2 * float(energy.max(initial=0.0))
    chosen: list[int] = []
    for _ in range(min(count, len(left))):
        best = int(energy.argmax())
        if not energy[best] > least:
            break
        direction = left[best] / np.sqrt(energy[best])
        left -= np.outer(left @ direction, direction)
        energy = np.einsum("nk,nk->n", left, left)
        energy[chosen] = 0.0
        energy[best] = 0.0
        chosen.append(best)
    return np.array(chosen, np.int64)
