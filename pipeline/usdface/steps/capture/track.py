"""Track the face in a video, and write a take of its landmarks.

Cameras are those of a calibration, of options, or of the file's metadata.
"""

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from itertools import chain, islice
from pathlib import Path

import numpy as np

from usdface.capture.camera_calibration import CalibratedCamera, read_calibration
from usdface.capture.channel_take import gap_ranges
from usdface.capture.face_gaze import LOOK_SHAPES, gaze_angles, look_weights
from usdface.capture.face_landmarker import KNOWN_MODELS
from usdface.capture.face_landmarks import LANDMARKS
from usdface.capture.face_tracking import LASTING_PICTURES, FaceTrack, FaceTracker
from usdface.capture.marker_take import CaptureHeader, CaptureOptions, build_marker_take
from usdface.core.arrays import Float32Array
from usdface.core.assets import Take, Video, WeightsClip
from usdface.core.errors import InputError
from usdface.core.progress import Progress, part
from usdface.core.provenance import Provenance
from usdface.core.rates import exact_rate, shift_timecode, valid_timecode
from usdface.core.sidecars import samples_path
from usdface.core.text import first_few, pluralize
from usdface.media.film.timed_frames import OpenVideo
from usdface.media.film.video import VideoReader, open_video
from usdface.model.placement.plausibility import check_findings, judge_markers
from usdface.numerics.rigid.perspective import PinholeCamera
from usdface.runner.result import StepResult
from usdface.specs.capture import TrackSpec
from usdface.steps.capture.track_notes import DOUBTFUL_SHARE, check_faces, track_notes
from usdface.steps.capture.track_pictures import (
    FIRST_VIDEO_FRAME,
    PictureDetector,
    PictureTiming,
    detections_folder,
    resolve_timing,
)
from usdface.steps.capture.track_views import FaceView, join_views, measure_view
from usdface.usdio.take.write import write_take


@dataclass(frozen=True)
class _Clip:
    """A video with its tracked face."""

    video: OpenVideo
    timing: PictureTiming
    track: FaceTrack


def run(spec: TrackSpec, *, provenance: Provenance, progress: Progress) -> StepResult:
    """Track the face in a video and write a take, or with --part the model's detections."""
    rate = None if spec.video_rate is None else exact_rate(spec.video_rate, where="--video-rate")
    with detections_folder(spec.out) as folder, ExitStack() as open_files:
        paths = (spec.video, *(spec.views or ()))
        videos = [open_files.enter_context(open_video(path, rate)) for path in paths]
        timings = [resolve_timing(spec, video, rate) for video in videos]
        if other := [each.rate for each in timings if each.rate != timings[0].rate]:
            raise InputError(
                f"the videos have {timings[0].rate} and {other[0]} frames per second; record all "
                "cameras at one rate"
            )
        detector = PictureDetector(spec, provenance, folder, open_files)
        if spec.part:
            found = list(detector.detect(spec.video, videos[0], timings[0], progress))
            detector.write(spec.out, timings[0].pictures, found, provenance)
            share = sum(bool(each.direct) for each in found) / len(found)
            summary = f"{spec.out.name}: {pluralize(len(found), 'picture')}, a face in {share:.1%}"
            return StepResult((spec.out,), summary, timings[0].notes, {"pictures": len(found)})
        cameras, notes = resolve_cameras(spec, videos)
        clips = []
        for number, (path, video, timing) in enumerate(zip(paths, videos, timings, strict=True)):
            done = 0.95 * number / len(paths), 0.95 * (number + 1) / len(paths)
            detected = detector.detect(path, video, timing, part(progress, *done))
            opening = list(islice(detected, LASTING_PICTURES))
            tracker = FaceTracker(spec.face, mirrored=spec.quality == "final")
            tracker.choose(opening)
            faces = chain(opening, detected)
            for index, face in zip(timing.pictures.tolist(), faces, strict=True):
                tracker.add(face, where=f"{path} at {video.times[index]:.2f} s")
            track = tracker.track(detector.score_names, _picture_size(video))
            check_faces(path, track)
            clips.append(_Clip(video, timing, track))
        return _write(spec, clips, cameras, notes, detector, provenance, progress)


def _write(
    spec: TrackSpec,
    clips: list[_Clip],
    cameras: list[CalibratedCamera],
    notes: list[str],
    detector: PictureDetector,
    provenance: Provenance,
    progress: Progress,
) -> StepResult:
    """Build the take from the tracked faces, and write it."""
    views = []
    for number, (clip, camera) in enumerate(zip(clips, cameras, strict=True), start=1):
        timing = clip.timing
        frames = np.rint(timing.frames).astype(np.int64) + timing.first_frame
        doubtful = (*timing.notes, *track_notes(clip.track, rate=timing.rate, frames=frames))
        notes += [f"video {number}: {note}" if len(clips) > 1 else note for note in doubtful]
        views.append(measure_view(clip.track, timing, camera.camera, spec.eye_distance))
    view, clip = views[0], clips[0]
    if len(views) > 1:
        view, joined = join_views(views, cameras, eye_distance_mm=spec.eye_distance)
        notes += joined
    if detector.digest not in KNOWN_MODELS:
        notes.append(
            f"the model differs from the version that usdface was tested with (SHA-256 "
            f"{detector.digest[:16]}…)"
        )
    take, built = _build_take(spec, view, clip.timing, detector.score_names)
    # The rate is that of the video, so it is not checked.
    found = judge_markers(take.markers, None) if take.markers else ()
    warnings = check_findings(found, where=spec.video)
    label, wrong = valid_timecode(clip.video.timecode, take.rate)
    start = shift_timecode(label, take.first_frame - FIRST_VIDEO_FRAME, take.rate)
    take = replace(take, warnings=warnings, timecode_start=start)
    progress(0.95, f"writing {spec.out.name}")
    write_take(spec.out, take, provenance=provenance)
    outputs = tuple(dict.fromkeys((spec.out, samples_path(spec.out))))
    figures = _figures(take, clip.track, cameras[0].camera)
    several = f" of {len(clips)} cameras" if len(clips) > 1 else ""
    summary = (
        f"{take.name}: {pluralize(take.frame_count, 'frame')} at {float(take.rate):g} per second, "
        f"{pluralize(len(LANDMARKS.names), 'landmark')}, face in "
        f"{100 * clip.track.seen.mean():.1f} % of the pictures{several}"
    )
    figures |= {"model_sha256": detector.digest, "cameras": len(clips)}
    return StepResult(outputs, summary, (*notes, *built, *wrong, *warnings), figures)


def _build_take(
    spec: TrackSpec, view: FaceView, timing: PictureTiming, score_names: tuple[str, ...]
) -> tuple[Take, tuple[str, ...]]:
    """Return the take of a face, and notes."""
    neutral, notes = _neutral_frame(spec, view, score_names)
    score_names, scores = _with_gaze(score_names, view, neutral - view.first_frame)
    start = timing.start_seconds + (view.first_frame - timing.first_frame) / float(timing.rate)
    built = build_marker_take(
        CaptureHeader(spec.video, "track", timing.rate, view.first_frame),
        LANDMARKS.names,
        view.positions,
        view.visible.copy(),
        # None is rigid: `clean` weights each landmark by the rigidity of its part of the face.
        CaptureOptions(neutral=neutral),
    )
    markers = built.take.markers
    assert markers is not None
    # Landmarks that are never visible, as in a profile, are no markers.
    columns = [LANDMARKS.names.index(name) for name in markers.names]
    confidence = np.where(markers.visible, view.confidence[:, columns], 0).astype(np.float32)
    take = replace(
        built.take,
        name=spec.take or spec.video.stem,
        markers=replace(markers, confidence=confidence),
        source=WeightsClip(
            score_names,
            scores,
            view.first_frame,
            timing.rate,
            gap_ranges(~view.present, view.first_frame),
        ),
        video=Video(spec.video, timing.rate, offset=-start),
        performer=spec.performer,
        session=spec.session,
        emotion=spec.emotion,
    )
    return take, (*notes, *built.notes)


def _neutral_frame(
    spec: TrackSpec, view: FaceView, names: tuple[str, ...]
) -> tuple[int, list[str]]:
    """Return the frame of the neutral face, and a note if it was chosen by the model's scores."""
    neutral = spec.neutral
    if neutral is None:
        expressive = [at for at, name in enumerate(names) if not name.startswith(("eyeLook", "_"))]
        expression = view.scores[:, expressive].sum(axis=1)
        trusted = (view.visible & (view.confidence >= 0.5)).mean(axis=1)
        usable = view.present & (trusted >= trusted.max() - DOUBTFUL_SHARE)
        neutral = int(np.argmin(np.where(usable, expression, np.inf))) + view.first_frame
        return neutral, [f"frame {neutral} has the least expression, and is used as neutral"]
    row = neutral - view.first_frame
    if not (0 <= row < len(view.present) and view.present[row]):
        raise InputError(
            f"{spec.video}: no face is visible at the neutral frame {neutral}; name another"
        )
    return neutral, []


def _with_gaze(
    names: tuple[str, ...], view: FaceView, neutral: int
) -> tuple[tuple[str, ...], Float32Array]:
    """Replace the scores of looks by one gaze of both eyes, interpolated over blinks."""
    looks = [names.index(name) for name in LOOK_SHAPES]
    others = [at for at in range(len(names)) if at not in looks]
    usable = view.present[:, None] & ~view.closed
    weights = look_weights(*gaze_angles(view.scores[:, looks], usable, neutral))
    values = np.concatenate([view.scores[:, others], weights], axis=1)
    return (*(names[at] for at in others), *LOOK_SHAPES), values


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


DEFAULT_FOCAL_LENGTH = 28.0
"""35 mm equivalent [mm]: phones film with 23 to 31 mm, more with stabilised pictures."""
_FILM_DIAGONAL = float(np.hypot(36.0, 24.0))
"""[mm]"""


_SAME_SHAPE = 0.01
"""Relative difference of the aspect ratio above which a picture was cropped."""


def resolve_cameras(
    spec: TrackSpec, videos: Sequence[OpenVideo]
) -> tuple[list[CalibratedCamera], list[str]]:
    """Return the camera of each video, and notes on its source."""
    if spec.calibration is None:
        camera, note = _lens(spec, videos[0])
        return [CalibratedCamera(camera, None, None)], [note]
    known = read_calibration(spec.calibration)
    names = spec.cameras or tuple(known)
    if len(names) != len(videos):
        raise InputError(
            f"{spec.calibration}: {pluralize(len(names), 'camera')}, {first_few(list(names))}, for "
            f"{pluralize(len(videos), 'video')}; name the camera of each with --cameras, in order"
        )
    if unknown := [name for name in names if name not in known]:
        raise InputError(
            f"{spec.calibration}: has no camera {unknown[0]!r}; there are {first_few(list(known))}"
        )
    cameras = []
    for name, video in zip(names, videos, strict=True):
        where = f"{spec.calibration}: camera {name}"
        if len(videos) > 1 and known[name].pose is None:
            raise InputError(
                f"{where} has no rotation and translation; calibrate the cameras together"
            )
        cameras.append(_at_size(known[name], video, where))
    pairs = [
        f"{Path(video.path).name} by {name}" for video, name in zip(videos, names, strict=True)
    ]
    return cameras, [f"cameras of {spec.calibration.name}: {', '.join(pairs)}"]


def _at_size(found: CalibratedCamera, video: OpenVideo, where: str) -> CalibratedCamera:
    """Return a calibrated camera scaled to the size of a video's pictures."""
    width, height = _picture_size(video)
    camera = found.camera
    if found.size is not None and found.size != (width, height):
        across, down = width / found.size[0], height / found.size[1]
        if abs(across / down - 1) > _SAME_SHAPE:
            raise InputError(
                f"{video.path}: is {width} × {height}, and {where} was calibrated at "
                f"{found.size[0]} × {found.size[1]}; give the original video, neither cropped nor "
                "rotated, or name its camera with --cameras"
            )
        center = (camera.center[0] * across, camera.center[1] * down)
        camera = replace(camera, focal_pixels=camera.focal_pixels * across, center=center)
    _check_unfolded(where, camera, width, height)
    return replace(found, camera=camera)


def _picture_size(video: OpenVideo) -> tuple[int, int]:
    """Return width and height."""
    height, width = video.frame(0).shape[:2]
    return width, height


def _lens(spec: TrackSpec, video: OpenVideo) -> tuple[PinholeCamera, str]:
    """Return the camera of options or the file's metadata, and a note on its focal length."""
    width, height = _picture_size(video)
    focal = spec.focal_length
    if focal is None and isinstance(video, VideoReader):
        focal = video.focal_length
    if focal is None:
        focal = DEFAULT_FOCAL_LENGTH
        note = (
            f"the file states no focal length; {focal:g} mm (35 mm equivalent) is assumed for "
            "undoing perspective: give it with --focal-length"
        )
    else:
        note = f"perspective undone for a 35 mm equivalent focal length of {focal:g} mm"
    pixels = focal / _FILM_DIAGONAL * float(np.hypot(width, height))
    camera = PinholeCamera(pixels, (width / 2, height / 2), spec.distortion)
    terms = ",".join(f"{term:g}" for term in spec.distortion)
    _check_unfolded(f"{spec.video}: --distortion {terms}", camera, width, height)
    return camera, note


def _check_unfolded(where: str, camera: PinholeCamera, width: int, height: int) -> None:
    """Refuse a distortion that is not invertible within the picture."""
    across, down = np.meshgrid(np.linspace(0, width, 33), np.linspace(0, height, 33))
    grid = np.stack([across.ravel(), down.ravel()], axis=1)
    folded = np.isnan(camera.undistort(grid)).any(axis=1)
    if folded.any():
        nearest = grid[folded][np.linalg.norm(grid[folded] - camera.center, axis=1).argmin()]
        raise InputError(
            f"{where} with a focal length of {camera.focal_pixels:.0f} pixels cannot be inverted "
            f"at {nearest[0]:.0f}, {nearest[1]:.0f}, where it folds the picture; give the terms in "
            "OpenCV's order, k1,k2,p1,p2,k3, with the focal length of the same calibration"
        )
