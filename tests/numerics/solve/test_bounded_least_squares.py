"""Bounded least squares: exact, and the same as one frame at a time."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear, nnls

from usdface.numerics.solve.bounded_least_squares import (
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
