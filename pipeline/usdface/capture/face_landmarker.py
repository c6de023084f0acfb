"""MediaPipe's face landmark model, run on single pictures.

The user supplies the model file; it is never downloaded. Pictures are detected independently:
MediaPipe's video mode filters over time, less accurately than smoothing of the whole take.
"""

import contextlib
import hashlib
import os
import tempfile
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np

from usdface.capture.face_landmarks import LANDMARK_COUNT
from usdface.core.arrays import ByteImage, FloatArray
from usdface.core.errors import InputError
from usdface.core.text import first_few

MODEL_VARIABLE = "USDFACE_FACE_MODEL"
"""Environment variable that names the model where a command does not."""

KNOWN_MODELS = {
    "64184e229b263107bc2b804c6625db1341ff2bb731874b0bcc2fe6544e0bc9ff": "face_landmarker, float16/1"
}
"""SHA-256 of the models whose accuracy was measured."""

MODEL_ADVICE = (
    "tracking needs MediaPipe's face landmark model, face_landmarker.task (3.8 MB, Apache 2.0, "
    "Google: ai.google.dev/edge/mediapipe/solutions/vision/face_landmarker, model bundle "
    f"FaceLandmarker); name its file with --model or in {MODEL_VARIABLE}"
)

_PARTS = ("face_detector.tflite", "face_landmarks_detector.tflite", "face_blendshapes.tflite")
"""Members of the model bundle."""

_LARGEST_MODEL_BYTES = 256 << 20
_MOST_FACES = 4


@dataclass(frozen=True)
class FaceDetection:
    """One face in one picture."""

    landmarks: FloatArray
    """(478, 3): x to the right, y down, z away from the camera and 0 at the centre of the head
    [pixels]."""
    scores: FloatArray
    """(scores,): the model's weights of ARKit's shapes [0-1], in the order of
    `FaceLandmarker.score_names`."""


def named_model(path: Path | None) -> Path:
    """Return `path`, or else the path in the environment variable."""
    named = path or os.environ.get(MODEL_VARIABLE)
    if not named:
        raise InputError(f"no model is named: {MODEL_ADVICE}")
    return Path(named)


def check_model(path: Path) -> str:
    """Check that a file is a complete face landmark model; return its SHA-256."""
    if not path.is_file():
        raise InputError(f"{path}: no such file; {MODEL_ADVICE}")
    size = path.stat().st_size
    if size > _LARGEST_MODEL_BYTES:
        raise InputError(f"{path}: {size >> 20} MiB is too large to be the model; {MODEL_ADVICE}")
    try:
        with zipfile.ZipFile(path) as bundle:
            members = bundle.namelist()
            damaged = bundle.testzip()
    except (zipfile.BadZipFile, OSError, EOFError, NotImplementedError, RuntimeError) as error:
        raise InputError(
            f"{path}: is not a model bundle, or is truncated ({size} bytes: {error}); copy it "
            f"again: {MODEL_ADVICE}"
        ) from error
    if damaged is not None:
        raise InputError(f"{path}: {damaged} in it is damaged; copy the model again")
    missing = [part for part in _PARTS if part not in members]
    if missing:
        raise InputError(
            f"{path}: is a model of another task: it holds {first_few(members)}, and no "
            f"{missing[0]}; {MODEL_ADVICE}"
        )
    return hashlib.sha256(path.read_bytes()).hexdigest()


class FaceLandmarker:
    """The loaded model, a context manager.

    `model`: checked by `check_model`.
    """

    def __init__(self, model: Path) -> None:
        try:
            import mediapipe
            from mediapipe.tasks.python import BaseOptions, vision
        except (ImportError, OSError) as error:  # OSError: a system library is missing
            raise InputError(
                f"tracking needs MediaPipe, which cannot be imported ({error}); install "
                "usdface[track] (340 MB on disk, Apache 2.0), or ingest the landmarks of another "
                "tracker"
            ) from error
        options = vision.FaceLandmarkerOptions(
            base_options=BaseOptions(model_asset_path=str(model)),
            running_mode=vision.RunningMode.IMAGE,
            num_faces=_MOST_FACES,
            output_face_blendshapes=True,
        )
        self._mediapipe = mediapipe
        self.score_names: tuple[str, ...] = ()
        """ARKit's names of the scored shapes; empty until a face has been found."""
        try:
            with _without_library_log():
                self._landmarker = vision.FaceLandmarker.create_from_options(options)
                self.find_faces(np.zeros((64, 64, 3), np.uint8))  # the first call logs
        except (RuntimeError, ValueError) as error:
            raise InputError(
                f"{model}: MediaPipe {mediapipe.__version__} does not load it ({error}); "
                f"{MODEL_ADVICE}"
            ) from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._landmarker.close()

    def find_faces(self, picture: ByteImage) -> list[FaceDetection]:
        """Return the faces in a picture, at most four.

        `picture`: (height, width, 3), sRGB, upright.
        """
        image = self._mediapipe.Image(
            image_format=self._mediapipe.ImageFormat.SRGB, data=np.ascontiguousarray(picture)
        )
        found = self._landmarker.detect(image)
        height, width = picture.shape[:2]
        size = np.array([width, height, width], np.float64)
        return [
            FaceDetection(_positions(landmarks) * size, self._scores(scores))
            for landmarks, scores in zip(found.face_landmarks, found.face_blendshapes, strict=True)
        ]

    def _scores(self, categories: Any) -> FloatArray:
        if not self.score_names:
            self.score_names = tuple(each.category_name for each in categories)
        return np.array([each.score for each in categories], np.float64)


@contextlib.contextmanager
def _without_library_log() -> Iterator[None]:
    """Suppress what MediaPipe's C++ library writes to standard error."""
    before = os.dup(2)
    with tempfile.TemporaryFile() as sink:
        os.dup2(sink.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(before, 2)
            os.close(before)


def _positions(landmarks: Any) -> FloatArray:
    positions = np.array([(each.x, each.y, each.z) for each in landmarks], np.float64)
    if positions.shape != (LANDMARK_COUNT, 3):
        raise InputError(
            f"the model finds {len(positions)} landmarks of a face, not {LANDMARK_COUNT}; "
            f"{MODEL_ADVICE}"
        )
    return positions
