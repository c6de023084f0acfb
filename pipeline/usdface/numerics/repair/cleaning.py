"""Cleaning of marker tracks: head motion, swapped labels, outliers, slips, gaps and noise."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from usdface.core.arrays import (
    MAD_TO_DEVIATION,
    BoolArray,
    Float32Array,
    FloatArray,
    IntArray,
    distances,
    frame_blocks,
    median_places,
    medians_where,
    sample_frames,
)
from usdface.core.processes import map_threads
from usdface.core.progress import Progress, silent
from usdface.numerics.motion.noise import marker_noise
from usdface.numerics.repair.face_pose import interpolation_precision, pose_by_face
from usdface.numerics.repair.fit_low_rank import choose_rank, fit_low_rank
from usdface.numerics.repair.gap_filling import complete_take, explained_after
from usdface.numerics.repair.low_rank import LowRankModel, fill_and_predict
from usdface.numerics.repair.outliers import USUAL_RATE, find_lost, find_outliers
from usdface.numerics.repair.relabeling import Swap, apply_swaps, find_swaps, jumps_onto_lost
from usdface.numerics.repair.slips import Slip, find_slips, undo_slips
from usdface.numerics.repair.smoothing import smooth_poses, smooth_take
from usdface.numerics.rigid.rigid_alignment import (
    align_rigid,
    align_rigid_robust,
    alignment_of,
    remove_motion,
)
from usdface.numerics.rigid.stabilization import stabilize, stabilize_by_prior

_RELABEL_ROUNDS = 4
_RELABELLED_CONFIDENCE = 0.9
_FEWEST_FACE_MARKERS = 8
"""Fewest markers that determine the head's pose where too few rigid ones are seen."""
_FEWEST_MEASURED_FRAMES = 200
"""Fewest frames with a measured pose for a model of the face: 25 for each of eight directions."""
_LEAST_POSE_CONFIDENCE, _MOST_POSE_CONFIDENCE = 0.25, 0.999
"""Limits of poses that are not measured."""
_POSE_ROUNDS = 2
_POSE_INLIER_DEVIATIONS = 3.0
"""Residual of a marker that weighs half (Cauchy weights)."""
_POSE_SAMPLE_FRAMES = 8192


@dataclass(frozen=True)
class CleanedMarkers:
    """Markers without head motion, and a record of the repairs."""

    positions: Float32Array
    """(frames, markers, 3) [mm] Stabilised. Gaps that are not filled have the prediction from
    the other markers."""
    visible: BoolArray
    """(frames, markers): measured or filled; False only in gaps that are not filled."""
    confidence: Float32Array
    """(frames, markers) [0-1] 1 as measured, lower where relabelled, filled, or where rigid markers
    do not determine the pose; 0 in gaps that are not filled."""
    head_motion: FloatArray
    """(frames, 4, 4): for column vectors: ``captured = head_motion @ stabilised``."""
    swaps: tuple[Swap, ...]
    """Swapped labels that were exchanged back."""
    outliers: BoolArray
    """(frames, markers): measured samples that were replaced."""
    lost: BoolArray
    """(frames, markers): measured samples of markers that were off the face, which are gaps."""
    filled: BoolArray
    """(frames, markers): samples that were not measured or were outliers, and were filled."""
    pose_confidence: FloatArray
    """(frames,) [0-1] 1 where rigid markers determine the head's pose; else one minus the variance
    of the pose over that of the markers' motion or, if interpolated, lower the longer the gap."""
    noise_mm: float
    """Measurement noise per coordinate before smoothing [mm]."""
    slips: tuple[Slip, ...] = ()
    """Markers that slipped, moved back to their place in the neutral frame."""


@dataclass(frozen=True)
class _StabilizedTake:
    """A take in the head's space; the steps of `clean_markers` change it in place."""

    positions: Float32Array
    visible: BoolArray
    head_motion: FloatArray
    pose_confidence: FloatArray
    poses: FloatArray
    """(frames, 4, 4): measured or interpolated, not smoothed."""
    measured: BoolArray
    """(frames,): whether rigid markers determine the pose."""
    centre: FloatArray
    """(3,): of the rigid markers [mm]."""


def clean_markers(
    positions: ArrayLike,
    visible: ArrayLike,
    *,
    rigid: Sequence[int],
    neutral: int,
    rate: float = USUAL_RATE,
    skin_motion_mm: FloatArray | None = None,
    max_gap: int = 120,
    smooth: bool = True,
    relabel: bool = True,
    progress: Progress = silent,
) -> CleanedMarkers:
    """Clean a take's markers.

    In this order: head pose from the rigid markers, markers that left the face, swapped labels,
    outliers, head pose from all markers against their predictions, markers that slipped on the
    skin, gaps, and noise, with a penalty for each principal axis of the frames.

    Parameters
    ----------
    positions : (frames, markers, 3) array_like
        [mm] Captured; anything finite where not visible.
    visible : (frames, markers) array_like of bool
        Each marker in one frame at least.
    rigid : sequence of int
        Columns of the markers that move with the skull alone; see `rigid_markers`.
    neutral : int
        Index of the frame whose head pose defines the head space.
    rate : float
        Frames per second.
    skin_motion_mm : (markers,) float array, optional
        Standard deviation of each marker's motion relative to the skull [mm], infinite for markers
        to ignore. Replaces `rigid` where no set of markers is rigid.
    max_gap : int
        Longest gap to fill [frames].
    smooth, relabel : bool
        Whether to smooth, and to exchange swapped labels.
    """
    captured, seen = np.asarray(positions, np.float32), np.array(visible, bool)
    progress(0.0, "head motion")
    take, lost = _stabilize_without_lost(captured, seen, rigid, neutral, rate, skin_motion_mm)
    progress(0.05, "model of the motion")
    model, rank, noise = _model_face(take)
    swaps: tuple[Swap, ...] = ()
    if relabel:
        swaps, model = _relabel(take, model, rank, noise, neutral, progress)
        if {column for swap in swaps for column in (swap.first, swap.second)} & set(rigid):
            del take  # first, to save the memory of one copy of a long take
            captured = np.array(captured)
            apply_swaps(captured, swaps)
            take = _stabilize(captured, seen, rigid, neutral, rate, skin_motion_mm, out=captured)
            model = _pose_by_face(take, take.visible, model, rank, noise)
    progress(0.45, "outliers")
    outliers = find_outliers(take.positions, seen, model=model, noise=noise, rate=rate)
    good = seen & ~outliers
    progress(0.6, "head motion, from all markers")
    noise, slips = _refine_pose_and_slips(take, good, model, neutral=neutral, rate=rate)
    progress(0.7, "gaps")
    model = fit_low_rank(take.positions, good, rank_limit=rank, start=model, noise=noise)
    sigma = float(np.median(noise))
    filled, confidence = complete_take(
        take.positions, good, model=model, max_gap=max_gap, noise=sigma, rate=rate
    )
    for swap in swaps:
        relabelled = [swap.first, swap.second]
        confidence[swap.start : swap.stop, relabelled] *= _RELABELLED_CONFIDENCE
    if smooth:
        progress(0.8, "noise")
        smooth_take(take.positions, noise=noise)
    known = good | filled
    progress(1.0, "clean")
    return CleanedMarkers(
        positions=take.positions,
        visible=known,
        confidence=confidence * take.pose_confidence[:, None].astype(np.float32),
        head_motion=take.head_motion,
        swaps=swaps,
        outliers=outliers,
        lost=lost,
        filled=filled,
        pose_confidence=take.pose_confidence,
        noise_mm=sigma,
        slips=slips,
    )


def _refine_pose_and_slips(
    take: _StabilizedTake, good: BoolArray, model: LowRankModel, *, neutral: int, rate: float
) -> tuple[FloatArray, tuple[Slip, ...]]:
    """Refine the head pose and correct slips, in place; return the noise and the slips."""
    _refine_pose(take, good, model)
    noise = marker_noise(take.positions, good)
    slips = find_slips(take.positions, good, model=model, rate=rate)
    rank = len(model.variances)
    return noise, undo_slips(take.positions, good, slips, neutral=neutral, rank=rank, noise=noise)


def _stabilize(
    captured: Float32Array,
    seen: BoolArray,
    rigid: Sequence[int],
    neutral: int,
    rate: float,
    skin_motion_mm: FloatArray | None,
    *,
    out: Float32Array | None = None,
) -> _StabilizedTake:
    """Remove a smoothed head motion.

    Jitter of the pose moves all markers alike, and would be fitted as a direction of the face's
    motion. Fast head motion is restored when the pose is refined.
    """
    if skin_motion_mm is None:
        body = stabilize(captured, seen, rigid=rigid, neutral=neutral)
    else:
        body = stabilize_by_prior(
            captured, seen, skin_motion_mm=skin_motion_mm, rate=rate, neutral=neutral
        )
    centre, measured = body.reference.mean(axis=0), body.pose_gap == 0
    smooth = smooth_poses(body.head_motion, center=centre)
    motion = np.where(measured[:, None, None], smooth, body.head_motion)
    positions = remove_motion(captured, alignment_of(motion), out=out)
    confidence = np.maximum(explained_after(body.pose_gap / rate), _LEAST_POSE_CONFIDENCE)
    return _StabilizedTake(
        np.asarray(positions, np.float32),
        seen,
        motion,
        confidence,
        body.head_motion,
        measured,
        centre,
    )


def _stabilize_without_lost(
    captured: Float32Array,
    seen: BoolArray,
    rigid: Sequence[int],
    neutral: int,
    rate: float,
    skin_motion_mm: FloatArray | None,
) -> tuple[_StabilizedTake, BoolArray]:
    """Return the take and the samples of markers that left the face, cleared in `seen`."""
    take = _stabilize(captured, seen, rigid, neutral, rate, skin_motion_mm)
    rows = np.flatnonzero(~take.measured)
    interpolated = take.positions[rows]
    take.positions[rows] = _aligned_with_measured(take, rows)
    lost = find_lost(take.positions, seen, neutral=neutral)
    take.positions[rows] = interpolated
    seen &= ~lost
    if lost[:, rigid].any():  # it pulled the head's pose
        del take  # first, to save the memory of one copy of a long take
        take = _stabilize(captured, seen, rigid, neutral, rate, skin_motion_mm)
    return take, lost


def _aligned_with_measured(take: _StabilizedTake, rows: IntArray) -> Float32Array:
    """Return the markers of frames, aligned with the median face of frames with a measured pose.

    Interpolated poses may be far off, as if all markers had left the face.
    """
    positions, known = take.positions[rows], np.flatnonzero(take.measured)
    if not len(rows):
        return positions
    known = known[sample_frames(len(known), _POSE_SAMPLE_FRAMES)]
    shown = np.flatnonzero(take.visible[known].any(axis=0))
    face = median_places(take.positions[known][:, shown], take.visible[known][:, shown])
    alignment = align_rigid_robust(positions[:, shown], face, visible=take.visible[rows][:, shown])
    aligned = remove_motion(positions, alignment).astype(np.float32)
    return np.where(alignment.determined[:, None, None], aligned, positions)


def _model_face(take: _StabilizedTake) -> tuple[LowRankModel, int, FloatArray]:
    """Return the face's model, its rank, and the markers' noise; replace interpolated poses."""
    noise = marker_noise(take.positions, _with_measured_pose(take, take.visible))
    jumps = jumps_onto_lost(take.positions, take.visible, noise=float(np.median(noise)))
    labelled = take.visible & ~jumps
    posed = _with_measured_pose(take, labelled)
    model = fit_low_rank(take.positions, posed, noise=noise)
    rank = choose_rank(take.positions, posed, start=model, noise=noise)
    return _pose_by_face(take, labelled, model, rank, noise), rank, noise


def _with_measured_pose(take: _StabilizedTake, labelled: BoolArray) -> BoolArray:
    """Return the samples to which the face's model is fitted, (frames, markers).

    Of those that are certainly labelled, the ones of frames with a measured pose; all, for markers
    that are visible only in other frames, and in takes of fewer such frames than
    `_FEWEST_MEASURED_FRAMES`.
    """
    if take.measured.sum() < _FEWEST_MEASURED_FRAMES or take.measured.all():
        return labelled
    posed = labelled & take.measured[:, None]
    unseen = ~posed.any(axis=0)
    posed[:, unseen] = labelled[:, unseen]
    return posed


def _pose_by_face(
    take: _StabilizedTake, labelled: BoolArray, start: LowRankModel, rank: int, noise: FloatArray
) -> LowRankModel:
    """Fit the face's model at measured poses, and replace the interpolated poses by it, in place.

    The confidence of a pose is ``1 - variance / motion``, mean squares of a marker [mm^2].
    """
    posed = _with_measured_pose(take, labelled)
    model = fit_low_rank(take.positions, posed, rank_limit=rank, start=start, noise=noise)
    known = take.visible.sum(axis=1) >= _FEWEST_FACE_MARKERS
    rows = np.flatnonzero(~take.measured & known)
    if not len(rows):
        return model
    poses, variance = pose_by_face(
        model,
        take.positions[rows],
        take.visible[rows],
        precision=interpolation_precision(take.poses, take.measured, take.centre)[rows],
        centre=take.centre,
    )
    take.positions[rows] = remove_motion(take.positions[rows], alignment_of(poses))
    take.head_motion[rows] = take.head_motion[rows] @ poses
    motion = (model.variances.sum() + 3 * (model.noise**2).sum()) / len(model.noise)
    share = np.clip(1.0 - variance / motion, _LEAST_POSE_CONFIDENCE, _MOST_POSE_CONFIDENCE)
    take.pose_confidence[rows] = share
    return model


def _relabel(
    take: _StabilizedTake,
    model: LowRankModel,
    rank: int,
    noise: FloatArray,
    neutral: int,
    progress: Progress,
) -> tuple[tuple[Swap, ...], LowRankModel]:
    """Exchange swapped labels back, in rounds, between which the model is fitted again."""
    found: list[Swap] = []
    for number in range(_RELABEL_ROUNDS):
        progress(0.1 + 0.35 * number / _RELABEL_ROUNDS, "labels")
        swaps = find_swaps(
            take.positions,
            take.visible,
            model=model,
            noise=float(np.median(noise)),
            neutral=neutral,
        )
        if not swaps:
            break
        apply_swaps(take.positions, swaps)
        apply_swaps(take.visible, swaps)
        found += swaps
        model = fit_low_rank(
            take.positions, take.visible, rank_limit=rank, start=model, noise=noise
        )
    return tuple(found), model


def _refine_pose(take: _StabilizedTake, good: BoolArray, model: LowRankModel) -> None:
    """Align each frame with the predictions of its markers from each other, in place."""
    positions, motion = take.positions, take.head_motion
    sample = sample_frames(len(positions), _POSE_SAMPLE_FRAMES)
    for _ in range(_POSE_ROUNDS):
        complete, predicted = fill_and_predict(model, positions[sample], good[sample])
        median = medians_where(distances(complete, predicted), good[sample])
        deviation = np.maximum(MAD_TO_DEVIATION * median, model.noise)

        def align(block: slice, deviation: FloatArray = deviation) -> None:
            complete, predicted = fill_and_predict(model, positions[block], good[block])
            distance = distances(complete, predicted)
            weights = good[block] / (1.0 + (distance / (_POSE_INLIER_DEVIATIONS * deviation)) ** 2)
            weights /= deviation**2
            turn = align_rigid(complete, predicted, weights=weights)
            remove_motion(positions[block], turn, out=positions[block])
            motion[block] = motion[block] @ turn.matrices()

        map_threads(align, frame_blocks(len(positions)))
