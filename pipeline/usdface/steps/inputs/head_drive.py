"""Drive joints or Xforms of a rig by the head motion and gaze of a take."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from usdface.core.arrays import FloatArray
from usdface.core.assets import Rig
from usdface.core.deformer import Deformer
from usdface.core.errors import InputError, as_input_error
from usdface.core.text import first_few
from usdface.model.placement.rig_orientation import face_axes, face_centre
from usdface.model.retarget.head_pose import (
    EYES,
    HEAD,
    look_angles,
    look_shapes,
    recorded_angles,
    rotations_of,
    turn_about,
)
from usdface.numerics.rigid.rigid_alignment import pose_matrices
from usdface.usdio.rig.drive_targets import DriveTarget, HeadDrive, find_drive_target
from usdface.usdio.rig.rig_motion import points_following
from usdface.usdio.take.read import TakeReader

_REMEDY = {
    HEAD: "needs HeadMotion of a cleaned take, or channels such as HeadYaw that move",
    **dict.fromkeys(EYES, "needs channels such as LeftEyeYaw that move, or weights of eyeLook"),
}

_TURNED_SHARE = 0.05
"""Displacement, as a share of an eyeball's size, above which a shape turns the eyeball; 30 degrees
move its front by a quarter."""

_FARTHEST_DEGREES = {HEAD: 60.0, **dict.fromkeys(EYES, 45.0)}
"""Rotation above which the source's angles are probably degrees instead of radians."""


@dataclass(frozen=True)
class HeadSource:
    """Motion of a performer's head and eyes."""

    path: Path
    turns: Mapping[str, FloatArray]
    """(frames, 3, 3) by part: rotation about the axes of a face."""
    motion: FloatArray | None = None
    """(frames, 4, 4): head motion since the neutral frame, in its space there [mm]; None if only
    rotations are known."""
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Centre of the head in that space [mm]."""

    def transforms(
        self, rig: Rig, targets: Sequence[DriveTarget], onto: FloatArray | None = None
    ) -> dict[DriveTarget, FloatArray]:
        """Return the transform of each target from rest, (frames, 4, 4), in the rig's world [mm].

        `onto`: (4, 4), similarity from the performer's space to the rig's. By default the performer
        is upright and looks along Z, as tracked and stabilised faces do.
        """
        axes, transforms = face_axes(rig), dict[DriveTarget, FloatArray]()
        for target in targets:
            if target.part == HEAD and self.motion is not None:
                to_rig = onto
                if to_rig is None:
                    to_rig = pose_matrices(axes, face_centre(rig) - axes @ self.centre)
                transforms[target] = to_rig @ self.motion @ np.linalg.inv(to_rig)
            elif target.part in self.turns:
                transforms[target] = turn_about(self.turns[target.part], axes, target.pivot)
            else:
                raise InputError(
                    f"{self.path}: has no motion of the {target.part} for --drive: that "
                    f"{_REMEDY[target.part]}; leave out --drive {target.part}="
                )
        return transforms

    def drive(
        self, rig: Rig, targets: Sequence[DriveTarget], onto: FloatArray | None = None
    ) -> HeadDrive:
        """Return transforms, zeroed shapes and notes of the targets; see `transforms`."""
        zeroed = redundant_look_shapes(rig, targets)
        notes = []
        for target in targets:
            turns = self.turns.get(target.part)
            if turns is not None:
                degrees = float(np.degrees(Rotation.from_matrix(turns).magnitude().max()))
                far = degrees > _FARTHEST_DEGREES[target.part]
                notes.append(
                    f"{target.part} turns by up to {degrees:.0f} degrees"
                    + ("; if that is too far, its angles are not in radians: convert them" * far)
                )
        if zeroed:
            notes.append(
                f"held at 0, as --drive turns the same eyeballs: {first_few(zeroed)}; lids that "
                "they move do not follow the gaze"
            )
        return HeadDrive(self.transforms(rig, targets, onto), zeroed, tuple(notes))


def redundant_look_shapes(rig: Rig, targets: Sequence[DriveTarget]) -> tuple[str, ...]:
    """Return the shapes that turn eyeballs of targets, by which gaze would be doubled.

    A shape of both eyes counts if both are driven. Shapes that only move lids do not count.
    """
    eyes = {each.part: each for each in targets if each.part in EYES}
    looks = look_shapes(rig.shapes)
    if not eyes or not looks:
        return ()
    deformer = Deformer(rig)
    offsets = deformer.shapes.target_offsets()
    balls = {
        part: points_following(rig, each.path, is_joint=each.is_joint)
        for part, each in eyes.items()
    }
    sizes = {
        part: np.ptp(deformer.neutral[ball], axis=0).max() if ball.any() else np.inf
        for part, ball in balls.items()
    }
    found = []
    for name, sides in looks.items():
        moved = offsets[[rig.shapes.index(name)]].toarray().reshape(-1, 3)
        if sides <= eyes.keys() and any(
            np.abs(moved[balls[eye]]).max(initial=0.0) > _TURNED_SHARE * sizes[eye] for eye in sides
        ):
            found.append(name)
    return tuple(found)


def named_targets(rig: Rig, drive: Sequence[str]) -> tuple[DriveTarget, ...]:
    """Return the targets of ``PART=NAME`` on a rig."""
    named = (each.partition("=") for each in drive)
    targets = tuple(find_drive_target(rig, part, name) for part, _, name in named)
    parts: dict[str, str] = {}
    for each in targets:
        other = parts.setdefault(each.path, each.part)
        if other != each.part:
            raise InputError(
                f"{rig.file}: --drive names {each.path} for the {other} and the {each.part}; name "
                "it for one part"
            )
    return targets


def weights_head_source(path: Path, names: Sequence[str], weights: FloatArray) -> HeadSource:
    """Return the motion of head and eyes from channels, (frames, channels)."""
    with as_input_error(path):
        angles = look_angles(names, weights) | recorded_angles(names, weights)
    return HeadSource(path, {part: rotations_of(each) for part, each in angles.items()})


def take_head_source(take: TakeReader, first: int, last: int) -> HeadSource:
    """Return the motion of head and eyes of a take; channels take precedence over HeadMotion."""
    # The signs of angles are estimated from the whole take.
    channels = take.read_source(range(take.first_frame, take.last_frame + 1))
    turns: Mapping[str, FloatArray] = {}
    if channels is not None:
        every = weights_head_source(take.path, channels.names, channels.values.astype(np.float64))
        rows = slice(first - take.first_frame, last + 1 - take.first_frame)
        turns = {part: each[rows] for part, each in every.turns.items()}
    motion = None if HEAD in turns else take.head_motion_from_neutral(first, last)
    if motion is None:
        return HeadSource(take.path, turns)
    at = min(max(take.neutral_frame, take.first_frame), take.last_frame)
    markers = take.read_markers_at([at])
    if markers is None:
        return HeadSource(take.path, turns, motion)
    # If no marker is visible, the positions of all are used.
    seen = markers.visible[0] | ~markers.visible[0].any()
    x, y, z = markers.positions[0][seen].mean(axis=0).tolist()
    return HeadSource(take.path, turns, motion, (x, y, z))
