"""Looks that are scored come back as angles; a blink is no look down."""

import numpy as np
import pytest

from tests.capture.simulated_faces import head_points
from usdface.capture.face_gaze import (
    FULL_LOOK_DEGREES,
    LOOK_SHAPES,
    closed_eyes,
    gaze_angles,
    look_weights,
)
from usdface.capture.face_landmarks import LANDMARKS

FRAMES = 60
TIME = np.arange(FRAMES)
YAW = np.where(TIME < 10, 0, 20 * np.sin(TIME / 6))
PITCH = np.where(TIME < 10, 0, 12 * np.cos(TIME / 9))
OPEN = np.ones((FRAMES, 2), bool)


def scored_looks(yaw: np.ndarray, pitch: np.ndarray) -> np.ndarray:
    """Return weights of `LOOK_SHAPES` by their names: (frames, 8)."""
    left, up = yaw / FULL_LOOK_DEGREES, pitch / FULL_LOOK_DEGREES
    ways = {"OutLeft": left, "InRight": left, "InLeft": -left, "OutRight": -left}
    ways |= {f"Up{side}": up for side in ("Left", "Right")}
    ways |= {f"Down{side}": -up for side in ("Left", "Right")}
    return np.stack([np.maximum(ways[name.removeprefix("eyeLook")], 0) for name in LOOK_SHAPES], 1)


def test_looks_come_back_as_angles_and_as_weights() -> None:
    looks = scored_looks(YAW, PITCH)
    yaw, pitch = gaze_angles(looks, OPEN, neutral=3)
    np.testing.assert_allclose(yaw, YAW, atol=1e-9)
    np.testing.assert_allclose(pitch, PITCH, atol=1e-9)
    np.testing.assert_allclose(look_weights(yaw, pitch), looks, atol=1e-6)


def test_eyes_look_straight_ahead_in_the_neutral_frame() -> None:
    yaw, pitch = gaze_angles(scored_looks(YAW + 4, PITCH - 7), OPEN, neutral=3)
    np.testing.assert_allclose(yaw, YAW, atol=1e-9)
    np.testing.assert_allclose(pitch, PITCH, atol=1e-9)


def blinking(closing: np.ndarray) -> np.ndarray:
    """(frames, markers, 3): lids that meet where `closing` is 1."""
    frames = np.repeat(head_points()[LANDMARKS.indices][None], FRAMES, axis=0)
    for part, height in (("lid_upper", 5), ("lid_lower", -5)):
        frames[:, LANDMARKS.columns(part), 1] = height * (1 - 0.95 * closing[:, None])
    return frames


def test_a_blink_is_no_look_down() -> None:
    closing = np.zeros(FRAMES)
    closing[30:34] = (0.5, 1, 1, 0.6)
    closed = closed_eyes(blinking(closing), np.ones(FRAMES, bool))
    assert closed[31:33].all()
    assert closed.any(axis=1).sum() <= 6
    looks = scored_looks(np.zeros(FRAMES), -25 * closing)
    assert np.abs(gaze_angles(looks, ~closed, neutral=3)[1]).max() < 1e-9
    assert gaze_angles(looks, OPEN, neutral=3)[1].min() == pytest.approx(-25)


def test_of_a_wink_the_open_eye_says_where_both_look() -> None:
    looks, winking = scored_looks(YAW, PITCH), OPEN.copy()
    winking[20:40, 0] = False
    looks[20:40, :4] = 0.7
    yaw, pitch = gaze_angles(looks, winking, neutral=3)
    np.testing.assert_allclose(yaw, YAW, atol=1e-9)
    np.testing.assert_allclose(pitch, PITCH, atol=1e-9)


def test_both_eyes_get_the_mean_of_both() -> None:
    looks = scored_looks(YAW, PITCH)
    looks[:, 4:] = scored_looks(0 * YAW, PITCH)[:, 4:]
    np.testing.assert_allclose(gaze_angles(looks, OPEN, neutral=3)[0], YAW / 2, atol=1e-9)


def test_where_no_eye_is_seen_open_both_look_ahead() -> None:
    yaw, pitch = gaze_angles(scored_looks(YAW, PITCH), ~OPEN, neutral=3)
    assert not yaw.any()
    assert not pitch.any()
