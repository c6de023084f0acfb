"""Alignment of a take with a performer's marker order, head space and neutral face."""

from dataclasses import dataclass, replace
from typing import NamedTuple, NoReturn

import numpy as np

from usdface.core.arrays import (
    BoolArray,
    Float32Array,
    FloatArray,
    IntArray,
    median_places,
    rms_radius,
    sample_frames,
)
from usdface.core.assets import Markers
from usdface.core.errors import InputError
from usdface.core.text import first_few
from usdface.model.mapping.performer_face import PerformerFace
from usdface.model.mapping.take_neutral import (
    MIN_OFFSET_MM,
    TakeNeutral,
    check_not_mirrored,
    compare_neutral,
)
from usdface.model.placement.plausibility import unit_remedy
from usdface.numerics.registration.marker_application import SAMPLE_FRAMES
from usdface.numerics.rigid.pose_error import PoseErrors, observed_motion
from usdface.numerics.rigid.rigid_alignment import FEWEST_RIGID, align_rigid, optimal_rotations
from usdface.numerics.rigid.rigid_template import RigidTemplate

MINIMUM_SHARE = 0.5
"""Share of the mapping's markers that a take must have: with fewer, most of the face is unobserved.
"""

RIGID_TOLERANCE_MM = 5.0
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

_MOVED_MM = 2.0
"""Mean error of the poses from which the rigid markers, as of a head band, were put on again: head
spaces of one application agree to a millimetre."""

_OFFSET_ERROR_SHARE = 0.25
"""Error of an offset, relative to that of the markers on skin: reapplied ones have 0.33 to 0.39
(`poe bench real_sessions`), of which a part is common to all and changes no weights."""

_PAIR_OFFSET_ERROR_SHARE = 0.36
"""The same of an offset that one reference pair of the take tells; of n pairs, over sqrt(n)
(decision 62)."""

_ALIGNMENT_ROUNDS = 10
"""Iteratively reweighted alignments."""


@dataclass(frozen=True)
class MappedMarkers:
    """Markers of a take, as input of a mapping."""

    positions: Float32Array
    """(frames, markers, 3): in the mapping's marker order and head space [mm]; 0 where not visible.
    """
    visible: BoolArray
    """(frames, markers): where a position was measured or repaired."""
    confidence: Float32Array
    """(frames, markers) [0-1]: share of the variance of the marker's motion that is known: 1 where
    measured, decreasing with the distance into a filled gap."""


@dataclass(frozen=True)
class HeadSpace:
    """Alignment of a take with a mapping, estimated once and applied to every chunk of the take."""

    columns: IntArray
    """(n,): indices of the common markers in the take."""
    slots: IntArray
    """(n,): their indices in the mapping."""
    count: int
    """Number of the mapping's markers."""
    rotation: FloatArray
    """(3, 3)"""
    shift: FloatArray
    """(3,) [mm]"""
    missing: tuple[str, ...]
    extra: tuple[str, ...]
    """`missing`, `extra`: Markers that the take lacks, and those that the mapping lacks."""
    neutral: TakeNeutral
    """Of the take, in the mapping's order and head space."""
    known_share: FloatArray | float = 1.0
    """(markers,): share of the variance of a marker's motion that is not an error of the offset."""
    pose_errors: PoseErrors | None = None
    """Of the take's frames; None if there are none."""
    moved_mm: float = 0.0
    """Distance of the rigid markers from the performer's, or of the face if these are in place, if
    they were put on again, root mean square [mm]."""
    pair_offset: FloatArray | float = 0.0
    """(markers, 3): offset that the take's reference pairs show, in the take's space [mm]."""
    template: RigidTemplate | None = None
    """Of the performer's rigid markers, in the take's space; None if the take's are the same."""
    scale: float = 1.0
    """Distances of the take's rigid markers over the performer's, if that is why they differ."""

    def place(self, markers: Markers) -> MappedMarkers:
        """Return frames of the take in the mapping's order, head space and neutral face."""
        positions, visible = _in_order(markers, self.columns, self.slots, self.count)
        positions = self.move(positions, visible)
        if not visible.all():
            positions[~visible] = 0.0
        confidence = np.zeros(visible.shape, np.float32)
        confidence[:, self.slots] = markers.confidence[:, self.columns]
        confidence *= self.known_share
        return MappedMarkers(positions, visible, confidence)

    def move(self, positions: Float32Array, visible: BoolArray) -> Float32Array:
        """Align positions in the mapping's order, (frames, markers, 3) [mm], with its neutral."""
        if self.template is not None:
            positions = self.template.align(positions, visible)
        flat = positions - np.float32(self.pair_offset)
        flat = flat.reshape(-1, 3) @ self.rotation.T.astype(np.float32)
        flat += self.shift.astype(np.float32)
        moved: Float32Array = flat.reshape(positions.shape)
        if self.pose_errors is not None and self.pose_errors.size_mm:
            moved = self.pose_errors.remove(moved, visible).astype(np.float32)
        if self.neutral.offset.any():
            moved -= self.neutral.offset.astype(np.float32)
        return moved

    def restore(self, positions: FloatArray) -> FloatArray:
        """Transform positions (..., markers, 3) [mm] back to the take's space.

        Errors of its poses, and frames before their alignment by `template`, are not restored.
        """
        moved = (positions + self.neutral.offset - self.shift) @ self.rotation
        return np.asarray(moved + self.pair_offset)


class _Alignment(NamedTuple):
    """Rigid alignment of a take with a performer's face."""

    rotation: FloatArray
    """(3, 3)"""
    shift: FloatArray
    """(3,) [mm]"""
    pair_offset: FloatArray | float = 0.0
    """As of `HeadSpace`."""
    moved_mm: float = 0.0
    """As of `HeadSpace`."""
    pairs: int = 0
    """Number of the take's reference pairs by which it is aligned."""
    scale: float = 1.0
    """As of `HeadSpace`."""


def find_head_space(
    face: PerformerFace,
    markers: Markers,
    *,
    rate: float,
    frames: IntArray | None = None,
    take: str = "",
    performer: str = "",
    session: str = "",
) -> HeadSpace:
    """Match markers by name, and estimate the alignment of a take with a performer's face.

    Frames of a take that was stabilised by other rigid markers are aligned by the performer's
    first. One rigid transformation for the take maps the median positions of its rigid markers to
    the performer's. The constant difference that remains is the take's offset.

    Parameters
    ----------
    markers : Markers
        Stabilised; a sample of frames suffices.
    rate : float
        Frames per second.
    frames : (frames,) int array, optional
        Frame numbers of the sample; by default they begin at 0.
    take, performer, session : str
        Names; empty if unknown.

    Raises
    ------
    InputError
        If the take is not stabilised, shares too few markers with the face, has neither its rigid
        markers nor its face where the performer's are, or is another performer's.
    """
    slots, columns = _common_markers(face, markers)
    count = len(face.marker_names)
    positions, visible = _in_order(markers, columns, slots, count)
    rigid, template = np.flatnonzero(np.isin(face.marker_names, face.rigid)), None
    if set(markers.rigid) != set(face.rigid):
        template = RigidTemplate.from_sample(positions, visible, rigid)
    if template is not None:
        positions = template.align(positions, visible)
    numbers = np.arange(len(positions)) if frames is None else frames
    by_pairs = _align_pairs(face, take, numbers, positions, visible)
    aligned = by_pairs or _align_medians(face, positions, visible)
    positions = positions - np.float32(aligned.pair_offset)
    picks = sample_frames(len(positions), SAMPLE_FRAMES)
    if frames is not None:
        picks = np.union1d(picks, np.flatnonzero(numbers == markers.neutral_frame))
    sample, seen = positions[picks].astype(np.float64), visible[picks]
    aligned, errors = _correct_poses(face, sample, seen, aligned)
    sample = sample @ aligned.rotation.T + aligned.shift
    neutral = compare_neutral(
        face,
        sample if errors is None else errors.remove(sample, seen),
        seen,
        frames=numbers[picks],
        stated_frame=markers.neutral_frame,
        rate=rate,
        performer=performer,
        session=session,
    )
    if by_pairs is not None and not neutral.offset.any():
        size_mm = float(np.sqrt(np.square(by_pairs.pair_offset)[slots].sum(axis=1).mean()))
        neutral = replace(neutral, offset_mm=size_mm)
    missing = tuple(name for name in face.marker_names if name not in markers.names)
    extra = tuple(name for name in markers.names if name not in face.marker_names)
    return HeadSpace(
        columns,
        slots,
        count,
        aligned.rotation,
        aligned.shift,
        missing,
        extra,
        neutral,
        _known_share(face, neutral.offset, aligned, slots),
        errors,
        aligned.moved_mm,
        aligned.pair_offset,
        template,
        aligned.scale,
    )


def _correct_poses(
    face: PerformerFace, positions: FloatArray, seen: BoolArray, aligned: _Alignment
) -> tuple[_Alignment, PoseErrors | None]:
    """Remove the mean error of a take's poses from its alignment; return the errors that are left.

    Where the rig's motion of the markers is not known, that of the performer's frames tells the
    mean. None, and the alignment as it is, if the mean is left to the rigid part of the offset.
    """
    rigid = np.isin(face.marker_names, face.rigid)
    motion = face.expressions or observed_motion(
        np.where(face.usable[..., None], face.frames, face.neutral), face.neutral, rigid=rigid
    )
    rotation, shift = aligned.rotation, aligned.shift
    errors = motion.find_errors(positions @ rotation.T + shift, seen)
    size_mm = errors.size_mm if face.expressions is not None else 0.0
    if not size_mm and errors.mean_mm < _MOVED_MM:
        return aligned, None
    turn, step = errors.mean_transform
    rotation, shift = turn @ rotation, turn @ shift + step
    left = motion.find_errors(positions @ rotation.T + shift, seen)
    if not size_mm and left.evidence <= errors.evidence:
        return aligned, None
    moved_mm = errors.mean_mm if errors.mean_mm >= _MOVED_MM else 0.0
    corrected = aligned._replace(
        rotation=rotation, shift=shift, moved_mm=max(aligned.moved_mm, moved_mm)
    )
    return corrected, replace(left, size_mm=left.size_mm * (size_mm > 0))


def _align_pairs(
    face: PerformerFace, take: str, numbers: IntArray, positions: Float32Array, visible: BoolArray
) -> _Alignment | None:
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
    aligned = _Alignment(rotation, shift, offset, pairs=len(rows))
    return aligned if scatter_mm < MIN_OFFSET_MM else None


def _known_share(
    face: PerformerFace, offset: FloatArray, aligned: _Alignment, shown: IntArray
) -> FloatArray:
    """Return `HeadSpace.known_share` of the offsets of markers `shown`."""
    on_skin = shown[~np.isin(np.array(face.marker_names)[shown], face.rigid)]
    by_pairs = _PAIR_OFFSET_ERROR_SHARE / max(aligned.pairs, 1) ** 0.5
    error = np.hypot(_OFFSET_ERROR_SHARE * offset, by_pairs * aligned.pair_offset)
    error2 = (error[on_skin] ** 2).sum() / max(len(on_skin), 1)
    motion2 = ((face.frames - face.neutral) ** 2).sum(axis=2).mean(axis=0)
    return np.asarray(np.clip(1 - error2 / np.maximum(motion2, 1e-9), 0.0, 1.0))


def _common_markers(face: PerformerFace, markers: Markers) -> tuple[IntArray, IntArray]:
    """Return the indices of the common markers in the face, and in the take."""
    if markers.space != "stabilized":
        raise InputError("the take still holds head motion; run the clean step on it first")
    index = {name: i for i, name in enumerate(markers.names)}
    common = [name for name in face.marker_names if name in index]
    known = len(face.marker_names)
    if len(common) < MINIMUM_SHARE * known:
        missing = [name for name in face.marker_names if name not in index]
        raise InputError(
            f"the take has {len(common)} of the mapping's {known} markers, at least "
            f"{int(np.ceil(MINIMUM_SHARE * known))} are needed; missing: "
            f"{first_few(missing)}. "
            "Rename the take's markers, or train a mapping for this marker set; where one "
            "performance was captured with both sets and one video, the solve of one set keys "
            "references of the other (`usdface references import --at video`)"
        )
    slots = np.array([i for i, name in enumerate(face.marker_names) if name in index])
    return slots, np.array([index[face.marker_names[i]] for i in slots])


def _in_order(
    markers: Markers, columns: IntArray, slots: IntArray, count: int
) -> tuple[Float32Array, BoolArray]:
    """Return positions and visibility in the mapping's order: (frames, markers[, 3])."""
    frames = len(markers.positions)
    positions = np.zeros((frames, count, 3), dtype=np.float32)
    visible = np.zeros((frames, count), dtype=bool)
    positions[:, slots] = markers.positions[:, columns]
    visible[:, slots] = markers.usable[:, columns]
    finite = np.isfinite(positions).all(axis=2)
    visible &= finite
    positions[~finite] = 0.0
    return positions, visible


def _align_medians(face: PerformerFace, positions: Float32Array, visible: BoolArray) -> _Alignment:
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
    if np.median(away[used]) <= RIGID_TOLERANCE_MM:
        scale = _explaining_scale(median[used], target[used], away[used])
        return _Alignment(rotation, shift, scale=scale)
    by_face = _robust_transform(median, target)
    face_away = np.linalg.norm(median @ by_face[0].T + by_face[1] - target, axis=1)
    if np.median(face_away) > RIGID_TOLERANCE_MM:
        check_not_mirrored(median, target)
        _refuse(names[used].tolist(), median[used], target[used], away[used])
    return _Alignment(*by_face, moved_mm=float(np.sqrt((face_away[rigid] ** 2).mean())))


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


def pose_error_note(subject: str, size_mm: float) -> str:
    """Return a note on removed errors, of a take or of references."""
    return (
        f"the head still moves in {subject}: by {size_mm:.1f} mm (root mean square), as if the "
        "rigid markers had slipped or sat on skin. The face shows it, so it is removed; look at "
        "the choice of rigid markers (`usdface clean --rigid`)"
    )
