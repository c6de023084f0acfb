"""Rigid alignment of a take with a performer's face, by its reference pairs or its medians."""

from typing import NamedTuple, NoReturn

import numpy as np

from usdface.core.arrays import (
    BoolArray,
    Float32Array,
    FloatArray,
    IntArray,
    median_places,
    rms_radius,
)
from usdface.core.errors import InputError
from usdface.model.mapping.performer_face import PerformerFace
from usdface.model.mapping.take_neutral import MIN_OFFSET_MM, check_not_mirrored
from usdface.model.placement.plausibility import unit_remedy
from usdface.numerics.rigid.rigid_alignment import FEWEST_RIGID, align_rigid, optimal_rotations

_RIGID_TOLERANCE_MM = 5.0
"""Largest median distance of the rigid markers from the performer's after alignment."""

_RIGID_RADIUS_MM = 60.0
"""Usual RMS distance of rigid markers from their centre: 40 mm on a brow and nose, 90 on a cap."""

_EXPLAINED_SHARE = 0.25
"""A scale explains the distances of the rigid markers if it reduces their root mean square to less
than this share: of four that were put on again, in 0.2 % of cases."""

_LEAST_SCALE = 0.005
"""Relative difference of sizes from which calibrations differ: noise of 0.1 mm has 0.002."""

_UNIT_RATIO = 2.0
"""Ratio of sizes from which units differ, by 2.5 or more: heads differ by up to 33 %, and by half
again if their rigid markers sit elsewhere."""

_SLIP_MM = 1.0
"""Scale of the Geman-McClure weights, which reject rigid markers that slipped."""

_ALIGNMENT_ROUNDS = 10
"""Iteratively reweighted alignments."""


class TakeAlignment(NamedTuple):
    """Rigid alignment of a take with a performer's face."""

    rotation: FloatArray
    """(3, 3)"""
    shift: FloatArray
    """(3,) [mm]"""
    pair_offset: FloatArray | float = 0.0
    """As of `usdface.model.mapping.head_space.HeadSpace`."""
    moved_mm: float = 0.0
    """As of `usdface.model.mapping.head_space.HeadSpace`."""
    pairs: int = 0
    """Number of the take's reference pairs by which it is aligned."""
    scale: float = 1.0
    """As of `usdface.model.mapping.head_space.HeadSpace`."""


def align_to_pairs(
    face: PerformerFace, take: str, numbers: IntArray, positions: Float32Array, visible: BoolArray
) -> TakeAlignment | None:
    """Map a take's frames to its own reference pairs, by markers that are visible in all of these.

    None if the pairs are fewer than two, or frames of another take of that name.
    """
    frames, markers = face.pairs.get(take, (numbers[:0], face.frames[:0]))
    _, rows, pairs = np.intersect1d(numbers, frames, return_indices=True)
    seen = visible[rows].all(axis=0)
    if len(rows) < 2 or seen.sum() < FEWEST_RIGID:
        return None
    own, others = positions[rows][:, seen], markers[pairs][:, seen]
    middle, target = own.mean(axis=0), others.mean(axis=0)
    rotation, shift = _robust_transform(middle, target)
    offset = np.zeros_like(face.neutral)
    offset[seen] = middle - (target - shift) @ rotation
    away = own - offset[seen] - (others - shift) @ rotation
    scatter_mm = np.sqrt((away**2).sum(axis=2).mean())
    aligned = TakeAlignment(rotation, shift, offset, pairs=len(rows))
    return aligned if scatter_mm < MIN_OFFSET_MM else None


def align_to_medians(
    face: PerformerFace, positions: Float32Array, visible: BoolArray
) -> TakeAlignment:
    """Map the median positions of a take's rigid markers to the performer's.

    Those of all markers, where the rigid ones are too few, collinear, or elsewhere, as of a head
    band that was put on again.
    """
    # Medians over whole takes, as a single neutral frame is noisy.
    common = np.flatnonzero(visible.any(axis=0) & face.usable.any(axis=0))
    target, median = (
        median_places(points[:, common], seen[:, common])
        for points, seen in ((face.frames, face.usable), (positions, visible))
    )
    names = np.array(face.marker_names)[common]
    rigid = np.isin(names, face.rigid)
    is_determined = align_rigid(target[None, rigid], target[rigid]).determined[0]
    used = rigid if is_determined else np.ones(len(common), np.bool_)
    if used.sum() < FEWEST_RIGID:
        raise InputError(
            f"the take and those of the mapping have {used.sum()} markers in common that are "
            f"ever seen, at least {FEWEST_RIGID} are needed to find its head space"
        )
    rotation, shift = _robust_transform(median[used], target[used])
    away = np.linalg.norm(median @ rotation.T + shift - target, axis=1)
    if np.median(away[used]) <= _RIGID_TOLERANCE_MM:
        scale = _explaining_scale(median[used], target[used], away[used])
        return TakeAlignment(rotation, shift, scale=scale)
    by_face = _robust_transform(median, target)
    face_away = np.linalg.norm(median @ by_face[0].T + by_face[1] - target, axis=1)
    if np.median(face_away) > _RIGID_TOLERANCE_MM:
        check_not_mirrored(median, target)
        _refuse(names[used].tolist(), median[used], target[used], away[used])
    return TakeAlignment(*by_face, moved_mm=float(np.sqrt((face_away[rigid] ** 2).mean())))


def _refuse(names: list[str], median: FloatArray, target: FloatArray, away: FloatArray) -> NoReturn:
    """Refuse a take whose markers are not those of the performer, with the probable cause."""
    here, there = map(rms_radius, (median, target))
    size = here / there
    if not 1 / _UNIT_RATIO < size < _UNIT_RATIO:
        wrong, factor = "the take", size
        if abs(np.log(here / _RIGID_RADIUS_MM)) < abs(np.log(there / _RIGID_RADIUS_MM)):
            wrong, factor = "those", 1 / size
        raise InputError(
            f"the distances between the take's rigid markers are {size:.3g} times those of the "
            f"takes it is compared with: one of them is in another unit; ingest {wrong} again "
            f"and {unit_remedy(factor)}"
        )
    cause = "it is another marker set or another performer: select and train for it separately"
    if _explaining_scale(median, target, away) != 1.0:
        cause = (
            f"a scale explains it: every distance is {size:.3g} times as large. If "
            f"units or calibration differ, ingest it again with {1 / size:.3g} times its "
            "--scale (default 1); else it is another performer: select and train for it "
            "separately"
        )
    raise InputError(
        f"the take's rigid markers are {np.median(away):.1f} mm from those of the takes it is "
        f"compared with ({names[int(away.argmax())]}: {away.max():.1f} mm), and its face does not "
        f"agree with theirs either; {cause}"
    )


def _explaining_scale(median: FloatArray, target: FloatArray, away: FloatArray) -> float:
    """Return how many times as large rigid markers are if that explains their distances, or 1."""
    size = rms_radius(median) / rms_radius(target)
    turned, moved = _robust_transform(median / size, target)
    scaled = np.linalg.norm(median / size @ turned.T + moved - target, axis=1)
    explained = (scaled**2).mean() < _EXPLAINED_SHARE**2 * (away**2).mean()
    differs = abs(size - 1) > _LEAST_SCALE and len(median) > FEWEST_RIGID
    return size if explained and differs else 1.0


def _robust_transform(points: FloatArray, target: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return rotation and shift of points onto others, robust against points that slipped."""
    weights = np.ones(len(points))
    for _ in range(_ALIGNMENT_ROUNDS):
        centre = np.average(points, axis=0, weights=weights)
        target_centre = np.average(target, axis=0, weights=weights)
        covariance = (weights[:, None] * (target - target_centre)).T @ (points - centre)
        rotations, _ = optimal_rotations(covariance[None], rank_tolerance=1e-12)
        rotation: FloatArray = rotations[0]
        residual = np.linalg.norm((points - centre) @ rotation.T - (target - target_centre), axis=1)
        weights = 1 / (1 + (residual / _SLIP_MM) ** 2) ** 2
    return rotation, target_centre - rotation @ centre
