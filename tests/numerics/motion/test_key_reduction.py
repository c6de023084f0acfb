"""Key reduction: within the tolerance everywhere, and no keys where a line would do."""

import numpy as np
import pytest

from usdface.numerics.motion.key_reduction import reduce_keys

FRAMES = np.arange(400)
CURVES = np.stack(
    [0.5 + 0.5 * np.sin(FRAMES / 17), np.exp(-((FRAMES - 200) ** 2) / 50.0), FRAMES / 400], axis=1
)


def lines(keys: np.ndarray, weights: np.ndarray) -> np.ndarray:
    return np.stack([np.interp(FRAMES, keys, column[keys]) for column in weights.T], axis=1)


@pytest.mark.parametrize("tolerance", [0.001, 0.01, 0.1])
def test_every_frame_is_within_the_tolerance(tolerance: float) -> None:
    keys = reduce_keys(CURVES, tolerance)
    assert np.abs(lines(keys, CURVES) - CURVES).max() <= tolerance
    assert len(keys) < len(FRAMES) * (0.6 if tolerance < 0.01 else 0.25)


def test_no_frames_need_no_keys() -> None:
    assert reduce_keys(np.zeros((0, 3)), 0.1).tolist() == []
    assert reduce_keys(np.zeros((1, 3)), 0.1).tolist() == [0]


def test_straight_lines_are_found_by_their_corners() -> None:
    corners = np.array([0, 31, 64, 200, 399])
    heights = np.random.default_rng(0).random((5, 4))
    weights = np.stack([np.interp(FRAMES, corners, column) for column in heights.T], axis=1)
    np.testing.assert_array_equal(reduce_keys(weights, 1e-9), corners)


def test_the_tolerance_is_in_the_unit_of_the_deviation() -> None:
    size_mm = np.array([30.0, 2.0, 0.0])  # the third shape moves nothing

    def deviation(part: slice, weights: np.ndarray) -> np.ndarray:
        return np.abs(weights - CURVES[part]) @ size_mm

    keys = reduce_keys(CURVES, 0.3, deviation=deviation)
    assert (np.abs(lines(keys, CURVES) - CURVES) @ size_mm).max() <= 0.3


@pytest.mark.parametrize("count", [1, 2])
def test_short_clips_keep_all_they_have(count: int) -> None:
    np.testing.assert_array_equal(reduce_keys(CURVES[:count], 0.5), np.arange(count))


def test_a_tolerance_of_nothing_is_refused() -> None:
    with pytest.raises(ValueError, match="must be positive"):
        reduce_keys(CURVES, 0.0)
