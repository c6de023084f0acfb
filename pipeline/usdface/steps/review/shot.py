"""A shot: performance, take and rig over their common frames, and its cameras."""

from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from usdface.capture.sniff import read_capture
from usdface.core.arrays import FloatArray, IntArray, columns_by_name
from usdface.core.assets import Markers, Performance, Rig, Take
from usdface.core.deformer import Deformer
from usdface.core.errors import InputError
from usdface.core.rates import shift_timecode
from usdface.core.sidecars import is_usd_name
from usdface.media.face.camera import Camera, frame_rig, motion_weights, triple
from usdface.model.placement.rig_orientation import facing_degrees
from usdface.model.review.verdict import SolveEvidence
from usdface.runner.origin import find_take, provenance_of, spec_of, take_of_performance
from usdface.specs.paths import frame_range
from usdface.specs.review import AUTO_CAMERA, FRONT_CAMERA
from usdface.steps.inputs.cleaned_takes import read_cleaned
from usdface.steps.inputs.solve_verdict import evidence_of
from usdface.steps.review.clock import MovieClock
from usdface.usdio.authoring import unique_names
from usdface.usdio.performance.read import PerformanceReader, performance_of
from usdface.usdio.rig.reference import read_rig_of_stage
from usdface.usdio.rig.rig_motion import PointMotion, RigMotion
from usdface.usdio.rig.stage_camera import StageCamera, StageView

WIDEST_ASPECT = 3.0
"""Largest aspect ratio; wider pictures are cropped, as the face would be small."""

SMALL_SHARE = 0.2
"""Height of a face, as a share of the picture's, below which lips and lids cannot be judged."""


class ShotCamera:
    """One camera for all pictures of a shot, which it follows if it is automatic.

    `name`: ``'auto'``, ``'front'`` or the path of a camera in `stage`, by default the performance.
    """

    def __init__(self, shot: "Shot", name: str = AUTO_CAMERA, stage: Path | None = None) -> None:
        rig = self._rig = shot.rig
        self._motion = shot.motion
        reach = motion_weights(rig.meshes)
        self._points = np.concatenate([mesh.points for mesh in rig.meshes])
        self._face = reach > 0 if reach.any() else np.ones(len(reach), bool)
        self._framed = frame_rig(rig.meshes, yaw_degrees=facing_degrees(rig), hair=True)
        self._name = name
        self._stage: StageCamera | None = None
        if name not in (AUTO_CAMERA, FRONT_CAMERA):
            self._stage = StageCamera(
                stage or shot.performance_file,
                name,
                rig,
                rate=shot.performance.weights.rate,
                motion=shot.motion if isinstance(shot.motion, RigMotion) else None,
            )

    def at(self, frame: int, *, still: bool = False) -> Camera:
        """Return the camera at a frame; a still one does not follow the head."""
        if self._stage is None:
            if still or self._motion is None:
                return self._framed
            return self._followed(self._motion, frame)
        return _as_camera(self._stage.at(frame), self._framed)

    def _followed(self, motion: PointMotion, frame: int) -> Camera:
        """Return the camera translated with the face, without its rotation."""
        step = (motion.apply(self._points, frame) - self._points)[self._face].mean(axis=0)
        return replace(
            self._framed,
            eye=triple(self._framed.eye + step),
            target=triple(self._framed.target + step),
        )

    def width(self, height: int, frame: int) -> int:
        """Return the width of pictures: square, or by the aspect of the stage's camera."""
        if self._stage is None:
            return height
        return max(round(height * min(self._stage.at(frame).aspect, WIDEST_ASPECT)), 1)

    def notes(self, frame: int) -> tuple[str, ...]:
        """Return notes on the view of the face by the stage's camera at a frame."""
        if self._stage is None:
            return ()
        found = []
        if not self._stage.holds_character:
            found.append(
                f"{self._rig.file.name} is not in the camera's stage, and drawn at its origin"
            )
        height = 1000
        width = self.width(height, frame)
        seen = self.at(frame).project(self._points[self._face], width=width, height=height)
        inside = (seen[:, 2] > 0) & np.all((seen[:, :2] > 0) & (seen[:, :2] < (width, height)), 1)
        if not inside.any():
            found.append(f"{self._name} does not see the face at frame {frame}")
        elif np.ptp(seen[:, 1]) < SMALL_SHARE * height:
            share = 100 * np.ptp(seen[:, 1]) / height
            found.append(
                f"the face is {share:.0f}% of the picture's height by {self._name} at frame "
                f"{frame}: judge lips and lids with --camera auto"
            )
        return tuple(found)


def _as_camera(view: StageView, framed: Camera) -> Camera:
    """Return a stage's view as a camera whose target is at the depth of the face."""
    reach = float(np.subtract(framed.target, view.eye) @ view.forward)
    aim = view.eye + (reach if reach > 0 else 1000.0) * view.forward
    return Camera(
        eye=triple(view.eye),
        target=triple(aim),
        fov_degrees=view.fov_degrees,
        up=triple(view.up),
        shift=view.shift,
        span_mm=view.span_mm,
    )


@dataclass(frozen=True)
class Shot:
    """A performance, its take and its rig over their common frames."""

    performance_file: Path
    take: Take
    performance: Performance
    rig: Rig
    deformer: Deformer
    frames: IntArray
    """(frames,): frame numbers."""
    weights: FloatArray
    """(frames, shapes): in the rig's order."""
    motion: PointMotion | None = None
    """Motion of points in addition to shapes: joints and Xforms, or the performer's head; None if
    none moves."""
    take_file: Path | None = None
    """None if the take is not USD."""

    def pose(self, row: int, weights: FloatArray, *, still: bool = False) -> FloatArray:
        """Return the rig's points at weights, (shapes,), moved by a row's joints unless `still`."""
        points = self.deformer.points(weights[None])[0]
        return points if still else self.apply_motion(row, points)

    def apply_motion(self, row: int, points: FloatArray, *, vectors: bool = False) -> FloatArray:
        """Return points, or directions at them, moved by a row's joints and Xforms."""
        if self.motion is None:
            return points
        return self.motion.apply(points, int(self.frames[row]), vectors=vectors)

    def camera(self, name: str = AUTO_CAMERA, stage: Path | None = None) -> ShotCamera:
        """Return a camera of the shot; see `ShotCamera`."""
        return ShotCamera(self, name, stage)

    def clock(self, rate: Fraction) -> MovieClock:
        """Return the clock of a movie of the shot, in pictures per second."""
        return MovieClock(rate, self.take.rate, int(self.frames[0]), len(self.frames))

    @property
    def markers(self) -> Markers:
        """Markers of the whole take; refuse a take that has none."""
        if self.take.markers is None:
            raise InputError(f"{self.take.name}: has no markers")
        return self.take.markers

    @property
    def positions(self) -> FloatArray:
        """Markers at the common frames, (frames, markers, 3) [mm]."""
        rows = self.frames - self.take.first_frame
        return self.markers.positions[rows].astype(np.float64)

    @property
    def neutral_row(self) -> int:
        """Row of the take's neutral frame, or of the one that mapping used instead."""
        frame, take = self.performance.neutral_frame, self.take
        if frame is None and take.markers is not None:
            frame = take.markers.neutral_frame
        return min(max((frame or 0) - take.first_frame, 0), take.frame_count - 1)

    def face_uncertainty_mm(self) -> FloatArray | None:
        """Return the face's uncertainty at the common frames, (frames,) [mm]; None if unknown."""
        uncertainty = self.performance.uncertainty_mm
        if uncertainty is None:
            return None
        rows = self.frames - self.performance.weights.first_frame
        return np.asarray(uncertainty[rows, 0])

    def evidence(self) -> SolveEvidence:
        """Return the evidence of the verdict at the common frames."""
        return self.evidence_at(self.frames - self.performance.weights.first_frame)

    def evidence_at(self, rows: IntArray | slice) -> SolveEvidence:
        """Return the evidence at some rows of the performance."""
        known = self.performance
        figures = (known.uncertainty_mm, known.coverage, known.residual_mm)
        evidence = evidence_of(
            PerformanceReader(self.performance_file),
            [None if each is None else each[rows] for each in figures],
        )
        return replace(
            evidence,
            by_markers=self.take.markers is not None,
            has_video=self.take.video is not None,
        )

    def timecode(self, frame: int) -> str:
        """Return the timecode of a frame; empty if the take has none."""
        return shift_timecode(
            self.take.timecode_start, frame - self.take.first_frame, self.take.rate
        )


def open_shot(
    performance_file: Path,
    take_file: Path | None = None,
    *,
    frames: str | None = None,
    video: Path | None = None,
) -> Shot:
    """Read a performance with the take it was made from, at the common frames.

    `take_file`: see `find_take`; a performance without a take is shown on its own. `frames`: to
    use, as FIRST-LAST. `video`: new path of the take's video.
    """
    keyed = take_file is None and take_of_performance(performance_file) is None
    take_file = performance_file if keyed else find_take(performance_file, take_file)
    reader = PerformanceReader(performance_file)
    if reader.time_shift and not keyed:
        raise InputError(
            f"{performance_file}: a layer offset or another timeCodesPerSecond moves its weights "
            f"{reader.time_shift}, so they do not match those of {take_file}; give the performance "
            "as mapped"
        )
    performance = performance_of(reader)
    if keyed:
        take = _keyed_take(performance_file, performance)
    else:
        take = _read_take(take_file, performance_file)
    take = _with_video(take_file, take, video)
    rig = read_rig_of_stage(reader.stage, reader.animation)
    clip = performance.weights
    first = max(clip.first_frame, take.first_frame)
    last = min(clip.first_frame + len(clip.values), take.first_frame + take.frame_count)
    whole = first, last
    limits = frame_range(frames)
    if limits is not None:
        first, last = max(first, limits[0]), min(last, limits[1] + 1)
    if last <= first:
        if whole[0] < whole[1]:
            raise InputError(
                f"{performance_file}: has no frame in {frames}; choose some of "
                f"{whole[0]}-{whole[1] - 1}"
            )
        raise InputError(
            f"{performance_file}: has no common frame with {take_file}; give the take it was "
            "mapped from"
        )
    numbers = np.arange(first, last, dtype=np.int64)
    weights = weights_in_rig_order(performance, rig, numbers)
    motion = RigMotion(performance_file, rig)
    return Shot(
        performance_file,
        take,
        performance,
        rig,
        Deformer(rig),
        numbers,
        weights,
        motion if motion.shares.nnz else None,
        take_file if is_usd_name(take_file) and not keyed else None,
    )


def _read_take(file: Path, performance: Path) -> Take:
    """Read a take, or the capture that a performance was retargeted from."""
    if is_usd_name(file):
        return read_cleaned(file, need_markers=False)
    spec = spec_of(provenance_of(performance))
    stated = {
        name: spec[name] for name in ("rate", "weight_unit", "take") if spec.get(name) is not None
    }
    if spec.get("shapes"):
        stated["shapes"] = performance.parent / str(spec["shapes"])
    return read_capture(file, **stated).take


def _keyed_take(file: Path, performance: Performance) -> Take:
    """Return the weights of a performance without a take, such as an animator's, as a take."""
    clip = performance.weights
    return Take(
        name=file.name.split(".")[0],
        rate=clip.rate,
        first_frame=clip.first_frame,
        source=clip,
        timecode_start=performance.timecode_start,
    )


def _with_video(file: Path, take: Take, moved: Path | None) -> Take:
    """Return a take with the new path of its video; refuse a missing video."""
    if take.video is None:
        if moved is not None:
            raise InputError(
                f"{file}: has no video, so --video {moved} has no effect; ingest the take with "
                "--video"
            )
        return take
    if moved is not None:
        return replace(take, video=replace(take.video, file=moved))
    if not take.video.file.is_file():
        raise InputError(
            f"{file}: its video, {take.video.file}, is gone; put it back, or give its new path by "
            "--video"
        )
    return take


def weights_in_rig_order(performance: Performance, rig: Rig, frames: IntArray) -> FloatArray:
    """Return (frames, shapes) weights; 0 for shapes that the performance lacks."""
    clip = performance.weights
    return columns_by_name(clip.values[frames - clip.first_frame], clip.names, rig.shapes)


def version_labels(files: list[Path], *, taken: set[str]) -> list[str]:
    """Return unique labels of performances, none of `taken`: names, if ambiguous with folder."""
    stems = [file.stem.split(".usd")[0] for file in files]
    labels = [
        stem
        if stems.count(stem) == 1 and stem not in taken
        else f"{file.resolve().parent.name}/{stem}"
        for file, stem in zip(files, stems, strict=True)
    ]
    return unique_names([*taken, *labels])[len(taken) :]
