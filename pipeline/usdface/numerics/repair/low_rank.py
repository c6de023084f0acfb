"""How markers move together: a Gaussian of few directions, learned despite gaps and strays.

Every marker is predictable from the others. That fills gaps of any length, and tells samples that
do not belong: strays, and labels that have changed places.

References
----------
Tipping and Bishop (1999), Probabilistic principal component analysis, JRSS B 61(3), 611-622;
missing entries by expectation-maximisation.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from usdface.numerics.repair.excursions import find_excursions
from usdface.numerics.repair.noise import marker_noise

_CHUNK_FRAMES = 2048
_SAMPLE_FRAMES = 16_000
"""A model of a hundred directions needs no more."""
_ROUNDS = 8
_LEAST_NOISE = 0.02
"""[mm] Better than any camera: keeps exact data invertible."""
_FRAMES_PER_DIRECTION = 25
_LEAST_RANK_LIMIT = 8
"""Short takes would learn their own swaps as directions of motion."""
_RANKS = (6, 9, 13, 19, 28, 40, 60)
_CHOICE_FRAMES = 4000
_STRETCHES, _FOLDS = 24, 3
_STRAY_DEVIATIONS = 6.0
_MAD_TO_DEVIATION = 1.4826

FloatArray = NDArray[np.floating]


@dataclass(frozen=True)
class LowRankModel:
    """A Gaussian over whole frames: few directions of motion, and noise per marker.

    Attributes
    ----------
    mean : (markers * 3,) float array
        [mm]
    components : (rank, markers * 3) float array
        Orthonormal rows, the largest variance first.
    variances : (rank,) float array
        Of the motion along each row, noise taken off [mm^2].
    noise : (markers,) float array
        Standard deviation of what the directions leave, per coordinate [mm].
    """

    mean: NDArray[np.float64]
    components: NDArray[np.float64]
    variances: NDArray[np.float64]
    noise: NDArray[np.float64]

    @cached_property
    def precision(self) -> NDArray[np.float64]:
        """Inverse covariance, (markers * 3, markers * 3)."""
        covariance = (self.components.T * self.variances) @ self.components
        covariance += np.diag(np.repeat(self.noise**2, 3))
        return np.asarray(np.linalg.inv(covariance))

    @cached_property
    def own_blocks(self) -> NDArray[np.float64]:
        """Covariance of each marker when all others are known, (markers, 3, 3)."""
        count = len(self.noise)
        blocks = self.precision.reshape(count, 3, count, 3)
        return np.asarray(np.linalg.inv(blocks[np.arange(count), :, np.arange(count)]))


def fit_low_rank(
    positions: FloatArray, good: NDArray[np.bool_], *, rank_limit: int = 60
) -> LowRankModel:
    """Learn how the markers of a take move together.

    Parameters
    ----------
    positions : (frames, markers, 3) float array
        [mm] Without head motion; anything where not good.
    good : (frames, markers) bool array
        Samples to learn from; those that the others contradict are found and left out.
    rank_limit : int
        Most directions to keep. Directions below the measurement noise are never kept.

    Raises
    ------
    ValueError
        If a marker has no good sample at all.
    """
    rows = np.unique(np.linspace(0, len(positions) - 1, _SAMPLE_FRAMES).astype(np.int64))
    sample, usable = positions[rows].astype(np.float64), good[rows]
    if not usable.any(axis=0).all():
        missing = np.flatnonzero(~usable.any(axis=0)).tolist()
        raise ValueError(f"markers {missing} have no good sample to learn from; leave them out")
    sensor_noise = np.maximum(marker_noise(positions, good), _LEAST_NOISE)
    middle = np.stack([np.median(sample[ok, m], axis=0) for m, ok in enumerate(usable.T)])
    believed = usable & ~find_excursions(positions, good, noise=sensor_noise)[rows]
    filled = np.where(believed[..., None], sample, middle)
    for _ in range(_ROUNDS):
        model = _moments_model(filled, believed, sensor_noise, rank_limit)
        filled = fill_missing(model, sample, believed)
        # A sample the others contradict is not learned from; it may come back in a later round.
        offsets = sample - predict_from_others(model, filled)
        believed = usable & ~_contradicted(offsets, usable, sensor_noise)
        filled = fill_missing(model, sample, believed)
    return _moments_model(filled, believed, sensor_noise, rank_limit)


def choose_rank(positions: FloatArray, good: NDArray[np.bool_]) -> int:
    """Return how many directions predict hidden markers best in parts of the take not learned from.

    A long, rich take affords many; in a short one many directions fit only the frames they were
    learned from. The take is cut into stretches of time, and every other few are held out in turn.

    Parameters
    ----------
    positions : (frames, markers, 3) float array
        [mm] Without head motion; anything where not good.
    good : (frames, markers) bool array
    """
    rows = np.unique(np.linspace(0, len(positions) - 1, _CHOICE_FRAMES).astype(np.int64))
    start = fit_low_rank(positions, good)
    filled = fill_missing(start, positions[rows].astype(np.float64), good[rows])
    sensor_noise = np.maximum(marker_noise(positions, good), _LEAST_NOISE)
    fold = np.arange(len(rows)) * _STRETCHES // len(rows) % _FOLDS
    candidates = [rank for rank in _RANKS if rank < len(start.variances)]
    candidates.append(len(start.variances))
    scores = np.zeros(len(candidates))
    for held in range(_FOLDS):
        test = fold == held
        if not test.any() or test.all():
            continue
        widest = _moments_model(filled[~test], good[rows][~test], sensor_noise, candidates[-1])
        for i, rank in enumerate(candidates):
            model = _with_rank(widest, rank)
            away = np.linalg.norm(filled[test] - predict_from_others(model, filled[test]), axis=2)
            scores[i] += float(away[good[rows][test]].mean())
    return candidates[int(scores.argmin())]


def _with_rank(model: LowRankModel, rank: int) -> LowRankModel:
    """Return the model with fewer directions, the rest counted as noise."""
    dropped = model.components[rank:]
    square = (dropped**2 * model.variances[rank:, None]).sum(axis=0).reshape(-1, 3).mean(axis=1)
    noise = np.sqrt(model.noise**2 + square)
    return LowRankModel(model.mean, model.components[:rank], model.variances[:rank], noise)


def fill_missing(model: LowRankModel, positions: FloatArray, good: NDArray[np.bool_]) -> FloatArray:
    """Return positions with every sample that is not good replaced by its conditional mean.

    Parameters
    ----------
    model : LowRankModel
    positions : (frames, markers, 3) float array
    good : (frames, markers) bool array

    Returns
    -------
    (frames, markers, 3) float array
        Of the same precision as `positions`.
    """
    filled = np.array(positions)
    missing_counts = good.shape[1] - good.sum(axis=1)
    for count in np.unique(missing_counts[missing_counts > 0]):
        step = max(1, _CHUNK_FRAMES * 4 // int(count) ** 2)
        frames = np.flatnonzero(missing_counts == count)
        for start in range(0, len(frames), step):
            rows = frames[start : start + step]
            filled[rows] = _fill_rows(model, positions[rows], good[rows], int(count))
    return filled


def predict_from_others(model: LowRankModel, filled: FloatArray) -> FloatArray:
    """Return where each marker should be, told from all other markers of its frame.

    Parameters
    ----------
    model : LowRankModel
    filled : (frames, markers, 3) float array
        Complete, as `fill_missing` returns it.
    """
    predicted = np.empty_like(filled)
    for start in range(0, len(filled), _CHUNK_FRAMES):
        rows = slice(start, start + _CHUNK_FRAMES)
        x = filled[rows].astype(np.float64)
        pull = (x.reshape(len(x), -1) - model.mean) @ model.precision
        pull = pull.reshape(x.shape)
        predicted[rows] = x - np.einsum("fki,kij->fkj", pull, model.own_blocks)
    return predicted


def _moments_model(
    filled: NDArray[np.float64],
    believed: NDArray[np.bool_],
    sensor_noise: NDArray[np.float64],
    rank_limit: int,
) -> LowRankModel:
    """Return the model of complete frames: principal directions that rise above the noise."""
    frames, markers = believed.shape
    flat = filled.reshape(frames, -1)
    mean = flat.mean(axis=0)
    centered = flat - mean
    covariance = centered.T @ centered / max(frames - 1, 1)
    values, vectors = np.linalg.eigh(covariance)
    values, vectors = values[::-1], vectors[:, ::-1]
    floor = float(np.median(sensor_noise)) ** 2
    # Eigenvalues of pure noise reach (1 + sqrt(p / n))^2 times its variance (Marchenko-Pastur).
    threshold = floor * (1.0 + np.sqrt(3 * markers / frames)) ** 2
    affordable = max(frames // _FRAMES_PER_DIRECTION, _LEAST_RANK_LIMIT)
    rank = int(
        np.clip((values > threshold).sum(), 1, min(rank_limit, affordable, max(frames - 2, 1)))
    )
    components = vectors[:, :rank].T
    residual = centered - (centered @ components.T) @ components
    square = (residual.reshape(frames, markers, 3) ** 2).sum(axis=2) / 3.0
    count = np.maximum(believed.sum(axis=0), 1)
    left = np.sqrt(np.where(believed, square, 0.0).sum(axis=0) / count)
    return LowRankModel(
        mean=mean,
        components=components,
        variances=np.maximum(values[:rank] - floor, 1e-3 * floor),
        noise=np.maximum(left, sensor_noise),
    )


def _contradicted(
    offsets: NDArray[np.float64], usable: NDArray[np.bool_], sensor_noise: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Return which samples lie farther from their prediction than the marker usually does."""
    distance = np.linalg.norm(offsets, axis=2)
    limit = np.empty(distance.shape[1])
    for marker, ok in enumerate(usable.T):
        usual = _MAD_TO_DEVIATION * float(np.median(distance[ok, marker]))
        limit[marker] = _STRAY_DEVIATIONS * max(usual, float(sensor_noise[marker]))
    return np.asarray(distance > limit)


def _fill_rows(
    model: LowRankModel, positions: FloatArray, good: NDArray[np.bool_], count: int
) -> FloatArray:
    """Fill frames that all miss `count` markers: one small solve each, in one batch."""
    frames, markers = good.shape
    filled = np.array(positions)
    x = np.where(good[..., None], positions, model.mean.reshape(markers, 3))
    offset = x.reshape(frames, -1).astype(np.float64) - model.mean
    missing = np.nonzero(~good)[1].reshape(frames, count)
    entries = (3 * missing[..., None] + np.arange(3)).reshape(frames, 3 * count)
    pull = np.take_along_axis(offset @ model.precision, entries, axis=1)
    own = model.precision[entries[:, :, None], entries[:, None, :]]
    # x_m = mean_m - L_mm^-1 L_mo (x_o - mean_o), L the precision matrix
    shift = -np.linalg.solve(own, pull[..., None])[..., 0]
    fitted = model.mean[entries] + shift
    filled[np.arange(frames)[:, None], missing] = fitted.reshape(frames, count, 3)
    return filled
