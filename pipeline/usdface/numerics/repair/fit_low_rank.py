"""Robust fit of a low-rank Gaussian model to a take with gaps, outliers and swaps.

References
----------
Tipping and Bishop (1999), Probabilistic principal component analysis, JRSS B 61(3), 611-622;
missing entries by expectation-maximisation.
Ilin and Raiko (2010), Practical approaches to principal component analysis in the presence of
missing values, JMLR 11, 1957-2000: slow convergence and overfitting of imputation.
Hoerl and Kennard (1970), Ridge regression, Technometrics 12(1), 55-67.
"""

from collections.abc import Iterator

import numpy as np
from scipy import linalg

from usdface.core.arrays import (
    MAD_TO_DEVIATION,
    BoolArray,
    FloatArray,
    RealArray,
    coordinates_of,
    distances,
    frame_blocks,
    runs,
    sample_frames,
)
from usdface.numerics.motion.noise import marker_noise
from usdface.numerics.regression.pca import fit_pca, sum_moments
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
_STRETCH_COUNT, _FOLD_COUNT = 24, 3
"""Stretches of time, and folds of them, of cross-validation: stretches of a take are nearly
independent, neighbouring frames are not."""
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
    # A marker that is seen in few frames of a long take may be seen in none of these.
    rare = ~good[rows].any(axis=0)
    rows = np.union1d(rows, good[:, rare].argmax(axis=0))
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
    positions: RealArray, good: BoolArray, *, start: LowRankModel, noise: FloatArray
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
    candidates = [rank for rank in _CANDIDATE_RANKS if rank < len(start.variances)]
    candidates.append(len(start.variances))
    scores = np.zeros(len(candidates))
    for test in _folds(len(rows)):
        if not seen[test].any():  # nothing to compare with
            continue
        known = filled[~test]
        widest = _model(known, seen[~test], sensor_noise, candidates[-1])
        for i, rank in enumerate(candidates):
            model = with_rank(widest, rank)
            away = distances(filled[test], predict_from_others(model, filled[test]))
            scores[i] += float(away[seen[test]].mean(dtype=np.float64))
    return candidates[int(scores.argmin())]


def _folds(count: int) -> Iterator[BoolArray]:
    """Yield the rows of each fold to test, unless these are all."""
    fold = np.arange(count) * _STRETCH_COUNT // count % _FOLD_COUNT
    for left_out in range(_FOLD_COUNT):
        test = fold == left_out
        if not test.all():
            yield test


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


_INTERPOLATED_FRAMES = 8
"""[frames] Longest gap that is interpolated in time: a line errs little over less than a blink."""
_LEAST_GAP_SHARE = 0.01
"""[of a take] Long gaps of a marker that are regressed; fewer frames do not form a direction."""
_DIRECTION_COUNT = 60
"""As many as the model of a take has at most."""
_TRAINING_FRAMES = 1024
"""[frames] Seventeen for each direction."""
_PENALTIES = np.geomspace(1e-7, 1e2, 37)
"""Of the largest eigenvalue of Z' Z."""


def first_fill(positions: RealArray, good: BoolArray) -> RealArray:
    """Return positions with all gaps filled, (frames, markers, 3), of the same precision.

    Expectation-maximisation that fills samples, and fits a model to them, converges slowly from its
    first fill (Ilin and Raiko 2010): the step from a marker's samples to a constant fill is a
    direction of motion, which the fit keeps. Here a marker with long gaps is regressed on the
    others, over the frames in which it is seen, and never on values that were filled for it::

        x_m - mean = z a + noise,    z = V_s' (x_s - mean),    a = (Z' Z + penalty I)^-1 Z' X_m

    with s the markers seen in the gap, V the principal directions of the take, and the penalty of
    the least squared error in stretches of time that are left out.

    Parameters
    ----------
    positions : (frames, markers, 3) float array
        [mm] Without head motion; anything where not good.
    good : (frames, markers) bool array
        Every marker has a good sample.
    """
    filled = _interpolated(positions, good)
    gaps = _long_gaps(good)
    if not gaps:
        return filled
    absent = np.zeros_like(good)
    for marker, start, stop in gaps:
        absent[start:stop, marker] = True
    flat = filled.reshape(len(filled), -1).astype(np.float64)
    pca = fit_pca(flat, dimensions=min(_DIRECTION_COUNT, flat.shape[1], len(flat) - 1))
    centered, directions = flat - pca.mean, pca.components.T
    scores = centered @ directions
    for marker, start, stop in gaps:
        columns = coordinates_of(np.flatnonzero(absent[start:stop].any(axis=0)))
        seen = np.flatnonzero(good[:, marker])
        training = seen[sample_frames(len(seen), _TRAINING_FRAMES)]
        rows = np.concatenate([training, np.arange(start, stop)])
        others = scores[rows] - centered[np.ix_(rows, columns)] @ directions[columns]
        known = len(training)
        filled[start:stop, marker] = _regress(
            others[:known], positions[training, marker].astype(np.float64), others[known:]
        )
    return filled


def _interpolated(positions: RealArray, good: BoolArray) -> RealArray:
    """Return every gap filled by a line in time, constant at the ends of the take."""
    filled = np.array(positions)
    for marker in np.flatnonzero(~good.all(axis=0)):
        known, gap = np.flatnonzero(good[:, marker]), np.flatnonzero(~good[:, marker])
        for axis in range(3):
            filled[gap, marker, axis] = np.interp(gap, known, positions[known, marker, axis])
    return filled


def _long_gaps(good: BoolArray) -> list[tuple[int, int, int]]:
    """Return (marker, start, stop) of the gaps that are regressed."""
    found = []
    for marker in np.flatnonzero(~good.all(axis=0)):
        gaps = [gap for gap in runs(~good[:, marker]) if gap[1] - gap[0] > _INTERPOLATED_FRAMES]
        if sum(stop - start for start, stop in gaps) >= _LEAST_GAP_SHARE * len(good):
            found += [(int(marker), start, stop) for start, stop in gaps]
    return found


def _regress(scores: FloatArray, targets: FloatArray, wanted: FloatArray) -> FloatArray:
    """Return the ridge regression's targets of other scores, (frames, 3).

    Parameters
    ----------
    scores : (samples, directions) float array
    targets : (samples, 3) float array
    wanted : (frames, directions) float array
    """
    center, mean = scores.mean(axis=0), targets.mean(axis=0)
    Z, Y = scores - center, targets - mean
    gram, cross = Z.T @ Z, Z.T @ Y
    penalties = _PENALTIES * max(float(linalg.norm(gram, 2)), np.finfo(float).eps)
    errors = np.zeros(len(penalties))
    for test in _folds(len(Z)):
        values, vectors = linalg.eigh(gram - Z[test].T @ Z[test])
        turned = vectors.T @ (cross - Z[test].T @ Y[test])
        shrunk = turned / (np.maximum(values, 0.0) + penalties[:, None])[..., None]
        errors += ((Z[test] @ vectors @ shrunk - Y[test]) ** 2).sum(axis=(1, 2))
    chosen = penalties[errors.argmin()]
    gain = np.linalg.solve(gram + chosen * np.eye(len(gram)), cross)
    return mean + (wanted - center) @ gain
