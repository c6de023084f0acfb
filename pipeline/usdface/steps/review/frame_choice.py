"""Which frames of a shot are worth a look."""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import BoolArray, FloatArray
from usdface.specs.review import FramePick

WORST_SHARE = 6
"""Among expressions, one frame in so many is a worst one."""


@dataclass(frozen=True)
class ChosenFrame:
    """A row of the shot, and why it was chosen; empty where it shows what the face does."""

    row: int
    reason: str = ""


def choose_frames(
    pick: FramePick,
    count: int,
    *,
    strength: FloatArray,
    error_mm: FloatArray,
    confidence: FloatArray | None,
    jump_mm: FloatArray,
) -> list[ChosenFrame]:
    """Choose frames, in order of time and spread over it.

    Parameters
    ----------
    pick : {'expression', 'residual', 'confidence', 'jump', 'even'}
        What makes a frame worth it; ``'expression'`` takes some of the largest errors too.
    count : int
        Fewer where there are fewer frames, or fewer whose error is known, of the worst.
    strength : (frames,) float array
        How far the face is from neutral.
    error_mm : (frames,) float array
        NaN where it is not known.
    confidence : (frames,) float array or None
        [0-1] Without it, `error_mm` stands in.
    jump_mm : (frames,) float array
        How far the surface moved since the frame before.
    """
    frames = len(strength)
    count = min(count, frames)
    apart = max(frames // (3 * count), 1)
    known = np.isfinite(error_mm)
    error = np.where(known, error_mm, -1.0)
    if pick == "even":
        spread = np.unique(np.linspace(0, frames - 1, count).round().astype(np.int64))
        return [ChosenFrame(row) for row in spread.tolist()]
    if pick == "expression":
        worst = min(count // WORST_SHARE, count - 1)
        chosen = _strongest(strength, count - worst, apart)
        rows = _largest(error, count, apart, taken=chosen)
        found = [ChosenFrame(row) for row in chosen]
        found += [ChosenFrame(row, "worst" if known[row] else "") for row in rows]
    elif pick == "confidence" and confidence is not None:
        rows = _largest(-confidence, count, apart)
        found = [ChosenFrame(row, f"confidence {confidence[row]:.2f}") for row in rows]
    elif pick == "jump":
        rows = _largest(jump_mm, count, apart)
        found = [ChosenFrame(row, f"moved {jump_mm[row]:.2f} mm") for row in rows]
    else:
        rows = _largest(error, count, apart, among=known if known.any() else None)
        found = [
            ChosenFrame(row, f"error {error[row]:.2f} mm" if known[row] else "") for row in rows
        ]
    return sorted(found, key=lambda frame: frame.row)


def _strongest(strength: FloatArray, count: int, apart: int) -> list[int]:
    """Return the strongest row of each of so many stretches of time."""
    chosen: list[int] = []
    for stretch in np.array_split(np.arange(len(strength)), count):
        free = [row for row in stretch if all(abs(row - other) >= apart for other in chosen)]
        chosen.append(int(max(free or stretch, key=lambda row: strength[row])))
    return chosen


def _largest(
    values: FloatArray,
    count: int,
    apart: int,
    *,
    taken: list[int] | None = None,
    among: BoolArray | None = None,
) -> list[int]:
    """Return rows by falling value, none near another or one that is taken, up to `count` of both.

    One bad moment is one row, not all of them; where the shot is too short for that, rows that are
    near others fill up.
    """
    known = list(taken or ())
    chosen: list[int] = []
    blocked = np.zeros(len(values), bool)
    for row in known:
        blocked[max(row - apart + 1, 0) : row + apart] = True
    order = np.argsort(-values, kind="stable")
    if among is not None:
        order = order[among[order]]
    for row in order.tolist():
        if len(known) + len(chosen) >= count:
            return chosen
        if not blocked[row]:
            chosen.append(row)
            blocked[max(row - apart + 1, 0) : row + apart] = True
    left = [row for row in order.tolist() if row not in {*known, *chosen}]
    return chosen + left[: max(count - len(known) - len(chosen), 0)]
