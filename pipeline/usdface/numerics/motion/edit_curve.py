"""Changes on top of a solved curve, so that they outlive the solve.

With offset *e*, override *o* and mask *m*, the solved weight *s* becomes ``(1 - m) s + m o + e``.
Each change is folded in so that the last one wins where it is at full strength, and blends in its
fades: adding *a* gives ``w + n a``, overriding with *v* gives ``(1 - n) w + n v``, clearing
``(1 - n) w + n s``, where *w* is the edited weight before and *n* the new change's own mask.
"""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import BoolArray, FloatArray, IntArray

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

    Raises
    ------
    ValueError
        If the range is empty or the fade negative.
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
