"""One face followed through pictures, chosen where there are several; each is measured twice."""

from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from usdface.capture.face_landmarker import FaceFinding
from usdface.capture.face_landmarks import LANDMARKS
from usdface.core.arrays import BoolArray, ByteImage, Float32Array, FloatArray
from usdface.core.errors import InputError

FaceChoice = Literal["largest", "left", "right"]

_SAME_FACE = 0.5
"""Of a face's breadth: two findings whose middles lie further apart are of two faces."""
_BACKGROUND_SHARE = 0.5
"""Of the breadth of the broadest face: who is twice as far from the camera is not who is filmed,
and detectors take hair and patterns for small faces."""
_LASTING_PICTURES = 12
"""Half a second of a slow camera: a second face that is gone sooner is hair, or a pattern."""
_DOUBTED_RATIO = 3.0
"""Times the median over the take: 1 in 500 differences of two Gaussian measurements in a plane
(Rayleigh) is larger."""
_USUAL_BREADTHS = 0.01
"""Of a face's breadth: so far apart both are at most at 95 of 100 landmarks of recorded clips. What
is more is no measure of what is usual: a hand may be there throughout."""
_LEAST_CONFIDENCE = 0.1
_CUT_BREADTHS = 1.0
"""Of a face's breadth, from one picture to the next: heads move by a tenth."""
_CUT_SHAPE = 0.03
"""Of a face's breadth, by which landmarks of the skull come to lie otherwise: 0.018 at most in
1,400 pictures of four heads that turn, 0.039 from one person to another."""
_CUT_LOG_SIZE = float(np.log(1.2))
"""Of the face's size: 4 % at most in the same pictures."""


class FaceFinder(Protocol):
    """What finds faces in a picture, as `FaceLandmarker` does."""

    @property
    def score_names(self) -> tuple[str, ...]:
        """Names of the scores of each face."""

    def find_faces(self, picture: ByteImage) -> list[FaceFinding]:
        """Return the faces in a picture."""


@dataclass(frozen=True)
class PictureFaces:
    """The faces in a picture: of each the landmarks of `LANDMARKS`, in single precision."""

    direct: list[FaceFinding]
    mirrored: list[FaceFinding]
    """Those in its mirror image, back in the picture's place."""


def detect_faces(finder: FaceFinder, picture: ByteImage, *, mirrored: bool) -> PictureFaces:
    """Return the faces in a picture, and with `mirrored` those in its mirror image."""
    direct = [_markers(face) for face in finder.find_faces(picture)]
    if not (mirrored and direct):
        return PictureFaces(direct, [])
    again = []
    for face in finder.find_faces(picture[:, ::-1]):
        back = face.landmarks * (-1, 1, 1) + (picture.shape[1], 0, 0)
        found = _markers(FaceFinding(back, face.scores))
        again.append(FaceFinding(found.landmarks[LANDMARKS.mirror], found.scores))
    return PictureFaces(direct, again)


def _markers(face: FaceFinding) -> FaceFinding:
    """Return a face's landmarks that are markers, as precise as they are kept."""
    landmarks, scores = face.landmarks[LANDMARKS.indices], face.scores
    return FaceFinding(
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
    """(pictures, markers): between the picture and its mirror image, across the line of sight
    [pixels]; NaN where the mirror image shows no face."""
    scores: Float32Array
    """(pictures, scores): the model's own weights, the mean of those of the picture and of its
    mirror image; NaN without a face."""

    @property
    def seen(self) -> BoolArray:
        """(pictures,): where there is a face."""
        return np.isfinite(self.positions[:, 0, 0])

    def jumps(self) -> BoolArray:
        """Return the pictures before which the face changes as none does by itself: (pictures,).

        It lies elsewhere, has another size, or landmarks of the skull lie otherwise to each other:
        a cut, perhaps to another person in the same place.
        """
        rows = np.flatnonzero(self.seen)
        jumps = np.zeros(len(self.positions), bool)
        skull = [LANDMARKS.names.index(name) for name in LANDMARKS.rigid]
        at = self.positions[rows, :, 0] + 1j * self.positions[rows, :, 1].astype(np.float64)
        breadth = np.maximum(np.ptp(at.real, axis=1), 1e-6)[1:]
        step = np.abs(np.diff(at.mean(axis=1)))
        centred = at[:, skull] - at[:, skull].mean(axis=1, keepdims=True)
        before, after = centred[:-1], centred[1:]
        # The similarity of least squares: one complex number turns and scales.
        similarity = (before.conj() * after).sum(axis=1) / (np.abs(before) ** 2).sum(axis=1)
        away = np.abs(after - similarity[:, None] * before)
        shape = np.sqrt((away**2).mean(axis=1)) / breadth
        size = np.abs(np.log(np.maximum(np.abs(similarity), 1e-6)))
        changed = (step > _CUT_BREADTHS * breadth) | (shape > _CUT_SHAPE) | (size > _CUT_LOG_SIZE)
        jumps[rows[1:]] = changed & (np.diff(rows) == 1)
        return jumps

    def mirror_difference(self) -> float:
        """Return the median of `difference`, in breadths of the face; 0 where nothing is found."""
        found = self.difference[np.isfinite(self.difference)]
        return float(np.median(found)) / self._breadth() if len(found) else 0.0

    def _breadth(self) -> float:
        """Return the median breadth of the face [pixels]."""
        return float(np.median(np.ptp(self.positions[self.seen, :, 0], axis=1)))

    def confidence(self) -> Float32Array:
        """Return how far each sample can be trusted: (pictures, markers) [0-1].

        1 where the two measurements differ as they usually do at this landmark, falling with the
        square of the difference beyond: a hand before the mouth, hair, a blurred picture.
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


class FaceFollower:
    """Measures one face in picture after picture.

    Parameters
    ----------
    choice : FaceChoice or None
        Which face to begin with where there are several, left and right in the picture; None
        refuses them.
    mirrored : bool
        Whether each picture is looked at a second time in the mirror: the mean of both has less
        noise, and what differs is doubtful.
    """

    def __init__(self, choice: FaceChoice | None, *, mirrored: bool) -> None:
        self._choice = choice
        self._mirrored = mirrored
        self._last: FloatArray | None = None
        self._others: list[FloatArray] = []
        """Other faces, where each was last seen."""
        self._crowded_pictures = 0
        self._rows: list[tuple[FloatArray, FloatArray, FloatArray, FloatArray | None]] = []

    def look(self, found: PictureFaces, *, where: str) -> bool:
        """Measure the face in the next picture; return whether there is one.

        Raises
        ------
        InputError
            If there are several faces, at first or for half a second, and none was chosen.
        """
        faces = _distinct(found.direct)
        marker_count = len(LANDMARKS.names)
        self._crowded_pictures = self._crowded_pictures + 1 if len(faces) > 1 else 0
        lasting = self._last is None or self._crowded_pictures >= _LASTING_PICTURES
        if len(faces) > 1 and lasting and self._choice is None:
            raise InputError(
                f"{where}: {len(faces)} faces in the picture; choose one with --face largest, left "
                "or right (it is then followed), or crop the video"
            )
        face = self._pick(faces)
        if face is None:
            nothing, unknown = np.full((marker_count, 3), np.nan), np.array([np.nan])
            self._rows.append((nothing, nothing[:, 0], unknown, None))
            return False
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
        return True

    def track(self, score_names: tuple[str, ...]) -> FaceTrack:
        """Return what was measured so far.

        Parameters
        ----------
        score_names : tuple of str
            As of `FaceFinder`: a mirror image is scored with left and right exchanged.
        """
        other = [score_names.index(_other_side(name)) for name in score_names]
        scores = [
            direct if mirrored is None else (direct + mirrored[other]) / 2
            for *_, direct, mirrored in self._rows
        ]
        count = max(map(len, scores), default=0)
        return FaceTrack(
            np.array([row[0] for row in self._rows], np.float32),
            np.array([row[1] for row in self._rows], np.float32),
            np.array([np.broadcast_to(each, count) for each in scores], np.float32),
        )

    def _pick(self, faces: list[FaceFinding]) -> FaceFinding | None:
        """Return the face that is followed; None where only others are found."""
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


def _other_side(name: str) -> str:
    """Return ARKit's name of the same shape on the other side of the face."""
    side = next((each for each in ("Left", "Right") if name.endswith(each)), "")
    return name.removesuffix(side) + {"Left": "Right", "Right": "Left", "": ""}[side]


def _distinct(faces: list[FaceFinding]) -> list[FaceFinding]:
    """Leave out small findings, and those that lie on another: the detector finds some twice."""
    distinct: list[FaceFinding] = []
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
    """Return how far apart two faces lie in the picture [pixels]."""
    if other is None:
        return 0.0
    return float(np.linalg.norm(one[:, :2].mean(axis=0) - other[:, :2].mean(axis=0)))
