"""Folds that keep neighbours together, and errors as they show on the surface.

Two reference frames a few frames apart are nearly the same face: split between training and
testing they would flatter every method. So folds are made of runs of neighbours.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from usdface.core.arrays import FloatArray, IntArray

FEWEST_TRAINING_ROWS = 3
"""Rows below which a fold teaches nothing: then neighbours of tested rows are trained on too."""


@dataclass(frozen=True)
class Fold:
    """Rows to train on and rows to test on; no row of the one neighbours a row of the other.

    But where fewer than `FEWEST_TRAINING_ROWS` would be left to train on, all rows that are not
    tested are.
    """

    train: IntArray
    test: IntArray


def blocked_folds(
    frames: ArrayLike, takes: Sequence[str], *, folds: int = 5, margin: int = 30
) -> tuple[Fold, ...]:
    """Split pairs into folds, blocked by take and time.

    Pairs of one take at most `margin` frames apart form a run and stay together; runs are dealt
    to the folds in turn, in order of time, so that each fold sees all of the performance. Where
    the runs are fewer than the folds, contiguous blocks are cut instead, and training pairs
    within `margin` of a tested one are left out.

    Parameters
    ----------
    frames : (n,) int array
        Frame number of each pair in its take.
    takes : sequence of n str
        Name of each pair's take.
    folds : int
        How many; at most the number of pairs.
    margin : int
        Frames within which two pairs count as neighbours.
    """
    numbers = np.asarray(frames, dtype=np.int64)
    if len(numbers) != len(takes):
        raise ValueError(f"{len(numbers)} frames but {len(takes)} take names")
    if len(numbers) < 2 or folds < 2:
        raise ValueError(f"cannot make {folds} folds of {len(numbers)} pairs")
    folds = min(folds, len(numbers))
    codes = np.unique(np.asarray(takes, dtype=str), return_inverse=True)[1]
    order = np.lexsort((numbers, codes))
    breaks = (np.diff(numbers[order]) > margin) | (np.diff(codes[order]) != 0)
    run = np.concatenate([[0], np.cumsum(breaks)])
    label = np.empty(len(numbers), dtype=np.int64)
    if run[-1] + 1 >= folds:
        label[order] = _deal(np.bincount(run), folds)[run]
    else:
        label[order] = np.arange(len(numbers)) * folds // len(numbers)
    return tuple(_fold(label == k, numbers, codes, margin) for k in range(folds))


def predict_out_of_fold(
    fit_predict: Callable[[IntArray, IntArray], FloatArray], folds: Sequence[Fold], *, width: int
) -> FloatArray:
    """Predict every row by a fit that has not seen it.

    Parameters
    ----------
    fit_predict : callable
        Takes the rows to train on and the rows to test on, returns (test rows, width).
    folds : sequence of Fold
        Together they test every row once.
    width : int
        Columns of the prediction.
    """
    out: FloatArray = np.full((sum(len(fold.test) for fold in folds), width), np.nan)
    for fold in folds:
        out[fold.test] = fit_predict(fold.train, fold.test)
    return out


def weight_rmse(errors: FloatArray) -> float:
    """Root mean square over frames and channels."""
    return float(np.sqrt(np.mean(errors**2)))


def surface_rms_mm(errors: FloatArray, gram: FloatArray) -> float:
    """Root mean square, over frames and points, of how far weight errors move the surface [mm].

    Parameters
    ----------
    errors : (frames, channels) float array
    gram : (channels, channels) float array
        Mean over the rig's points of the dot products of channel displacements [mm^2].
    """
    return float(np.sqrt(np.mean(surface_errors_mm(errors, gram) ** 2)))


def surface_errors_mm(errors: FloatArray, gram: FloatArray) -> FloatArray:
    """How far each frame's weight errors move the surface, root mean square over points [mm].

    Returns
    -------
    (frames,) float array
    """
    squared = np.einsum("fs,fs->f", errors @ gram, errors)
    errors_mm: FloatArray = np.sqrt(np.maximum(squared, 0.0))
    return errors_mm


def _deal(sizes: IntArray, folds: int) -> IntArray:
    """Give each run to the fold that holds least so far; ties go round in order."""
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
