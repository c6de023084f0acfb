"""Turn the drawn head like the performer's in the video."""

from dataclasses import replace

import numpy as np
from scipy import sparse

from usdface.core.arrays import FloatArray
from usdface.core.assets import Rig
from usdface.core.errors import InputError
from usdface.model.placement.rig_orientation import face_axes, face_centre
from usdface.model.retarget.head_pose import HEAD, turn_about
from usdface.specs.review import AUTO_CAMERA
from usdface.steps.inputs.head_drive import take_head_source
from usdface.steps.inputs.placement import (
    is_placement_of,
    placement_of_performance,
    virtual_markers,
)
from usdface.steps.review.shot import Shot
from usdface.usdio.rig.rig_motion import PointMotion
from usdface.usdio.take.read import TakeReader


class HeadTurn(PointMotion):
    """Rotation of a whole rig about the centre of its face.

    `axes`: (3, 3), whose columns are the axes of the rotations in the rig's space. `turns`:
    (frames, 3, 3), rotations from the take's first frame; None reads the take's HeadMotion.
    """

    moves_as_one = True

    def __init__(
        self, rig: Rig, take: TakeReader, axes: FloatArray, turns: FloatArray | None
    ) -> None:
        count = sum(len(mesh.points) for mesh in rig.meshes)
        self.shares = sparse.csc_array(np.ones((count, 1)))
        self._take, self._axes, self._turns = take, axes, turns
        self._centre = face_centre(rig)

    def transforms(self, frame: int) -> FloatArray:
        """Return the rotation at a frame: (1, 4, 4) [mm]."""
        if self._turns is not None:
            turn = self._turns[frame - self._take.first_frame]
        else:  # matrices are slow to read, so only those of drawn frames are
            motion = self._take.head_motion_from_neutral(frame, frame)
            turn = np.eye(3) if motion is None else motion[0, :3, :3]
        return turn_about(turn[None], self._axes, self._centre.tolist())


def with_video_head_turn(shot: Shot, camera: str) -> Shot:
    """Return a shot whose head turns like the performer's, for the same view as the video.

    The shot is returned unchanged if the camera is not automatic, it has no video, its rig has
    moving joints or Xforms, or head motion or orientation of the performer are unknown.
    """
    if camera != AUTO_CAMERA or shot.take.video is None or shot.take_file is None:
        return shot
    if shot.motion is not None:
        return shot
    take = TakeReader(shot.take_file)
    try:
        source = take_head_source(take, take.first_frame, take.first_frame)
        if HEAD in source.turns:
            every = take_head_source(take, take.first_frame, take.last_frame)
            motion = HeadTurn(shot.rig, take, face_axes(shot.rig), every.turns[HEAD])
            return replace(shot, motion=motion)
        axes = None if source.motion is None else _performer_axes(shot)
    except InputError:
        return shot
    return shot if axes is None else replace(shot, motion=HeadTurn(shot.rig, take, axes, None))


def _performer_axes(shot: Shot) -> FloatArray | None:
    """Return the axes of the take's head space on the rig, by the placement of its markers."""
    markers = shot.take.markers
    placement = placement_of_performance(shot.performance_file, shot.rig)
    if markers is None or placement is None:
        return None
    neutral = markers.positions[shot.neutral_row].astype(np.float64)
    if not is_placement_of(placement, markers.names, neutral):
        return None
    return virtual_markers(placement, markers.names, neutral).rotation
