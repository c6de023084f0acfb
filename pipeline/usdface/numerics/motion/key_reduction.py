"""Fewer keys for animators who edit keys: lines between some frames, within a tolerance."""

from collections.abc import Callable

import numpy as np

from usdface.core.arrays import FloatArray, IntArray

Deviation = Callable[[slice, FloatArray], FloatArray]
"""Called with a range of frames and weights for them, (frames, shapes); returns how far these are
from the true ones, (frames,)."""


def reduce_keys(
    weights: FloatArray, tolerance: float, *, deviation: Deviation | None = None
) -> IntArray:
    """Choose the frames to keep so that lines between them stay within a tolerance.

    From the first frame to the last a line is drawn; the frame it misses by most is kept and the
    two halves are looked at in turn, until none is missed by more than the tolerance.

    Parameters
    ----------
    weights : (frames, shapes) float array
        One array of weights is one key, as in a SkelAnimation: all shapes share their keys.
    tolerance : float
        Most that any frame may be off, in the unit of `deviation`.
    deviation : callable, optional
        The largest difference of any weight by default.

    Returns
    -------
    (keys,) int array
        Rows of `weights`, ascending, the first and the last among them; none of none.

    Raises
    ------
    ValueError
        If the tolerance is not positive.

    References
    ----------
    Ramer (1972), Computer Graphics and Image Processing 1(3); Douglas and Peucker (1973),
    Cartographica 10(2).
    """
    if not tolerance > 0:
        raise ValueError(f"tolerance must be positive, got {tolerance}")
    if deviation is None:

        def deviation(part: slice, lines: FloatArray) -> FloatArray:
            off: FloatArray = np.abs(weights[part] - lines).max(axis=1, initial=0.0)
            return off

    count = len(weights)
    kept = np.zeros(count, dtype=bool)
    if not count:
        return np.flatnonzero(kept)
    kept[[0, -1]] = True
    spans = [(0, count - 1)]
    while spans:
        first, last = spans.pop()
        if last - first < 2:
            continue
        part = slice(first + 1, last)
        off = deviation(part, line_between(weights, first, last))
        worst = int(off.argmax())
        if off[worst] > tolerance:
            middle = first + 1 + worst
            kept[middle] = True
            spans += [(first, middle), (middle, last)]
    return np.flatnonzero(kept)


def line_between(weights: FloatArray, first: int, last: int) -> FloatArray:
    """Return the weights on the line between two rows, for the rows between them."""
    along = (np.arange(first + 1, last) - first) / (last - first)
    line: FloatArray = weights[first] + along[:, None] * (weights[last] - weights[first])
    return line
