"""Designs of reference frames, held to brute force and to other routes."""

import tracemalloc
from collections.abc import Callable

import numpy as np
import pytest

from usdface.core.arrays import first_smallest
from usdface.numerics.regression.reference_design import (
    DesignKernel,
    design_d_optimal,
    design_gp_variance,
    design_k_centre,
    pivoted_selection,
    posterior_shares,
    predict_from,
    whiten,
)

DESIGNS = [design_d_optimal, design_k_centre, design_gp_variance]
every_design = pytest.mark.parametrize("design", DESIGNS, ids=lambda f: f.__name__)


def cloud(frames: int = 400, dimensions: int = 5) -> np.ndarray:
    return np.random.default_rng(0).normal(size=(frames, dimensions))


@every_design
def test_no_frame_is_chosen_twice_even_when_all_are_equal(design: Callable) -> None:
    for features in (cloud(60), np.ones((60, 3)), np.repeat(cloud(6), 10, axis=0)):
        chosen = design(features, 60).chosen
        assert sorted(chosen) == list(range(60))


@every_design
def test_tuned_frames_stay_and_are_not_proposed_again(design: Callable) -> None:
    features = cloud()
    first = design(features, 20)
    more = design(features, 10, already=first.chosen)
    assert not set(more.chosen) & set(first.chosen)
    if design is not design_k_centre:  # its first frame is a choice of its own
        np.testing.assert_array_equal(more.chosen, design(features, 30).chosen[20:])


@every_design
def test_gain_never_grows_and_twice_gives_the_same(design: Callable) -> None:
    features = cloud()
    first, second = design(features, 40), design(features, 40)
    np.testing.assert_array_equal(first.chosen, second.chosen)
    assert (np.diff(first.gain[1:]) <= 1e-9 * np.abs(first.gain[1:-1])).all()


@every_design
def test_impossible_requests_say_why(design: Callable) -> None:
    features = cloud(10)
    with pytest.raises(ValueError, match="cannot choose 11 of 10"):
        design(features, 11)
    features[4, 1] = np.nan
    with pytest.raises(ValueError, match="row 4 are not finite"):
        design(features, 1)


def test_d_optimal_multiplies_the_determinant_by_the_most_at_every_step() -> None:
    features = cloud(80, 3)
    design = design_d_optimal(features, 12)
    rows = np.column_stack([features, np.ones(len(features))])
    information = 1e-3 * np.eye(4)
    for turn, pick in enumerate(design.chosen):
        gains = [np.linalg.det(information + np.outer(r, r)) for r in rows]
        gains = np.array(gains)
        gains[design.chosen[:turn]] = -1
        assert gains[pick] == pytest.approx(gains.max(), rel=1e-9)
        information += np.outer(rows[pick], rows[pick])


def test_k_centre_covers_within_twice_the_best_radius() -> None:
    rng = np.random.default_rng(0)
    centres = 100 * rng.normal(size=(8, 4))
    features = np.concatenate([c + rng.uniform(-1, 1, size=(30, 4)) / 2 for c in centres])
    chosen = design_k_centre(features, 8).chosen
    assert sorted(chosen // 30) == list(range(8))


def dense_greedy(features: np.ndarray, count: int) -> list[int]:
    """The same covariance, factorised whole."""
    squared = (features**2).sum(axis=1)
    away = squared[:, None] + squared - 2 * features @ features.T
    some = away[np.triu_indices(len(features), 1)]
    kernel = 10 * features @ features.T / squared.mean() + 3 * np.exp(-away / 2 / np.median(some))
    chosen: list[int] = []
    for _ in range(count):
        within = kernel[np.ix_(chosen, chosen)] + 1e-3 * np.eye(len(chosen))
        known = kernel[:, chosen] @ np.linalg.solve(within, kernel[chosen]) if chosen else 0
        left = np.diag(kernel - known).copy()
        left[chosen] = -np.inf
        chosen.append(int(left.argmax()))
    return chosen


def test_gp_design_equals_the_dense_one() -> None:
    features = cloud(300, 4)
    assert design_gp_variance(features, 40).chosen.tolist() == dense_greedy(features, 40)


def test_gp_design_of_a_long_take_needs_memory_linear_in_its_frames() -> None:
    features = cloud(100_000, 8)
    tracemalloc.start()
    chosen = design_gp_variance(features, 100).chosen
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(set(chosen)) == 100
    assert peak < 1.3 * features.shape[0] * 100 * 8  # little more than the factor's rows


def test_whitening_makes_variances_equal_or_leaves_them() -> None:
    rng = np.random.default_rng(0)
    coordinates = rng.normal(size=(5000, 3)) * [10.0, 1.0, 0.1]
    variances = coordinates.var(axis=0)
    np.testing.assert_allclose(whiten(coordinates, variances, power=1.0).var(axis=0), 1.0)
    np.testing.assert_array_equal(whiten(coordinates, variances, power=0.0), coordinates)


def rows(count: int = 60) -> np.ndarray:
    return np.random.default_rng(0).normal(size=(count, 3))


def test_nothing_known_leaves_all_over_and_knowing_a_frame_leaves_its_noise() -> None:
    cloud = rows()
    kernel = DesignKernel.for_rows(cloud)
    np.testing.assert_array_equal(posterior_shares(kernel, cloud[:0], cloud)[-1], 1.0)
    left = posterior_shares(kernel, cloud[:1], cloud[:1])[-1]
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
        predict_from(kernel, cloud[:20], values, cloud),
        theirs.predict(cloud) + values.mean(axis=0),
        atol=1e-8,
    )


def test_the_chosen_rows_are_those_of_a_pivoted_qr() -> None:
    from scipy.linalg import qr

    rows = np.random.default_rng(0).normal(size=(40, 12)) * np.linspace(0.2, 3, 40)[:, None]
    _, _, pivots = qr(rows.T, pivoting=True, mode="economic")
    np.testing.assert_array_equal(pivoted_selection(rows, 9), pivots[:9])


def test_half_a_smile_is_not_chosen_beside_the_smile() -> None:
    smile, jaw = np.eye(5)[:2] * [[10], [6]]
    rows = np.array([0.5 * smile, smile, 0.9 * smile, jaw, 0.2 * jaw])
    assert pivoted_selection(rows, 4).tolist() == [1, 3]


def test_rows_of_nothing_give_nothing() -> None:
    assert pivoted_selection(np.zeros((4, 3)), 2).tolist() == []
    assert pivoted_selection(np.zeros((0, 3)), 2).tolist() == []


def test_a_row_of_a_thousandth_of_the_largest_is_the_least_that_counts() -> None:
    rows = np.diag([10.0, 0.05, 0.011, 0.009])
    assert pivoted_selection(rows, 4).tolist() == [0, 1, 2]


def test_choices_do_not_hang_on_the_last_bit() -> None:
    """Frames that a performer repeats are equal but for rounding; so are errors of some ridges."""
    rng = np.random.default_rng(0)
    features = np.tile(rng.normal(0, 1, (40, 6)), (3, 1))
    noise = 1 + 1e-13 * rng.normal(0, 1, features.shape)
    for design in (
        lambda rows: pivoted_selection(rows, 6),
        lambda rows: design_k_centre(rows, 8).chosen,
    ):
        chosen = design(features)
        np.testing.assert_array_equal(design(features * noise), chosen)
        assert chosen.max() < 40
    errors = rng.random((5, 30)).repeat(2, axis=0)
    wobbled = errors * (1 + 1e-13 * rng.normal(0, 1, errors.shape))
    np.testing.assert_array_equal(first_smallest(wobbled), 2 * errors[::2].argmin(axis=0))
