"""Learn how the markers of a take move together, despite gaps, strays and swaps in it.

References
----------
Tipping and Bishop (1999), Probabilistic principal component analysis, JRSS B 61(3), 611-622;
missing entries by expectation-maximisation.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from usdface.core.arrays import RealArray
from usdface.numerics.repair.frame_blocks import frame_blocks, sample_frames
from usdface.numerics.repair.low_rank import LowRankModel, fill_missing, predict_from_others
from usdface.numerics.repair.noise import marker_noise
from usdface.numerics.repair.spikes import find_excursions

_CHUNK_FRAMES = 2048
_SAMPLE_FRAMES = 16_000
"""A model of a hundred directions needs no more."""
_USUAL_FRAMES = 4096
"""Tell the median distance of a marker from its prediction to two hundredths."""
_ROUNDS = 8
_ROUNDS_AGAIN = 2
"""Where learning starts from a model: it goes on where that one's learning ended."""
_SETTLED = 0.02
"""Of the noise: what is filled in moves by less, root mean square, in the last round."""
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


def fit_low_rank(
    positions: RealArray,
    good: NDArray[np.bool_],
    *,
    rank_limit: int = 60,
    start: LowRankModel | None = None,
    noise: NDArray[np.float64] | None = None,
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
    start : LowRankModel, optional
        Learned from nearly the same samples: to begin with, instead of with medians.
    noise : (markers,) float array, optional
        The samples' `marker_noise`, where it is known.

    Raises
    ------
    ValueError
        If a marker has no good sample at all.
    """
    rows = sample_frames(len(positions), _SAMPLE_FRAMES)
    sample, usable = positions[rows], good[rows]
    if not usable.any(axis=0).all():
        missing = np.flatnonzero(~usable.any(axis=0)).tolist()
        raise ValueError(f"markers {missing} have no good sample to learn from; leave them out")
    noise = marker_noise(positions, good) if noise is None else noise
    sensor_noise = np.maximum(noise, _LEAST_NOISE)
    settled = _SETTLED * float(np.median(sensor_noise))
    if start is None:
        middle = np.stack([np.median(sample[ok, m], axis=0) for m, ok in enumerate(usable.T)])
        believed = usable & ~find_excursions(positions, good, noise=sensor_noise)[rows]
        filled = np.where(believed[..., None], sample, middle.astype(sample.dtype))
    else:
        believed, filled = usable, fill_missing(start, sample, usable)
    moments = _Moments.of(filled)
    model = start
    for number in range(_ROUNDS if start is None else _ROUNDS_AGAIN):
        if number or model is None:
            model = _model(moments, filled, believed, sensor_noise, rank_limit)
        incomplete = np.asarray(~believed.all(axis=1))
        moved = _refill(moments, filled, sample, believed, model, incomplete)
        # A sample the others contradict is not learned from; it may come back in a later round.
        distance = _distances(sample, predict_from_others(model, filled))
        before, believed = believed, usable & ~_contradicted(distance, usable, sensor_noise)
        changed = (believed != before).any(axis=1)
        _refill(moments, filled, sample, believed, model, changed)
        told_anew = number > 0 or start is None
        if told_anew and not changed.any() and moved < settled:
            break
    return _model(moments, filled, believed, sensor_noise, rank_limit)


def choose_rank(
    positions: RealArray,
    good: NDArray[np.bool_],
    *,
    start: LowRankModel | None = None,
    noise: NDArray[np.float64] | None = None,
) -> int:
    """Return how many directions predict hidden markers best in parts of the take not learned from.

    A long, rich take affords many; in a short one many directions fit only the frames they were
    learned from. The take is cut into stretches of time, and every other few are held out in turn.

    Parameters
    ----------
    positions : (frames, markers, 3) float array
        [mm] Without head motion; anything where not good.
    good : (frames, markers) bool array
    start : LowRankModel, optional
        What `fit_low_rank` makes of the same samples.
    noise : (markers,) float array, optional
        The samples' `marker_noise`, where it is known.
    """
    rows = sample_frames(len(positions), _CHOICE_FRAMES)
    noise = marker_noise(positions, good) if noise is None else noise
    start = fit_low_rank(positions, good, noise=noise) if start is None else start
    seen = good[rows]
    filled = fill_missing(start, positions[rows], seen)
    sensor_noise = np.maximum(noise, _LEAST_NOISE)
    fold = np.arange(len(rows)) * _STRETCHES // len(rows) % _FOLDS
    candidates = [rank for rank in _RANKS if rank < len(start.variances)]
    candidates.append(len(start.variances))
    scores = np.zeros(len(candidates))
    for held in range(_FOLDS):
        test = fold == held
        if test.all() or not seen[test].any():  # nothing to compare with
            continue
        known = filled[~test]
        widest = _model(_Moments.of(known), known, seen[~test], sensor_noise, candidates[-1])
        for i, rank in enumerate(candidates):
            model = with_rank(widest, rank)
            away = _distances(filled[test], predict_from_others(model, filled[test]))
            scores[i] += float(away[seen[test]].mean(dtype=np.float64))
    return candidates[int(scores.argmin())]


def with_rank(model: LowRankModel, rank: int) -> LowRankModel:
    """Return the model with at most so many directions, the rest counted as noise."""
    dropped = model.components[rank:]
    square = (dropped**2 * model.variances[rank:, None]).sum(axis=0).reshape(-1, 3).mean(axis=1)
    noise = np.sqrt(model.noise**2 + square)
    return LowRankModel(model.mean, model.components[:rank], model.variances[:rank], noise)


@dataclass
class _Moments:
    """Sums over frames that change where frames do, so that the others need no second look."""

    center: NDArray[np.float64]
    total: NDArray[np.float64]
    products: NDArray[np.float64]
    count: int

    @classmethod
    def of(cls, filled: RealArray) -> "_Moments":
        flat = filled.reshape(len(filled), -1)
        center = flat[:: max(1, len(flat) // 256)].mean(axis=0, dtype=np.float64)
        moments = cls(center, np.zeros(len(center)), np.zeros((len(center),) * 2), len(flat))
        moments.add(flat)
        return moments

    def add(self, flat: RealArray, sign: float = 1.0) -> None:
        """Add frames, or take them away."""
        for block in frame_blocks(len(flat), frames=_CHUNK_FRAMES):
            centered = flat[block].astype(np.float64) - self.center
            self.total += sign * centered.sum(axis=0)
            self.products += sign * (centered.T @ centered)

    def mean(self) -> NDArray[np.float64]:
        return np.asarray(self.center + self.total / self.count)

    def scatter(self) -> NDArray[np.float64]:
        """Return the sum of squares and products about the mean."""
        return np.asarray(self.products - np.outer(self.total, self.total / self.count))


def _refill(
    moments: _Moments,
    filled: RealArray,
    sample: RealArray,
    believed: NDArray[np.bool_],
    model: LowRankModel,
    which: NDArray[np.bool_],
) -> float:
    """Fill some frames anew, in place, and return by how much filled samples moved [mm]."""
    rows = np.flatnonzero(which)
    if not rows.size:
        return 0.0
    before, ok = filled[rows], believed[rows]
    filled[rows] = fill_missing(model, sample[rows], ok)
    if 2 * len(rows) < len(filled):
        moments.add(before.reshape(len(rows), -1), -1.0)
        moments.add(filled[rows].reshape(len(rows), -1))
    else:
        again = _Moments.of(filled)
        moments.center, moments.total, moments.products = again.center, again.total, again.products
    moved = _distances(filled[rows], before)[~ok]
    return float(np.sqrt(np.mean(moved**2))) if moved.size else 0.0


def _model(
    moments: _Moments,
    filled: RealArray,
    believed: NDArray[np.bool_],
    sensor_noise: NDArray[np.float64],
    rank_limit: int,
) -> LowRankModel:
    """Return the model of complete frames: principal directions that rise above the noise."""
    frames, markers = believed.shape
    mean, scatter = moments.mean(), moments.scatter()
    freedom = max(frames - 1, 1)
    values, vectors = np.linalg.eigh(scatter / freedom)
    values, vectors = values[::-1], vectors[:, ::-1]
    floor = float(np.median(sensor_noise)) ** 2
    # Eigenvalues of pure noise reach (1 + sqrt(p / n))^2 times its variance (Marchenko-Pastur).
    threshold = floor * (1.0 + np.sqrt(3 * markers / frames)) ** 2
    affordable = max(frames // _FRAMES_PER_DIRECTION, _LEAST_RANK_LIMIT)
    rank = int(
        np.clip((values > threshold).sum(), 1, min(rank_limit, affordable, max(frames - 2, 1)))
    )
    components = vectors[:, :rank].T
    # What the directions leave of all samples, less what they leave of those not believed.
    left = np.diag(scatter) - freedom * (values[:rank] @ components**2)
    square = left.reshape(markers, 3).sum(axis=1)
    rows = np.flatnonzero(~believed.all(axis=1))
    for block in frame_blocks(len(rows), frames=_CHUNK_FRAMES):
        some = rows[block]
        centered = filled[some].reshape(len(some), -1).astype(np.float64) - mean
        rest = (centered - (centered @ components.T) @ components).reshape(len(some), markers, 3)
        square -= np.where(believed[some], 0.0, np.einsum("fki,fki->fk", rest, rest)).sum(axis=0)
    count = np.maximum(believed.sum(axis=0), 1)
    return LowRankModel(
        mean=mean,
        components=components,
        variances=np.maximum(values[:rank] - floor, 1e-3 * floor),
        noise=np.maximum(np.sqrt(np.maximum(square, 0.0) / (3.0 * count)), sensor_noise),
    )


def _distances(one: RealArray, other: RealArray) -> RealArray:
    """Return the distance between the samples of two takes, (frames, markers) [mm]."""
    offsets = one - other
    return np.asarray(np.sqrt(np.einsum("fki,fki->fk", offsets, offsets)))


def _contradicted(
    distance: RealArray, usable: NDArray[np.bool_], sensor_noise: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Return which samples lie farther from their prediction than the marker usually does."""
    limit = np.empty(distance.shape[1], distance.dtype)
    for marker, ok in enumerate(usable.T):
        rows = np.flatnonzero(ok)
        some = distance[rows[:: max(1, len(rows) // _USUAL_FRAMES)], marker]
        usual = _MAD_TO_DEVIATION * float(np.median(some))
        limit[marker] = _STRAY_DEVIATIONS * max(usual, float(sensor_noise[marker]))
    return np.asarray(distance > limit)
