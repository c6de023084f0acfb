"""Principal components of a performer's markers over whole takes: the input space of mappings.

Coordinates of frames with occluded markers are conditional means.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from usdface.core.arrays import BoolArray, FloatArray, RealArray, equal_rows, sample_frames
from usdface.core.assets import MotionSpace, References, TrainedMapping
from usdface.core.errors import InputError
from usdface.numerics.registration.marker_application import SAMPLE_FRAMES
from usdface.numerics.regression.pca import PCA, fit_pca, pca_from_moments, project, sum_moments
from usdface.numerics.rigid.pose_error import PoseErrors


def fit_motion_space(
    clips: Sequence[RealArray], *, dimensions: int = 60, sample_count: int = 2000
) -> MotionSpace:
    """Fit principal components to stabilised markers of one or more takes.

    Parameters
    ----------
    clips : sequence of (frames, markers, 3) float arrays
        Stabilised and cleaned positions of the same markers in the same order [mm]; float32 is
        read in blocks and summed in float64.
    dimensions : int
        Largest number of components.
    sample_count : int
        Frames, evenly spread over the takes, whose coordinates are kept.
    """
    clips = [clip for clip in clips if len(clip)]
    frames = sum(len(clip) for clip in clips)
    if frames < 2:
        raise InputError(
            f"the motion space needs at least 2 frames, got {frames}; give longer takes"
        )
    counts = sorted({clip.shape[1] for clip in clips})
    if len(counts) > 1:
        raise InputError(
            f"takes with {' and '.join(map(str, counts))} markers share no motion space; "
            "give takes of one marker set, in one order"
        )
    try:
        moments = sum_moments(clip.reshape(len(clip), -1) for clip in clips)
    except ValueError as error:
        raise InputError(
            f"the motion space cannot be fitted: {error}; clean the takes first"
        ) from error
    if np.trace(moments.scatter) <= 0:
        raise InputError(f"no marker moves in {frames} frames; give takes of a moving face")
    kept = min(dimensions, moments.count - 1, len(moments.mean))
    pca = pca_from_moments(moments, dimensions=kept)
    sampled = _spread(clips, min(sample_count, frames))
    starts = np.cumsum([0, *map(len, sampled[:-1])]).tolist()
    return replace(motion_from_pca(pca, np.concatenate(sampled)), sample_starts=tuple(starts))


def motion_from_pca(pca: PCA, sample: FloatArray) -> MotionSpace:
    """Return a motion space from components and sample rows of packed positions."""
    return MotionSpace(
        mean=pca.mean,
        components=pca.components,
        variances=pca.variances,
        total_variance=pca.total_variance,
        sample=project(pca, sample),
    )


def _spread(clips: Sequence[RealArray], count: int) -> list[FloatArray]:
    """Pack evenly spaced frames of all clips, taken as one long take; return those of each."""
    ends = np.cumsum([len(clip) for clip in clips])
    wanted = np.linspace(0, ends[-1] - 1, count).round().astype(np.int64)
    rows = []
    for clip, end in zip(clips, ends, strict=True):
        rows_of_clip = wanted[(wanted >= end - len(clip)) & (wanted < end)] - (end - len(clip))
        rows.append(clip[rows_of_clip].reshape(len(rows_of_clip), -1).astype(np.float64))
    return rows


def motion_of(mapping: TrainedMapping) -> MotionSpace:
    """Return the motion space of a mapping, with the sample that `motion_arrays` kept."""
    try:
        return MotionSpace(
            mean=mapping.arrays["motion_mean"],
            components=mapping.arrays["motion_components"],
            variances=mapping.arrays["motion_variances"],
            total_variance=float(mapping.arrays["motion_total"].sum()),
            sample=mapping.arrays["takes_sample"],
        )
    except KeyError as error:
        raise InputError(
            f"the mapping lacks the array {error}; train it again with this version"
        ) from error


def motion_arrays(motion: MotionSpace) -> dict[str, FloatArray]:
    """Return a motion space as arrays of a mapping, the input of `motion_of`."""
    return {
        "motion_mean": motion.mean,
        "motion_components": motion.components,
        "motion_variances": motion.variances,
        "motion_total": np.array([motion.total_variance]),
        "takes_sample": thinned_sample(motion),
    }


def motion_of_pairs(references: References) -> MotionSpace:
    """Fit the motion space to the pairs, for references without that of their takes."""
    packed = references.markers.reshape(len(references.markers), -1).astype(np.float64)
    return motion_from_pca(fit_pca(packed), packed)


def sampled_frames(motion: MotionSpace) -> FloatArray:
    """Return the sample of a motion space, (frames, markers, 3) [mm]."""
    return frames_at(motion, motion.sample)


def frames_at(motion: MotionSpace, coordinates: FloatArray) -> FloatArray:
    """Return the frames at coordinates of a motion space, (frames, markers, 3) [mm]."""
    return (motion.mean + coordinates @ motion.components).reshape(len(coordinates), -1, 3)


def motion_without_errors(motion: MotionSpace, errors: PoseErrors) -> MotionSpace:
    """Return the motion space of its sample without errors of poses."""
    if not errors.size_mm:
        return motion
    frames = sampled_frames(motion)
    rows = errors.remove(frames, np.ones(frames.shape[:2], np.bool_)).reshape(len(frames), -1)
    pca = fit_pca(rows, dimensions=len(motion.variances))
    unexplained = motion.total_variance - float(motion.variances.sum())
    return replace(
        motion_from_pca(pca, rows),
        total_variance=pca.total_variance + unexplained,
        sample_starts=motion.sample_starts,
    )


def thinned_sample(motion: MotionSpace) -> FloatArray:
    """Return coordinates of up to `SAMPLE_FRAMES` frames: (frames, dimensions)."""
    return motion.sample[sample_frames(len(motion.sample), SAMPLE_FRAMES)]


NOISE_FLOOR_MM = 0.05
"""Smallest noise of a marker's coordinate: about the resolution of optical systems."""


def noise_variance(motion: MotionSpace) -> float:
    """Return the mean variance of the discarded components [mm^2]."""
    discarded = motion.components.shape[1] - len(motion.components)
    unexplained = motion.total_variance - float(motion.variances.sum())
    return float(max(unexplained / max(discarded, 1), NOISE_FLOOR_MM**2))


def marker_coordinates(
    motion: MotionSpace, positions: RealArray, *, visible: BoolArray | None = None
) -> FloatArray:
    """Project frames onto the motion space: (frames, dimensions) [mm].

    With occluded markers, coordinates are the conditional mean given the others under probabilistic
    PCA (Tipping and Bishop 1999). Frames with the same pattern of visibility share one solve.

    Parameters
    ----------
    positions : (frames, markers, 3) float array
        In the motion space's head space [mm]; ignored where not visible.
    visible : (frames, markers) bool array, optional
        By default all are.
    """
    offsets: FloatArray = positions.reshape(len(positions), -1) - motion.mean
    if visible is None or visible.all():
        return np.asarray(offsets @ motion.components.T)
    offsets[~np.repeat(visible, 3, axis=1)] = 0.0  # also removes NaN
    values: FloatArray = offsets @ motion.components.T
    for rows in equal_rows(visible):
        pattern = visible[rows[0]]
        if not pattern.all():
            values[rows] = _conditional_mean(motion, offsets[rows], pattern)
    return values


def _conditional_mean(motion: MotionSpace, offsets: FloatArray, pattern: BoolArray) -> FloatArray:
    """Return ``(B B' + noise diag(1 / variances))^-1 B x`` over the visible coordinates x."""
    seen = np.repeat(pattern, 3)
    basis = motion.components[:, seen]
    noise = noise_variance(motion)
    prior = noise / np.maximum(motion.variances, 1e-6 * noise)
    precision = basis @ basis.T + np.diag(prior)
    values = np.linalg.solve(precision, basis @ offsets[:, seen].T).T
    return values.astype(np.float64)
