"""Samples that a line between their neighbours tells well enough are left out."""

import numpy as np
from numpy.typing import NDArray

from usdface.core.arrays import Float32Array, FloatArray, IntArray

SPAN = 64
"""Longest stretch that one line may tell: stretches are looked at on their own, so what is kept of
one depends on nothing around it."""


def sparse_rows(values: Float32Array | FloatArray, tolerance: float) -> IntArray:
    """Choose rows so that lines between them tell all others within a tolerance.

    A stretch that its two ends do not tell is halved, and its halves are looked at in turn: all
    stretches of one length at once, so that the cost of a frame is that of a few sums.

    Parameters
    ----------
    values : (frames, columns) float array
        Looked at in single precision, as USD keeps them.
    tolerance : float
        Most that any value may be off, in the unit of the values.

    Returns
    -------
    (kept,) int array
        Ascending, the first and the last among them.

    See Also
    --------
    usdface.numerics.motion.key_reduction.reduce_keys : fewer rows, in a loop over them.
    """
    rows = np.asarray(values, dtype=np.float32)
    count = len(rows)
    kept = np.zeros(count, dtype=bool)
    kept[::SPAN] = True
    kept[-1:] = True
    whole = (count - 1) // SPAN if count else 0
    if whole:
        _halve(rows, np.arange(whole) * SPAN, SPAN, tolerance, kept)
    start, span = whole * SPAN, SPAN // 2
    while span:  # what is left, in stretches each half as long as the one before
        if start + span < count:
            kept[start + span] = True
            _halve(rows, np.array([start]), span, tolerance, kept)
            start += span
        span //= 2
    return np.flatnonzero(kept)


def _halve(
    rows: Float32Array, starts: IntArray, span: int, tolerance: float, kept: NDArray[np.bool_]
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
        kept[starts] = True
