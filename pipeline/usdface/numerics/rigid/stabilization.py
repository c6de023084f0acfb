"""Removal of head motion from a take.

Where no set of markers is rigid, markers are weighted by their motion relative to the skull: the
skin of the forehead follows the brows, that of the nose the lip. Each marker has a prior standard
deviation of this motion, and its weight in a frame depends on its residual there.

References
----------
Deng, Chiang, Fox and Neumann (2006), section 3. Where the paper puts one marker at the centre of
every frame, the centroid of the rigid markers seen in the frame is used: it carries less noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import distance_transform_edt, uniform_filter1d
from scipy.spatial.transform import Rotation, Slerp

from usdface.core.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    RealArray,
    equal_rows,
    median_places,
    rms_radius,
    sample_frames,
)
from usdface.numerics.rigid.rigid_alignment import (
    RigidAlignment,
    align_rigid,
    align_rigid_robust,
    alignment_residuals,
    remove_motion,
)

_IRLS_ROUNDS = 15
_SHARE_OF_PRIOR = 0.7
_WEIGHT_EXPONENT = 1.5
"""The weight of a marker with residual r is ``prior^-2 (1 + r^2 / (0.7 prior)^2)^-1.5``, which
decreases faster than Cauchy weights: a forehead that moves for a while hardly counts."""

_WINDOW_SECONDS = 0.3
"""Squared residuals are averaged over this time, the duration of a movement."""


def align_by_prior(
    positions: ArrayLike,
    reference: ArrayLike,
    *,
    visible: ArrayLike,
    skin_motion_mm: ArrayLike,
    rate: float,
) -> RigidAlignment:
    """Align a reference to every frame, with weights by the markers' motion over the skull.

    By iteratively reweighted least squares.

    Parameters
    ----------
    positions : (frames, markers, 3) array_like
        [mm] Captured.
    reference : (markers, 3) array_like
        At rest.
    visible : (frames, markers) array_like of bool
    skin_motion_mm : (markers,) array_like
        Standard deviation of each marker's motion over the skull [mm]; positive, infinite for one
        to ignore.
    """
    seen = np.asarray(visible, bool)
    prior = np.asarray(skin_motion_mm, float)
    base: FloatArray = seen / prior**2
    window = max(1, round(_WINDOW_SECONDS * rate))
    weights = base
    alignment = align_rigid(positions, reference, weights=weights)
    share = uniform_filter1d(seen.astype(float), window, axis=0, mode="nearest")
    for _ in range(_IRLS_ROUNDS):
        squared = np.where(seen, alignment_residuals(positions, reference, alignment) ** 2, 0.0)
        mean = uniform_filter1d(squared, window, axis=0, mode="nearest") / np.maximum(share, 1e-9)
        weights = base / (1 + mean / (_SHARE_OF_PRIOR * prior) ** 2) ** _WEIGHT_EXPONENT
        alignment = align_rigid(positions, reference, weights=weights)
    return alignment


_REFERENCE_FRAMES = 20_000
_MOST_POSE_ERROR_MM = 0.5
"""Of the face's markers, by noise of the rigid markers that are seen, if nearly on a line. Above it
the face tells the pose better: to 0.2 to 0.5 mm in gaps of recorded takes (decision 47)."""
_LEAST_ERROR_RATIO = 3.0
"""Of that error to the take's usual one, which smoothing and `clean_markers` reduce."""


@dataclass(frozen=True)
class Stabilization:
    """The head motion of a take."""

    head_motion: FloatArray
    """(frames, 4, 4): for column vectors: ``captured = head_motion @ stabilised``."""
    pose_gap: IntArray
    """(frames,): frames to the nearest measured pose; 0 where it is measured."""
    reference: FloatArray
    """(rigid, 3) [mm] Rigid markers in the head space."""


def stabilize(
    positions: ArrayLike, visible: ArrayLike, *, rigid: Sequence[int], neutral: int
) -> Stabilization:
    """Remove the head motion from every frame, by rigid markers.

    Parameters
    ----------
    positions : (frames, markers, 3) array_like
        [mm] Captured.
    visible : (frames, markers) array_like of bool
    rigid : sequence of int
        Columns of the markers that move with the skull alone, three or more.
    neutral : int
        Index of the frame whose head pose defines the head space.

    Raises
    ------
    ValueError
        If fewer than three rigid markers are seen in the neutral frame, if they lie on a line, or
        if no frame determines the pose.
    """
    points, seen = np.asarray(positions), np.asarray(visible, bool)
    columns = np.asarray(rigid, np.int64)
    body, body_seen = points[:, columns], seen[:, columns]
    at_neutral = np.flatnonzero(body_seen[neutral])
    start = body[neutral, at_neutral].astype(np.float64)
    _check_reference(start, len(columns), neutral)
    reference = _mean_shape(body, body_seen, start, at_neutral)
    back = align_rigid(start[None], reference[at_neutral])  # identity pose at the neutral frame
    reference = reference @ back.rotations[0].T + back.translations[0]
    alignment = align_rigid_robust(body, reference, visible=body_seen)
    noise = np.median(alignment_residuals(body, reference, alignment)[body_seen])
    reach = rms_radius(points[neutral, seen[neutral]].astype(np.float64))
    turn = _turn_per_mm(reference, body_seen)
    uncertain = (turn * reach * noise > _MOST_POSE_ERROR_MM) & (
        turn > _LEAST_ERROR_RATIO * np.median(turn)
    )
    alignment = replace(alignment, determined=alignment.determined & ~uncertain)
    return _stabilized(alignment, reference)


def _turn_per_mm(reference: FloatArray, seen: BoolArray) -> FloatArray:
    """Return by how much noise of 1 mm turns a frame's rigid markers about their line [rad]."""
    widths = np.zeros(len(seen))
    for rows in equal_rows(seen):
        markers = reference[seen[rows[0]]]
        if len(markers):
            offsets = markers - markers.mean(axis=0)
            widths[rows] = np.linalg.norm(np.linalg.svd(offsets, compute_uv=False)[1:])
    return 1.0 / np.maximum(widths, 1e-9)


def stabilize_by_prior(
    positions: ArrayLike,
    visible: ArrayLike,
    *,
    skin_motion_mm: ArrayLike,
    rate: float,
    neutral: int,
) -> Stabilization:
    """Remove the head motion from every frame, by `align_by_prior`.

    Parameters
    ----------
    positions : (frames, markers, 3) array_like
        [mm] Captured.
    visible : (frames, markers) array_like of bool
    skin_motion_mm : (markers,) array_like
        Standard deviation of each marker's motion over the skull [mm]; infinite for one to ignore.
    neutral : int
        Index of the frame whose head pose defines the head space.
    """
    points, seen = np.asarray(positions), np.asarray(visible, bool)
    prior = np.asarray(skin_motion_mm, float)
    columns = np.flatnonzero(np.isfinite(prior) & seen[neutral])
    start = points[neutral, columns].astype(np.float64)
    _check_reference(start, len(columns), neutral)
    body, body_seen = points[:, columns], seen[:, columns]
    alignment = align_by_prior(
        body, start, visible=body_seen, skin_motion_mm=prior[columns], rate=rate
    )
    return _stabilized(alignment, start)


def _stabilized(alignment: RigidAlignment, reference: FloatArray) -> Stabilization:
    poses = interpolate_poses(alignment)
    return Stabilization(
        head_motion=poses.matrices(),
        pose_gap=distance_transform_edt(~alignment.determined).astype(np.int64),
        reference=reference,
    )


def interpolate_poses(alignment: RigidAlignment) -> RigidAlignment:
    """Replace undetermined poses by interpolated ones, at the ends by the nearest."""
    known = np.flatnonzero(alignment.determined)
    if not known.size:
        raise ValueError("no frame determines the head's pose; name more rigid markers")
    missing = np.flatnonzero(~alignment.determined)
    if not missing.size:
        return alignment
    rotations, translations = alignment.rotations.copy(), alignment.translations.copy()
    inside = np.clip(missing, known[0], known[-1])
    if known.size == 1:
        rotations[missing] = rotations[known[0]]
    else:
        interpolated = Slerp(known, Rotation.from_matrix(rotations[known]))
        rotations[missing] = interpolated(inside).as_matrix()
    for axis in range(3):
        translations[missing, axis] = np.interp(missing, known, translations[known, axis])
    return RigidAlignment(rotations, translations, alignment.determined, alignment.weights)


def _check_reference(start: FloatArray, named: int, neutral: int) -> None:
    if len(start) < 3:
        raise ValueError(
            f"{len(start)} of {named} rigid markers are seen at the neutral frame (index "
            f"{neutral}), 3 are needed; choose another neutral frame or name more rigid markers"
        )
    extent = np.linalg.svd(start - start.mean(axis=0), compute_uv=False)
    if not align_rigid(start[None], start).determined[0]:
        raise ValueError(
            f"the {len(start)} rigid markers seen at the neutral frame (index {neutral}) lie on a "
            f"line ({extent[0]:.1f} mm long, {extent[1]:.2f} mm wide); name one off that line"
        )


def _mean_shape(
    body: RealArray, seen: BoolArray, start: FloatArray, at_neutral: IntArray
) -> FloatArray:
    """Return the median position of each rigid marker, robust to swaps and outliers.

    In the space of `start`, the markers `at_neutral`; of a sample of the frames, or of all if the
    sample does not show a marker.
    """
    for rows in (sample_frames(len(body), _REFERENCE_FRAMES), np.arange(len(body))):
        first = align_rigid_robust(
            body[rows[:, None], at_neutral], start, visible=seen[rows[:, None], at_neutral]
        )
        still, known = remove_motion(body[rows], first), seen[rows] & first.determined[:, None]
        if known.any(axis=0).all():
            return median_places(still, known)
    if not first.determined.any():
        raise ValueError(
            f"no frame of {len(body)} shows three of the {body.shape[1]} rigid markers off one "
            "line; name more rigid markers"
        )
    raise ValueError(
        f"rigid marker {int(known.any(axis=0).argmin())} (in the order given) is never seen "
        "together with three others; leave it out"
    )
