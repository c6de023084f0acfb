"""Detection of faces in the pictures of a video, resumable and in parts on a farm."""

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np

from usdface.capture.face_landmarker import FaceDetection, FaceLandmarker, check_model, named_model
from usdface.capture.face_landmarks import LANDMARKS
from usdface.capture.face_tracking import PictureFaces, detect_faces
from usdface.capture.sample_times import picture_frames
from usdface.core.arrays import FloatArray, IntArray
from usdface.core.errors import InputError
from usdface.core.progress import Progress, part
from usdface.core.provenance import Provenance, hash_text, relative_name
from usdface.core.side_files import STRETCH_FILES, make_side_folder, remove_side_folder
from usdface.core.sidecars import work_folder
from usdface.media.film.timed_frames import ImageSequence, OpenVideo
from usdface.specs.capture import TrackSpec
from usdface.specs.paths import frame_range
from usdface.usdio.take.detections import read_detections, write_detections

LONGEST_BRIDGED = 2.5
"""Largest distance in frames of two pictures to interpolate between: one may be missing."""

FIRST_VIDEO_FRAME = 1

_STRETCH_PICTURES = 240
"""Pictures per file of detections: an interrupted run loses a few seconds at most."""
_ARRAYS = ("pictures", "counts", "landmarks", "scores")
_NAMES = ("madeFrom", "scoreNames")


@dataclass(frozen=True)
class PictureTiming:
    """The pictures to analyse, and the take frame of each."""

    rate: Fraction
    """Frames per second of the take."""
    pictures: IntArray
    """(pictures,): index in the video."""
    frames: FloatArray
    """(pictures,): frame from `first_frame`; whole numbers if the video's rate is constant."""
    first_frame: int
    start_seconds: float
    """Time of the frame `first_frame` on the video's clock [s]."""
    notes: tuple[str, ...]


def resolve_timing(spec: TrackSpec, video: OpenVideo, wanted: Fraction | None) -> PictureTiming:
    """Return the take frame of each picture, by its time stamp."""
    notes = []
    times = video.times
    rate, frames = picture_frames(times, wanted or video.rate)
    if not (wanted or video.rate):
        notes.append(
            f"the video's rate varies, with a median of {1 / float(np.median(np.diff(times))):.3g} "
            f"pictures per second: resampled to {rate} frames per second; choose another rate with "
            "--video-rate"
        )
    limits = frame_range(spec.frames)
    pictures = np.arange(len(times))
    if limits is not None:
        # A picture between the last frame of a part and the first of the next is in the former.
        counted = FIRST_VIDEO_FRAME + (np.floor(frames) if spec.part else frames)
        pictures = pictures[(counted >= limits[0]) & (counted <= limits[1])]
        if not len(pictures):
            last = FIRST_VIDEO_FRAME + int(frames[-1])
            raise InputError(
                f"{spec.video}: --frames {spec.frames} is outside its frames, "
                f"{FIRST_VIDEO_FRAME} to {last}; give some of these"
            )
    first = int(np.ceil(frames[pictures[0]]))
    first_frame, last = FIRST_VIDEO_FRAME + first, FIRST_VIDEO_FRAME + int(frames[pictures[-1]])
    if spec.neutral is not None and not first_frame <= spec.neutral <= last:
        raise InputError(
            f"{spec.video}: --neutral {spec.neutral} is outside the frames to track, {first_frame} "
            f"to {last}; give one of these"
        )
    return PictureTiming(
        rate=rate,
        pictures=pictures,
        frames=frames[pictures] - first,
        first_frame=first_frame,
        start_seconds=float(times[0] + first / float(rate)),
        notes=tuple(notes),
    )


@contextlib.contextmanager
def detections_folder(out: Path) -> Iterator[Path]:
    """Yield a folder next to an output for detections, from which a killed run is resumed.

    It is removed at the end, and if input is refused.
    """
    folder = work_folder(out, "detections")
    try:
        yield folder
    except InputError:
        remove_side_folder(folder, STRETCH_FILES)
        raise
    remove_side_folder(folder, STRETCH_FILES)


@dataclass(frozen=True)
class _Stretch:
    """Consecutive pictures, and the file of their detections."""

    pictures: IntArray
    file: Path
    is_part: bool = False


class PictureDetector:
    """Detects faces in the pictures of a video that no part or interrupted run holds.

    `folder`: from `detections_folder`. `open_files`: closes the model, which is loaded for the
    first picture. Attributes: `digest`, SHA-256 of the model, and `score_names`, empty until a face
    was detected.
    """

    def __init__(
        self,
        spec: TrackSpec,
        provenance: Provenance,
        folder: Path,
        open_files: contextlib.ExitStack,
    ) -> None:
        self._spec, self._folder, self._open_files = spec, folder, open_files
        self._parts = spec.parts or ()
        self._inputs = provenance.inputs
        self._video = spec.video
        self._model: Path | None = None
        self._finder: FaceLandmarker | None = None
        self.digest = ""
        self.score_names: tuple[str, ...] = ()

    def detect(
        self, path: Path, video: OpenVideo, timing: PictureTiming, progress: Progress
    ) -> Iterator[PictureFaces]:
        """Yield the faces in each picture of a video."""
        self._video = path
        parts = [self._part_pictures(path) for path in self._parts]
        owner = np.full(len(timing.pictures), -1)
        for number, pictures in enumerate(parts):
            owner[np.isin(timing.pictures, pictures)] = number
        if (owner < 0).any():
            self._check_model()
        stretches = list(self._stretches(timing.pictures, owner))
        # Only one picture of a sequence is hashed, so changes of others would not be noticed.
        stored = len(stretches) > 1 and not isinstance(video, ImageSequence)
        if stored and (owner < 0).any():
            make_side_folder(self._folder)
        done = 0
        for stretch in stretches:
            ahead = part(
                progress,
                done / len(timing.pictures),
                (done + len(stretch.pictures)) / len(timing.pictures),
            )
            done += len(stretch.pictures)
            yield from self._faces(stretch, video, ahead, stored=stored)

    def write(
        self,
        out: Path,
        pictures: IntArray,
        faces: list[PictureFaces],
        made: Provenance | None = None,
    ) -> None:
        """Write the detections in some pictures."""
        every = [face for each in faces for face in (*each.direct, *each.mirrored)]
        arrays = {
            "pictures": pictures,
            "counts": np.array([(len(each.direct), len(each.mirrored)) for each in faces]),
            "landmarks": np.array([face.landmarks for face in every]),
            "scores": np.array([face.scores for face in every]),
        }
        names = {"madeFrom": self._made_from(), "scoreNames": self.score_names}
        write_detections(out, arrays, names, provenance=made)

    def _made_from(self) -> tuple[str, ...]:
        return (self._video_hash(), self._spec.quality, self.digest)

    def _video_hash(self) -> str:
        anchor = self._spec.out.resolve().parent  # as provenance names inputs
        return self._inputs.get(relative_name(self._video, anchor), "")

    def _check_model(self) -> None:
        self._model = named_model(self._spec.model)
        digest = check_model(self._model)
        if self.digest not in ("", digest):
            raise InputError(
                f"{self._model}: the parts were made with another model; give that with --model"
            )
        self.digest = digest

    def _part_pictures(self, path: Path) -> IntArray:
        """Return the pictures of a part, after checking that it is of this video."""
        arrays, names = read_detections(path, _ARRAYS[:1], _NAMES)
        made = (*names["madeFrom"], "", "", "")[:3]  # also of a damaged file
        expected = (self._video_hash(), self._spec.quality, self.digest or made[-1])
        if made != expected:
            kinds = ("video", "--quality", "model")
            other = next(kind for kind, a, b in zip(kinds, made, expected, strict=True) if a != b)
            raise InputError(
                f"{path}: was made with another {other} than this take, or it has changed since; "
                "make the part again"
            )
        self.digest = made[-1]
        return arrays["pictures"].astype(np.int64)

    def _stretches(self, pictures: IntArray, owner: IntArray) -> Iterator[_Stretch]:
        key = hash_text("\n".join(self._made_from()))[:16]
        edges = np.flatnonzero(np.diff(owner)) + 1
        for rows in np.split(np.arange(len(pictures)), edges):
            if owner[rows[0]] >= 0:
                yield _Stretch(pictures[rows], self._parts[owner[rows[0]]], is_part=True)
                continue
            for start in range(0, len(rows), _STRETCH_PICTURES):
                stretch = pictures[rows[start : start + _STRETCH_PICTURES]]
                name = f"{key}.{stretch[0]:07d}-{stretch[-1]:07d}.usdc"
                yield _Stretch(stretch, self._folder / name)

    def _faces(
        self, stretch: _Stretch, video: OpenVideo, progress: Progress, *, stored: bool
    ) -> list[PictureFaces]:
        """Return the faces in the pictures of a stretch, from its file if it is there."""
        if stretch.is_part:
            return self._read(stretch.file, stretch.pictures)
        if stored and stretch.file.is_file():
            with contextlib.suppress(InputError):  # damaged, so detected again
                return self._read(stretch.file, stretch.pictures)
        faces = []
        for number, index in enumerate(stretch.pictures.tolist()):
            picture = video.frame(index)
            if self._finder is None:
                assert self._model is not None
                self._finder = self._open_files.enter_context(FaceLandmarker(self._model))
            faces.append(
                detect_faces(self._finder, picture, mirrored=self._spec.quality == "final")
            )
            if number % 8 == 0:
                progress(number / len(stretch.pictures), f"tracking {self._video.name}")
        if self._finder is not None:
            self.score_names = self._finder.score_names
        if stored:
            self.write(stretch.file, stretch.pictures, faces)
        return faces

    def _read(self, path: Path, wanted: IntArray) -> list[PictureFaces]:
        arrays, names = read_detections(path, _ARRAYS, _NAMES)
        pictures, counts = (arrays[name].astype(np.int64) for name in _ARRAYS[:2])
        landmarks, scores = (arrays[name].astype(np.float64) for name in _ARRAYS[2:])
        ends = counts.ravel().cumsum()
        fitting = (
            counts.shape == (len(pictures), 2)
            and counts.min(initial=0) >= 0
            and counts.sum() == len(landmarks) == len(scores)
            and (not len(landmarks) or landmarks.shape[1:] == (len(LANDMARKS.names), 3))
        )
        if not fitting or not np.isin(wanted, pictures).all():
            raise InputError(f"{path}: its arrays are inconsistent; make the part again")
        self.score_names = names["scoreNames"] or self.score_names
        faces = [FaceDetection(*each) for each in zip(landmarks, scores, strict=True)]
        split = [faces[end - count : end] for end, count in zip(ends, counts.ravel(), strict=True)]
        rows = np.flatnonzero(np.isin(pictures, wanted))
        return [PictureFaces(split[2 * row], split[2 * row + 1]) for row in rows]
