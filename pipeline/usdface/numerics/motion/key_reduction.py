"""Reduction of curves to few keys with lines between them, and edits layered over solved curves.

`reduce_keys` chooses fewer keys, for animators; `sparse_rows` is faster, for files.

Edits are stored apart from the solve, so that they survive a new one. With offset *e*, override *o*
and mask *m*, the solved weight *s* becomes ``(1 - m) s + m o + e``. A new edit with mask *n* is
composed with the edited weight *w* before it: adding *a* gives ``w + n a``, overriding with *v*
gives ``(1 - n) w + n v``, and clearing gives ``(1 - n) w + n s``.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import BoolArray, Float32Array, FloatArray, IntArray

_LEAST_CHANGE = 1e-6
"""Smaller changes of a weight are ignored: single precision, in which weights are stored."""


@dataclass(frozen=True)
class EditCurve:
    """Edits of one shape, frame by frame."""

    offset: FloatArray
    """(frames,): added to the weight."""
    override: FloatArray
    """(frames,): replaces the solved weight by the share `mask`; arbitrary where `mask` is 0."""
    mask: FloatArray
    """(frames,) [0-1]"""

    @property
    def active(self) -> BoolArray:
        """Frames with a change."""
        return np.asarray((np.abs(self.offset) > _LEAST_CHANGE) | (self.mask > _LEAST_CHANGE))


def no_edit(frames: int) -> EditCurve:
    """Return an edit without any change, over a number of frames."""
    return EditCurve(np.zeros(frames), np.zeros(frames), np.zeros(frames))


def apply_edit(solved: FloatArray, edit: EditCurve) -> FloatArray:
    """Return the edited weights of one shape, (frames,)."""
    return np.asarray((1 - edit.mask) * solved + edit.mask * edit.override + edit.offset)


def fade_mask(frames: IntArray, first: int, last: int, *, fade: int = 0) -> FloatArray:
    """Return 1 from `first` to `last`, with half a cosine from and to 0 outside.

    Parameters
    ----------
    frames : (n,) int array
        Frame numbers.
    first, last : int
        Inclusive.
    fade : int
        Length of the half cosine on either side [frames].
    """
    if last < first or fade < 0:
        raise ValueError(f"frames {first}-{last} with a fade of {fade} are no range")
    away = np.maximum(np.maximum(first - frames, frames - last), 0)
    return np.asarray(0.5 + 0.5 * np.cos(np.pi * np.minimum(away / (fade + 1), 1.0)))


def add_to_edit(edit: EditCurve, value: float | FloatArray, mask: FloatArray) -> EditCurve:
    """Return the edit with `mask` times `value` added."""
    return EditCurve(edit.offset + mask * value, edit.override, edit.mask)


def override_edit(edit: EditCurve, value: float | FloatArray, mask: FloatArray) -> EditCurve:
    """Return the edit with the weight replaced by `value`, by the share `mask`."""
    earlier = (1 - mask) * edit.mask
    total = mask + earlier
    shown = mask * value + earlier * edit.override
    override = np.where(total > 0, shown / np.where(total > 0, total, 1.0), edit.override)
    return EditCurve((1 - mask) * edit.offset, override, total)


def clear_edit(edit: EditCurve, mask: FloatArray) -> EditCurve:
    """Return the edit with the solve restored, by the share `mask`."""
    return EditCurve((1 - mask) * edit.offset, edit.override, (1 - mask) * edit.mask)


def needed_samples(values: FloatArray) -> BoolArray:
    """Return the samples that a linearly interpolated curve needs: all but those inside runs.

    A constant curve needs one.
    """
    needed = np.ones(len(values), dtype=bool)
    if len(values) > 2:
        needed[1:-1] = (values[1:-1] != values[:-2]) | (values[1:-1] != values[2:])
    if len(values) and (values == values[0]).all():
        needed[1:] = False
    return needed


Deviation = Callable[[slice, FloatArray], FloatArray]
"""Called with a range of frames and interpolated weights (frames, shapes); returns their errors
(frames,)."""
_SPAN_FRAMES = 64
"""Longest line of `sparse_rows`. Spans are reduced independently of each other."""


def reduce_keys(
    weights: FloatArray, tolerance: float, *, deviation: Deviation | None = None
) -> IntArray:
    """Choose keys by the Ramer-Douglas-Peucker algorithm: lines between them meet a tolerance.

    Returns (keys,) rows of `weights`, ascending, with the first and the last.

    Parameters
    ----------
    weights : (frames, shapes) float array
        All shapes share their keys, as in a SkelAnimation.
    tolerance : float
        Largest error of a frame, in the unit of `deviation`.
    deviation : callable, optional
        By default the largest difference of any weight.

    References
    ----------
    Ramer (1972), Computer Graphics and Image Processing 1(3); Douglas and Peucker (1973),
    Cartographica 10(2).
    """
    if deviation is None:

        def deviation(part: slice, lines: FloatArray) -> FloatArray:
            return np.asarray(np.abs(weights[part] - lines).max(axis=1, initial=0.0))

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
        along = (np.arange(first + 1, last) - first)[:, None] / (last - first)
        off = deviation(part, weights[first] + along * (weights[last] - weights[first]))
        worst = int(off.argmax())
        if off[worst] > tolerance:
            middle = first + 1 + worst
            chosen[middle] = True
            spans += [(first, middle), (middle, last)]
    return np.flatnonzero(chosen)


def sparse_rows(values: Float32Array | FloatArray, tolerance: float) -> IntArray:
    """Choose rows by bisection, so that lines between them meet all others within a tolerance.

    Faster than `reduce_keys`, which chooses fewer. A span whose line misses a row is halved, and so
    on: all spans of one length at once. Returns (n,), ascending, with the first and the last.

    Parameters
    ----------
    values : (frames, columns) float array
        Compared in single precision, in which USD stores them.
    tolerance : float
        Largest error of a value.
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
    while span:  # the remainder, in spans each half as long as the previous
        if start + span < count:
            chosen[start + span] = True
            _halve(rows, np.array([start]), span, tolerance, chosen)
            start += span
        span //= 2
    return np.flatnonzero(chosen)


def _halve(
    rows: Float32Array, starts: IntArray, span: int, tolerance: float, chosen: BoolArray
) -> None:
    """Mark the rows to keep within the spans that begin at `starts`."""
    while span > 1 and len(starts):
        along = (np.arange(1, span) / span).astype(np.float32)[:, None]
        first, last = rows[starts][:, None], rows[starts + span][:, None]
        off = rows[starts[:, None] + np.arange(1, span)]
        off -= first + along * (last - first)
        far = np.abs(off, out=off).max(axis=(1, 2), initial=0) > tolerance
        span //= 2
        starts = np.concatenate([starts[far], starts[far] + span])
        chosen[starts] = True
