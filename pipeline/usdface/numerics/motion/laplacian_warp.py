"""Insertion of sequences into a motion by 1-D Laplacian warping: Song et al. (2011), section 5.3.

The differences between consecutive frames (the 1-D Laplacian coordinates of eq. 11) are preserved
under soft constraints, whose targets are the keys of a sequence over its interval, and the motion
itself elsewhere. With X the change of the motion, D the (n - 1, n) difference matrix of eq. 11 and
W the diagonal matrix of weights, eq. 12 is ``(D' D + W) X = W (keys - motion)``: tridiagonal and
positive definite. Its right side is 0 outside the sequences, where X decays geometrically, so that
only windows around the sequences are solved.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.linalg import solveh_banded

from usdface.core.arrays import FloatArray

_ROUNDING_SHARE = 2.0**-60
"""[of a change] Below the rounding of the motion."""


@dataclass(frozen=True)
class Insertion:
    """A sequence to insert into a motion."""

    start: int
    """Frame index of its first key."""
    keys: FloatArray
    """(m, controls)"""
    weights: FloatArray
    """(m,): of each key's squared difference; 1 in the paper, 0 for no constraint, 100 for a nearly
    hard one."""

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
    """Insert sequences into a motion; frames farther than `blend` from them keep their values.

    Returns (frames, controls).

    Parameters
    ----------
    motion : (frames, controls) float array
        Left as it is.
    insertions : sequence of Insertion
        In any order, not overlapping.
    blend : int
        Frames on each side of a sequence over which the motion passes into it.
    keep : float
        Weight of the motion outside the sequences and their blends. Infinite: unchanged to the
        last bit. Finite, as published (there 1): changes decay with the distance, and blends have
        no constraints.
    """
    ordered = sorted(insertions, key=lambda each: each.start)
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
    """Return the solution X of eq. 12, the change of a motion: (frames, controls).

    Parameters
    ----------
    motion, targets : (frames, controls) float arrays
    weights : (frames,) float array
        Of each frame's squared distance from its target.
    fixed_before, fixed_after : bool
        Whether X is 0 at the frame before the first, or after the last.
    """
    if not (weights.any() or fixed_before or fixed_after):
        raise ValueError("every weight is 0, so the warped motion is undetermined")
    banded = np.zeros((2, len(motion)))
    banded[0, 1:] = -1.0
    banded[1] = weights + 2.0
    banded[1, 0] -= not fixed_before
    banded[1, -1] -= not fixed_after
    right = weights[:, None] * (targets - motion)
    if len(motion) == 1:  # LAPACK's banded solver needs two rows
        return np.asarray(right / banded[1])
    return np.asarray(solveh_banded(banded, right, overwrite_b=True, check_finite=False))


def constraints(
    motion: FloatArray, window: _Window, *, blend: int, keep: float
) -> tuple[FloatArray, FloatArray]:
    """Return a window's targets (frames, controls) and their weights (frames,).

    With an infinite `keep`, the weight in a blend is ``2 / d^2`` at distance d from its outer end.
    The change then grows as d squared, without a discontinuity of the slope.
    """
    count = len(motion)
    targets = motion.copy()
    weights = np.full(count, 0.0 if math.isinf(keep) else keep)
    for insertion in window.insertions:
        start, stop = insertion.start - window.first, insertion.stop - window.first
        before = np.arange(max(start - blend, 0), start)
        after = np.arange(stop, min(stop + blend, count))
        if math.isinf(keep):
            weights[before] = np.maximum(weights[before], 2.0 / (before - start + blend + 1.0) ** 2)
            weights[after] = np.maximum(weights[after], 2.0 / (stop + blend - after) ** 2)
        else:
            weights[before] = weights[after] = 0.0
    for insertion in window.insertions:
        inside = slice(insertion.start - window.first, insertion.stop - window.first)
        targets[inside], weights[inside] = insertion.keys, insertion.weights
    return targets, weights


def reach_frames(keep: float) -> int:
    """Return the number of constrained frames after which a change is below rounding.

    There ``X[i-1] - (2 + keep) X[i] + X[i+1] = 0``, so X decays by the smaller root of the
    characteristic polynomial: 0.38 per frame for a weight of 1. It is computed as the reciprocal
    of the larger root, without cancellation.
    """
    if math.isinf(keep):
        return 0
    growth = 1 + keep / 2 + math.sqrt(keep) * math.sqrt(1 + keep / 4)
    return math.ceil(-math.log(_ROUNDING_SHARE) / math.log(growth))


def ease_weights(count: int, weight: float, *, ease: int) -> FloatArray:
    """Return key weights with a smoothstep rise to `weight` over `ease` frames at both ends."""
    edge = np.minimum(np.arange(1, count + 1), np.arange(count, 0, -1))
    share = np.clip(edge / (ease + 1.0), 0.0, 1.0)
    return np.asarray(weight * share**2 * (3 - 2 * share))


def stretch_motion(motion: FloatArray, frames: int) -> FloatArray:
    """Resample a motion (n, controls) to other `frames`, from its first to its last; at least 2.

    By monotone cubics (Fritsch and Carlson 1980), which do not overshoot.
    """
    if frames == len(motion):
        return motion.copy()
    old = np.linspace(0.0, 1.0, len(motion))
    return np.asarray(PchipInterpolator(old, motion, axis=0)(np.linspace(0.0, 1.0, frames)))


def _windows(ordered: Sequence[Insertion], frames: int, margin: int) -> list[_Window]:
    windows: list[_Window] = []
    for insertion in ordered:
        first, stop = max(insertion.start - margin, 0), min(insertion.stop + margin, frames)
        if windows and first <= windows[-1].stop:
            last = windows.pop()
            windows.append(_Window(last.first, stop, (*last.insertions, insertion)))
        else:
            windows.append(_Window(first, stop, (insertion,)))
    return windows
