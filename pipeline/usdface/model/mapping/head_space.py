"""Another take of the same marker set, brought to a mapping's markers and head space."""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import BoolArray, Float32Array, FloatArray, IntArray
from usdface.core.assets import Markers, TrainedMapping
from usdface.core.errors import InputError
from usdface.core.text import first_few
from usdface.numerics.rigid.rigid_alignment import optimal_rotations

MINIMUM_SHARE = 0.5
"""Of the mapping's markers, how many a take must have: with fewer, most of the face is a guess."""

MINIMUM_RIGID = 3
RIGID_TOLERANCE_MM = 5.0

ON_A_LINE = 0.02
"""Breadth of the rigid markers, as a share of their length, below which they are as good as a
line: about it noise turns the head."""


@dataclass(frozen=True)
class MappedMarkers:
    """A take's markers as a mapping reads them.

    Attributes
    ----------
    positions : (frames, markers, 3) float32 array
        In the mapping's marker order and head space [mm]; 0 where the take lacks the marker.
    visible : (frames, markers) bool array
        Where a position may be used: measured or repaired.
    missing : tuple of str
        Markers of the mapping that the take lacks.
    extra : tuple of str
        Markers of the take that the mapping does not know; ignored.
    moved_mm : float
        How far the take's head space was from the mapping's: root mean square over markers [mm].
    """

    positions: Float32Array
    visible: BoolArray
    missing: tuple[str, ...]
    extra: tuple[str, ...]
    moved_mm: float


@dataclass(frozen=True)
class HeadSpace:
    """How a take's markers become a mapping's: found once, used for every chunk of the take.

    Attributes
    ----------
    columns : (n,) int array
        Columns of the take that the mapping reads.
    slots : (n,) int array
        Where they go in the mapping's order.
    count : int
        Number of the mapping's markers.
    rotation : (3, 3) float array
    shift : (3,) float array
        [mm]
    missing, extra : tuple of str
        Markers that only the mapping, or only the take, has.
    moved_mm : float
        How far the take's head space was from the mapping's: root mean square over markers [mm].
    """

    columns: IntArray
    slots: IntArray
    count: int
    rotation: FloatArray
    shift: FloatArray
    missing: tuple[str, ...]
    extra: tuple[str, ...]
    moved_mm: float

    def place(self, markers: Markers) -> MappedMarkers:
        """Bring frames of the take into the mapping's order and head space."""
        positions, visible = _in_order(markers, self.columns, self.slots, self.count)
        flat = positions.reshape(-1, 3) @ self.rotation.T.astype(np.float32)
        flat += self.shift.astype(np.float32)
        positions = flat.reshape(positions.shape)
        if not visible.all():
            positions[~visible] = 0.0
        return MappedMarkers(positions, visible, self.missing, self.extra, self.moved_mm)


def find_head_space(mapping: TrainedMapping, markers: Markers) -> HeadSpace:
    """Match markers by name and find the rigid movement onto the mapping's neutral head.

    One rigid movement for the whole take: the median position of each rigid marker goes to where
    that marker stood when the mapping was trained.

    Parameters
    ----------
    markers : Markers
        Stabilised; frames spread over the take are enough.

    Raises
    ------
    InputError
        If the take is not stabilised, shares too few markers with the mapping, or its rigid
        markers are too few, on a line, or too far from where the mapping had them.
    """
    if markers.space != "stabilized":
        raise InputError("the take still holds head motion; run the clean step on it first")
    place = {name: i for i, name in enumerate(markers.names)}
    common = [name for name in mapping.marker_names if name in place]
    missing = tuple(name for name in mapping.marker_names if name not in place)
    known = set(mapping.marker_names)
    if len(common) < MINIMUM_SHARE * len(mapping.marker_names):
        raise InputError(
            f"the take has {len(common)} of the mapping's {len(known)} markers, at least "
            f"{int(np.ceil(MINIMUM_SHARE * len(known)))} are needed; missing: "
            f"{first_few(missing)}. "
            "Rename the take's markers, or train a mapping for this marker set"
        )
    slots = np.array([i for i, name in enumerate(mapping.marker_names) if name in place])
    columns = np.array([place[mapping.marker_names[i]] for i in slots])
    count = len(mapping.marker_names)
    positions, visible = _in_order(markers, columns, slots, count)
    rotation, shift, moved = _rigid_movement(mapping, positions, visible)
    extra = tuple(name for name in markers.names if name not in known)
    return HeadSpace(columns, slots, count, rotation, shift, missing, extra, moved)


def into_head_space(mapping: TrainedMapping, markers: Markers) -> MappedMarkers:
    """Bring a whole take into a mapping's order and head space; see `find_head_space`."""
    return find_head_space(mapping, markers).place(markers)


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
    mapping: TrainedMapping, positions: Float32Array, visible: BoolArray
) -> tuple[FloatArray, FloatArray, float]:
    """Rotation and shift that put the take's rigid markers where the mapping had them."""
    # The mean over whole takes, not the neutral frame: one frame is noisy, the mean is not.
    rest = mapping.arrays["motion_mean"].reshape(-1, 3)
    names = [
        name
        for name in mapping.rigid
        if name in mapping.marker_names and visible[:, mapping.marker_names.index(name)].any()
    ]
    if len(names) < MINIMUM_RIGID:
        raise InputError(
            f"the take has {len(names)} of the mapping's {len(mapping.rigid)} rigid markers, at "
            f"least {MINIMUM_RIGID} are needed to find its head space; name them in the take"
        )
    slots = [mapping.marker_names.index(name) for name in names]
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
    trust = np.ones(len(slots))
    for _ in range(10):  # a rigid marker that slipped must not turn the head
        centre = np.average(middle, axis=0, weights=trust)
        goal = np.average(target, axis=0, weights=trust)
        carried = (trust[:, None] * (target - goal)).T @ (middle - centre)
        turned, _ = optimal_rotations(carried[None], rank_tolerance=1e-12)
        rotation: FloatArray = turned[0]
        away = np.linalg.norm((middle - centre) @ rotation.T - (target - goal), axis=1)
        trust = 1 / (1 + (away / 1.0) ** 2) ** 2
    if np.median(away) > RIGID_TOLERANCE_MM:
        raise InputError(
            f"the take's rigid markers are {np.median(away):.1f} mm from where the mapping had "
            f"them ({names[int(away.argmax())]}: {away.max():.1f} mm); it is another marker set "
            "or another performer: train a mapping for it"
        )
    shift = goal - rotation @ centre
    moved = rest @ rotation.T + shift - rest
    return rotation, shift, float(np.sqrt((moved**2).sum(axis=1).mean()))
