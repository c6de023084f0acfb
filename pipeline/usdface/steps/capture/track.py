"""A video in, a take of the face's landmarks out."""

from contextlib import ExitStack
from dataclasses import replace

import numpy as np

from usdface.capture.channel_take import fill_frames
from usdface.capture.face_gaze import LOOK_SHAPES, GazeAngles, closed_eyes, gaze_angles
from usdface.capture.face_landmarker import KNOWN_MODELS
from usdface.capture.face_landmarks import LANDMARKS
from usdface.capture.face_tracking import FaceFollower, FaceTrack
from usdface.capture.marker_take import CaptureHeader, CaptureOptions, build_marker_take
from usdface.core.arrays import BoolArray, Float32Array, FloatArray, IntArray
from usdface.core.assets import Take, Video, WeightsClip
from usdface.core.errors import InputError
from usdface.core.progress import Progress, part, silent
from usdface.core.provenance import Provenance
from usdface.core.rates import exact_rate, frames_of
from usdface.core.sidecars import samples_path
from usdface.core.text import pluralize
from usdface.media.film.image_sequence import ImageSequence, open_video
from usdface.media.film.video import VideoReader
from usdface.model.placement.label_hints import skin_motion_mm
from usdface.model.placement.plausibility import judge_markers, settle_findings
from usdface.numerics.rigid.perspective import PinholeCamera, unproject_head
from usdface.numerics.rigid.stabilization import align_by_prior
from usdface.runner.result import StepResult
from usdface.specs.capture import TrackSpec
from usdface.steps.capture.track_notes import check_faces, eye_columns, track_notes
from usdface.steps.capture.track_pictures import (
    FIRST_VIDEO_FRAME,
    PictureDetector,
    PictureTiming,
    detections_folder,
    settle_timing,
)
from usdface.usdio.take.write import write_take

DEFAULT_FOCAL_LENGTH = 28.0
"""[mm] of a 35 mm camera: phones film with 23 to 31 mm, more with the picture stabilised."""
_FILM_DIAGONAL = float(np.hypot(36.0, 24.0))
"""[mm]"""

_LONGEST_BRIDGED = 2.5
"""[frames] Between two pictures that are interpolated: one may be missing."""
_PROFILE_SINE = 0.17
"""Sine of 10 degrees: skin turned further away than that beyond the silhouette is not seen."""


def run(spec: TrackSpec, *, provenance: Provenance, progress: Progress = silent) -> StepResult:
    """Track the face in a video and write a take, or what the model detects for one."""
    rate = None if spec.video_rate is None else exact_rate(spec.video_rate, where="--video-rate")
    with (
        detections_folder(spec.out) as folder,
        ExitStack() as open_files,
        open_video(spec.video, rate) as video,
    ):
        timing = settle_timing(spec, video, rate)
        detector = PictureDetector(spec, provenance, folder, open_files)
        looking = detector.look(video, timing, part(progress, 0.0, 0.95))
        if spec.part:
            faces = list(looking)
            detector.write(spec.out, timing.pictures, faces, provenance=provenance)
            seen = sum(bool(each.direct) for each in faces)
            count = pluralize(len(faces), "picture")
            summary = f"{spec.out.name}: {count}, a face in {100 * seen / len(faces):.1f} %"
            return StepResult((spec.out,), summary, timing.notes, {"pictures": len(faces)})
        follower = FaceFollower(spec.face, mirrored=spec.quality == "final")
        for index, found in zip(timing.pictures.tolist(), looking, strict=True):
            follower.look(found, where=f"{spec.video} at {video.times[index]:.2f} s")
        return _write(spec, follower.track(), timing, video, detector, provenance, progress)


def _write(
    spec: TrackSpec,
    track: FaceTrack,
    timing: PictureTiming,
    video: VideoReader | ImageSequence,
    detector: PictureDetector,
    provenance: Provenance,
    progress: Progress,
) -> StepResult:
    """Make the take of what was tracked, and write it."""
    check_faces(spec, track)
    camera, focal_note = _camera(spec, video)
    frames = np.rint(timing.frames).astype(np.int64) + timing.first_frame
    doubtful = track_notes(track, rate=timing.rate, frames=frames)
    notes = [*timing.notes, focal_note, *doubtful]
    if detector.digest not in KNOWN_MODELS:
        notes.append(
            f"the model is not the version that was measured (SHA-256 {detector.digest[:16]}…)"
        )
    take, built = _build_take(spec, track, timing, camera, detector.score_names)
    # The rate is the video's own: no option corrects it.
    found = judge_markers(take.markers, None) if take.markers else ()
    doubts = settle_findings(found, where=spec.video)
    take = replace(take, doubts=doubts, timecode_start=_timecode(video.timecode, timing))
    progress(0.95, f"writing {spec.out.name}")
    write_take(spec.out, take, provenance=provenance)
    progress(1.0, f"wrote {spec.out.name}")
    outputs = tuple(dict.fromkeys((spec.out, samples_path(spec.out))))
    figures = _figures(take, track, camera) | {"model_sha256": detector.digest}
    summary = (
        f"{take.name}: {pluralize(take.frame_count, 'frame')} at {float(take.rate):g} per second, "
        f"{pluralize(len(LANDMARKS.names), 'landmark')}, face in {100 * track.seen.mean():.1f} % "
        "of the pictures"
    )
    return StepResult(outputs, summary, (*notes, *built, *doubts), figures)


def _camera(spec: TrackSpec, video: VideoReader | ImageSequence) -> tuple[PinholeCamera, str]:
    """Return the camera, and where its focal length comes from."""
    picture = video.frame_at(float(video.times[0]))
    assert picture is not None
    height, width = picture.shape[:2]
    focal, note = spec.focal_length, ""
    if focal is None and isinstance(video, VideoReader):
        focal = video.focal_length
    if focal is None:
        focal = DEFAULT_FOCAL_LENGTH
        note = (
            f"the file states no focal length; {focal:g} mm of a 35 mm camera assumed: name the "
            "lens with --focal-length, as perspective is undone by it"
        )
    else:
        note = f"perspective undone for a focal length of {focal:g} mm of a 35 mm camera"
    pixels = focal / _FILM_DIAGONAL * float(np.hypot(width, height))
    camera = PinholeCamera(pixels, (width / 2, height / 2), spec.distortion)
    _check_unfolded(spec, camera, width, height)
    return camera, note


def _check_unfolded(spec: TrackSpec, camera: PinholeCamera, width: int, height: int) -> None:
    """Refuse a distortion by which some of the picture would show no place."""
    across, down = np.meshgrid(np.linspace(0, width, 33), np.linspace(0, height, 33))
    grid = np.stack([across.ravel(), down.ravel()], axis=1)
    folded = np.isnan(camera.undistort(grid)).any(axis=1)
    if folded.any():
        nearest = grid[folded][np.linalg.norm(grid[folded] - camera.center, axis=1).argmin()]
        raise InputError(
            f"{spec.video}: by --distortion {','.join(f'{term:g}' for term in spec.distortion)} "
            f"and a focal length of {camera.focal_pixels:.0f} pixels no place is seen at "
            f"{nearest[0]:.0f}, {nearest[1]:.0f}, where the distortion folds the picture; give the "
            "terms in OpenCV's order, k1,k2,p1,p2,k3, with the focal length of the same calibration"
        )


def _build_take(
    spec: TrackSpec,
    track: FaceTrack,
    timing: PictureTiming,
    camera: PinholeCamera,
    score_names: tuple[str, ...],
) -> tuple[Take, tuple[str, ...]]:
    """Bring landmarks into space and onto even frames; return the take and notes."""
    seen = track.seen
    space = unproject_head(
        track.positions.astype(np.float64),
        seen,
        rigid=np.array([LANDMARKS.names.index(name) for name in LANDMARKS.rigid]),
        eyes=eye_columns(),
        eye_distance_mm=spec.eye_distance,
        camera=camera,
    )
    rows, present = _even_rows(timing.frames, seen)
    positions = _on_frames(space.reshape(len(space), -1)[seen], timing.frames[seen], rows)
    confidence = _on_frames(track.confidence().astype(np.float64)[seen], timing.frames[seen], rows)
    scores = _on_frames(track.scores.astype(np.float64)[seen], timing.frames[seen], rows)
    positions = positions.reshape(len(rows), -1, 3)
    closed = closed_eyes(positions, present)
    visible = present[:, None] & ~_turned_away(positions) & ~_behind_lids(closed)
    neutral, notes = _neutral_frame(spec, timing, present, scores, score_names)
    head = align_by_prior(
        positions,
        positions[neutral - timing.first_frame],
        visible=np.repeat(present[:, None], len(LANDMARKS.names), axis=1),
        skin_motion_mm=skin_motion_mm(LANDMARKS.names),
        rate=float(timing.rate),
    )
    gaze = gaze_angles(positions, head, closed, neutral - timing.first_frame)
    score_names, scores = _with_gaze(score_names, scores, gaze)
    built = build_marker_take(
        CaptureHeader(spec.video, "track", timing.rate, timing.first_frame),
        LANDMARKS.names,
        positions,
        visible,
        # None is rigid: `clean` weights each landmark by how far its part of the face moves.
        CaptureOptions(neutral=neutral),
    )
    markers = built.take.markers
    assert markers is not None
    confidence = np.where(markers.visible, confidence, 0).astype(np.float32)
    take = replace(
        built.take,
        name=spec.take or spec.video.stem,
        markers=replace(markers, confidence=confidence),
        source=WeightsClip(score_names, scores, timing.first_frame, timing.rate),
        video=Video(spec.video, timing.rate, offset=-timing.start_seconds),
        performer=spec.performer,
        session=spec.session,
        emotion=spec.emotion,
    )
    return take, (*notes, *built.notes)


def _neutral_frame(
    spec: TrackSpec,
    timing: PictureTiming,
    present: BoolArray,
    scores: Float32Array,
    names: tuple[str, ...],
) -> tuple[int, list[str]]:
    """Return the frame of the face at rest, and a note where nobody named it."""
    neutral = spec.neutral
    if neutral is None:
        neutral = _least_expression(scores, present, names) + timing.first_frame
        return neutral, [f"frame {neutral} shows the least expression, and is taken as neutral"]
    if not present[neutral - timing.first_frame]:
        raise InputError(
            f"{spec.video}: no face is seen at the neutral frame {neutral}; name another"
        )
    return neutral, []


def _behind_lids(closed: BoolArray) -> BoolArray:
    """Return which landmarks a closed eye hides, its iris: (frames, landmarks)."""
    hidden = [
        closed[:, 0] if name.startswith("iris_R") else closed[:, 1] & name.startswith("iris_L")
        for name in LANDMARKS.names
    ]
    return np.stack(hidden, axis=1)


def _with_gaze(
    names: tuple[str, ...], scores: Float32Array, gaze: GazeAngles
) -> tuple[tuple[str, ...], Float32Array]:
    """Put the looks that the irises show in the place of those that the model scores."""
    others = [at for at, name in enumerate(names) if name not in LOOK_SHAPES]
    values = np.concatenate([scores[:, others], gaze.look_weights()], axis=1)
    return (*(names[at] for at in others), *LOOK_SHAPES), values


def _even_rows(frames: FloatArray, seen: BoolArray) -> tuple[IntArray, BoolArray]:
    """Return the take's frames from 0, and in which a face is seen in pictures nearby."""
    rows = np.arange(int(np.floor(frames[-1])) + 1)
    before = np.clip(np.searchsorted(frames, rows + 1e-6) - 1, 0, len(frames) - 1)
    after = np.where(frames[before] >= rows - 1e-6, before, np.minimum(before + 1, len(frames) - 1))
    near = frames[after] - frames[before] <= _LONGEST_BRIDGED
    return rows, seen[before] & seen[after] & near


def _on_frames(values: FloatArray, frames: FloatArray, rows: IntArray) -> Float32Array:
    """Return (frames, channels): linear between pictures, held at the ends."""
    ends = [np.minimum(frames[:1], 0.0), np.maximum(frames[-1:], rows[-1])]
    held = np.concatenate([values[:1], values, values[-1:]])
    times = np.concatenate([ends[0] - 1e-9, frames, ends[1] + 1e-9])
    return fill_frames(held, times)


def _turned_away(positions: Float32Array) -> BoolArray:
    """Return which landmarks lie behind the silhouette: (frames, landmarks).

    The head is taken for an upright cylinder about an axis between the ears; a landmark that lies
    beyond its edge as the camera sees it is a guess of the model.
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
    return np.asarray(sine < -_PROFILE_SINE)


def _least_expression(scores: Float32Array, present: BoolArray, names: tuple[str, ...]) -> int:
    """Return the row whose face is nearest to rest by the model's scores, the gaze apart."""
    counted = [at for at, name in enumerate(names) if not name.startswith(("eyeLook", "_"))]
    expression = scores[:, counted].sum(axis=1)
    return int(np.argmin(np.where(present, expression, np.inf)))


def _timecode(start: str, timing: PictureTiming) -> str:
    """Return the timecode of the first tracked frame; empty where the video's is none."""
    if not start or timing.first_frame != FIRST_VIDEO_FRAME:
        return ""
    try:
        frames_of(start, timing.rate)
    except InputError:
        return ""
    return start


def _figures(take: Take, track: FaceTrack, camera: PinholeCamera) -> dict[str, object]:
    markers = take.markers
    assert markers is not None
    return {
        "frames": take.frame_count,
        "rate": float(take.rate),
        "first_frame": take.first_frame,
        "markers": len(markers.names),
        "neutral_frame": markers.neutral_frame,
        "face_share": float(track.seen.mean()),
        "gap_share": float(1 - markers.visible.mean()),
        "low_confidence_share": float((markers.confidence[markers.visible] < 0.5).mean()),
        "focal_pixels": camera.focal_pixels,
    }
