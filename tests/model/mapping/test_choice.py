"""The choice of a method: the default, unless another is better by more than chance."""

import numpy as np
from scipy.stats import ttest_rel

from usdface.model.mapping.candidates import paired_t, time_blocks


def test_blocks_are_of_a_take_and_of_time() -> None:
    blocks = time_blocks(np.array([1, 100, 130, 500, 100]), ("a", "a", "a", "a", "b"))
    assert blocks[0] == blocks[1]
    assert len(set(blocks.tolist())) == 4


def test_t_is_that_of_scipy_over_means_of_blocks() -> None:
    rng = np.random.default_rng(0)
    usual, other = rng.normal(size=(60, 4)), 0.9 * rng.normal(size=(60, 4))
    blocks = np.arange(60) // 3
    means = [(each**2).sum(axis=1).reshape(-1, 3).mean(axis=1) for each in (usual, other)]
    wanted = ttest_rel(*means).statistic
    np.testing.assert_allclose(paired_t(usual, other, np.eye(4), blocks), wanted)
    assert paired_t(usual, usual, np.eye(4), blocks) == 0.0
