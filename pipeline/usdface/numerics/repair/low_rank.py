"""Low-rank Gaussian model of the joint motion of markers, and conditional predictions.

The prediction of a marker from the others fills gaps of any length, and detects outliers and
swapped labels. `fit_low_rank` fits a model to a take.

References
----------
Tipping and Bishop (1999), Probabilistic principal component analysis, JRSS B 61(3), 611-622.
Rasmussen and Williams (2006), Gaussian Processes for Machine Learning, section A.2: conditioning;
section A.3: Woodbury's identity.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from usdface.core.arrays import BoolArray, FloatArray, IntArray, RealArray, frame_blocks

_CHUNK_FRAMES = 512
"""The working arrays of a hundred markers fit in a core's cache."""
_MATRIX_ENTRIES = 1 << 18
"""Entries of the small systems solved in one batch: 2 MB in double precision."""


@dataclass(frozen=True)
class LowRankModel:
    """Gaussian distribution of frames: few directions of motion, and noise per marker."""

    mean: FloatArray
    """(markers * 3,) [mm]"""
    components: FloatArray
    """(rank, markers * 3): orthonormal rows, the largest variance first."""
    variances: FloatArray
    """(rank,): of the motion along each row, without the noise [mm^2]."""
    noise: FloatArray
    """(markers,): standard deviation of the residual, per coordinate [mm]."""

    @cached_property
    def weighted(self) -> FloatArray:
        """Components over the variance of the noise, (rank, markers * 3)."""
        return self.components / np.repeat(self.noise**2, 3)

    @cached_property
    def score_precision(self) -> FloatArray:
        """Precision of the scores when all markers are seen, (rank, rank)."""
        return self.weighted @ self.components.T + np.diag(1.0 / self.variances)

    @cached_property
    def score_weights(self) -> FloatArray:
        """``inverse(score_precision) @ weighted``: from centred frames to scores."""
        return np.asarray(np.linalg.solve(self.score_precision, self.weighted))

    def precision_of(self, entries: IntArray) -> FloatArray:
        """Return blocks of the inverse covariance: (..., n) entries to (..., n, n).

        The whole matrix takes 72 MB for a thousand markers.
        """
        blocks = -(self.weighted.T[entries] @ np.swapaxes(self.score_weights.T[entries], -1, -2))
        rows = np.arange(entries.shape[-1])
        blocks[..., rows, rows] += np.repeat(self.noise**-2.0, 3)[entries]
        return blocks

    @cached_property
    def conditional_covariances(self) -> FloatArray:
        """Covariance of each marker when all others are known, (markers, 3, 3)."""
        entries = np.arange(3 * len(self.noise)).reshape(-1, 3)
        return np.asarray(np.linalg.inv(self.precision_of(entries)))


def fill_missing(model: LowRankModel, positions: RealArray, good: BoolArray) -> RealArray:
    """Return positions with all samples that are not good replaced by their conditional means.

    Returns (frames, markers, 3), of the same precision as `positions`.
    """
    filled = np.array(positions)
    missing_counts = good.shape[1] - np.count_nonzero(good, axis=1)
    for count in np.unique(missing_counts[missing_counts > 0]).tolist():
        step = max(1, _MATRIX_ENTRIES // (3 * count * max(3 * count, len(model.variances))))
        frames = np.flatnonzero(missing_counts == count)
        for block in frame_blocks(len(frames), frames=min(step, _CHUNK_FRAMES)):
            rows = frames[block]
            missing = np.nonzero(~good[rows])[1].reshape(len(rows), count)
            filled[rows[:, None], missing] = _expected(model, positions[rows], missing)
    return filled


def predict_from_others(model: LowRankModel, filled: RealArray) -> RealArray:
    """Return the conditional mean of each marker given all other markers of its frame.

    Returns (frames, markers, 3), of the same precision as `filled`, and computed in it.

    Parameters
    ----------
    filled : (frames, markers, 3) float array
        Complete, as `fill_missing` returns it.
    """
    kind, count = filled.dtype, len(model.noise)
    # With L the precision, x_m - E[x_m | others] = L_mm^-1 (L (x - mean))_m; L is diagonal plus low
    # rank.
    covariances = model.conditional_covariances
    own = np.swapaxes(covariances, 1, 2) / model.noise[:, None, None] ** 2
    solved = (covariances @ model.score_weights.T.reshape(count, 3, -1)).reshape(3 * count, -1)
    mean, weighted = model.mean.astype(kind), model.weighted.T.astype(kind)
    own, solved = own.astype(kind), solved.T.astype(kind)
    flat = filled.reshape(len(filled), -1)
    predicted = np.empty_like(filled)
    for rows in frame_blocks(len(flat), frames=_CHUNK_FRAMES):
        offset = flat[rows] - mean
        predicted[rows] = filled[rows] + (offset @ weighted @ solved).reshape(-1, count, 3)
        offset = offset.reshape(-1, count, 3)
        predicted[rows] -= np.swapaxes(np.swapaxes(offset, 0, 1) @ own, 0, 1)
    return predicted


def fill_and_predict(
    model: LowRankModel, positions: RealArray, good: BoolArray
) -> tuple[RealArray, RealArray]:
    """Return frames with gaps filled, and each marker's prediction from the others."""
    filled = fill_missing(model, positions, good)
    return filled, predict_from_others(model, filled)


def _expected(model: LowRankModel, positions: RealArray, missing: IntArray) -> FloatArray:
    """Return the conditional mean of the missing markers, (frames, missing, 3).

    For frames with the same number of missing markers: one small system each, in the missing
    coordinates or in the directions, whichever are fewer, solved in one batch.
    """
    kind, (frames, count) = positions.dtype, missing.shape
    offset = positions - model.mean.reshape(-1, 3).astype(kind)
    offset[np.arange(frames)[:, None], missing] = 0.0
    weighted_offset = offset.reshape(frames, -1) @ model.weighted.T.astype(kind)
    entries = (3 * missing[..., None] + np.arange(3)).reshape(frames, 3 * count)
    if 3 * count <= len(model.variances):
        # x_m = mean_m - L_mm^-1 L_mo (x_o - mean_o), L the precision matrix
        pull = weighted_offset @ model.score_weights.astype(kind)
        missed = np.take_along_axis(pull, entries, axis=1)[..., None]
        shift = np.asarray(np.linalg.solve(model.precision_of(entries), missed), np.float64)
    else:
        # Posterior mean of the scores given the visible markers.
        directions = model.components.T[entries]
        inner = model.score_precision - np.swapaxes(model.weighted.T[entries], 1, 2) @ directions
        shift = directions @ np.linalg.solve(inner, weighted_offset[..., None])
    return (model.mean[entries] + shift[..., 0]).reshape(frames, count, 3)
