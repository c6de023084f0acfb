"""Robust fit of a low-rank Gaussian model to a take with gaps, outliers and swaps.

References
----------
Tipping and Bishop (1999), Probabilistic principal component analysis, JRSS B 61(3), 611-622;
missing entries by expectation-maximisation.
"""

import numpy as np
from scipy import linalg

from usdface.core.arrays import (
    MAD_TO_DEVIATION,
    BoolArray,
    FloatArray,
    RealArray,
    distances,
    frame_blocks,
    sample_frames,
)
from usdface.numerics.motion.noise import marker_noise
from usdface.numerics.regression.pca import sum_moments
from usdface.numerics.repair.first_fill import FOLD_COUNT, STRETCH_COUNT, first_fill
from usdface.numerics.repair.low_rank import LowRankModel, fill_missing, predict_from_others
from usdface.numerics.repair.outliers import find_spikes

_CHUNK_FRAMES = 2048
_FIT_FRAMES = 16_000
"""[frames] Enough for a hundred directions."""
_MEDIAN_FRAMES = 4096
"""Estimates the median distance of a marker from its prediction to 2 %."""
_EM_ROUNDS = 8
_EM_ROUNDS_CONTINUED = 2
"""Where the fit starts from a model."""
_SETTLED_SHARE = 0.02
"""[of the noise] Root mean square change of filled samples at convergence."""
_LEAST_NOISE_MM = 0.02
"""Below that of any camera; regularises exact data."""
_FRAMES_PER_DIRECTION = 25
_LEAST_RANK_LIMIT = 8
"""Fewest frames per direction, and the rank limit of shorter takes: with more directions they would
fit their swaps."""
_CANDIDATE_RANKS = (6, 9, 13, 19, 28, 40, 60)
_CHOICE_FRAMES = 4000
_OUTLIER_DEVIATIONS = 6.0


def fit_low_rank(
    positions: RealArray,
    good: BoolArray,
    *,
    rank_limit: int = 60,
    start: LowRankModel | None = None,
    noise: FloatArray | None = None,
) -> LowRankModel:
    """Fit a probabilistic PCA with noise per marker to a take, by expectation-maximisation.

    Parameters
    ----------
    positions : (frames, markers, 3) float array
        [mm] Without head motion; anything where not good.
    good : (frames, markers) bool array
        Samples to fit; outliers among them are excluded.
    rank_limit : int
        Most directions; those below the measurement noise are left out.
    start : LowRankModel, optional
        Initial model, fitted to nearly the same samples; by default gaps start as `first_fill`.
    noise : (markers,) float array, optional
        `marker_noise` of the samples, if known.
    """
    shown = np.flatnonzero(good.any(axis=1))
    rows = shown[sample_frames(len(shown), _FIT_FRAMES)]
    sample, usable = positions[rows], good[rows]
    if not usable.any(axis=0).all():
        missing = np.flatnonzero(~usable.any(axis=0)).tolist()
        raise ValueError(f"markers {missing} have no good sample; leave them out")
    noise = marker_noise(positions, good) if noise is None else noise
    sensor_noise = np.maximum(noise, _LEAST_NOISE_MM)
    settled = _SETTLED_SHARE * float(np.median(sensor_noise))
    if start is None:
        trusted = usable & ~find_spikes(positions, good, noise=sensor_noise)[rows]
        trusted |= usable & ~trusted.any(axis=0)
        filled = first_fill(sample, trusted)
    else:
        trusted, filled = usable, fill_missing(start, sample, usable)
    model = start
    for number in range(_EM_ROUNDS if start is None else _EM_ROUNDS_CONTINUED):
        if number or model is None:
            model = _model(filled, trusted, sensor_noise, rank_limit)
        incomplete = np.asarray(~trusted.all(axis=1))
        moved = _refill(filled, sample, trusted, model, incomplete)
        # Outliers are excluded, and tested again in the next round.
        distance = distances(sample, predict_from_others(model, filled))
        before, trusted = trusted, usable & ~_outliers(distance, usable, sensor_noise)
        changed = (trusted != before).any(axis=1)
        _refill(filled, sample, trusted, model, changed)
        reestimated = number > 0 or start is None
        if reestimated and not changed.any() and moved < settled:
            break
    return _model(filled, trusted, sensor_noise, rank_limit)


def choose_rank(
    positions: RealArray,
    good: BoolArray,
    *,
    start: LowRankModel,
    noise: FloatArray,
) -> int:
    """Return the number of directions that predicts hidden markers best, by cross-validation.

    With three folds of eight stretches of time each.

    Parameters
    ----------
    positions : (frames, markers, 3) float array
        [mm] Without head motion; anything where not good.
    good : (frames, markers) bool array
    start : LowRankModel
        `fit_low_rank` of the same samples.
    noise : (markers,) float array
        `marker_noise` of the samples.
    """
    shown = np.flatnonzero(good.any(axis=1))
    rows = shown[sample_frames(len(shown), _CHOICE_FRAMES)]
    seen = good[rows]
    filled = fill_missing(start, positions[rows], seen)
    sensor_noise = np.maximum(noise, _LEAST_NOISE_MM)
    fold = np.arange(len(rows)) * STRETCH_COUNT // len(rows) % FOLD_COUNT
    candidates = [rank for rank in _CANDIDATE_RANKS if rank < len(start.variances)]
    candidates.append(len(start.variances))
    scores = np.zeros(len(candidates))
    for left_out in range(FOLD_COUNT):
        test = fold == left_out
        if test.all() or not seen[test].any():  # nothing to compare with
            continue
        known = filled[~test]
        widest = _model(known, seen[~test], sensor_noise, candidates[-1])
        for i, rank in enumerate(candidates):
            model = with_rank(widest, rank)
            away = distances(filled[test], predict_from_others(model, filled[test]))
            scores[i] += float(away[seen[test]].mean(dtype=np.float64))
    return candidates[int(scores.argmin())]


def with_rank(model: LowRankModel, rank: int) -> LowRankModel:
    """Return the model with at most `rank` directions, the others added to the noise."""
    dropped = model.components[rank:]
    square = (dropped**2 * model.variances[rank:, None]).sum(axis=0).reshape(-1, 3).mean(axis=1)
    noise = np.sqrt(model.noise**2 + square)
    return LowRankModel(model.mean, model.components[:rank], model.variances[:rank], noise)


def _principal(
    filled: RealArray, limit: int
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return principal components of complete frames (frames, markers, 3) about their mean.

    Returns
    -------
    mean : (markers * 3,) float array
    values : (limit,) float array
        Sums of squares along the components, descending.
    components : (limit, markers * 3) float array
    squares : (markers * 3,) float array
        Sums of squares of each coordinate.
    """
    flat = filled.reshape(len(filled), -1)
    if len(flat) >= flat.shape[1]:
        moments = sum_moments([flat])
        values, vectors = _largest(moments.scatter, limit)
        return moments.mean, values, vectors.T, np.diag(moments.scatter)
    mean = flat.mean(axis=0, dtype=np.float64)
    centered = flat - mean
    values, vectors = _largest(centered @ centered.T, limit)  # the smaller matrix
    spread = vectors.T @ centered
    length = np.linalg.norm(spread, axis=1, keepdims=True)
    components = spread / np.maximum(length, np.finfo(float).tiny)
    return mean, values, components, np.einsum("fi,fi->i", centered, centered)


def _largest(matrix: FloatArray, count: int) -> tuple[FloatArray, FloatArray]:
    """Return the largest eigenvalues of a symmetric matrix, descending, and their vectors."""
    size = len(matrix)
    values, vectors = linalg.eigh(matrix, subset_by_index=[size - min(count, size), size - 1])
    return values[::-1], vectors[:, ::-1]


def _refill(
    filled: RealArray, sample: RealArray, trusted: BoolArray, model: LowRankModel, which: BoolArray
) -> float:
    """Fill some frames again, in place; return the RMS change of filled samples [mm]."""
    rows = np.flatnonzero(which)
    before, ok = filled[rows], trusted[rows]
    filled[rows] = fill_missing(model, sample[rows], ok)
    moved = distances(filled[rows], before)[~ok]
    return float(np.sqrt(np.mean(moved**2))) if moved.size else 0.0


def _model(
    filled: RealArray, trusted: BoolArray, sensor_noise: FloatArray, rank_limit: int
) -> LowRankModel:
    """Return the model of complete frames: principal components above the noise."""
    frames, markers = trusted.shape
    freedom = max(frames - 1, 1)
    affordable = max(frames // _FRAMES_PER_DIRECTION, _LEAST_RANK_LIMIT)
    limit = min(rank_limit, affordable, max(frames - 2, 1))
    mean, values, components, squares = _principal(filled, limit)
    values = values / freedom
    floor = float(np.median(sensor_noise)) ** 2
    # Eigenvalues of pure noise reach (1 + sqrt(p / n))^2 times its variance (Marchenko-Pastur).
    threshold = floor * (1.0 + np.sqrt(3 * markers / frames)) ** 2
    rank = int(np.clip((values > threshold).sum(), 1, limit))
    components = components[:rank]
    # Residual sum of squares of all samples, less that of samples not trusted.
    residual = squares - freedom * (values[:rank] @ components**2)
    square = residual.reshape(markers, 3).sum(axis=1)
    rows = np.flatnonzero(~trusted.all(axis=1))
    for block in frame_blocks(len(rows), frames=_CHUNK_FRAMES):
        some = rows[block]
        centered = filled[some].reshape(len(some), -1).astype(np.float64) - mean
        rest = (centered - (centered @ components.T) @ components).reshape(len(some), markers, 3)
        square -= np.where(trusted[some], 0.0, np.einsum("fki,fki->fk", rest, rest)).sum(axis=0)
    count = np.maximum(trusted.sum(axis=0), 1)
    return LowRankModel(
        mean=mean,
        components=components,
        variances=np.maximum(values[:rank] - floor, 1e-3 * floor),
        noise=np.maximum(np.sqrt(np.maximum(square, 0.0) / (3.0 * count)), sensor_noise),
    )


def _outliers(distance: RealArray, usable: BoolArray, sensor_noise: FloatArray) -> BoolArray:
    """Return samples whose distance from their prediction is beyond six robust deviations."""
    limit = np.empty(distance.shape[1], distance.dtype)
    for marker, ok in enumerate(usable.T):
        rows = np.flatnonzero(ok)
        some = distance[rows[:: max(1, len(rows) // _MEDIAN_FRAMES)], marker]
        deviation = MAD_TO_DEVIATION * float(np.median(some))
        limit[marker] = _OUTLIER_DEVIATIONS * max(deviation, float(sensor_noise[marker]))
    return distance > limit
