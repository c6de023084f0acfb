"""Positions of a face's landmarks at a take's frames, from one camera or triangulated."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from usdface.capture.camera_calibration import CalibratedCamera
from usdface.capture.channel_take import fill_frames
from usdface.capture.face_gaze import closed_eyes
from usdface.capture.face_landmarks import LANDMARKS
from usdface.capture.face_tracking import FaceTrack
from usdface.core.arrays import BoolArray, Float32Array, FloatArray, IntArray
from usdface.core.errors import InputError
from usdface.model.placement.label_hints import skin_motion_mm
from usdface.numerics.rigid.camera_views import CameraPose, average_heads, triangulate_points
from usdface.numerics.rigid.perspective import PinholeCamera, unproject_head
from usdface.steps.capture.track_notes import eye_columns
from usdface.steps.capture.track_pictures import LONGEST_BRIDGED, PictureTiming

_PROFILE_SINE = 0.17
"""Sine of 10 degrees: skin turned away further than that beyond the silhouette is not visible."""
_HIDDEN_WEIGHT = 0.1
"""Weight of a landmark behind the silhouette: the lowest confidence of a visible one."""
_USUAL_DISAGREEMENT = 0.1
"""Share of a face's breadth: 0.03 on a drawn face with views 25 degrees apart, as landmarks mark
different skin from each side; 0.2 with the cameras exchanged."""

_RIGID = np.array([LANDMARKS.names.index(name) for name in LANDMARKS.rigid])


@dataclass(frozen=True)
class FaceView:
    """A face at a take's frames, from one camera or several."""

    first_frame: int
    positions: Float32Array
    """(frames, landmarks, 3): in the camera's space, Y up, looking along -Z [mm]."""
    confidence: Float32Array
    """(frames, landmarks) [0-1]"""
    visible: BoolArray
    """(frames, landmarks)"""
    present: BoolArray
    """(frames,): whether there is a face."""
    scores: Float32Array
    """(frames, scores): the model's scores of shapes [0-1]."""
    closed: BoolArray
    """(frames, 2): whether the right and the left eye are closed."""


def measure_view(
    track: FaceTrack, timing: PictureTiming, camera: PinholeCamera, eye_distance_mm: float
) -> FaceView:
    """Return a tracked face in camera space, at the take's frames."""
    seen = track.seen
    space = unproject_head(
        track.positions.astype(np.float64),
        seen,
        rigid=_RIGID,
        eyes=eye_columns(),
        eye_distance_mm=eye_distance_mm,
        camera=camera,
    )
    rows, present = _even_rows(timing.frames, seen)
    positions = _on_frames(space.reshape(len(space), -1)[seen], timing.frames[seen], rows)
    confidence = _on_frames(track.confidence().astype(np.float64)[seen], timing.frames[seen], rows)
    scores = _on_frames(track.scores.astype(np.float64)[seen], timing.frames[seen], rows)
    positions = positions.reshape(len(rows), -1, 3)
    closed = closed_eyes(positions, present)
    outside = _on_frames(track.outside.astype(np.float64)[seen], timing.frames[seen], rows) > 0
    visible = present[:, None] & ~outside & ~_turned_away(positions) & ~_behind_lids(closed)
    return FaceView(timing.first_frame, positions, confidence, visible, present, scores, closed)


def join_views(
    views: Sequence[FaceView], cameras: Sequence[CalibratedCamera], *, eye_distance_mm: float
) -> tuple[FaceView, list[str]]:
    """Join the views of synchronous cameras in the space of the first; return it with notes.

    Landmarks are triangulated, then each view is aligned with the triangulated head and the views
    are averaged, weighted by confidence, with a low weight where hidden.
    """
    first = max(view.first_frame for view in views)
    stop = min(view.first_frame + len(view.present) for view in views)
    if stop <= first:
        raise InputError("the videos have no frame in common; give --frames that all have")
    cut = [_rows_of(view, first, stop) for view in views]
    present = np.stack([view.present for view in cut])
    heads = np.stack([view.positions for view in cut]).astype(np.float64) * (1.0, -1.0, -1.0)
    trust = (
        np.stack([np.where(view.visible, view.confidence, _HIDDEN_WEIGHT) for view in cut])
        * present[..., None]
    )
    joined = present.sum(axis=0) >= 2
    if not joined.any():
        raise InputError(
            "no frame in which two cameras see a face; cut the videos to the same start"
        )
    poses = _relative(cameras)
    heads, weights = heads[:, joined], trust[:, joined]
    focal = np.array([each.camera.focal_pixels for each in cameras])
    points = triangulate_points(
        heads[..., :2] / heads[..., 2:], weights * focal[:, None, None] ** 2, poses
    )
    right, left = eye_columns()
    apart = points[:, left].mean(axis=1) - points[:, right].mean(axis=1)
    points *= eye_distance_mm / np.median(np.linalg.norm(apart, axis=1))
    mean = average_heads(points, heads, weights, skin_motion_mm(LANDMARKS.names) ** -2.0)
    _check_agreement(points, mean)
    upright = (mean * (1.0, -1.0, -1.0)).reshape(len(mean), -1)
    rows = np.arange(len(joined))
    positions = _on_frames(upright, rows[joined].astype(np.float64), rows)
    positions = positions.reshape(len(rows), -1, 3)
    visible = np.any([view.visible for view in cut], axis=0) & joined[:, None]
    notes = []
    if (~joined & present.any(axis=0)).any():
        count = int((~joined & present.any(axis=0)).sum())
        notes.append(
            f"only one camera sees a face in {count} of {len(joined)} frames, which are gaps"
        )
    scores = sum(view.scores * each[:, None] for view, each in zip(cut, present, strict=True))
    return FaceView(
        first,
        positions,
        trust.max(axis=0).astype(np.float32),
        visible,
        joined,
        (scores / np.maximum(present.sum(axis=0), 1)[:, None]).astype(np.float32),
        closed_eyes(positions, joined),
    ), notes


def _rows_of(view: FaceView, first: int, stop: int) -> FaceView:
    rows = slice(first - view.first_frame, stop - view.first_frame)
    return FaceView(first, *(getattr(view, each.name)[rows] for each in fields(view)[1:]))


def _relative(cameras: Sequence[CalibratedCamera]) -> list[CameraPose]:
    """Return the poses of the cameras relative to the first."""
    poses = [each.pose for each in cameras if each.pose is not None]
    base = poses[0]
    relative = []
    for pose in poses:
        turn = pose.rotation @ base.rotation.T
        relative.append(CameraPose(turn, pose.translation - turn @ base.translation))
    return relative


def _check_agreement(points: FloatArray, mean: FloatArray) -> None:
    """Refuse cameras whose triangulated face differs from that of each view."""
    skull = points[:, _RIGID], mean[:, _RIGID]
    off = np.linalg.norm(skull[0] - skull[1], axis=2).mean(axis=1)
    share = float(np.median(off / np.ptp(skull[1][..., 0], axis=1)))
    if not share <= _USUAL_DISAGREEMENT:
        raise InputError(
            f"the cameras disagree about the face by {100 * share:.0f} % of its breadth (usually "
            "3 %); check that the videos start together and that --cameras has their order, or "
            "calibrate again"
        )


def _even_rows(frames: FloatArray, seen: BoolArray) -> tuple[IntArray, BoolArray]:
    """Return the take's frames from 0, and whether adjacent pictures show a face."""
    rows = np.arange(int(np.floor(frames[-1])) + 1)
    before = np.clip(np.searchsorted(frames, rows + 1e-6) - 1, 0, len(frames) - 1)
    after = np.where(frames[before] >= rows - 1e-6, before, np.minimum(before + 1, len(frames) - 1))
    near = frames[after] - frames[before] <= LONGEST_BRIDGED
    return rows, seen[before] & seen[after] & near


def _on_frames(values: FloatArray, frames: FloatArray, rows: IntArray) -> Float32Array:
    """Return (frames, channels): linear between pictures, held at the ends."""
    ends = [np.minimum(frames[:1], 0.0), np.maximum(frames[-1:], rows[-1])]
    held = np.concatenate([values[:1], values, values[-1:]])
    times = np.concatenate([ends[0] - 1e-9, frames, ends[1] + 1e-9])
    return fill_frames(held, times)


def _turned_away(positions: Float32Array) -> BoolArray:
    """Return which landmarks lie behind the silhouette: (frames, landmarks).

    The head is approximated by an upright cylinder about an axis between the ears.
    """
    ears = positions[:, [LANDMARKS.column(234), LANDMARKS.column(454)]].astype(np.float64)
    axis = ears.mean(axis=1)
    outward = positions - axis[:, None]
    up = positions[:, LANDMARKS.column(10)] - positions[:, LANDMARKS.column(152)]
    up /= np.maximum(np.linalg.norm(up, axis=1, keepdims=True), 1e-9)
    outward = outward - (outward * up[:, None]).sum(axis=2, keepdims=True) * up[:, None]
    length = np.linalg.norm(outward, axis=2)
    sight = -axis / np.maximum(np.linalg.norm(axis, axis=1, keepdims=True), 1e-9)
    sine = (outward * sight[:, None]).sum(axis=2) / np.maximum(length, 1e-9)
    return sine < -_PROFILE_SINE


def _behind_lids(closed: BoolArray) -> BoolArray:
    """Return which landmarks closed eyes hide, their irises: (frames, landmarks)."""
    hidden = [
        closed[:, 0] if name.startswith("iris_R") else closed[:, 1] & name.startswith("iris_L")
        for name in LANDMARKS.names
    ]
    return np.stack(hidden, axis=1)
