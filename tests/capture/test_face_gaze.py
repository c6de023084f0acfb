"""Known turns of the eyes come back; a blink is no look down."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.capture.simulated_faces import head_points, turning_head
from usdface.capture.face_gaze import (
    FULL_LOOK_DEGREES,
    IRIS_RADIUS_MM,
    LOOK_SHAPES,
    closed_eyes,
    gaze_angles,
)
from usdface.capture.face_landmarks import LANDMARKS

FRAMES = 60


def moving_eyes(yaw: np.ndarray, pitch: np.ndarray, blink: np.ndarray) -> np.ndarray:
    """(frames, markers, 3): eyes that turn by angles [degrees] in a head that moves.

    Where `blink` is 1 the lids meet and the iris is guessed 4 mm too low, as models do.
    """
    frames = []
    for number in range(len(yaw)):
        points = turning_head(number, at=(0, 0, 0))
        turn = np.linalg.lstsq(head_points(), points, rcond=None)[0].T
        local = points @ turn
        for side in "RL":
            iris = [at for at in LANDMARKS.columns("iris") if f"_{side}" in LANDMARKS.names[at]]
            lids = [
                [at for at in LANDMARKS.columns(part) if f"_{side}" in LANDMARKS.names[at]]
                for part in ("lid_upper", "lid_lower")
            ]
            row = LANDMARKS.indices[iris]
            look = Rotation.from_euler("yx", [yaw[number], -pitch[number]], degrees=True)
            local[row] += look.apply([0, 0, IRIS_RADIUS_MM]) - [0, 0, IRIS_RADIUS_MM]
            local[row] -= [0, 4 * blink[number], 0]
            for at, height in zip(lids, (5, -5), strict=True):
                local[LANDMARKS.indices[at], 1] = height * (1 - 0.95 * blink[number])
        frames.append((local @ turn.T)[LANDMARKS.indices])
    return np.stack(frames)


def test_turns_of_the_eyes_come_back() -> None:
    time = np.arange(FRAMES)
    yaw = np.where(time < 10, 0, 20 * np.sin(time / 6))
    pitch = np.where(time < 10, 0, 12 * np.cos(time / 9))
    positions = moving_eyes(yaw, pitch, np.zeros(FRAMES))
    seen = np.ones(FRAMES, bool)
    closed = closed_eyes(positions, seen)
    assert not closed.any()
    gaze = gaze_angles(positions, seen, closed, neutral=3)
    # The second turn is about an axis that the first has turned: a cosine of the other angle.
    assert np.abs(gaze.yaw - yaw[:, None]).max() < 1.0
    assert np.abs(gaze.pitch - pitch[:, None]).max() < 1.0
    weights = dict(zip(LOOK_SHAPES, gaze.look_weights().T, strict=True))
    left = int(np.argmax(yaw))
    assert weights["eyeLookOutLeft"][left] == pytest.approx(yaw[left] / FULL_LOOK_DEGREES, abs=0.04)
    assert weights["eyeLookInRight"][left] == pytest.approx(yaw[left] / FULL_LOOK_DEGREES, abs=0.04)
    assert weights["eyeLookInLeft"][left] == weights["eyeLookOutRight"][left] == 0


def test_a_blink_is_no_look_down() -> None:
    blink = np.zeros(FRAMES)
    blink[30:34] = (0.5, 1, 1, 0.6)
    positions = moving_eyes(np.zeros(FRAMES), np.zeros(FRAMES), blink)
    seen = np.ones(FRAMES, bool)
    closed = closed_eyes(positions, seen)
    assert closed[31:33].all()
    assert closed.any(axis=1).sum() <= 6
    gaze = gaze_angles(positions, seen, closed, neutral=3)
    assert np.abs(gaze.pitch).max() < 1e-3
    unguarded = gaze_angles(positions, seen, np.zeros_like(closed), neutral=3)
    assert unguarded.pitch.min() < -15
