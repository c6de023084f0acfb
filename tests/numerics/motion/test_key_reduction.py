"""Key reduction: within the tolerance everywhere, and no keys where a line would do."""

import numpy as np
import pytest

from usdface.numerics.motion.key_reduction import _SPAN_FRAMES, reduce_keys, sparse_rows

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


def interpolated(values: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Every frame from the sparse rows, by numpy's own interpolation."""
    frames = np.arange(len(values))
    return np.stack([np.interp(frames, rows, column[rows]) for column in values.T], axis=1)


@pytest.mark.parametrize("count", [0, 1, 2, 3, 64, 65, 100, 128, 129, 1024, 4097])
def test_lines_between_sparse_rows_meet_all_others(count: int) -> None:
    rng = np.random.default_rng(0)
    values = np.cumsum(rng.normal(0, 0.01, (count, 3)), axis=0)
    rows = sparse_rows(values, 0.02)
    if count:
        assert rows[0] == 0
        assert rows[-1] == count - 1
        assert np.abs(interpolated(values, rows) - values).max() <= 0.02 + 1e-6
    assert (np.diff(rows) > 0).all()
    assert len(rows) < 0.8 * count or count < 10


def test_a_line_needs_one_row_a_span() -> None:
    rows = sparse_rows(np.linspace(0, 5, 10 * _SPAN_FRAMES + 1)[:, None], 1e-5)
    np.testing.assert_array_equal(rows, np.arange(11) * _SPAN_FRAMES)


def test_noise_beyond_the_tolerance_is_all_kept() -> None:
    values = np.random.default_rng(0).choice([0.0, 1.0], (257, 1))
    values[1::2] = 1 - values[::2][: len(values) // 2]
    values[::2] = 5 * values[::2]
    assert len(sparse_rows(values, 1e-6)) > 0.7 * len(values)


def test_what_is_kept_of_a_span_depends_on_nothing_before_it() -> None:
    values = np.cumsum(np.random.default_rng(0).normal(0, 0.01, (640, 2)), axis=0)
    rows = sparse_rows(values, 0.02)
    later = sparse_rows(values[5 * _SPAN_FRAMES :], 0.02)
    np.testing.assert_array_equal(rows[rows >= 5 * _SPAN_FRAMES] - 5 * _SPAN_FRAMES, later)
