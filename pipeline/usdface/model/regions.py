"""Parts of the face that residuals and confidence are told for: by what shapes move."""

import numpy as np

from usdface.assets import FloatArray, IntArray
from usdface.numerics.measure.face_regions import points_by_region, shapes_by_region

FACE = "face"
"""The first region: everything."""

_RIDGE = 0.02  # of the pairs, on weights: shapes that act together share the motion


def region_points(names: tuple[str, ...], motion: FloatArray) -> dict[str, IntArray]:
    """Give every point to the part of the face whose shapes move it most.

    Parameters
    ----------
    names : tuple of str
        Of the shapes; where none speaks of a part of the face there is only the whole.
    motion : (shapes, points, 3) float array
        What each shape at 1 does [mm].

    Returns
    -------
    dict of str to (n,) int array
        The whole face first.
    """
    from scipy import sparse  # only when wanted: it takes half a second

    everywhere = np.arange(motion.shape[1])
    found = points_by_region(
        sparse.csr_array(motion.reshape(len(motion), -1)), shapes_by_region(names)
    )
    return {FACE: everywhere} | found


def marker_motion(weights: FloatArray, markers: FloatArray) -> FloatArray:
    """Learn what each shape does to each marker: (shapes, markers, 3) float array [mm].

    Parameters
    ----------
    weights : (pairs, shapes) float array
    markers : (pairs, markers, 3) float array
    """
    rows = weights - weights.mean(axis=0)
    seen = (markers - markers.mean(axis=0)).reshape(len(markers), -1)
    normal = rows.T @ rows + _RIDGE * len(rows) * np.eye(rows.shape[1])
    moved: FloatArray = np.linalg.solve(normal, rows.T @ seen)
    return moved.reshape(rows.shape[1], -1, 3)


def membership(points: dict[str, IntArray], count: int) -> FloatArray:
    """Return which of `count` points each region holds: (regions, count) array of 0 and 1."""
    held = np.zeros((len(points), count))
    for row, members in enumerate(points.values()):
        held[row, members] = 1.0
    return held
