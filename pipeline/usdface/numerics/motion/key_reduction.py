"""Curves as animators edit them: fewer keys with lines between them, and changes on top.

`reduce_keys` chooses few, for animators who edit keys; `sparse_rows` is quick, for files.

Edits lie on top of a solved curve, so that they outlive the solve. With offset *e*, override *o*
and mask *m*, the solved weight *s* becomes ``(1 - m) s + m o + e``. Each change is folded in so
that the last one wins where it is at full strength, and blends in its fades: adding *a* gives
``w + n a``, overriding with *v* gives ``(1 - n) w + n v``, clearing ``(1 - n) w + n s``, where *w*
is the edited weight before and *n* the new change's own mask.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import BoolArray, Float32Array, FloatArray, IntArray

_LEAST_CHANGE = 1e-6
"""A smaller change is none: single precision, in which weights are kept, ends there."""


@dataclass(frozen=True)
class EditCurve:
    """What an animator changed of one shape, frame by frame."""

    offset: FloatArray
    """(frames,): added to the weight."""
    override: FloatArray
    """(frames,): replaces the solved weight by the share `mask`; anything where `mask` is 0."""
    mask: FloatArray
    """(frames,) [0-1]"""

    @property
    def active(self) -> BoolArray:
        """Frames at which anything is changed."""
        changed: BoolArray = (np.abs(self.offset) > _LEAST_CHANGE) | (self.mask > _LEAST_CHANGE)
        return changed


def no_edit(frames: int) -> EditCurve:
    """Return a curve that changes nothing over so many frames."""
    return EditCurve(np.zeros(frames), np.zeros(frames), np.zeros(frames))


def apply_edit(solved: FloatArray, edit: EditCurve) -> FloatArray:
    """Return the edited weights of one shape, (frames,)."""
    edited: FloatArray = (1 - edit.mask) * solved + edit.mask * edit.override + edit.offset
    return edited


def fade_mask(frames: IntArray, first: int, last: int, *, fade: int = 0) -> FloatArray:
    """Return 1 from `first` to `last`, and an ease from and to 0 outside.

    Parameters
    ----------
    frames : (n,) int array
        Frame numbers.
    first, last : int
        Inclusive.
    fade : int
        Frames on either side that are blended by half a cosine; at 0 the change is hard.
    """
    if last < first or fade < 0:
        raise ValueError(f"frames {first}-{last} with a fade of {fade} are no range")
    away = np.maximum(np.maximum(first - frames, frames - last), 0)
    eased: FloatArray = 0.5 + 0.5 * np.cos(np.pi * np.minimum(away / (fade + 1), 1.0))
    return eased


def add_to_edit(edit: EditCurve, value: float | FloatArray, mask: FloatArray) -> EditCurve:
    """Fold in: `mask` times `value` is added."""
    return EditCurve(edit.offset + mask * value, edit.override, edit.mask)


def override_edit(edit: EditCurve, value: float | FloatArray, mask: FloatArray) -> EditCurve:
    """Fold in: the weight is `value` by the share `mask`, whatever was there."""
    earlier = (1 - mask) * edit.mask
    total = mask + earlier
    shown = mask * value + earlier * edit.override
    override = np.where(total > 0, shown / np.where(total > 0, total, 1.0), edit.override)
    return EditCurve((1 - mask) * edit.offset, override, total)


def clear_edit(edit: EditCurve, mask: FloatArray) -> EditCurve:
    """Fold in: the solve shows again by the share `mask`."""
    return EditCurve((1 - mask) * edit.offset, edit.override, (1 - mask) * edit.mask)


def needed_samples(values: FloatArray) -> BoolArray:
    """Return which samples a curve needs that is held and interpolated linearly between them.

    Inside a run of equal values none is needed: only its ends. A curve of one value needs one.
    """
    needed = np.ones(len(values), dtype=bool)
    if len(values) > 2:
        needed[1:-1] = (values[1:-1] != values[:-2]) | (values[1:-1] != values[2:])
    if len(values) and (values == values[0]).all():
        needed[1:] = False
    return needed


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
