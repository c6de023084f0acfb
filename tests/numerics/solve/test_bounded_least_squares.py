"""Bounded least squares: exact, and the same as one frame at a time."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear, nnls

from usdface.numerics.solve import hessian
from usdface.numerics.solve.bounded_least_squares import (
    minimise_within_bounds,
    solve_bounded_least_squares,
)


@pytest.fixture
def problem():
    rng = np.random.default_rng(0)
    common = rng.normal(size=(60, 1))
    matrix = rng.normal(size=(60, 24)) + 2 * common  # columns as alike as shapes of a face
    return matrix, rng.normal(size=(40, 60)) * 4


def violation(x, matrix, targets, *, lower, upper, ridge=0.0):
    """Of the conditions of Karush, Kuhn and Tucker, at unit diagonal, relative to the targets'."""
    unit = 1 / np.sqrt((matrix**2).sum(axis=0) + ridge)
    gradient = unit * ((x @ matrix.T - targets) @ matrix + ridge * x)
    step = np.clip(x / unit - gradient, lower / unit, upper / unit) - x / unit
    return np.abs(step).max(axis=1) / np.abs(unit * (targets @ matrix)).max(axis=1)


def test_equals_scipy_within_bounds(problem):
    matrix, targets = problem
    lower, upper = np.full(24, -0.2), np.linspace(0.1, 1, 24)
    ours = solve_bounded_least_squares(matrix, targets, lower=lower, upper=upper)
    theirs = [lsq_linear(matrix, b, (lower, upper), tol=1e-14).x for b in targets]
    np.testing.assert_allclose(ours, theirs, atol=1e-7)


def test_equals_scipy_nnls(problem):
    matrix, targets = problem
    ours = solve_bounded_least_squares(matrix, targets, lower=0, upper=np.inf)
    np.testing.assert_allclose(ours, [nnls(matrix, b)[0] for b in targets], atol=1e-7)


def test_without_bounds_is_least_squares(problem):
    matrix, targets = problem
    ours = solve_bounded_least_squares(matrix, targets, lower=-np.inf, upper=np.inf)
    np.testing.assert_allclose(ours.T, np.linalg.lstsq(matrix, targets.T)[0], atol=1e-7)


def test_optimality_conditions_hold_for_every_frame(problem):
    matrix, targets = problem
    x = solve_bounded_least_squares(matrix, targets, lower=-0.1, upper=0.3)
    gradient = (x @ matrix.T - targets) @ matrix
    inside = (x > -0.1) & (x < 0.3)
    assert np.abs(gradient[inside]).max() < 1e-6
    assert (gradient[x == -0.1] > -1e-6).all()
    assert (gradient[x == 0.3] < 1e-6).all()
    assert inside.any()


def test_no_gradient_step_within_bounds_improves_it(problem):
    matrix, targets = problem
    x = solve_bounded_least_squares(matrix, targets, lower=0, upper=1)
    assert violation(x, matrix, targets, lower=0, upper=1).max() < 1e-9


def test_dependent_columns_still_give_an_optimum():
    rng = np.random.default_rng(0)
    matrix = rng.normal(size=(20, 4))
    doubled = np.concatenate([matrix, matrix], axis=1)
    targets = rng.normal(size=(10, 20))
    wide = solve_bounded_least_squares(doubled, targets, lower=0, upper=1)
    narrow = solve_bounded_least_squares(matrix, targets, lower=0, upper=2)
    np.testing.assert_allclose(wide[:, :4] + wide[:, 4:], narrow, atol=1e-6)


def test_nearly_dependent_columns_are_solved_to_optimality():
    rng = np.random.default_rng(0)
    matrix = rng.normal(size=(40, 10)) @ rng.normal(size=(10, 60))
    matrix += 1e-3 * rng.normal(size=matrix.shape)
    targets = rng.normal(size=(25, 40)) * 5
    given = {"lower": 0, "upper": 1, "ridge": 1e-3}
    solution = solve_bounded_least_squares(matrix, targets, **given)
    assert violation(solution, matrix, targets, **given).max() < 1e-8


def test_without_a_measured_coordinate_costs_alone_decide():
    """As in a frame without any marker."""
    nothing, no_target = np.zeros((0, 30)), np.zeros((4, 0))
    cost = np.linspace(-1, 1, 30)
    solution = solve_bounded_least_squares(
        nothing, no_target, lower=0, upper=0.3, ridge=2.0, cost=cost
    )
    np.testing.assert_allclose(solution, [np.clip(-cost / 2, 0, 0.3)] * 4, atol=1e-12)


def test_equal_bounds_fix_a_variable(problem):
    matrix, targets = problem
    lower, upper = np.zeros(24), np.ones(24)
    lower[3] = upper[3] = 0.25
    assert (
        solve_bounded_least_squares(matrix, targets, lower=lower, upper=upper)[:, 3] == 0.25
    ).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"lower": 1.0, "upper": 0.0}, "lower must not exceed upper; variable 0"),
        ({"targets": np.full((1, 2), np.nan)}, "must be finite"),
    ],
)
def test_refuses_what_it_cannot_solve(change, message):
    given = {"targets": np.zeros((1, 2)), "lower": 0.0, "upper": 1.0, **change}
    with pytest.raises(ValueError, match=message):
        solve_bounded_least_squares(np.eye(2), **given)


def test_costs_and_ridges_of_single_variables(problem):
    """By the identity, costs move targets: |x - b|^2 + 2 c x is |x - (b - c)|^2 but a constant."""
    _, targets = problem
    rng = np.random.default_rng(1)
    cost, ridge = rng.random((40, 60)), rng.random(60)
    ours = solve_bounded_least_squares(
        np.eye(60), targets, lower=-1, upper=1, ridge=ridge, cost=cost
    )
    np.testing.assert_allclose(ours, np.clip((targets - cost) / (1 + ridge), -1, 1), atol=1e-12)


def test_more_variables_than_coordinates_are_solved_alike(monkeypatch):
    """By few coordinates or by all variables, frames that are alike or not, hidden rows or none."""
    rng = np.random.default_rng(2)
    matrix = rng.gamma(0.3, size=(30, 1)) * rng.normal(size=(30, 120))
    matrix[7] = 0.0
    poses = np.repeat(rng.random((6, 120)) < 0.2, 20, axis=0) * rng.random((120, 120))
    targets = poses @ matrix.T + 0.1 * rng.normal(size=(120, 30))
    given = {"lower": np.full(120, -0.1), "upper": np.linspace(0.2, 1, 120), "ridge": 0.05}
    assert isinstance(hessian.hessian_of(matrix, np.full(120, 0.05)), hessian._LowRank)
    few = solve_bounded_least_squares(matrix, targets, **given)
    monkeypatch.setattr(hessian, "_LOW_RANK_SHARE", 0.0)
    dense = solve_bounded_least_squares(matrix, targets, **given)
    assert violation(few, matrix, targets, **given).max() < 1e-9
    np.testing.assert_allclose(few, dense, atol=1e-9)
    theirs = lsq_linear(
        np.vstack([matrix, np.sqrt(0.05) * np.eye(120)]),
        np.append(targets[0], np.zeros(120)),
        (given["lower"], given["upper"]),
        tol=1e-14,
    ).x
    np.testing.assert_allclose(few[0], theirs, atol=1e-6)


def test_steps_are_as_long_as_the_steepest_direction_allows() -> None:
    """That of shapes which undo each other: the sum of all shapes does not show it."""
    rng = np.random.default_rng(0)
    frames, n = 50, 12
    together, against = np.ones(n) / np.sqrt(n), np.where(np.arange(n) % 2, 1, -1) / np.sqrt(n)
    H = 0.5 * np.outer(together, together) + np.outer(against, against) + 0.1 * np.eye(n)
    linear = rng.uniform(0.2, 0.8, size=(frames, n)) @ H
    found = minimise_within_bounds(
        lambda rows: rows @ H,
        np.tile(np.diag(H), (frames, 1)),
        linear,
        lower=np.zeros((frames, n)),
        upper=np.ones((frames, n)),
        start=np.full((frames, n), 0.5),
        steps=30,
    )
    factor = np.linalg.cholesky(H)
    for frame, pull in zip(found, linear, strict=True):
        exact = lsq_linear(factor.T, np.linalg.solve(factor, pull), (0.0, 1.0), tol=1e-12).x
        np.testing.assert_allclose(frame, exact, atol=0.01)


@pytest.mark.parametrize("size", [1, 8, 9, 51, 64])
def test_inverses_by_halves_are_those_of_lapack(size: int) -> None:
    rows = np.random.default_rng(size).normal(size=(5, size, size + 3))
    matrices = rows @ rows.transpose(0, 2, 1) + np.eye(size)
    found = hessian.invert_by_halves(matrices)
    np.testing.assert_allclose(found, np.linalg.inv(matrices), rtol=1e-8, atol=1e-10)
    single = hessian.invert_by_halves(matrices.astype(np.float32))
    assert single.dtype == np.float32
    np.testing.assert_allclose(single, found, atol=1e-4)
