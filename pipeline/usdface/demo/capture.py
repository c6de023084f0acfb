"""A simulated optical capture of the actor's face.

The actor differs from the character: other proportions, stronger or weaker and slightly mixed
shapes, and skin that stretches less the further it is pulled. The truth (the weights that an
animator keys on the character) is therefore not a linear function of the markers.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from usdface.core.arrays import (
    BoolArray,
    Float32Array,
    FloatArray,
    IntArray,
    columns_by_name,
    row_lengths,
    smoothstep,
)
from usdface.demo.acting import ActedPerformance
from usdface.demo.half_cage import Mark
from usdface.demo.head import DemoHead, HeadPart
from usdface.numerics.rigid.rigid_alignment import pose_matrices

MARKER_RADIUS = 1.5
"""Distance of a marker's centre from the skin [mm]."""


@dataclass(frozen=True)
class MarkerSet:
    """Markers attached to a head."""

    names: tuple[str, ...]
    points: IntArray
    """(markers,): the head's point under each marker."""
    rigid: tuple[str, ...]
    """Names of the markers that move with the skull only."""


def demo_markers(head: DemoHead) -> MarkerSet:
    """Return 102 markers, 10 of them rigid, symmetric in left and right."""
    skin = _Picker(head)
    eye, nose, mouth, skull = (getattr(head.style, k) for k in ("eye", "nose", "mouth", "skull"))
    ex, ey = eye.center[:2]
    by = ey + skull.brow_height
    w, my = mouth.half_width, mouth.height
    wide = skull.face_radii[0]

    middle = {
        "head_1": (0.0, by + 34.0),
        "head_2": (0.0, nose.root[0] - 2.0),
        "forehead_mid": (0.0, by + 18.0),
        "glabella": (0.0, by - 2.0),
        "nose_bridge": (0.0, 0.5 * (nose.root[0] + nose.tip[0])),
        "nose_tip": (0.0, nose.tip[0] + 2.0),
        "chin_crease": (0.0, my - mouth.lower - 7.0),
        "chin": (0.0, skull.chin[1] + 2.0),
    }
    sides = {
        "head_3": (20.0, by + 34.0),
        "head_5": (0.72 * wide, by + 30.0),
        "forehead_1": (13.0, by + 17.0),
        "forehead_2": (31.0, by + 15.0),
        "brow_1": (9.0, by - 1.0),
        "brow_2": (ex - 11.0, by + 4.0),
        "brow_3": (ex, by + 6.5),
        "brow_4": (ex + 11.0, by + 5.0),
        "brow_5": (ex + 20.0, by - 1.0),
        "temple": (0.92 * wide, ey + 4.0),
        "under_eye_1": (ex - 12.0, ey - 20.0),
        "under_eye_2": (ex + 2.0, ey - 22.0),
        "under_eye_3": (ex + 16.0, ey - 18.0),
        "nose_side_1": (8.0, 0.45 * (nose.root[0] + nose.tip[0])),
        "nose_side_2": (10.5, nose.wing[1] + 10.0),
        "nose_wing": (nose.wing[0] + 4.0, nose.wing[1]),
        "fold_1": (nose.wing[0] + 12.0, nose.wing[1] - 1.0),
        "fold_2": (w + 7.0, my + 15.0),
        "fold_3": (w + 11.0, my + 4.0),
        "fold_4": (w + 9.0, my - 9.0),
        "cheek_1": (ex - 2.0, ey - 32.0),
        "cheek_2": (ex + 13.0, ey - 32.0),
        "cheek_3": (0.86 * wide, ey - 26.0),
        "cheek_4": (ex + 4.0, ey - 45.0),
        "cheek_5": (0.82 * wide, ey - 45.0),
        "lip_above": (0.45 * w, my + mouth.upper + 5.0),
        "lip_below": (0.55 * w, my - mouth.lower - 5.0),
        "jaw_1": (14.0, skull.chin[1] + 5.0),
        "jaw_2": (22.0, my - 20.0),
        "jaw_3": (31.0, my - 13.0),
        "jaw_4": (0.74 * wide, my - 4.0),
    }
    lids = {
        "lid_upper_1": (1, -0.5),
        "lid_upper_2": (1, 0.05),
        "lid_upper_3": (1, 0.6),
        "lid_lower_1": (-1, -0.45),
        "lid_lower_2": (-1, 0.05),
        "lid_lower_3": (-1, 0.6),
    }
    chosen = {name: skin.on_front(x, y) for name, (x, y) in middle.items()}
    chosen["lip_upper_mid"], chosen["lip_lower_mid"] = skin.on_lip(0.0, 1), skin.on_lip(0.0, -1)
    pairs = {name: skin.on_front(x, y) for name, (x, y) in sides.items()}
    pairs |= {name: skin.on_lid(side, across) for name, (side, across) in lids.items()}
    pairs["mouth_corner"] = skin.on_front(w + 3.0, my + mouth.curve)
    for number, across in enumerate((0.28, 0.62, 0.9), start=1):
        pairs[f"lip_upper_{number}"] = skin.on_lip(across, 1)
        pairs[f"lip_lower_{number}"] = skin.on_lip(across, -1)
    pairs["head_7"], pairs["head_9"] = skin.on_ear(1.0), skin.on_ear(-1.0)
    for name, point in pairs.items():
        left, right = _pair_names(name)
        chosen[left], chosen[right] = point, int(head.mirror[point])
    names = tuple(sorted(chosen, key=_natural))
    return MarkerSet(
        names=names,
        points=np.array([chosen[name] for name in names], np.int64),
        rigid=tuple(name for name in names if name.startswith("head_")),
    )


def _pair_names(name: str) -> tuple[str, str]:
    """Return the names of a left and right pair: numbered if rigid, else with the side."""
    if name.startswith("head_"):
        number = int(name.removeprefix("head_"))
        return f"head_{number}", f"head_{number + 1}"
    base, _, number_text = name.rpartition("_")
    if number_text.isdigit():
        return f"{base}_L{number_text}", f"{base}_R{number_text}"
    return f"{name}_L", f"{name}_R"


def _natural(name: str) -> tuple[str, int]:
    digits = "".join(c for c in name if c.isdigit())
    return name.rstrip("0123456789"), int(digits or 0)


class _Picker:
    """Finds points of the skin by position."""

    def __init__(self, head: DemoHead) -> None:
        self._head = head
        ring = head.marks[:, Mark.MOUTH_RING]
        outside = (ring > 1.5) & (head.marks[:, Mark.EYE_RING] > 1.5)
        dry = head.marks[:, Mark.NOSTRIL] < 0.05
        self._open = (head.parts == HeadPart.SKIN) & outside & dry & (head.points[:, 0] >= 0.0)
        self._taken: set[int] = set()

    def _nearest(self, cost: FloatArray, allowed: BoolArray) -> int:
        cost = np.where(allowed, cost, np.inf)
        cost[list(self._taken)] = np.inf
        best = int(np.argmin(cost))
        self._taken.add(best)
        return best

    def on_front(self, x: float, y: float) -> int:
        """Return the front point nearest to x, y; on the midline if x is 0."""
        p = self._head.points
        allowed = self._open & (p[:, 2] > 12.0)
        if x == 0.0:
            allowed &= p[:, 0] == 0.0
        # Prefers points in front, such as the nose over the lip.
        distance = np.hypot(p[:, 0] - x, p[:, 1] - y)
        return self._nearest(distance - 0.02 * p[:, 2], allowed)

    def on_lip(self, across: float, side: int) -> int:
        """Return a point on the border of a lip."""
        p, marks = self._head.points, self._head.marks
        ring = np.abs(marks[:, Mark.MOUTH_RING] - 2.0) < 0.3
        allowed = (
            (self._head.parts == HeadPart.SKIN) & ring & (side * marks[:, Mark.MOUTH_SIDE] > 0.05)
        )
        allowed &= (p[:, 0] == 0.0) if across == 0.0 else (p[:, 0] > 0.0)
        return self._nearest(np.abs(p[:, 0] - across * self._head.style.mouth.half_width), allowed)

    def on_lid(self, side: int, across: float) -> int:
        """Return a point on the outer skin of a lid, near its edge."""
        p, marks, eye = self._head.points, self._head.marks, self._head.style.eye
        ring = (marks[:, Mark.EYE_RING] > 0.35) & (marks[:, Mark.EYE_RING] < 0.9)
        allowed = ring & (side * marks[:, Mark.EYE_SIDE] > 0.3) & (p[:, 0] > 0.0)
        return self._nearest(np.abs(p[:, 0] - eye.center[0] - across * eye.half_width), allowed)

    def on_ear(self, height: float) -> int:
        """Return the outermost point of the left ear's upper or lower end."""
        p = self._head.points
        allowed = (self._head.parts == HeadPart.EARS) & (p[:, 0] > 0.0)
        middle = float(np.mean(p[allowed, 1]))
        wanted = middle + height * 17.0
        return self._nearest(np.abs(p[:, 1] - wanted) - 0.5 * p[:, 0], allowed)


NOISE_MM = 0.15
"""Standard deviation of a measured position, per axis."""

SWAPPED_LABELS = ((610, 668, "lip_upper_L2", "lip_upper_L3"), (1290, 1333, "brow_R3", "brow_R4"))
"""First and last frame index of each interval of two swapped labels, and the labels."""

_STANDING = (60.0, 1520.0, 140.0)  # position of the actor's head in the room [mm]
_NECK = (0.0, -105.0, -25.0)  # centre of the head's rotation [mm]
_SKIN_LIMIT = 70.0  # a displacement d [mm] becomes L tanh(d / L)


class ActorFace:
    """The actor's face at some of its points, with the actor's deviations from the shapes."""

    def __init__(self, head: DemoHead, which: IntArray) -> None:
        rng = np.random.default_rng(2006)
        names = list(head.shapes)
        self._rest = head.points[which]
        self._keys = [tuple((w, offsets[which]) for w, offsets in head.shapes[n]) for n in names]
        self._gain = rng.uniform(0.86, 1.14, len(names))
        self._bend = rng.uniform(-0.16, 0.16, len(names))
        # Each shape activates three others slightly.
        mixed = np.eye(len(names))
        for row, name in enumerate(names):
            free = [k for k, other in enumerate(names) if _may_follow(name, other)]
            for k in rng.choice(free, 3, replace=False) if len(free) >= 3 else ():
                mixed[row, k] += rng.uniform(0.02, 0.05)
        self._mixed = mixed

    def pose(self, weights: FloatArray) -> FloatArray:
        """Return points without head motion [mm], for weights in the order of the shapes."""
        bent = weights * (1.0 + self._bend * (1.0 - weights))
        gain = self._gain + (1.0 - self._gain) * smoothstep(weights, 0.6, 1.0)  # 1 at weight 1
        mixed = np.clip((bent * gain) @ self._mixed, 0.0, 1.0)
        moved = np.zeros_like(self._rest)
        for weight, keys in zip(mixed, self._keys, strict=True):
            if weight > 1e-4:
                moved += _between(keys, float(weight))
        length = row_lengths(moved) / _SKIN_LIMIT
        moved *= np.where(length > 1e-6, np.tanh(length) / np.maximum(length, 1e-6), 1.0)
        return self._rest + moved


def _may_follow(name: str, other: str) -> bool:
    """Return whether a shape may activate another: within the mouth region, or within the brows."""
    regions = (("mouth", "cheek", "nose"), ("brow",))
    return name != other and any(
        name.startswith(region) and other.startswith(region) for region in regions
    )


def _between(keys: tuple[tuple[float, FloatArray], ...], weight: float) -> FloatArray:
    """Return the offsets of a shape at a weight, linear between keys."""
    at = min(sum(weight > key for key, _ in keys), len(keys) - 1)
    high, stop = keys[at]
    if at == 0:
        return stop * (weight / high)
    low, start = keys[at - 1]
    return start + (stop - start) * ((weight - low) / (high - low))


def simulate_capture(
    head: DemoHead, acted: ActedPerformance, markers: MarkerSet
) -> tuple[Float32Array, BoolArray]:
    """Simulate the capture of a performance with noise, gaps and swapped labels.

    Returns positions with head motion, Y up, arbitrary if occluded, (frames, markers, 3) [mm]; and
    which are visible, (frames, markers).
    """
    rng = np.random.default_rng(102)
    face = ActorFace(head, markers.points)
    weights = columns_by_name(acted.weights.values, acted.weights.names, tuple(head.shapes))
    lifted = MARKER_RADIUS * _normals(head)[markers.points]
    still = np.stack([face.pose(row) for row in weights]) + lifted
    poses = head_poses(acted)
    world = np.einsum("fij,fmj->fmi", poses[:, :3, :3], still) + poses[:, None, :3, 3]
    world += rng.normal(0.0, NOISE_MM, world.shape)
    keep_clear = acted.neutral_frame - acted.weights.first_frame
    visible = _dropouts(rng, world.shape[0], markers, keep_clear=keep_clear)
    for first, last, one, other in SWAPPED_LABELS:
        a, b = markers.names.index(one), markers.names.index(other)
        world[first : last + 1, [a, b]] = world[first : last + 1, [b, a]]
    return world.astype(np.float32), visible


def head_poses(acted: ActedPerformance) -> FloatArray:
    """Return the poses of the actor's head in the room, (frames, 4, 4) [mm]."""
    turn = Rotation.from_euler("YXZ", acted.rotation[:, [1, 0, 2]], degrees=True).as_matrix()
    neck = np.array(_NECK)
    return pose_matrices(turn, neck - turn @ neck + acted.translation + _STANDING)


def _normals(head: DemoHead) -> FloatArray:
    corners = head.points[head.faces]
    face = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    normals = np.zeros_like(head.points)
    for corner in range(4):
        np.add.at(normals, head.faces[:, corner], face)
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9))


def _dropouts(
    rng: np.random.Generator, frame_count: int, markers: MarkerSet, *, keep_clear: int
) -> BoolArray:
    """Return visibility with gaps: single frames, short ones, and a few of up to half a second."""
    visible = np.ones((frame_count, len(markers.names)), bool)
    visible[rng.random(visible.shape) < 0.0015] = False
    for length, gaps in ((8, 40), (20, 16), (60, 6)):
        for _ in range(gaps):
            start = int(rng.integers(0, frame_count - length))
            lost = int(rng.integers(len(markers.names)))
            visible[start : start + int(rng.integers(length // 2, length + 1)), lost] = False
    # Lids are occluded more often, and once the whole upper lip.
    for prefix, start, stop in (("lid_upper_L", 940, 962), ("lip_upper_", 1180, 1192)):
        hidden = [k for k, name in enumerate(markers.names) if name.startswith(prefix)]
        visible[start:stop, hidden] = False
    visible[max(0, keep_clear - 6) : keep_clear + 7] = True
    return visible
