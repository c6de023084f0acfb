"""A face finder that needs no model: it shows a head that moves as it is told."""

from collections.abc import Callable
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from usdface.capture.face_gaze import LOOK_SHAPES
from usdface.capture.face_landmarker import FaceDetection
from usdface.capture.face_landmarks import LANDMARK_COUNT, LANDMARKS
from usdface.core.arrays import ByteImage, FloatArray
from usdface.model.placement.face_template import face_template

SCORES = ("_neutral", "eyeBlinkLeft", "jawOpen", "eyeBlinkRight", *LOOK_SHAPES)
IRIS_DIAMETER = 11.7
"""[mm]"""
SKULL = [LANDMARKS.indices[LANDMARKS.names.index(name)] for name in LANDMARKS.rigid]


@cache
def head_points() -> FloatArray:
    """(478, 3), read only: an adult's face where labels put it, ears behind it [mm].

    Landmarks without a label are in its middle.
    """
    points = np.zeros((LANDMARK_COUNT, 3))
    template = face_template(LANDMARKS.names)
    points[LANDMARKS.indices[template.columns]] = template.places
    sides = {"temple": (70, 10, -50), "jaw": (55, -60, -20), "cheek": (40, -25, 0)}
    sides |= {"iris": (31, 0, -5)}
    for part, (x, y, z) in sides.items():
        for column in LANDMARKS.columns(part):
            side = 1 if "_L" in LANDMARKS.names[column] else -1
            points[LANDMARKS.indices[column]] = (side * x, y, z)
    edges = IRIS_DIAMETER / 2 * np.array([(0, 0), (1, 0), (0, 1), (-1, 0), (0, -1)])
    for first in (LANDMARK_COUNT - 10, LANDMARK_COUNT - 5):
        points[first : first + 5, :2] += edges
    points.flags.writeable = False
    return points


class SimulatedFinder:
    """Answers one picture after the other.

    Parameters
    ----------
    faces : function of (picture number) to list of (478, 3) arrays
        Faces in space, seen from the origin along -Z [mm].
    """

    score_names = SCORES

    def __init__(
        self,
        faces: Callable[[int], list[FloatArray]],
        *,
        focal_pixels: float,
        looks: int = 1,
        bias: float = 0.0,
        first: int = 0,
    ) -> None:
        self._faces, self._focal, self._looks, self._bias = faces, focal_pixels, looks, bias
        self._count = first * looks

    def __enter__(self) -> "SimulatedFinder":
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing is held."""

    def find_faces(self, picture: ByteImage) -> list[FaceDetection]:
        number, look = divmod(self._count, self._looks)
        self._count += 1
        height, width = picture.shape[:2]
        found: list[FaceDetection] = []
        heads = self._faces(number)
        if not heads:  # nobody looks into the mirror
            self._count = (number + 1) * self._looks
        for points in heads:
            depth = -points[:, 2]
            x = width / 2 + self._focal * points[:, 0] / depth
            y = height / 2 - self._focal * points[:, 1] / depth
            middle = depth[SKULL].mean()
            z = (depth - middle) * self._focal / middle
            landmarks = np.stack([x, y, z], axis=1)
            if look:  # in the mirror, left is called right
                landmarks = landmarks * (-1, 1, 1) + (width, 0, 0)
                landmarks[LANDMARKS.indices] = landmarks[LANDMARKS.indices][LANDMARKS.mirror]
            scores = np.array([0.0, 0.1, 0.5 + 0.01 * number, 0.3, *np.zeros(len(LOOK_SHAPES))])
            if look:
                scores[[1, 3]] = scores[[3, 1]]
            found.append(FaceDetection(np.add(landmarks, [self._bias, 0, 0]), scores))
        return found


def turning_head(number: int, *, at: tuple[float, float, float] = (0, 0, -600)) -> FloatArray:
    """The head in picture `number`, nodding and shaking a little."""
    turn = Rotation.from_euler("yx", [8 * np.sin(number / 5), 5 * np.sin(number / 7)], degrees=True)
    return np.asarray(head_points() @ turn.as_matrix().T + at)
