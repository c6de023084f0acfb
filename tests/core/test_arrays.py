"""Runs, blocks and samples of frames."""

import numpy as np
import pytest
from scipy.special import ndtri

from usdface.core.arrays import MAD_TO_DEVIATION, extend_block, frame_blocks, runs, sample_frames


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
