"""Orientation of a rig's head, from the directions of its shapes: brows rise, lids and jaws fall.

These directions hold for any face, an animal's as well, while proportions and size do not.
"""

from collections.abc import Mapping

import numpy as np

from usdface.core.arrays import FloatArray
from usdface.core.assets import Rig, range_ends
from usdface.core.errors import InputError
from usdface.model.retarget.shape_names import read_meanings

LYING_RIG_DEGREES = 60.0
"""Angle between the head's up direction and Y above which the rig is refused: a wrong up axis turns
it by 90 or 180; on the heads measured the angle is below 10."""

_TURNED_DEGREES = 20.0
"""Angle from +Z above which a face counts as turned: a view along Z shows too little of it."""

_UPWARDS = {
    "browinnerup": 1,
    "browouterup": 1,
    "browdown": -1,
    "eyewide": 1,
    "eyeblink": -1,
    "nosesneer": 1,
    "mouthsmile": 1,
    "mouthfrown": -1,
    "mouthupperup": 1,
    "mouthlowerdown": -1,
    "jawopen": -1,
}
_FORWARDS = {
    "mouthpucker": 1,
    "mouthfunnel": 1,
    "jawforward": 1,
    "jawopen": -1,
    "mouthsmile": -1,
    "mouthstretch": -1,
    "mouthdimple": -1,
}
"""Sign of the mean displacement, of motions that go the same way on every face."""

_COVERED_SHARE = 0.01
"""Median distance from a mesh to the points that shapes move, over the extent of their mesh, up to
which it covers the face: 3 to 5 mm."""

_FEWEST_MOTIONS = 3
_LEAST_AGREEMENT = 0.75
"""Least length of the mean of unit vectors [0-1]: seven random ones in a plane reach it with a
probability of 1/80; faces reach 0.9."""


def check_rig_upright(rig: Rig) -> tuple[str, ...]:
    """Refuse a rig that is not upright; return a note if its left and right seem exchanged.

    Rigs with foreign shape names are not checked.
    """
    moved, centres = _motions(rig)
    across = _across(centres)
    up = _mean_direction(moved, _UPWARDS, across)
    if up is None:
        return ()
    degrees = float(np.degrees(np.arccos(np.clip(up[1], -1.0, 1.0))))
    if degrees > LYING_RIG_DEGREES:
        at = int(np.abs(up).argmax())
        axis = ("-" if up[at] < 0 else "") + "XYZ"[at]
        raise InputError(
            f"{rig.file} <{rig.prim}>: the head lies: by what its shapes do (brows rise, lids and "
            f"jaw fall) its up is {degrees:.0f} degrees from the stage's, near {axis} (where Y is "
            "up); correct upAxis in the rig's file, or turn its root upright"
        )
    if across is None:
        return ()
    forward = _mean_direction(moved, _FORWARDS, across)
    if forward is None or forward @ np.cross(across, up) > -_LEAST_AGREEMENT:
        return ()
    return (
        "shapes named left move the right side of the rig, as seen from itself: left and right of "
        "the capture will be exchanged unless its names are the viewer's; rename the rig's shapes",
    )


def covered_face_notes(rig: Rig) -> tuple[str, ...]:
    """Return notes on visible meshes without shapes that lie on the skin, such as a render mesh."""
    from scipy.spatial import KDTree  # only when wanted: it takes half a second

    still = [mesh for mesh in rig.meshes if mesh.visible and not mesh.shapes and len(mesh.points)]
    skin = max(rig.skin_meshes, key=lambda mesh: len(mesh.shapes))
    if not still or not skin.shapes:
        return ()
    reach = _COVERED_SHARE * float(np.linalg.norm(np.ptp(skin.points, axis=0)))
    moved = skin.points[np.unique(np.concatenate([s.keys[-1].points for s in skin.shapes]))]
    return tuple(
        f"{mesh.path} has no shapes and lies on {skin.path}: pictures may show it, at rest, "
        "instead of the face; hide it in the rig's file, or give it the shapes"
        for mesh in still
        if np.median(KDTree(mesh.points).query(moved)[0]) < reach
    )


def describe_orientation(rig: Rig) -> tuple[str, ...]:
    """Return what `check_rig_upright` refuses or notes, for steps that need no direction."""
    try:
        return check_rig_upright(rig)
    except InputError as error:
        return (str(error),)


def face_axes(rig: Rig) -> FloatArray:
    """Return a rig's left, up and forward axes: columns of a rotation, (3, 3).

    Up is Y; left and forward are level, from the centres of left and right shapes. X and Z if
    names do not tell sides.
    """
    moved, centres = _motions(rig)
    left = _across(centres)
    if left is None or np.hypot(left[0], left[2]) < _LEAST_AGREEMENT:
        return np.eye(3)
    forward = _mean_direction(moved, _FORWARDS, left)
    if forward is not None and forward @ np.cross(left, (0, 1, 0)) < 0:
        left = -left  # its names are the viewer's
    left = np.array([left[0], 0.0, left[2]]) / np.hypot(left[0], left[2])
    return np.stack([left, (0.0, 1.0, 0.0), np.cross(left, (0.0, 1.0, 0.0))], axis=1)


def facing_degrees(rig: Rig) -> float:
    """Return the yaw of a rig's face from +Z, -180 to 180 [degrees].

    0 if less than `_TURNED_DEGREES`, as of slightly asymmetric heads, or if names do not tell.
    """
    forward = face_axes(rig)[:, 2]
    degrees = float(np.degrees(np.arctan2(forward[0], forward[2])))
    return degrees if abs(degrees) > _TURNED_DEGREES else 0.0


def face_centre(rig: Rig) -> FloatArray:
    """Return the mean centre of the displacements of a rig's shapes: (3,) [mm]."""
    _, centres = _motions(rig)
    return np.asarray(np.mean(list(centres.values()), axis=0) if centres else np.zeros(3))


def _motions(
    rig: Rig,
) -> tuple[dict[tuple[str, str], FloatArray], dict[tuple[str, str], FloatArray]]:
    """Return sum and centre of each shape's displacements, by motion and side."""
    moved: dict[tuple[str, str], FloatArray] = {}
    weighted: dict[tuple[str, str], FloatArray] = {}
    total: dict[tuple[str, str], float] = {}
    meanings = read_meanings(list({s.name: s for mesh in rig.meshes for s in mesh.shapes}))
    ends = dict(zip(rig.shapes, np.sign(range_ends(rig.ranges)), strict=True))
    for mesh in rig.skin_meshes:
        for shape in mesh.shapes:
            meant = meanings[shape.name]
            full = next(key for key in shape.keys if key.weight == 1.0)
            key = meant.motion, meant.side
            size = np.linalg.norm(full.offsets, axis=1)
            way = ends.get(shape.name, 1.0)
            moved[key] = moved.get(key, np.zeros(3)) + way * full.offsets.sum(axis=0)
            weighted[key] = weighted.get(key, np.zeros(3)) + size @ mesh.points[full.points]
            total[key] = total.get(key, 0.0) + float(size.sum())
    return moved, {key: weighted[key] / total[key] for key in total if total[key] > 0}


def _across(centres: Mapping[tuple[str, str], FloatArray]) -> FloatArray | None:
    """Return the direction from the right side to the left; None without shapes of both."""
    pairs = [
        centres[motion, "L"] - centres[motion, "R"]
        for motion, side in centres
        if side == "L" and (motion, "R") in centres
    ]
    return _agreed(pairs)


def _mean_direction(
    moved: Mapping[tuple[str, str], FloatArray], signs: Mapping[str, int], across: FloatArray | None
) -> FloatArray | None:
    """Return the mean signed direction of motions in the plane of symmetry, both sides summed."""
    votes: dict[str, FloatArray] = {}
    for (motion, _), displacement in moved.items():
        if motion in signs:
            votes[motion] = votes.get(motion, np.zeros(3)) + signs[motion] * displacement
    if len(votes) < _FEWEST_MOTIONS:
        return None
    flat = votes.values()
    return _agreed([v if across is None else v - across * (v @ across) for v in flat])


def _agreed(vectors: list[FloatArray]) -> FloatArray | None:
    """Return the mean direction of vectors; None without any or below `_LEAST_AGREEMENT`."""
    units = [v / np.linalg.norm(v) for v in vectors if np.linalg.norm(v) > 0]
    if not units:
        return None
    mean = np.mean(units, axis=0)
    length = float(np.linalg.norm(mean))
    return mean / length if length >= _LEAST_AGREEMENT else None
