"""Takes brought to a performer's markers, head space and neutral face."""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import BoolArray, Float32Array, FloatArray, IntArray, sample_frames
from usdface.core.assets import Markers, TrainedMapping
from usdface.core.errors import InputError
from usdface.core.text import first_few
from usdface.model.mapping.performer_face import PerformerFace, face_of_mapping
from usdface.model.mapping.take_neutral import TakeNeutral, compare_neutral
from usdface.model.placement.plausibility import unit_remedy
from usdface.numerics.registration.marker_application import SAMPLE_FRAMES
from usdface.numerics.rigid.rigid_alignment import optimal_rotations

MINIMUM_SHARE = 0.5
"""Of the mapping's markers, how many a take must have: with fewer, most of the face is a guess."""

MINIMUM_RIGID = 3
RIGID_TOLERANCE_MM = 5.0

ON_A_LINE = 0.02
"""Breadth of the rigid markers, as a share of their length, below which they are as good as a
line: about it noise turns the head."""

_EXPLAINED_SHARE = 0.25
"""Of the distance of rigid markers: where one factor on all lengths leaves less, it explains it."""

OTHER_UNIT = 1.4
"""Ratio of sizes beyond that of any two heads: adults' differ by a fifth, and a child's by a third;
units differ by 2.5 or 10."""


@dataclass(frozen=True)
class MappedMarkers:
    """A take's markers as a mapping reads them."""

    positions: Float32Array
    """(frames, markers, 3): in the mapping's marker order and head space [mm]; 0 where the take
    lacks the marker."""
    visible: BoolArray
    """(frames, markers): where a position may be used: measured or repaired."""
    confidence: Float32Array
    """(frames, markers) [0-1]: how far a position tells of the marker's motion: 1 where measured,
    less the deeper in a gap that was filled."""
    missing: tuple[str, ...]
    """Markers of the mapping that the take lacks."""
    extra: tuple[str, ...]
    """Markers of the take that the mapping does not know; ignored."""
    moved_mm: float
    """How far the take's head space was from the mapping's: root mean square over markers [mm]."""


@dataclass(frozen=True)
class HeadSpace:
    """How a take's markers become a mapping's: found once, used for every chunk of the take."""

    columns: IntArray
    """(n,): columns of the take that the mapping reads."""
    slots: IntArray
    """(n,): where they go in the mapping's order."""
    count: int
    """Number of the mapping's markers."""
    rotation: FloatArray
    """(3, 3)"""
    shift: FloatArray
    """(3,) [mm]"""
    missing: tuple[str, ...]
    extra: tuple[str, ...]
    """`missing`, `extra`: Markers that only the mapping, or only the take, has."""
    moved_mm: float
    """How far the take's head space was from the mapping's: root mean square over markers [mm]."""
    neutral: TakeNeutral
    """Of the take, in the mapping's order and head space."""

    def place(self, markers: Markers) -> MappedMarkers:
        """Bring frames of the take into the mapping's order, head space and neutral face."""
        positions, visible = _in_order(markers, self.columns, self.slots, self.count)
        positions = self.move(positions)
        if not visible.all():
            positions[~visible] = 0.0
        confidence = np.zeros(visible.shape, np.float32)
        confidence[:, self.slots] = markers.confidence[:, self.columns]
        return MappedMarkers(
            positions, visible, confidence, self.missing, self.extra, self.moved_mm
        )

    def move(self, positions: Float32Array) -> Float32Array:
        """Bring positions in the mapping's order, (frames, markers, 3) [mm], to its neutral."""
        flat = positions.reshape(-1, 3) @ self.rotation.T.astype(np.float32)
        flat += self.shift.astype(np.float32)
        moved: Float32Array = flat.reshape(positions.shape)
        if self.neutral.offset.any():
            moved -= self.neutral.offset.astype(np.float32)
        return moved

    def restore(self, positions: FloatArray) -> FloatArray:
        """Return positions of the mapping's space, (..., markers, 3) [mm], in the take's."""
        return np.asarray((positions + self.neutral.offset - self.shift) @ self.rotation)


def find_head_space(
    face: PerformerFace,
    markers: Markers,
    *,
    frames: IntArray | None = None,
    rate: float = 60.0,
    performer: str = "",
    session: str = "",
) -> HeadSpace:
    """Match markers by name, and find the rigid movement and the offsets onto a performer's face.

    One rigid movement for the whole take: the median position of each rigid marker goes to where
    the performer's is. What then differs in every frame alike is the take's offset.

    Parameters
    ----------
    markers : Markers
        Stabilised; frames spread over the take are enough.
    frames : (frames,) int array, optional
        Frame numbers of those; by default they begin at 0.
    rate : float
        Frames per second.
    performer, session : str
        As the take says; empty where unknown.

    Raises
    ------
    InputError
        If the take is not stabilised, shares too few markers with the face, its rigid markers are
        too few, on a line, or too far from the performer's, or it is another performer's.
    """
    if markers.space != "stabilized":
        raise InputError("the take still holds head motion; run the clean step on it first")
    place = {name: i for i, name in enumerate(markers.names)}
    common = [name for name in face.marker_names if name in place]
    missing = tuple(name for name in face.marker_names if name not in place)
    known = set(face.marker_names)
    if len(common) < MINIMUM_SHARE * len(face.marker_names):
        raise InputError(
            f"the take has {len(common)} of the mapping's {len(known)} markers, at least "
            f"{int(np.ceil(MINIMUM_SHARE * len(known)))} are needed; missing: "
            f"{first_few(missing)}. "
            "Rename the take's markers, or train a mapping for this marker set; where one "
            "performance was captured with both sets and one video, the solve of one set keys "
            "references of the other (`usdface references import --at video`)"
        )
    slots = np.array([i for i, name in enumerate(face.marker_names) if name in place])
    columns = np.array([place[face.marker_names[i]] for i in slots])
    count = len(face.marker_names)
    positions, visible = _in_order(markers, columns, slots, count)
    rotation, shift = _rigid_movement(face, positions, visible)
    picks = sample_frames(len(positions), SAMPLE_FRAMES)
    numbers = np.arange(len(positions)) if frames is None else frames
    if frames is not None:
        picks = np.union1d(picks, np.flatnonzero(numbers == markers.neutral_frame))
    seen = visible[picks]

    def compare() -> TakeNeutral:
        return compare_neutral(
            face,
            positions[picks].astype(np.float64) @ rotation.T + shift,
            seen,
            frames=numbers[picks],
            stated_frame=markers.neutral_frame,
            rate=rate,
            performer=performer,
            session=session,
        )

    neutral = compare()
    if neutral.offset.any():
        # Rigid markers sit on skin, whose median follows what a take does: equal expressions tell
        # where the head is.
        turn, step = _head_movement(face, neutral.offset, np.asarray(seen.any(axis=0)))
        rotation, shift = turn @ rotation, turn @ shift + step
        neutral = compare()
    rest = face.frames.mean(axis=0)
    moved = float(np.sqrt(((rest @ rotation.T + shift - rest) ** 2).sum(axis=1).mean()))
    extra = tuple(name for name in markers.names if name not in known)
    return HeadSpace(columns, slots, count, rotation, shift, missing, extra, moved, neutral)


def into_head_space(mapping: TrainedMapping, markers: Markers) -> MappedMarkers:
    """Bring a whole take into a mapping's order and head space; see `find_head_space`."""
    return find_head_space(face_of_mapping(mapping), markers).place(markers)


def _in_order(
    markers: Markers, columns: IntArray, slots: IntArray, count: int
) -> tuple[Float32Array, BoolArray]:
    frames = len(markers.positions)
    if len(slots) == count:  # then they are in order: nothing to leave room for
        positions = np.take(markers.positions, columns, axis=1).astype(np.float32, copy=False)
        visible = np.take(markers.visible, columns, axis=1)
        visible |= np.take(markers.confidence, columns, axis=1) > 0
    else:
        positions = np.zeros((frames, count, 3), dtype=np.float32)
        visible = np.zeros((frames, count), dtype=bool)
        positions[:, slots] = markers.positions[:, columns]
        visible[:, slots] = markers.visible[:, columns] | (markers.confidence[:, columns] > 0)
    with np.errstate(over="ignore", invalid="ignore"):
        doubtful = not np.isfinite(positions.sum())  # one sum tells of all
    if doubtful:
        visible &= np.isfinite(positions).all(axis=2)
    return positions, visible


def _rigid_movement(
    face: PerformerFace, positions: Float32Array, visible: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Rotation and shift that put the take's rigid markers where the performer's are."""
    # The median over whole takes, not the neutral frame: one frame is noisy.
    rest = np.median(face.frames, axis=0)
    names = [
        name
        for name in face.rigid
        if name in face.marker_names and visible[:, face.marker_names.index(name)].any()
    ]
    if len(names) < MINIMUM_RIGID:
        raise InputError(
            f"the take has {len(names)} of the mapping's {len(face.rigid)} rigid markers, at "
            f"least {MINIMUM_RIGID} are needed to find its head space; name them in the take"
        )
    slots = [face.marker_names.index(name) for name in names]
    middle = np.array(
        [np.median(positions[visible[:, i], i].astype(np.float64), axis=0) for i in slots]
    )
    target = rest[slots]
    breadth = np.linalg.svd(target - target.mean(axis=0), compute_uv=False)
    if breadth[1] <= ON_A_LINE * breadth[0]:
        raise InputError(
            f"the take's rigid markers, {first_few(names)}, lie on a line, and nothing tells "
            "how the head is turned about it; name another of the mapping's rigid markers in the "
            "take, or train with more"
        )
    rotation, shift = _robust_movement(middle, target)
    away = np.linalg.norm(middle @ rotation.T + shift - target, axis=1)
    if np.median(away) > RIGID_TOLERANCE_MM:
        sizes = [np.linalg.norm(each - each.mean(axis=0)) for each in (middle, target)]
        size = float(sizes[0] / sizes[1])
        if not 1 / OTHER_UNIT < size < OTHER_UNIT:
            raise InputError(
                f"the take's rigid markers are {size:.3g} times as far from each other as in the "
                "takes it is compared with: one of them is in another unit; ingest it again and "
                f"{unit_remedy(size)}"
            )
        what = "it is another marker set or another performer: select and train for it separately"
        turned, moved = _robust_movement(middle / size, target)
        scaled = np.linalg.norm(middle / size @ turned.T + moved - target, axis=1)
        if np.median(scaled) < _EXPLAINED_SHARE * np.median(away):
            what = (
                f"one factor explains it: every distance is {size:.3g} times as large. If "
                f"units or calibration differ, ingest it again with {1 / size:.3g} times its "
                "--scale (default 1); else it is another performer: select and train for it "
                "separately"
            )
        raise InputError(
            f"the take's rigid markers are {np.median(away):.1f} mm from those of the takes it is "
            f"compared with ({names[int(away.argmax())]}: {away.max():.1f} mm); {what}"
        )
    return rotation, shift


def _head_movement(
    face: PerformerFace, offset: FloatArray, seen: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Return the part of an offset that is a movement of the head, by the rigid markers."""
    slots = [i for i, name in enumerate(face.marker_names) if name in face.rigid and seen[i]]
    return _robust_movement((face.neutral + offset)[slots], face.neutral[slots])


def _robust_movement(points: FloatArray, target: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return rotation and shift of points onto others: one that slipped must not turn the head."""
    trust = np.ones(len(points))
    for _ in range(10):
        centre = np.average(points, axis=0, weights=trust)
        goal = np.average(target, axis=0, weights=trust)
        carried = (trust[:, None] * (target - goal)).T @ (points - centre)
        turned, _ = optimal_rotations(carried[None], rank_tolerance=1e-12)
        rotation: FloatArray = turned[0]
        away = np.linalg.norm((points - centre) @ rotation.T - (target - goal), axis=1)
        trust = 1 / (1 + (away / 1.0) ** 2) ** 2
    return rotation, goal - rotation @ centre
