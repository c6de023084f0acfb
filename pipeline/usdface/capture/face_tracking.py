"""Tracking of one face through pictures, from detections in each picture and its mirror image."""

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import mode
from typing import Literal

import numpy as np

from usdface.capture.face_landmarker import FaceDetection, FaceLandmarker
from usdface.capture.face_landmarks import LANDMARKS
from usdface.core.arrays import BoolArray, ByteImage, Float32Array, FloatArray
from usdface.core.errors import InputError
from usdface.numerics.measure.face_regions import mirrored_shapes

FaceChoice = Literal["largest", "left", "right"]

_SAME_FACE = 0.5
"""Distance of two detections [face breadths] above which they are two faces."""
_BACKGROUND_SHARE = 0.5
"""Breadth relative to the broadest face below which a detection is ignored: a person at twice the
distance, or hair and patterns detected as small faces."""
LASTING_PICTURES = 12
"""Half a second at 24 pictures per second: shorter second faces are false detections."""
_DOUBTED_RATIO = 3.0
"""Difference relative to the median over the take above which confidence falls: exceeded by 1 in
500 differences of two Gaussian measurements in a plane (Rayleigh)."""
_USUAL_BREADTHS = 0.01
"""Upper limit of the median difference [face breadths]: 95 % of the landmarks of recorded clips are
below. Larger medians come from occlusion throughout the take."""
_LEAST_CONFIDENCE = 0.1
_CUT_BREADTHS = 1.0
"""Displacement between two pictures [face breadths] that is a cut; heads move by 0.1."""
_CUT_SHAPE = 0.03
"""Change of the skull's landmarks between two pictures [face breadths, RMS] that is a cut: at most
0.018 in 1,400 pictures of four turning heads, 0.039 between two persons."""
_CUT_LOG_SIZE = float(np.log(1.2))
"""Change of log size between two pictures that is a cut; at most 4 % in the same pictures."""


@dataclass(frozen=True)
class PictureFaces:
    """The faces in a picture, with the landmarks of `LANDMARKS` in single precision."""

    direct: list[FaceDetection]
    mirrored: list[FaceDetection]
    """Detected in the mirror image, mirrored back."""


def detect_faces(detector: FaceLandmarker, picture: ByteImage, *, mirrored: bool) -> PictureFaces:
    """Return the faces in a picture, and if `mirrored` those in its mirror image."""
    direct = [_markers(face) for face in detector.find_faces(picture)]
    if not (mirrored and direct):
        return PictureFaces(direct, [])
    again = []
    for face in detector.find_faces(picture[:, ::-1]):
        back = face.landmarks * (-1, 1, 1) + (picture.shape[1], 0, 0)
        found = _markers(FaceDetection(back, face.scores))
        again.append(FaceDetection(found.landmarks[LANDMARKS.mirror], found.scores))
    return PictureFaces(direct, again)


def _markers(face: FaceDetection) -> FaceDetection:
    """Return a face's landmarks of `LANDMARKS`, rounded to single precision."""
    landmarks, scores = face.landmarks[LANDMARKS.indices], face.scores
    return FaceDetection(
        landmarks.astype(np.float32).astype(np.float64),
        scores.astype(np.float32).astype(np.float64),
    )


@dataclass(frozen=True)
class FaceTrack:
    """The landmarks of `LANDMARKS` over pictures."""

    positions: Float32Array
    """(pictures, markers, 3): x to the right, y down, z away from the camera [pixels]; NaN without
    a face."""
    difference: Float32Array
    """(pictures, markers): between picture and mirror image, in the image plane [pixels]; NaN
    without a face in the mirror image."""
    scores: Float32Array
    """(pictures, scores): the model's weights, mean of picture and mirror image; NaN without a
    face."""
    size: tuple[int, int]
    """Width and height of the pictures [pixels]."""

    @property
    def seen(self) -> BoolArray:
        """(pictures,): whether there is a face."""
        return np.isfinite(self.positions[:, 0, 0])

    @property
    def outside(self) -> BoolArray:
        """(pictures, markers): whether the picture's edge cuts a landmark off."""
        at = self.positions[..., :2]
        return np.asarray(((at < 0) | (at > self.size)).any(axis=-1))

    def jumps(self) -> BoolArray:
        """Return the first pictures after a cut: (pictures,) bool.

        A cut changes the position, the size, or the relative positions of the skull's landmarks
        (another person) by more than motion does.
        """
        rows = np.flatnonzero(self.seen)
        jumps = np.zeros(len(self.positions), bool)
        skull = [LANDMARKS.names.index(name) for name in LANDMARKS.rigid]
        at = self.positions[rows, :, 0] + 1j * self.positions[rows, :, 1].astype(np.float64)
        breadth = np.maximum(np.ptp(at.real, axis=1), 1e-6)[1:]
        step = np.abs(np.diff(at.mean(axis=1)))
        centred = at[:, skull] - at[:, skull].mean(axis=1, keepdims=True)
        before, after = centred[:-1], centred[1:]
        # Least-squares similarity: a complex factor rotates and scales.
        similarity = (before.conj() * after).sum(axis=1) / (np.abs(before) ** 2).sum(axis=1)
        away = np.abs(after - similarity[:, None] * before)
        shape = np.sqrt((away**2).mean(axis=1)) / breadth
        size = np.abs(np.log(np.maximum(np.abs(similarity), 1e-6)))
        changed = (step > _CUT_BREADTHS * breadth) | (shape > _CUT_SHAPE) | (size > _CUT_LOG_SIZE)
        jumps[rows[1:]] = changed & (np.diff(rows) == 1)
        return jumps

    def mirror_difference(self) -> float:
        """Return the median of `difference` [face breadths]; 0 without detections."""
        found = self.difference[np.isfinite(self.difference)]
        return float(np.median(found)) / self._breadth() if len(found) else 0.0

    def _breadth(self) -> float:
        """Return the median breadth of the face [pixels]."""
        return float(np.median(np.ptp(self.positions[self.seen, :, 0], axis=1)))

    def confidence(self) -> Float32Array:
        """Return the confidence of each sample: (pictures, markers) [0-1].

        ``min(1, (3 m / d)**2)`` for a difference d whose median over the take is m: lower where a
        hand or hair covers the face and in blurred pictures.
        """
        difference = self.difference.astype(np.float64)
        found = np.isfinite(difference).all(axis=1)
        trust = np.where(self.seen, _LEAST_CONFIDENCE, 0.0)[:, None].repeat(
            difference.shape[1], axis=1
        )
        if found.any():
            usual = np.minimum(
                np.median(difference[found], axis=0), _USUAL_BREADTHS * self._breadth()
            )
            usual = np.maximum(usual, 1e-3)
            ratio = np.maximum(difference[found] / (_DOUBTED_RATIO * usual), 1.0)
            trust[found] = np.maximum(ratio**-2, _LEAST_CONFIDENCE)
        return trust.astype(np.float32)


class FaceTracker:
    """Follows one face from picture to picture.

    Parameters
    ----------
    choice : FaceChoice or None
        Face to start with if there are several; left and right of the picture. None refuses
        several.
    mirrored : bool
        Whether mirror images are detected too: their mean with the picture has less noise, their
        difference gives the confidence.
    """

    def __init__(self, choice: FaceChoice | None, *, mirrored: bool) -> None:
        self._choice = choice
        self._mirrored = mirrored
        self._last: FloatArray | None = None
        self._others: list[FloatArray] = []
        """Last positions of the other faces."""
        self._crowded_pictures = 0
        self._rows: list[tuple[FloatArray, FloatArray, FloatArray, FloatArray | None]] = []

    def choose(self, opening: Sequence[PictureFaces]) -> None:
        """Choose the face to start with from the first pictures, if a choice was given.

        The first picture may lack a face that the next ones show, and some show false faces: the
        first picture that has as many faces as most of them decides.
        """
        pictures = [faces for each in opening if (faces := _distinct(each.direct))]
        if self._choice is None or not pictures:
            return
        usual = mode(map(len, pictures))
        face = self._pick(next(faces for faces in pictures if len(faces) == usual))
        assert face is not None
        self._last = face.landmarks

    def add(self, found: PictureFaces, *, where: str) -> None:
        """Add the face of the next picture, if there is one.

        `InputError` if no face was chosen and there are several, at the start or for half a second.
        """
        faces = _distinct(found.direct)
        marker_count = len(LANDMARKS.names)
        self._crowded_pictures = self._crowded_pictures + 1 if len(faces) > 1 else 0
        lasting = self._last is None or self._crowded_pictures >= LASTING_PICTURES
        if len(faces) > 1 and lasting and self._choice is None:
            raise InputError(
                f"{where}: {len(faces)} faces in the picture; choose one with --face largest, left "
                "or right (it is then followed), or crop the video"
            )
        face = self._pick(faces)
        if face is None:
            nothing, unknown = np.full((marker_count, 3), np.nan), np.array([np.nan])
            self._rows.append((nothing, nothing[:, 0], unknown, None))
            return
        self._last = face.landmarks
        positions = face.landmarks
        difference = np.zeros(marker_count)
        mirrored_scores: FloatArray | None = None
        if self._mirrored:
            reach = _SAME_FACE * _breadth(positions)
            again = [
                each for each in found.mirrored if _distance(each.landmarks, positions) < reach
            ]
            if again:
                difference = np.linalg.norm((positions - again[-1].landmarks)[:, :2], axis=1)
                positions = (positions + again[-1].landmarks) / 2
                mirrored_scores = again[-1].scores
            else:
                difference[:] = np.nan
        self._rows.append((positions, difference, face.scores, mirrored_scores))

    def track(self, score_names: tuple[str, ...], size: tuple[int, int]) -> FaceTrack:
        """Return the pictures so far, of a width and height.

        `score_names`: of `FaceLandmarker`; scores of mirror images have left and right exchanged.
        """
        other = mirrored_shapes(score_names)
        scores = [
            direct if mirrored is None else (direct + mirrored[other]) / 2
            for *_, direct, mirrored in self._rows
        ]
        count = max(map(len, scores), default=0)
        return FaceTrack(
            np.array([row[0] for row in self._rows], np.float32),
            np.array([row[1] for row in self._rows], np.float32),
            np.array([np.broadcast_to(each, count) for each in scores], np.float32),
            size,
        )

    def _pick(self, faces: list[FaceDetection]) -> FaceDetection | None:
        """Return the tracked face; None if only others are detected."""
        if not faces:
            return None
        if self._last is not None:
            face = min(faces, key=lambda face: _distance(face.landmarks, self._last))
            way = _distance(face.landmarks, self._last)
            if any(_distance(face.landmarks, other) < way for other in self._others):
                self._others = [each.landmarks for each in faces]
                return None
        elif self._choice == "largest" or self._choice is None:
            face = max(faces, key=lambda face: _breadth(face.landmarks))
        else:
            side = 1 if self._choice == "left" else -1
            face = min(faces, key=lambda face: side * float(face.landmarks[:, 0].mean()))
        self._others = [each.landmarks for each in faces if each is not face]
        return face


def _distinct(faces: list[FaceDetection]) -> list[FaceDetection]:
    """Remove small detections and duplicates."""
    distinct: list[FaceDetection] = []
    least = _BACKGROUND_SHARE * max((_breadth(face.landmarks) for face in faces), default=0.0)
    for face in faces:
        reach = _SAME_FACE * _breadth(face.landmarks)
        if _breadth(face.landmarks) >= least and all(
            _distance(face.landmarks, other.landmarks) > reach for other in distinct
        ):
            distinct.append(face)
    return distinct


def _breadth(landmarks: FloatArray) -> float:
    return float(np.ptp(landmarks[:, 0]))


def _distance(one: FloatArray, other: FloatArray | None) -> float:
    """Return the distance between the centres of two faces [pixels]."""
    if other is None:
        return 0.0
    return float(np.linalg.norm(one[:, :2].mean(axis=0) - other[:, :2].mean(axis=0)))
