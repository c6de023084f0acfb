"""Known turns of the eyes come back; a blink is no look down."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.capture.simulated_faces import IRIS_DIAMETER, head_points, turning_head
from usdface.capture.face_gaze import (
    FULL_LOOK_DEGREES,
    IRIS_TURN_RATIO,
    LOOK_SHAPES,
    closed_eyes,
    gaze_angles,
)
from usdface.capture.face_landmarks import LANDMARKS
from usdface.numerics.rigid.rigid_alignment import RigidAlignment, align_rigid

NAMES = LANDMARKS.names
FRAMES = 60
RADIUS = IRIS_TURN_RATIO * IRIS_DIAMETER
"""About which eyes turn [mm]."""


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
            local[row] += look.apply([0, 0, RADIUS]) - [0, 0, RADIUS]
            local[row] -= [0, 4 * blink[number], 0]
            for at, height in zip(lids, (5, -5), strict=True):
                local[LANDMARKS.indices[at], 1] = height * (1 - 0.95 * blink[number])
        frames.append((local @ turn.T)[LANDMARKS.indices])
    return np.stack(frames)


def head_of(positions: np.ndarray) -> RigidAlignment:
    skull = [LANDMARKS.names.index(name) for name in LANDMARKS.rigid]
    return align_rigid(positions[:, skull], positions[3][skull])


def test_turns_of_the_eyes_come_back() -> None:
    time = np.arange(FRAMES)
    yaw = np.where(time < 10, 0, 20 * np.sin(time / 6))
    pitch = np.where(time < 10, 0, 12 * np.cos(time / 9))
    positions = moving_eyes(yaw, pitch, np.zeros(FRAMES))
    seen = np.ones(FRAMES, bool)
    closed = closed_eyes(positions, seen)
    assert not closed.any()
    gaze = gaze_angles(positions, head_of(positions), closed, neutral=3)
    # The second turn is about an axis that the first has turned: a cosine of the other angle.
    assert np.abs(gaze.yaw - yaw).max() < 1.0
    assert np.abs(gaze.pitch - pitch).max() < 1.0
    weights = dict(zip(LOOK_SHAPES, gaze.look_weights().T, strict=True))
    left = int(np.argmax(yaw))
    assert weights["eyeLookOutLeft"][left] == pytest.approx(yaw[left] / FULL_LOOK_DEGREES, abs=0.04)
    assert weights["eyeLookInRight"][left] == pytest.approx(yaw[left] / FULL_LOOK_DEGREES, abs=0.04)
    assert weights["eyeLookInLeft"][left] == weights["eyeLookOutRight"][left] == 0


def test_outer_corners_that_follow_the_lids_and_a_head_off_its_place_are_no_look() -> None:
    pitch = np.where(np.arange(FRAMES) < 10, 0, -8.0)
    positions = moving_eyes(np.zeros(FRAMES), pitch, np.zeros(FRAMES))
    head = head_of(positions)
    outer = [
        at for side in "RL" for at in LANDMARKS.columns("eye_outer") if f"_{side}" in NAMES[at]
    ]
    squint = np.where(np.arange(FRAMES) < 10, 0, -2.0)[:, None, None]
    positions[:, outer] += squint * np.einsum("fij,j->fi", head.rotations, [0, 1, 0])[:, None]
    head = replace(head, translations=head.translations - squint[:, 0])
    closed = np.zeros((FRAMES, 2), bool)
    assert np.abs(gaze_angles(positions, head, closed, neutral=3).pitch - pitch).max() < 1.0


def test_a_blink_is_no_look_down() -> None:
    blink = np.zeros(FRAMES)
    blink[30:34] = (0.5, 1, 1, 0.6)
    positions = moving_eyes(np.zeros(FRAMES), np.zeros(FRAMES), blink)
    seen = np.ones(FRAMES, bool)
    closed = closed_eyes(positions, seen)
    assert closed[31:33].all()
    assert closed.any(axis=1).sum() <= 6
    gaze = gaze_angles(positions, head_of(positions), closed, neutral=3)
    assert np.abs(gaze.pitch).max() < 1e-3
    unguarded = gaze_angles(positions, head_of(positions), np.zeros_like(closed), neutral=3)
    assert unguarded.pitch.min() < -15


def test_a_drawn_eye_that_is_twice_as_large_turns_as_far() -> None:
    """The scale of the face is a guess: the iris of each eye is its own measure."""
    time = np.arange(FRAMES)
    positions = moving_eyes(np.where(time < 10, 0, 15.0), np.zeros(FRAMES), np.zeros(FRAMES))
    closed = np.zeros((FRAMES, 2), bool)
    gaze = gaze_angles(2 * positions, head_of(2 * positions), closed, neutral=3)
    np.testing.assert_allclose(gaze.yaw[20:], 15, atol=0.5)


def test_a_wrong_pose_of_the_head_is_no_look_aside() -> None:
    """The head is taken to be half as far aside as it is: only the eye's corners know."""
    positions = moving_eyes(np.zeros(FRAMES), np.zeros(FRAMES), np.zeros(FRAMES))
    aside = np.linspace(0, 20, FRAMES)
    positions = positions + aside[:, None, None] * [1, 0, 0]
    head = head_of(positions - aside[:, None, None] * [0.5, 0, 0])
    gaze = gaze_angles(positions, head, np.zeros((FRAMES, 2), bool), neutral=3)
    assert np.abs(gaze.yaw).max() < 1.0


def test_of_a_wink_the_open_eye_says_where_both_look() -> None:
    time = np.arange(FRAMES)
    yaw = np.where(time < 10, 0, 15 * np.sin(time / 6))
    positions = moving_eyes(yaw, np.zeros(FRAMES), np.zeros(FRAMES))
    closed = np.zeros((FRAMES, 2), bool)
    closed[20:40, 0] = True
    gaze = gaze_angles(positions, head_of(positions), closed, neutral=3)
    assert np.abs(gaze.yaw - yaw).max() < 1.0


def test_noise_of_one_eye_is_halved_by_the_other() -> None:
    positions = moving_eyes(np.zeros(FRAMES), np.zeros(FRAMES), np.zeros(FRAMES))
    right = [at for at in LANDMARKS.columns("iris") if "_R" in LANDMARKS.names[at]]
    positions[20:, right] += (2.0, 0.0, 0.0)
    head = head_of(positions)
    gaze = gaze_angles(positions, head, np.zeros((FRAMES, 2), bool), neutral=3)
    whole = gaze_angles(positions, head, np.tile([False, True], (FRAMES, 1)), neutral=3)
    np.testing.assert_allclose(gaze.yaw[20:], whole.yaw[20:] / 2, atol=0.3)
