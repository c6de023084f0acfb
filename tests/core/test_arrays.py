"""Runs, blocks and samples of frames."""

import numpy as np
import pytest
from scipy.special import ndtri

from usdface.core.arrays import (
    MAD_TO_DEVIATION,
    equal_rows,
    extend_block,
    frame_blocks,
    medians_where,
    relative_distances,
    runs,
    sample_frames,
)


def test_runs_are_found_at_both_ends() -> None:
    assert runs(np.array([1, 1, 0, 1, 0, 0, 1], bool)) == [(0, 2), (3, 4), (6, 7)]
    assert runs(np.zeros(3, bool)) == []


def test_the_factor_is_that_of_a_normal_distribution() -> None:
    assert pytest.approx(1 / ndtri(3 / 4), abs=5e-5) == MAD_TO_DEVIATION


@pytest.mark.parametrize(("count", "frames", "at_least"), [(10, 4, 1), (10, 4, 6), (8, 4, 1)])
def test_blocks_cover_every_frame_once(count: int, frames: int, at_least: int) -> None:
    blocks = list(frame_blocks(count, frames=frames, at_least=at_least))
    covered = np.concatenate([np.arange(count)[block] for block in blocks])
    np.testing.assert_array_equal(covered, np.arange(count))
    assert all(block.stop - block.start >= max(frames, at_least) for block in blocks[:-1])
    around = [extend_block(block, 3, count) for block in blocks]
    assert (around[0].start, around[-1].stop) == (0, count)


@pytest.mark.parametrize(("count", "most"), [(1, 5), (5, 5), (100, 7), (3, 8192)])
def test_a_sample_holds_both_ends_and_no_frame_twice(count: int, most: int) -> None:
    rows = sample_frames(count, most)
    assert (rows[0], rows[-1], len(rows)) == (0, count - 1, min(count, most))
    assert (np.diff(rows) > 0).all()


@pytest.mark.parametrize("kind", [bool, float])
def test_equal_rows_are_grouped(kind):
    rows = (np.random.default_rng(0).random((200, 5)) > 0.6).astype(kind)
    groups = equal_rows(rows)
    assert sorted(np.concatenate(groups).tolist()) == list(range(200))
    assert len(groups) == len(np.unique(rows, axis=0))
    for group in groups:
        assert (rows[group] == rows[group[0]]).all()
        assert (np.diff(group) > 0).all()
    assert equal_rows(rows[:0]) == []


def test_medians_are_of_the_samples_in_a_mask():
    values = np.array([[1.0, 5.0], [3.0, 7.0], [100.0, 9.0]])
    mask = np.array([[True, False], [True, False], [False, False]])
    np.testing.assert_array_equal(medians_where(values, mask), [2.0, 0.0])


def test_relative_distances_are_1_between_usual_rows():
    rows = np.array([[0.0], [0.0], [1.0], [3.0]])
    found = relative_distances(rows)
    np.testing.assert_allclose(found, np.abs(rows - rows.T) / 2.0, atol=1e-7)
