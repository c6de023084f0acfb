"""Bounded least squares: exact, and the same as one frame at a time."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear, nnls

from usdface.numerics.solve.bounded_least_squares import (
    BoxProjection,
    minimise_bounded_quadratic,
    solve_bounded_least_squares,
)


@pytest.fixture
def problem():
    rng = np.random.default_rng(0)
    common = rng.normal(size=(60, 1))
    matrix = rng.normal(size=(60, 24)) + 2 * common  # columns as alike as shapes of a face
    return matrix, rng.normal(size=(40, 60)) * 4


def test_equals_scipy_within_bounds(problem):
    matrix, targets = problem
    lower, upper = np.full(24, -0.2), np.linspace(0.1, 1, 24)
    ours = solve_bounded_least_squares(matrix, targets, lower=lower, upper=upper)
    theirs = [lsq_linear(matrix, b, (lower, upper), tol=1e-14).x for b in targets]
    np.testing.assert_allclose(ours.x, theirs, atol=1e-7)


def test_equals_scipy_nnls(problem):
    matrix, targets = problem
    ours = solve_bounded_least_squares(matrix, targets, lower=0, upper=np.inf)
    np.testing.assert_allclose(ours.x, [nnls(matrix, b)[0] for b in targets], atol=1e-7)


def test_without_bounds_is_least_squares(problem):
    matrix, targets = problem
    ours = solve_bounded_least_squares(matrix, targets, lower=-np.inf, upper=np.inf)
    np.testing.assert_allclose(ours.x.T, np.linalg.lstsq(matrix, targets.T)[0], atol=1e-7)


def test_optimality_conditions_hold_for_every_frame(problem):
    matrix, targets = problem
    x = solve_bounded_least_squares(matrix, targets, lower=-0.1, upper=0.3).x
    gradient = (x @ matrix.T - targets) @ matrix
    inside = (x > -0.1) & (x < 0.3)
    assert np.abs(gradient[inside]).max() < 1e-6
    assert (gradient[x == -0.1] > -1e-6).all()
    assert (gradient[x == 0.3] < 1e-6).all()
    assert inside.any()


def test_reports_how_far_from_optimal_it_is(problem):
    matrix, targets = problem
    assert solve_bounded_least_squares(matrix, targets, lower=0, upper=1).violation.max() < 1e-9


def test_dependent_columns_still_give_an_optimum():
    rng = np.random.default_rng(0)
    matrix = rng.normal(size=(20, 4))
    doubled = np.concatenate([matrix, matrix], axis=1)
    targets = rng.normal(size=(10, 20))
    wide = solve_bounded_least_squares(doubled, targets, lower=0, upper=1).x
    narrow = solve_bounded_least_squares(matrix, targets, lower=0, upper=2).x
    np.testing.assert_allclose(wide[:, :4] + wide[:, 4:], narrow, atol=1e-6)


def test_nearly_dependent_columns_are_solved_to_optimality():
    rng = np.random.default_rng(0)
    matrix = rng.normal(size=(40, 10)) @ rng.normal(size=(10, 60))
    matrix += 1e-3 * rng.normal(size=matrix.shape)
    targets = rng.normal(size=(25, 40)) * 5
    solution = solve_bounded_least_squares(matrix, targets, lower=0, upper=1, ridge=1e-3)
    assert solution.violation.max() < 1e-8


def test_equal_bounds_fix_a_variable(problem):
    matrix, targets = problem
    lower, upper = np.zeros(24), np.ones(24)
    lower[3] = upper[3] = 0.25
    assert (
        solve_bounded_least_squares(matrix, targets, lower=lower, upper=upper).x[:, 3] == 0.25
    ).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"lower": 1.0, "upper": 0.0}, "lower must not exceed upper; variable 0"),
        ({"linear": np.full((1, 2), np.nan)}, "must be finite"),
        ({"linear": np.zeros((1, 3))}, "expected H"),
    ],
)
def test_refuses_what_it_cannot_solve(change, message):
    given = {"linear": np.zeros((1, 2)), "lower": 0.0, "upper": 1.0, **change}
    with pytest.raises(ValueError, match=message):
        minimise_bounded_quadratic(np.eye(2), **given)


def test_projection_is_the_nearest_point_of_the_box_under_the_metric() -> None:
    rng = np.random.default_rng(0)
    factor = rng.normal(size=(6, 6)) + 2 * np.eye(6)
    metric = factor.T @ factor
    wanted = rng.uniform(-0.5, 1.5, size=(12, 6))
    low, high = np.zeros(6), np.ones(6)
    found = BoxProjection(metric, lower=low, upper=high, steps=2000)(wanted)
    for row, result in zip(wanted, found, strict=True):
        exact = lsq_linear(factor, factor @ row, bounds=(low, high), tol=1e-12).x
        np.testing.assert_allclose(result, exact, atol=1e-5)


def test_a_metric_given_by_its_factor_is_the_same_metric() -> None:
    rng = np.random.default_rng(0)
    factor, diagonal = rng.normal(size=(40, 5)), rng.uniform(0.5, 2, 40)
    low, high = np.zeros(40), np.ones(40)
    wanted = rng.uniform(-0.4, 1.4, size=(30, 40))
    whole = BoxProjection(np.diag(diagonal) + factor @ factor.T, lower=low, upper=high)(wanted)
    thin = BoxProjection(diagonal, factor=factor, lower=low, upper=high)
    np.testing.assert_allclose(thin(wanted), whole, atol=1e-12)
    assert np.abs(whole - np.clip(wanted, 0, 1)).max() > 0.01


def test_rows_within_their_limits_are_left_alone_and_a_diagonal_metric_only_cuts() -> None:
    rng = np.random.default_rng(0)
    inside = rng.uniform(0.1, 0.9, size=(5, 3))
    metric = np.array([[2.0, 1.0, 0.0], [1.0, 3.0, 0.5], [0.0, 0.5, 1.0]])
    low, high = np.zeros(3), np.ones(3)
    np.testing.assert_array_equal(BoxProjection(metric, lower=low, upper=high)(inside), inside)
    outside = rng.uniform(-1, 2, size=(5, 3))
    cut = BoxProjection(np.diag([1.0, 5.0, 9.0]), lower=low, upper=high)(outside)
    np.testing.assert_allclose(cut, np.clip(outside, 0, 1), atol=1e-12)
