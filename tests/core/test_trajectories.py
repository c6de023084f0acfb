"""Motion about the frames of pairs."""

import numpy as np

from usdface.core.trajectories import TRAJECTORY_SECONDS, displacements_at, read_trajectories

CENTRE = len(TRAJECTORY_SECONDS) // 2
RATE, FRAMES = 24.0, 200
VELOCITY = np.array([30.0, -12.0, 6.0])


def positions_at(frames: np.ndarray) -> np.ndarray:
    """Return two markers that move uniformly, one of them backwards."""
    assert (np.diff(frames) > 0).all()
    moved = frames[:, None, None] / RATE * VELOCITY
    return np.concatenate([moved, -moved], axis=1)


def test_uniform_motion_is_interpolated_between_frames() -> None:
    frames = np.array([100, 60, 61])
    found = read_trajectories(frames, rate=RATE, first=0, last=FRAMES, positions_at=positions_at)
    seconds = frames[:, None] / RATE + TRAJECTORY_SECONDS
    expected = seconds[:, :, None, None] * np.array([VELOCITY, -VELOCITY])
    np.testing.assert_allclose(found, expected, atol=1e-9)
    moved = displacements_at(found - found[:, [CENTRE]], np.array([0.1, -0.033, 0.0]))
    np.testing.assert_allclose(moved[:, 0], np.outer([0.1, -0.033, 0.0], VELOCITY), atol=1e-9)


def test_motion_is_constant_beyond_the_take_and_the_times() -> None:
    frames = np.array([0, FRAMES])
    found = read_trajectories(frames, rate=RATE, first=0, last=FRAMES, positions_at=positions_at)
    for pair, beyond in ((0, found[0, :CENTRE]), (1, found[1, CENTRE:])):
        expected = np.broadcast_to(found[pair, CENTRE], beyond.shape)
        np.testing.assert_allclose(beyond, expected, atol=1e-9)
    last = displacements_at(found, np.array([9.0, -9.0]))
    np.testing.assert_allclose(last, [found[0, -1], found[1, 0]])
