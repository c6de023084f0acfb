"""Rotations of a performer's head and eyes, and their transfer to a rig.

Angles are about the axes of a face, x to its left, y up, z forward, right-handed::

    R = Ry(yaw) Rx(pitch) Rz(roll)

A positive yaw turns to the left, a positive pitch down, and a positive roll lowers the right side.
Recorders use other signs for some angles. A mirrored or rotated system of axes changes the signs of
two angles or of none, so that two signs determine the third. They are estimated from the take's
weights of looks, if it has any.
"""

import re
from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from usdface.core.arrays import FloatArray
from usdface.core.assets import Rig, TrainedMapping
from usdface.core.deformer import Deformer
from usdface.model.retarget.shape_names import read_meanings
from usdface.numerics.registration.cloud_alignment import fit_similarity
from usdface.numerics.rigid.rigid_alignment import pose_matrices

HEAD = "head"
EYES = ("left_eye", "right_eye")

FULL_LOOK_RADIANS = float(np.radians(30.0))
"""Angle of a look at weight 1, as in `usdface.capture.face_gaze`."""

_CHANNEL = re.compile(
    r"(?P<part>head|left_?eye|right_?eye)_?(?P<axis>yaw|pitch|roll|rotation_?[xyz])", re.IGNORECASE
)
_AXES = {"pitch": 0, "yaw": 1, "roll": 2, "x": 0, "y": 1, "z": 2}

_RECORDED_SIGNS = np.array([1.0, -1.0, -1.0])
"""Signs of pitch, yaw and roll of Live Link Face, the default. In two recordings the correlation of
the eyes' pitch with the weights of looks is above 0.99, that of their yaw below -0.98."""

_TELLING_RADIANS = 0.02
"""Standard deviation of a look above which it determines the sign of an angle."""

_DEGREES_RATIO = 5.0
"""Ratio of the standard deviations of an eye's angles and looks above which the angles are in
degrees. In two recordings of Live Link Face it is 0.85 to 1.6 in radians, 49 to 92 in degrees."""

_FEWEST_SHAPES = 3
"""Minimum number of shapes for a similarity."""

_WAYS = {"down": (0, 1), "up": (0, -1), "out": (1, 1), "in": (1, -1)}
"""Axis and sign of a look of the left eye."""

_EYE_OF = {"L": "left_eye", "R": "right_eye"}


def is_angle(name: str) -> bool:
    """Whether the name of a channel is that of an angle of the head or an eye."""
    return _CHANNEL.fullmatch(name) is not None


def recorded_angles(names: Sequence[str], weights: FloatArray) -> dict[str, FloatArray]:
    """Return recorded angles, (frames, 3) about x, y, z by part [rad], with this module's signs.

    Axes without a channel are 0; parts whose channels are constantly 0 are omitted.

    Raises
    ------
    ValueError
        If an angle is in degrees: above pi, or much larger than the looks of the eye.
    """
    found: dict[str, FloatArray] = {}
    for column, name in enumerate(names):
        match = _CHANNEL.fullmatch(name)
        if match is None or not weights[:, column].any():
            continue
        largest = float(np.abs(weights[:, column]).max())
        if largest > np.pi:
            raise ValueError(f"{name} reaches {largest:g}, and angles are in radians: convert it")
        part = match["part"].lower().replace("_", "").replace("eye", "_eye")
        at = _AXES[match["axis"].lower().removeprefix("rotation").lstrip("_")]
        found.setdefault(part, np.zeros((len(weights), 3)))[:, at] = weights[:, column]
    looked = look_angles(names, weights)
    _check_radians(found, looked)
    # The signs of a recorder's angles about x, y and z are those of its looks.
    both = [(found[eye], looked[eye]) for eye in EYES if eye in found and eye in looked]
    signs = _RECORDED_SIGNS.copy()
    for axis in (0, 1):
        spread = np.sqrt(sum(look[:, axis].var() for _, look in both))
        covariance = sum(np.cov(a[:, axis], look[:, axis], bias=True)[0, 1] for a, look in both)
        if spread > _TELLING_RADIANS and covariance:
            signs[axis] = np.sign(covariance)
    signs[2] = signs[0] * signs[1]
    return {part: signs * angles for part, angles in found.items()}


def look_shapes(names: Sequence[str]) -> dict[str, set[str]]:
    """Return the shapes of looks, each with the eyes that it turns."""
    cells = {name: each.cells for name, each in read_meanings(names).items()}
    looks = {
        name: {_EYE_OF[side] for motion, side, _ in each if motion.startswith("eyelook")}
        for name, each in cells.items()
    }
    return {name: eyes for name, eyes in looks.items() if eyes}


def look_angles(names: Sequence[str], weights: FloatArray) -> dict[str, FloatArray]:
    """Return gaze from weights of looks: (frames, 3) about x, y, z, by eye [rad]."""
    angles: dict[str, FloatArray] = {}
    meanings = read_meanings(names)
    for column, name in enumerate(names):
        # A look has two cells, upper and lower: count it once.
        for motion, side in sorted({cell[:2] for cell in meanings[name].cells}):
            way = motion.removeprefix("eyelook")
            if way == motion or way not in _WAYS or side not in _EYE_OF:
                continue
            axis, sign = _WAYS[way]
            if axis == 1 and side == "R":
                sign = -sign
            turned = angles.setdefault(_EYE_OF[side], np.zeros((len(weights), 3)))
            turned[:, axis] += sign * FULL_LOOK_RADIANS * weights[:, column]
    return angles


def _check_radians(recorded: dict[str, FloatArray], looked: dict[str, FloatArray]) -> None:
    """Refuse angles in degrees, which are 57 times those from the weights of looks."""
    for eye in EYES:
        if eye in recorded and eye in looked:
            by_channel, by_look = recorded[eye][:, :2].std(), looked[eye][:, :2].std()
            if by_look > _TELLING_RADIANS and by_channel > _DEGREES_RATIO * by_look:
                raise ValueError(
                    f"the angles of the {eye.replace('_', ' ')} are {by_channel / by_look:.0f} "
                    "times as large as those of its looks, so they are in degrees; convert them, "
                    "and those of the head, to radians"
                )


def rotations_of(angles: FloatArray) -> FloatArray:
    """Return (frames, 3, 3) rotations of (frames, 3) angles about x, y and z [rad]."""
    return np.asarray(Rotation.from_euler("YXZ", angles[:, [1, 0, 2]]).as_matrix())


def performer_onto_rig(mapping: TrainedMapping, rig: Rig) -> FloatArray:
    """Return the similarity, (4, 4), from a mapping's performer to the rig.

    It aligns the centres of the displacements of each shape, on the performer (by the mapping's
    forward model) and on the rig. Centres are weighted by squared displacements, since the model
    has small displacements everywhere, which would draw plain means together. Shapes are weighted
    by their displacement of the performer.
    """
    on_face = (mapping.arrays["forward_basis"] ** 2).sum(axis=2)[: len(mapping.shape_names)]
    deformer = Deformer(rig)
    offsets = deformer.shapes.target_offsets().toarray().reshape(len(rig.shapes), -1, 3)
    on_rig = (offsets**2).sum(axis=2)[[rig.shapes.index(n) for n in mapping.shape_names]]
    both = (on_face.sum(axis=1) > 0) & (on_rig.sum(axis=1) > 0)
    if both.sum() < _FEWEST_SHAPES:
        raise ValueError(f"{both.sum()} shapes move both, {_FEWEST_SHAPES} are needed")
    face, character = (
        size[both] @ places / size[both].sum(axis=1, keepdims=True)
        for size, places in ((on_face, mapping.neutral), (on_rig, deformer.neutral))
    )
    fit = fit_similarity(face, character, weight=np.sqrt(on_face[both].sum(axis=1)))
    return pose_matrices(fit.scale[0] * fit.rotation, fit.translation)


def turn_about(turns: FloatArray, axes: FloatArray, pivot: Sequence[float]) -> FloatArray:
    """Return rotations about a face's axes as transforms of the rig: (frames, 4, 4).

    Parameters
    ----------
    turns : (frames, 3, 3) float array
    axes : (3, 3) float array
        Columns: the rig's left, up and forward.
    pivot : (3,) sequence of float
        Fixed point.
    """
    rotations = axes @ turns @ axes.T
    return pose_matrices(rotations, pivot - rotations @ np.asarray(pivot))
