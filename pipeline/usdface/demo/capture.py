"""A simulated capture: the actor's face with markers on it, moving in a room full of cameras.

The actor is not the character: the proportions differ, the shapes are stronger or weaker, mixed a
little, and skin yields less the further it is pulled. So the truth (the performance's weights, what
an animator keys on the character) is not a linear function of the markers.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from usdface.core.arrays import BoolArray, Float32Array, FloatArray, IntArray
from usdface.demo.acting import ActedPerformance
from usdface.demo.details import smooth_step
from usdface.demo.head import DemoHead
from usdface.demo.markers import MARKER_RADIUS, MarkerSet

NOISE_MM = 0.15
"""Standard deviation of a measured position, per axis."""

_STANDING = (60.0, 1520.0, 140.0)  # the actor's head in the room [mm]
_NECK = (0.0, -105.0, -25.0)  # about which the head turns [mm]
_SKIN_LIMIT = 70.0  # a pull of this many mm arrives as tanh(1) of it


@dataclass(frozen=True)
class SimulatedCapture:
    """What the capture system recorded, and what really was."""

    markers: MarkerSet
    positions: Float32Array
    """(frames, markers, 3): as captured: head motion, noise and swapped labels in [mm], Y up. Not
    seen: anything."""
    visible: BoolArray
    """(frames, markers)"""
    head_motion: FloatArray
    """(frames, 4, 4): true pose of the head in the room [mm]."""
    swaps: tuple[tuple[int, int, str, str], ...]
    """First and last frame index of each stretch in which two labels are exchanged."""


class ActorFace:
    """The actor's face as it really moves; keeps its own shapes for some of its points.

    Parameters
    ----------
    head : DemoHead
        Of the actor.
    points : (n,) int array, optional
        Only these points; all by default.
    """

    def __init__(self, head: DemoHead, points: IntArray | None = None) -> None:
        which = np.arange(len(head.points)) if points is None else points
        rng = np.random.default_rng(2006)
        names = list(head.shapes)
        self._rest = head.points[which]
        self._names = names
        self._keys = [tuple((w, offsets[which]) for w, offsets in head.shapes[n]) for n in names]
        self._gain = rng.uniform(0.86, 1.14, len(names))
        self._bend = rng.uniform(-0.16, 0.16, len(names))
        # No muscle moves alone: each carries a little of three others along.
        mixed = np.eye(len(names))
        for row, name in enumerate(names):
            free = [k for k, other in enumerate(names) if _may_follow(name, other)]
            for k in rng.choice(free, 3, replace=False) if len(free) >= 3 else ():
                mixed[row, k] += rng.uniform(0.02, 0.05)
        self._mixed = mixed

    def pose(self, weights: FloatArray) -> FloatArray:
        """Points of the face [mm], head still, for weights in the order of the head's shapes."""
        bent = weights * (1.0 + self._bend * (1.0 - weights))
        gain = self._gain + (1.0 - self._gain) * smooth_step(0.6, 1.0, weights)  # full is full
        felt = np.clip((bent * gain) @ self._mixed, 0.0, 1.0)
        moved = np.zeros_like(self._rest)
        for weight, keys in zip(felt, self._keys, strict=True):
            if weight > 1e-4:
                moved += _between(keys, float(weight))
        length = np.linalg.norm(moved, axis=1, keepdims=True) / _SKIN_LIMIT
        moved *= np.where(length > 1e-6, np.tanh(length) / np.maximum(length, 1e-6), 1.0)
        return self._rest + moved

    def ordered(self, names: tuple[str, ...], values: FloatArray) -> FloatArray:
        """Bring (frames, channels) weights into the order that `pose` takes."""
        full = np.zeros((len(values), len(self._names)))
        for column, name in enumerate(names):
            full[:, self._names.index(name)] = values[:, column]
        return full


def _may_follow(name: str, other: str) -> bool:
    """Flesh near the mouth follows flesh near the mouth, brows follow brows; eyes stay free."""
    regions = (("mouth", "cheek", "nose"), ("brow",))
    return name != other and any(
        name.startswith(region) and other.startswith(region) for region in regions
    )


def _between(keys: tuple[tuple[float, FloatArray], ...], weight: float) -> FloatArray:
    """Offsets of one shape at a weight, from key to key in straight lines."""
    low, start = 0.0, np.zeros_like(keys[0][1])
    for high, stop in keys:
        if weight <= high or high == keys[-1][0]:
            return start + (stop - start) * ((weight - low) / (high - low))
        low, start = high, stop
    return start


def simulate_capture(
    head: DemoHead, acted: ActedPerformance, markers: MarkerSet
) -> SimulatedCapture:
    """Record the actor's performance with noise, gaps and mislabelled stretches.

    Parameters
    ----------
    head : DemoHead
        Of the actor.
    markers : MarkerSet
        On the same head.

    Returns
    -------
    SimulatedCapture
        The same on every call.
    """
    rng = np.random.default_rng(102)
    face = ActorFace(head, markers.points)
    weights = face.ordered(acted.weights.names, acted.weights.values.astype(np.float64))
    lifted = MARKER_RADIUS * _normals(head)[markers.points]
    still = np.stack([face.pose(row) for row in weights]) + lifted
    poses = head_poses(acted)
    world = np.einsum("fij,fmj->fmi", poses[:, :3, :3], still) + poses[:, None, :3, 3]
    world += rng.normal(0.0, NOISE_MM, world.shape)
    keep_clear = acted.neutral_frame - acted.weights.first_frame
    visible = _dropouts(rng, world.shape[0], markers, keep_clear=keep_clear)
    swaps = _swap_labels(world, markers)
    return SimulatedCapture(markers, world.astype(np.float32), visible, poses, swaps)


def head_poses(acted: ActedPerformance) -> FloatArray:
    """Where the actor's head is in the room: (frames, 4, 4), for points in the head's own space."""
    turn = Rotation.from_euler("YXZ", acted.rotation[:, [1, 0, 2]], degrees=True).as_matrix()
    poses = np.tile(np.eye(4), (len(turn), 1, 1))
    poses[:, :3, :3] = turn
    neck = np.array(_NECK)
    poses[:, :3, 3] = neck - turn @ neck + acted.translation + _STANDING
    return poses


def _normals(head: DemoHead) -> FloatArray:
    corners = head.points[head.faces]
    face = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    normals = np.zeros_like(head.points)
    for corner in range(4):
        np.add.at(normals, head.faces[:, corner], face)
    unit: FloatArray = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    return unit


def _dropouts(
    rng: np.random.Generator, frame_count: int, markers: MarkerSet, *, keep_clear: int
) -> BoolArray:
    """Lose markers as capture does: single frames, short gaps, a few of up to half a second."""
    visible = np.ones((frame_count, len(markers.names)), bool)
    visible[rng.random(visible.shape) < 0.0015] = False
    for length, gaps in ((8, 40), (20, 16), (60, 6)):
        for _ in range(gaps):
            start = int(rng.integers(0, frame_count - length))
            lost = int(rng.integers(len(markers.names)))
            visible[start : start + int(rng.integers(length // 2, length + 1)), lost] = False
    # Lids and lips hide from the cameras more than the rest; the whole upper lip once.
    for prefix, start, stop in (("lid_upper_L", 940, 962), ("lip_upper_", 1180, 1192)):
        hidden = [k for k, name in enumerate(markers.names) if name.startswith(prefix)]
        visible[start:stop, hidden] = False
    visible[max(0, keep_clear - 6) : keep_clear + 7] = True
    return visible


def _swap_labels(world: FloatArray, markers: MarkerSet) -> tuple[tuple[int, int, str, str], ...]:
    """Exchange two labels twice, in place."""
    swaps = ((610, 668, "lip_upper_L2", "lip_upper_L3"), (1290, 1333, "brow_R3", "brow_R4"))
    for first, last, one, other in swaps:
        a, b = markers.names.index(one), markers.names.index(other)
        world[first : last + 1, [a, b]] = world[first : last + 1, [b, a]]
    return swaps
