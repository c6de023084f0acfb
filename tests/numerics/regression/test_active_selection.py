"""What tuning next lowers doubt most, held to brute force."""

import numpy as np
import pytest

from usdface.numerics.regression.active_selection import design_total_variance
from usdface.numerics.regression.design_kernel import DesignKernel, left_over, predict_from


def rows(count: int = 60) -> np.ndarray:
    return np.random.default_rng(0).normal(size=(count, 3))


def dense_left(kernel: DesignKernel, known: np.ndarray, all_rows: np.ndarray) -> np.ndarray:
    within = np.linalg.inv(kernel(known, known) + 1e-2 * np.eye(len(known)))
    shared = kernel(known, all_rows)
    return kernel.diagonal(all_rows) - np.einsum("ij,ik,kj->j", shared, within, shared)


def test_each_pick_is_what_brute_force_would_pick() -> None:
    cloud = rows()
    kernel = DesignKernel.for_rows(cloud)
    importance = np.random.default_rng(1).random(len(cloud))
    known = cloud[:2]
    design = design_total_variance(cloud, 5, kernel=kernel, known=known, importance=importance)
    for turn, pick in enumerate(design.chosen):
        before = np.concatenate([known, cloud[design.chosen[:turn]]])
        total = [
            importance @ dense_left(kernel, np.concatenate([before, cloud[i : i + 1]]), cloud)
            if i not in design.chosen[:turn]
            else np.inf
            for i in range(len(cloud))
        ]
        assert pick == int(np.argmin(total))


def test_gains_add_up_to_the_doubt_that_went() -> None:
    cloud = rows()
    kernel = DesignKernel.for_rows(cloud)
    known = cloud[:3]
    design = design_total_variance(cloud, 8, kernel=kernel, known=known)
    start = dense_left(kernel, known, cloud).sum()
    end = dense_left(kernel, np.concatenate([known, cloud[design.chosen]]), cloud).sum()
    assert design.gain.sum() == pytest.approx(1 - end / start, rel=1e-9)
    assert len(set(design.chosen.tolist())) == 8


def test_nothing_known_leaves_all_over_and_knowing_a_frame_leaves_its_noise() -> None:
    cloud = rows()
    kernel = DesignKernel.for_rows(cloud)
    np.testing.assert_array_equal(left_over(kernel, cloud[:0], cloud, noise=1e-2), 1.0)
    left = left_over(kernel, cloud[:1], cloud[:1], noise=1e-2)
    prior = kernel.diagonal(cloud[:1])
    np.testing.assert_allclose(left, 1e-2 / (prior + 1e-2), rtol=1e-6)


def test_prediction_agrees_with_scikit_learn() -> None:
    process = pytest.importorskip("sklearn.gaussian_process")
    kernels = pytest.importorskip("sklearn.gaussian_process.kernels")
    cloud = rows()
    kernel = DesignKernel(2.0, 3.0, -0.4)
    values = np.random.default_rng(2).normal(size=(20, 2))
    theirs = process.GaussianProcessRegressor(
        2.0 * kernels.DotProduct(1e-9, "fixed") + 3.0 * kernels.RBF(np.sqrt(0.5 / 0.4)),
        alpha=1e-2,
        optimizer=None,
    )
    theirs.fit(cloud[:20], values - values.mean(axis=0))
    np.testing.assert_allclose(
        predict_from(kernel, cloud[:20], values, cloud, noise=1e-2),
        theirs.predict(cloud) + values.mean(axis=0),
        atol=1e-8,
    )


def test_impossible_requests_say_why() -> None:
    cloud = rows(10)
    kernel = DesignKernel.for_rows(cloud)
    with pytest.raises(ValueError, match="cannot choose 11 of 10"):
        design_total_variance(cloud, 11, kernel=kernel, known=cloud[:0])
    with pytest.raises(ValueError, match="finite entry of at least 0"):
        design_total_variance(cloud, 1, kernel=kernel, known=cloud[:0], importance=-np.ones(10))
