"""Fewer frames, with lines between them that meet the others within a tolerance.

`reduce_keys` chooses few, for animators who edit keys; `sparse_rows` is quick, for files.
"""

from collections.abc import Callable

import numpy as np

from usdface.core.arrays import BoolArray, Float32Array, FloatArray, IntArray

Deviation = Callable[[slice, FloatArray], FloatArray]
"""Called with a range of frames and weights for them, (frames, shapes); returns how far these are
from the true ones, (frames,)."""
_SPAN_FRAMES = 64
"""Longest stretch that `sparse_rows` spans by one line. Stretches are reduced one by one, so the
rows chosen of one depend on nothing around it."""


def reduce_keys(
    weights: FloatArray, tolerance: float, *, deviation: Deviation | None = None
) -> IntArray:
    """Choose the frames to keep so that lines between them stay within a tolerance.

    From the first frame to the last a line is drawn; the frame it misses by most is chosen and the
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
    chosen = np.zeros(count, dtype=bool)
    if not count:
        return np.flatnonzero(chosen)
    chosen[[0, -1]] = True
    spans = [(0, count - 1)]
    while spans:
        first, last = spans.pop()
        if last - first < 2:
            continue
        part = slice(first + 1, last)
        off = deviation(part, _line_between(weights, first, last))
        worst = int(off.argmax())
        if off[worst] > tolerance:
            middle = first + 1 + worst
            chosen[middle] = True
            spans += [(first, middle), (middle, last)]
    return np.flatnonzero(chosen)


def _line_between(weights: FloatArray, first: int, last: int) -> FloatArray:
    """Return the weights on the line between two rows, for the rows between them."""
    along = (np.arange(first + 1, last) - first) / (last - first)
    line: FloatArray = weights[first] + along[:, None] * (weights[last] - weights[first])
    return line


def sparse_rows(values: Float32Array | FloatArray, tolerance: float) -> IntArray:
    """Choose rows so that lines between them meet all others within a tolerance.

    Quicker than `reduce_keys`, which chooses fewer. A stretch that the line between its two ends
    misses is halved, and its halves are looked at in turn: all
    stretches of one length at once, so that the cost of a frame is that of a few sums.

    Parameters
    ----------
    values : (frames, columns) float array
        Looked at in single precision, as USD keeps them.
    tolerance : float
        Most that any value may be off, in the unit of the values.

    Returns
    -------
    (n,) int array
        Ascending, the first and the last among them.
    """
    rows = np.asarray(values, dtype=np.float32)
    count = len(rows)
    chosen = np.zeros(count, dtype=bool)
    chosen[::_SPAN_FRAMES] = True
    chosen[-1:] = True
    whole = (count - 1) // _SPAN_FRAMES if count else 0
    if whole:
        _halve(rows, np.arange(whole) * _SPAN_FRAMES, _SPAN_FRAMES, tolerance, chosen)
    start, span = whole * _SPAN_FRAMES, _SPAN_FRAMES // 2
    while span:  # what is left, in stretches each half as long as the one before
        if start + span < count:
            chosen[start + span] = True
            _halve(rows, np.array([start]), span, tolerance, chosen)
            start += span
        span //= 2
    return np.flatnonzero(chosen)


def _halve(
    rows: Float32Array, starts: IntArray, span: int, tolerance: float, chosen: BoolArray
) -> None:
    """Mark the rows to keep within stretches from each start to a span after it."""
    while span > 1 and len(starts):
        along = (np.arange(1, span) / span).astype(np.float32)[:, None]
        first, last = rows[starts][:, None], rows[starts + span][:, None]
        off = rows[starts[:, None] + np.arange(1, span)]
        off -= first + along * (last - first)
        far = np.abs(off, out=off).max(axis=(1, 2), initial=0) > tolerance
        span //= 2
        starts = np.concatenate([starts[far], starts[far] + span])
        chosen[starts] = True
