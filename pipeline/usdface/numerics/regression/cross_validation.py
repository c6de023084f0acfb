"""Cross-validation blocked in time, and errors on the surface.

Neighbouring reference frames are nearly the same face: split between training and testing, they
would bias the error. So folds consist of runs of neighbours.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from usdface.core.arrays import FloatArray, IntArray

FEWEST_TRAINING_ROWS = 3
"""With fewer, neighbours of tested rows are trained on as well."""


@dataclass(frozen=True)
class Fold:
    """Rows for training and testing, without neighbours of tested rows among the first.

    Unless fewer than `FEWEST_TRAINING_ROWS` would be left.
    """

    train: IntArray
    test: IntArray


def blocked_folds(
    frames: ArrayLike, takes: Sequence[str], *, folds: int = 5, margin: int = 30
) -> tuple[Fold, ...]:
    """Split pairs into folds, blocked by take and time.

    Pairs of one take at most `margin` frames apart form a run; runs are assigned to the folds in
    turn, so that each fold covers the whole performance. If there are fewer runs than folds, folds
    are contiguous blocks, and training pairs within `margin` of a tested one are left out.

    Parameters
    ----------
    frames : (n,) int array
        Frame number of each pair in its take.
    takes : sequence of n str
        Name of each pair's take.
    folds : int
        Number of folds, limited by the number of pairs.
    margin : int
        Largest distance of neighbours [frames].
    """
    numbers = np.asarray(frames, dtype=np.int64)
    if len(numbers) < 2 or folds < 2:
        raise ValueError(f"cannot make {folds} folds of {len(numbers)} pairs")
    folds = min(folds, len(numbers))
    codes = np.unique(np.asarray(takes, dtype=str), return_inverse=True)[1]
    order = np.lexsort((numbers, codes))
    breaks = (np.diff(numbers[order]) > margin) | (np.diff(codes[order]) != 0)
    run = np.concatenate([[0], np.cumsum(breaks)])
    label = np.empty(len(numbers), dtype=np.int64)
    if run[-1] + 1 >= folds:
        label[order] = _assign_runs(np.bincount(run), folds)[run]
    else:
        label[order] = np.arange(len(numbers)) * folds // len(numbers)
    return tuple(_fold(label == k, numbers, codes, margin) for k in range(folds))


def weight_rmse(errors: FloatArray) -> float:
    """Return the root mean square over frames and channels; NaN without any."""
    return float(np.sqrt(np.mean(errors**2))) if errors.size else float("nan")


def surface_rms_mm(errors: FloatArray, gram: FloatArray) -> float:
    """Return the root mean square displacement of the surface by weight errors [mm].

    Parameters
    ----------
    errors : (frames, channels) float array
    gram : (channels, channels) float array
        Mean over the rig's points of the dot products of channel displacements [mm^2].
    """
    return float(np.sqrt(np.mean(surface_errors_mm(errors, gram) ** 2)))


def surface_errors_mm(errors: FloatArray, gram: FloatArray) -> FloatArray:
    """Return each frame's root mean square displacement over points: (frames,) [mm]."""
    squared = np.einsum("fs,fs->f", errors @ gram, errors)
    return np.asarray(np.sqrt(np.maximum(squared, 0.0)))


def _assign_runs(sizes: IntArray, folds: int) -> IntArray:
    """Assign each run to the smallest fold so far, ties in rotation."""
    rows_of_fold = np.zeros(folds, dtype=np.int64)
    out = np.empty(len(sizes), dtype=np.int64)
    for i, size in enumerate(sizes):
        ring = np.roll(np.arange(folds), -(i % folds))
        out[i] = ring[rows_of_fold[ring].argmin()]
        rows_of_fold[out[i]] += size
    return out


def _fold(tested: NDArray[np.bool_], frames: IntArray, codes: IntArray, margin: int) -> Fold:
    test = np.flatnonzero(tested)
    near = (np.abs(frames[:, None] - frames[test]) <= margin) & (codes[:, None] == codes[test])
    train = np.flatnonzero(~tested & ~near.any(axis=1))
    if len(train) < FEWEST_TRAINING_ROWS:  # nearly all neighbour a tested one
        train = np.flatnonzero(~tested)
    return Fold(train, test)
