"""Points of a rig's surface that stand for all of it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from usdface.assets import FloatArray

if TYPE_CHECKING:
    from scipy import sparse

POINTS = 1500
LEAST_SHARE = 0.02
"""Of the largest movement: points that no shape moves this far are not face."""


def sample_skin(offsets: FloatArray | sparse.sparray, *, count: int = POINTS) -> FloatArray:
    """Keep evenly spaced ones of the points that shapes move.

    Parameters
    ----------
    offsets : (shapes, points * 3) float array or sparse array
        What each shape at 1 does to the surface [mm], as `BlendShapes.target_offsets` gives it.
    count : int
        Most points to keep.

    Returns
    -------
    (shapes, kept, 3) float array
    """
    from scipy import sparse  # only when wanted: it takes half a second

    table = sparse.csc_array(offsets)
    energy = np.asarray(table.power(2).sum(axis=0)).reshape(-1, 3).sum(axis=1)
    reach = np.sqrt(energy)
    moving = np.flatnonzero(reach > LEAST_SHARE * reach.max(initial=0.0))
    kept = moving[np.linspace(0, len(moving) - 1, min(count, len(moving))).astype(np.int64)]
    columns = (3 * kept[:, None] + np.arange(3)).ravel()
    sampled: FloatArray = np.asarray(table[:, columns].toarray(), dtype=np.float64)
    return sampled.reshape(table.shape[0], len(kept), 3)
