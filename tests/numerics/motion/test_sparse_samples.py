"""Samples left out: lines between those kept tell them within the tolerance."""

import numpy as np
import pytest

from usdface.numerics.motion.sparse_samples import SPAN, sparse_rows


def told(values: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Every frame from the rows kept, by numpy's own interpolation."""
    frames = np.arange(len(values))
    return np.stack([np.interp(frames, rows, column[rows]) for column in values.T], axis=1)


@pytest.mark.parametrize("count", [0, 1, 2, 3, 64, 65, 100, 128, 129, 1024, 4097])
def test_lines_between_kept_rows_tell_all_others(count: int) -> None:
    rng = np.random.default_rng(0)
    values = np.cumsum(rng.normal(0, 0.01, (count, 3)), axis=0)
    rows = sparse_rows(values, 0.02)
    if count:
        assert rows[0] == 0
        assert rows[-1] == count - 1
        assert np.abs(told(values, rows) - values).max() <= 0.02 + 1e-6
    assert (np.diff(rows) > 0).all()
    assert len(rows) < 0.8 * count or count < 10


def test_a_line_needs_one_row_a_span() -> None:
    rows = sparse_rows(np.linspace(0, 5, 10 * SPAN + 1)[:, None], 1e-5)
    np.testing.assert_array_equal(rows, np.arange(11) * SPAN)


def test_noise_beyond_the_tolerance_is_all_kept() -> None:
    values = np.random.default_rng(0).choice([0.0, 1.0], (257, 1))
    values[1::2] = 1 - values[::2][: len(values) // 2]
    values[::2] = 5 * values[::2]
    assert len(sparse_rows(values, 1e-6)) > 0.7 * len(values)


def test_what_is_kept_of_a_span_depends_on_nothing_before_it() -> None:
    values = np.cumsum(np.random.default_rng(0).normal(0, 0.01, (640, 2)), axis=0)
    rows = sparse_rows(values, 0.02)
    later = sparse_rows(values[5 * SPAN :], 0.02)
    np.testing.assert_array_equal(rows[rows >= 5 * SPAN] - 5 * SPAN, later)
