"""From captured markers to clean ones: head still, labels right, gaps filled, noise gone."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from usdface.numerics.repair.gaps import GapFill, fill_gaps
from usdface.numerics.repair.learning import choose_rank, fit_low_rank
from usdface.numerics.repair.low_rank import LowRankModel, fill_missing, predict_from_others
from usdface.numerics.repair.noise import marker_noise, measurement_noise
from usdface.numerics.repair.relabeling import Swap, apply_swaps, find_swaps
from usdface.numerics.repair.smoothing import significant_detail, smooth_tracks
from usdface.numerics.repair.strays import find_strays
from usdface.numerics.rigid.pose_smoothing import smooth_poses
from usdface.numerics.rigid.rigid_alignment import align_frames, alignment_of, remove_motion
from usdface.numerics.rigid.stabilization import stabilize
from usdface.progress import Progress, silent

_RELABEL_ROUNDS = 4
_POSE_ROUNDS = 2
_RELABELLED_CONFIDENCE = 0.9
_POSE_INLIER_DEVIATIONS = 3.0
_MAD_TO_DEVIATION = 1.4826
_SAMPLE_FRAMES = 20_000

FloatArray = NDArray[np.floating]


@dataclass(frozen=True)
class CleanedMarkers:
    """Markers without head motion, and what was done to them.

    Attributes
    ----------
    positions : (frames, markers, 3) float32 array
        [mm] Stabilised. Samples of gaps that were left hold the last good position.
    visible : (frames, markers) bool array
        Measured or filled; False only in gaps that were left.
    confidence : (frames, markers) float32 array
        [0-1] 1 as measured, lower where relabelled, filled, or where the pose was interpolated;
        0 in gaps that were left.
    head_motion : (frames, 4, 4) float array
        For column vectors: ``captured = head_motion @ stabilised``.
    swaps : tuple of Swap
        Labels put back.
    strays : (frames, markers) bool array
        Measured samples that were replaced.
    filled : (frames, markers) bool array
        Samples that were not measured or were strays, and were filled.
    pose_confidence : (frames,) float array
        [0-1]
    noise_mm : float
        Measurement noise per coordinate before smoothing [mm].
    """

    positions: NDArray[np.float32]
    visible: NDArray[np.bool_]
    confidence: NDArray[np.float32]
    head_motion: NDArray[np.float64]
    swaps: tuple[Swap, ...]
    strays: NDArray[np.bool_]
    filled: NDArray[np.bool_]
    pose_confidence: NDArray[np.float64]
    noise_mm: float


@dataclass(frozen=True)
class _Still:
    """A take in the head's space on its way through the chain."""

    positions: FloatArray
    visible: NDArray[np.bool_]
    head_motion: NDArray[np.float64]
    pose_confidence: NDArray[np.float64]


def clean_markers(
    positions: ArrayLike,
    visible: ArrayLike,
    *,
    rigid: Sequence[int],
    neutral: int,
    max_gap: int = 120,
    smooth: bool = True,
    relabel: bool = True,
    progress: Progress = silent,
) -> CleanedMarkers:
    """Clean a take's markers.

    In this order: the head's pose from the rigid markers; labels that have changed places; samples
    that the other markers contradict; the pose again, from all markers against what the others
    predict of them; gaps; noise, each direction of the face's motion by its own measure.

    Parameters
    ----------
    positions : (frames, markers, 3) array_like
        [mm] Captured; anything finite where not visible.
    visible : (frames, markers) array_like of bool
    rigid : sequence of int
        Columns of the markers that move with the skull alone; see `rigid_markers`.
    neutral : int
        Index of the frame whose head pose becomes the head's space.
    max_gap : int
        Longest gap to fill [frames].
    smooth, relabel : bool
        Leave a step out.
    progress : callable

    Raises
    ------
    ValueError
        If the shapes differ, the rigid markers do not determine a pose, a marker is never seen, or
        `max_gap` is negative.
    """
    captured = np.array(positions, np.float32)
    seen = np.array(visible, bool)
    _check(captured, seen, neutral, max_gap)
    progress(0.0, "head motion")
    still = _stabilize(captured, seen, rigid, neutral)
    progress(0.05, "how markers move together")
    widest = fit_low_rank(still.positions, seen)
    rank = choose_rank(still.positions, seen, start=widest)
    model = fit_low_rank(still.positions, seen, rank_limit=rank, start=widest)
    swaps: tuple[Swap, ...] = ()
    if relabel:
        swaps, model = _relabel(still, model, rank, progress)
        if {column for swap in swaps for column in (swap.first, swap.second)} & set(rigid):
            apply_swaps(captured, swaps)
            still = _stabilize(captured, seen, rigid, neutral)
            model = fit_low_rank(still.positions, seen, rank_limit=rank, start=model)
    progress(0.45, "strays")
    strays = find_strays(still.positions, seen, model=model)
    good = seen & ~strays
    progress(0.6, "head motion, from all markers")
    still = _refine_pose(still, good, model)
    noise = measurement_noise(still.positions, good)
    progress(0.7, "gaps")
    model = fit_low_rank(still.positions, good, rank_limit=rank, start=model)
    complete = fill_missing(model, still.positions, good)
    expected = predict_from_others(model, complete)
    gaps = fill_gaps(still.positions, good, max_gap=max_gap, prediction=expected, noise=noise)
    clean = np.where((good | gaps.filled)[..., None], gaps.positions, complete)
    if smooth:
        progress(0.8, "noise")
        clean = _smooth(clean, model, marker_noise(still.positions, good))
    known = good | gaps.filled
    _hold(clean, known)
    progress(1.0, "clean")
    return CleanedMarkers(
        positions=clean.astype(np.float32, copy=False),
        visible=known,
        confidence=_confidence(gaps, swaps, still.pose_confidence),
        head_motion=still.head_motion,
        swaps=swaps,
        strays=strays,
        filled=gaps.filled,
        pose_confidence=still.pose_confidence,
        noise_mm=noise,
    )


def _check(
    captured: NDArray[np.float32], seen: NDArray[np.bool_], neutral: int, max_gap: int
) -> None:
    if captured.ndim != 3 or captured.shape[2] != 3 or seen.shape != captured.shape[:2]:
        raise ValueError(
            f"positions {captured.shape} and visible {seen.shape} must be (frames, markers, 3) "
            "and (frames, markers)"
        )
    if not 0 <= neutral < len(captured):
        raise ValueError(f"neutral frame index {neutral} is outside 0 to {len(captured) - 1}")
    if max_gap < 0:
        raise ValueError(f"max_gap must be 0 or more frames, got {max_gap}")
    if not seen.any(axis=0).all():
        never = np.flatnonzero(~seen.any(axis=0)).tolist()
        raise ValueError(f"markers {never} are never seen; leave them out")


def _stabilize(
    captured: NDArray[np.float32], seen: NDArray[np.bool_], rigid: Sequence[int], neutral: int
) -> _Still:
    """Take out a smooth head motion.

    What jitters in the pose jitters in all markers alike, and would be learned as a way in which
    the face moves; quick head motion comes back when the pose is refined.
    """
    first = stabilize(captured, seen, rigid=rigid, neutral=neutral)
    motion = smooth_poses(first.head_motion, center=first.reference.mean(axis=0))
    positions = remove_motion(captured, alignment_of(motion))
    return _Still(positions, seen, motion, first.pose_confidence)


def _relabel(
    still: _Still, model: LowRankModel, rank: int, progress: Progress
) -> tuple[tuple[Swap, ...], LowRankModel]:
    """Put labels back in place in rounds: each round's model is learned with fewer swaps."""
    found: list[Swap] = []
    for number in range(_RELABEL_ROUNDS):
        progress(0.1 + 0.35 * number / _RELABEL_ROUNDS, "labels")
        swaps = find_swaps(still.positions, still.visible, model=model)
        if not swaps:
            break
        apply_swaps(still.positions, swaps)
        apply_swaps(still.visible, swaps)
        found += swaps
        model = fit_low_rank(still.positions, still.visible, rank_limit=rank, start=model)
    return tuple(found), model


def _refine_pose(still: _Still, good: NDArray[np.bool_], model: LowRankModel) -> _Still:
    """Move each frame rigidly to where its markers predict one another best."""
    positions, motion = still.positions, still.head_motion
    step = max(1, len(positions) // _SAMPLE_FRAMES)
    for _ in range(_POSE_ROUNDS):
        complete = fill_missing(model, positions, good)
        predicted = predict_from_others(model, complete)
        distance = np.linalg.norm(complete - predicted, axis=2)
        usual = np.array([_median(distance[::step, m][ok[::step]]) for m, ok in enumerate(good.T)])
        deviation = np.maximum(_MAD_TO_DEVIATION * usual, model.noise)
        weights = good / (1.0 + (distance / (_POSE_INLIER_DEVIATIONS * deviation)) ** 2)
        weights /= deviation**2
        turn = align_frames(complete, predicted, weights=weights)
        positions = remove_motion(positions, turn)
        motion = motion @ turn.matrices()
    return _Still(positions, still.visible, motion, still.pose_confidence)


def _smooth(clean: FloatArray, model: LowRankModel, noise: NDArray[np.float64]) -> FloatArray:
    """Smooth along the face's own directions of motion, slow ones more than quick ones.

    Blinks, which coordinates of single markers would lose in their noise, are few directions.
    """
    flat = clean.reshape(len(clean), -1)
    scores = (flat - model.mean.astype(flat.dtype)) @ model.components.T.astype(flat.dtype)
    smooth = smooth_tracks(scores).values
    tracks = (smooth @ model.components + model.mean).astype(flat.dtype).reshape(clean.shape)
    return tracks + significant_detail(clean - tracks, noise=noise)


def _hold(positions: FloatArray, known: NDArray[np.bool_]) -> None:
    """Let unknown samples hold the last known position, or before the first that one; in place."""
    frames = np.arange(len(known))
    for marker in np.flatnonzero(~known.all(axis=0) & known.any(axis=0)):
        ok = known[:, marker]
        latest = np.maximum.accumulate(np.where(ok, frames, -1))
        latest[latest < 0] = int(np.argmax(ok))
        positions[~ok, marker] = positions[latest[~ok], marker]


def _confidence(
    gaps: GapFill, swaps: tuple[Swap, ...], pose_confidence: NDArray[np.float64]
) -> NDArray[np.float32]:
    confidence = gaps.confidence.copy()
    for swap in swaps:
        confidence[swap.start : swap.stop, [swap.first, swap.second]] *= _RELABELLED_CONFIDENCE
    return np.asarray(confidence * pose_confidence[:, None], np.float32)


def _median(values: FloatArray) -> float:
    return float(np.median(values)) if values.size else 0.0
