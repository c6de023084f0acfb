"""Sequences put into a motion by 1-D Laplacian warping: Song et al. (2011), section 5.3, eq. 11-12.

The step from each frame to the next (the 1-D Laplacian coordinates of eq. 11) is kept as far as
soft constraints allow: over the interval of a sequence the targets are its keys, outside the motion
itself. With X what is added to the motion, D the (n - 1, n) matrix of eq. 11 and W the constraints'
weights on a diagonal, eq. 12 is ``(D' D + W) X = W (keys - motion)``: tridiagonal, positive
definite, and without a right side where the motion itself is the target. There X decays
geometrically, so that windows round the sequences are all there is to solve.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.linalg import solveh_banded

from usdface.core.arrays import FloatArray

_ROUNDING_SHARE = 2.0**-60
"""[of a change] Less is lost in the motion's own digits."""


@dataclass(frozen=True)
class Insertion:
    """A sequence to put into a motion."""

    start: int
    """Index of the frame where its first key goes."""
    keys: FloatArray
    """(m, controls)"""
    weights: FloatArray
    """(m,): of each key's squared difference; the paper has 1. 0 leaves a frame free, 100 is
    obeyed."""

    @property
    def stop(self) -> int:
        """Index of the frame after its last key."""
        return self.start + len(self.keys)


@dataclass(frozen=True)
class _Window:
    first: int
    stop: int
    insertions: tuple[Insertion, ...]


def warp_motion(
    motion: FloatArray, insertions: Sequence[Insertion], *, blend: int = 12, keep: float = math.inf
) -> FloatArray:
    """Put sequences into a motion; frames further than `blend` from all of them keep their values.

    Parameters
    ----------
    motion : (frames, controls) float array
        Left as it is.
    insertions : sequence of Insertion
        In any order, none overlapping another.
    blend : int
        Frames on each side of a sequence over which the motion passes into it.
    keep : float
        Weight that holds the motion outside the sequences and their blends. Infinite: it stays to
        the last bit. Finite, as published (there 1): it gives way a little, the less the further
        away, and the blends are free.

    Returns
    -------
    (frames, controls) float array
    """
    if motion.ndim != 2:
        raise ValueError(f"a motion is (frames, controls), got {motion.shape}")
    if blend < 0 or not keep > 0:
        raise ValueError(f"blend must not be negative and keep be positive, got {blend}, {keep}")
    ordered = sorted(insertions, key=lambda each: each.start)
    for each in ordered:
        _check(each, motion.shape)
    for one, other in pairwise(ordered):
        if other.start < one.stop:
            raise ValueError(
                f"sequences at frames {one.start}-{one.stop - 1} and {other.start}-"
                f"{other.stop - 1} overlap; leave one out"
            )
    warped = motion.copy()
    for window in _windows(ordered, len(motion), blend + reach_frames(keep)):
        part = slice(window.first, window.stop)
        targets, weights = constraints(motion[part], window, blend=blend, keep=keep)
        warped[part] += solve_warp(
            motion[part],
            targets,
            weights,
            fixed_before=math.isinf(keep) and window.first > 0,
            fixed_after=math.isinf(keep) and window.stop < len(motion),
        )
    return warped


def solve_warp(
    motion: FloatArray,
    targets: FloatArray,
    weights: FloatArray,
    *,
    fixed_before: bool = False,
    fixed_after: bool = False,
) -> FloatArray:
    """Return what eq. 12 adds to a motion: (frames, controls).

    Parameters
    ----------
    motion, targets : (frames, controls) float arrays
    weights : (frames,) float array
        Of each frame's squared distance from its target.
    fixed_before, fixed_after : bool
        Whether the frame before the first, or after the last, stays as it is.

    Raises
    ------
    ValueError
        If nothing holds the motion anywhere: then any offset of it is as good.
    """
    if not (weights.any() or fixed_before or fixed_after):
        raise ValueError("every weight is 0, so the warped motion is undetermined")
    banded = np.zeros((2, len(motion)))
    banded[0, 1:] = -1.0
    banded[1] = weights + 2.0
    banded[1, 0] -= not fixed_before
    banded[1, -1] -= not fixed_after
    right = weights[:, None] * (targets - motion)
    if len(motion) == 1:  # LAPACK's banded solver wants two
        return np.asarray(right / banded[1])
    return np.asarray(solveh_banded(banded, right, overwrite_b=True, check_finite=False))


def constraints(
    motion: FloatArray, window: _Window, *, blend: int, keep: float
) -> tuple[FloatArray, FloatArray]:
    """Return a window's targets (frames, controls) and their weights (frames,).

    With an infinite `keep` the blend carries weights of its own: ``2 / d^2`` at distance d from its
    outer end makes the change fade as d squared, so that it leaves the motion without a kink.
    """
    count = len(motion)
    targets = motion.copy()
    weights = np.full(count, 0.0 if math.isinf(keep) else keep)
    for each in window.insertions:
        start, stop = each.start - window.first, each.stop - window.first
        before = np.arange(max(start - blend, 0), start)
        after = np.arange(stop, min(stop + blend, count))
        if math.isinf(keep):
            weights[before] = np.maximum(weights[before], 2.0 / (before - start + blend + 1.0) ** 2)
            weights[after] = np.maximum(weights[after], 2.0 / (stop + blend - after) ** 2)
        else:
            weights[before] = weights[after] = 0.0
    for each in window.insertions:
        inside = slice(each.start - window.first, each.stop - window.first)
        targets[inside], weights[inside] = each.keys, each.weights
    return targets, weights


def reach_frames(keep: float) -> int:
    """Return how many held frames it takes for a change to fade below rounding.

    Between held frames ``X[i-1] - (2 + keep) X[i] + X[i+1] = 0``, so X shrinks from frame to frame
    by the smaller root of that recursion: 0.38 for a weight of 1. It is one over the larger root,
    whose terms do not cancel however large the weight.
    """
    if math.isinf(keep):
        return 0
    growth = 1 + keep / 2 + math.sqrt(keep) * math.sqrt(1 + keep / 4)
    return math.ceil(-math.log(_ROUNDING_SHARE) / math.log(growth))


def ease_weights(count: int, weight: float, *, ease: int) -> FloatArray:
    """Return key weights that rise from little to `weight` over `ease` frames at both ends."""
    edge = np.minimum(np.arange(1, count + 1), np.arange(count, 0, -1))
    share = np.clip(edge / (ease + 1.0), 0.0, 1.0)
    return np.asarray(weight * share**2 * (3 - 2 * share))


def stretch_motion(motion: FloatArray, frames: int) -> FloatArray:
    """Resample a motion to another number of frames; its first and last frame stay.

    Monotone cubics (Fritsch and Carlson 1980): a peak keeps its height and nothing swings past it.

    Parameters
    ----------
    motion : (n, controls) float array
    """
    if len(motion) < 2 or frames < 2:
        raise ValueError(f"cannot stretch {len(motion)} frames to {frames}; both need at least 2")
    if frames == len(motion):
        return motion.copy()
    old = np.linspace(0.0, 1.0, len(motion))
    return np.asarray(PchipInterpolator(old, motion, axis=0)(np.linspace(0.0, 1.0, frames)))


def _windows(ordered: Sequence[Insertion], frames: int, margin: int) -> list[_Window]:
    windows: list[_Window] = []
    for each in ordered:
        first, stop = max(each.start - margin, 0), min(each.stop + margin, frames)
        if windows and first <= windows[-1].stop:
            last = windows.pop()
            windows.append(_Window(last.first, stop, (*last.insertions, each)))
        else:
            windows.append(_Window(first, stop, (each,)))
    return windows


def _check(each: Insertion, shape: tuple[int, ...]) -> None:
    frames, controls = shape
    where = f"sequence of {len(each.keys)} keys at frame {each.start}"
    if each.keys.ndim != 2 or each.keys.shape[1] != controls or not len(each.keys):
        raise ValueError(f"{where}: {each.keys.shape} keys for {controls} controls")
    if each.start < 0 or each.stop > frames:
        raise ValueError(f"{where}: does not fit into {frames} frames")
    if each.weights.shape != (len(each.keys),) or not (each.weights >= 0).all():
        raise ValueError(f"{where}: needs one weight per key, none negative")
    if not (np.isfinite(each.keys).all() and np.isfinite(each.weights).all()):
        raise ValueError(f"{where}: keys or weights hold values that are not finite")
    if not each.weights.any():
        raise ValueError(f"{where}: every weight is 0, so it asks for nothing")
