"""Alignment of a take with a performer's marker order, head space and neutral face."""

from dataclasses import dataclass, replace

import numpy as np

from usdface.core.arrays import (
    BoolArray,
    Float32Array,
    FloatArray,
    IntArray,
    sample_frames,
)
from usdface.core.assets import Markers
from usdface.core.errors import InputError
from usdface.core.text import first_few
from usdface.model.mapping.performer_face import PerformerFace
from usdface.model.mapping.take_alignment import TakeAlignment, align_to_medians, align_to_pairs
from usdface.model.mapping.take_neutral import (
    TakeNeutral,
    compare_neutral,
)
from usdface.numerics.registration.marker_application import SAMPLE_FRAMES
from usdface.numerics.rigid.pose_error import PoseErrors, observed_motion
from usdface.numerics.rigid.rigid_template import RigidTemplate

MINIMUM_SHARE = 0.5
"""Share of the mapping's markers that a take must have: with fewer, most of the face is unobserved.
"""

_MOVED_MM = 2.0
"""Mean error of the poses from which the rigid markers, as of a head band, were put on again: head
spaces of one application agree to a millimetre."""

_OFFSET_ERROR_SHARE = 0.25
"""Error of an offset, relative to that of the markers on skin: reapplied ones have 0.33 to 0.39
(`poe bench real_sessions`), of which a part is common to all and changes no weights."""

_PAIR_OFFSET_ERROR_SHARE = 0.36
"""The same of an offset that one reference pair of the take tells; of n pairs, over sqrt(n)
(decision 62)."""


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
    by_pairs = align_to_pairs(face, take, numbers, positions, visible)
    aligned = by_pairs or align_to_medians(face, positions, visible)
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
    face: PerformerFace, positions: FloatArray, seen: BoolArray, aligned: TakeAlignment
) -> tuple[TakeAlignment, PoseErrors | None]:
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


def _known_share(
    face: PerformerFace, offset: FloatArray, aligned: TakeAlignment, shown: IntArray
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


def pose_error_note(subject: str, size_mm: float) -> str:
    """Return a note on removed errors, of a take or of references."""
    return (
        f"the head still moves in {subject}: by {size_mm:.1f} mm (root mean square), as if the "
        "rigid markers had slipped or sat on skin. The face shows it, so it is removed; look at "
        "the choice of rigid markers (`usdface clean --rigid`)"
    )
