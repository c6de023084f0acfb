"""The forward model against closed forms and brute force, and the bounded solve against SciPy."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize

from usdface.model.mapping.corrected_pairs import correct_keys
from usdface.model.regressions import forward_model, frame_solve
from usdface.model.regressions.forward_model import (
    ForwardModel,
    ForwardScales,
    fit_forward_model,
    weight_spread,
)
from usdface.model.regressions.frame_solve import FrameSolver
from usdface.numerics.regression.marker_prior import fit_marker_basis

PAIRS, SHAPES, MARKERS = 12, 5, 7
SCALES = ForwardScales(alpha=0.4, floor=0.2, eta=0.1, tau=0.05, curve=0.0)


def a_face(seed: int = 0) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(seed)
    neutral = rng.uniform(-40, 40, size=(MARKERS, 3))
    basis = 5 * rng.normal(size=(SHAPES, MARKERS, 3))
    weights = rng.random((PAIRS, SHAPES))
    moved = np.einsum("ns,skc->nkc", weights, basis) + 0.1 * rng.normal(size=(PAIRS, MARKERS, 3))
    return weights, moved, basis, neutral


def fitted(rows: np.ndarray | None = None, scales: ForwardScales | None = SCALES) -> ForwardModel:
    weights, moved, basis, neutral = a_face()
    rows = np.arange(PAIRS) if rows is None else rows
    return fit_forward_model(
        weights[rows], moved[rows], expected=0.8 * basis, neutral=neutral, scales=scales
    )


def test_leave_one_out_residuals_are_those_of_models_without_the_pair(monkeypatch) -> None:
    monkeypatch.setattr(forward_model, "_NOISES_MM", (0.1,))
    weights, moved, _, _ = a_face()
    # The quadratic scale follows the pairs' motion: without it the rest is the same model.
    scales = replace(SCALES, eta=0.0)
    whole = fitted(scales=scales)
    for left in range(3):
        model = fitted(np.delete(np.arange(PAIRS), left), scales)
        predicted = FrameSolver(model, np.full(SHAPES, 0.1)).linearise(weights[[left]])[0]
        expected = moved[left].ravel() - predicted[0]
        np.testing.assert_allclose(whole.residuals[left].ravel(), expected, atol=2e-4)


def test_motion_reaches_the_neighbours_of_moved_markers_without_much_memory() -> None:
    rng = np.random.default_rng(0)
    size2, neutral = rng.random((40, 300)) ** 8, rng.uniform(-60, 60, (300, 3))
    tracemalloc.start()
    reach = forward_model._reach(size2, neutral)
    peak_bytes = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    near = np.exp(-0.5 * (np.linalg.norm(neutral[7] - neutral, axis=1) / 25.0) ** 2)
    largest = np.maximum(size2.max(axis=1), 0.5)
    np.testing.assert_allclose(reach[:, 7], (size2 * near).max(axis=1) / largest + 0.2)
    assert peak_bytes < 8 * 40 * 300**2 / 3  # of an array of shapes and pairs of markers


def test_the_basis_is_the_mean_of_the_conjugate_posterior(monkeypatch) -> None:
    monkeypatch.setattr(forward_model, "_NOISES_MM", (0.1,))
    weights, moved, basis, _ = a_face()
    model = fitted(scales=replace(SCALES, eta=0.0, tau=0.0))
    for marker in range(2):
        prior = np.append(1 / model.deviation2[:, marker], 1 / 0.3**2)
        rows = np.column_stack([weights, np.ones(PAIRS)])
        right = rows.T @ (moved[:, marker] - weights @ (0.8 * basis[:, marker])) / 0.1**2
        mean = np.linalg.solve(np.diag(prior) + rows.T @ rows / 0.1**2, right)
        np.testing.assert_allclose(model.basis[:, marker], 0.8 * basis[:, marker] + mean[:-1])
        np.testing.assert_allclose(model.offset[marker], mean[-1])


def test_shapes_that_are_still_may_move_but_not_lids() -> None:
    targets = np.zeros((4, 3))
    targets[:, 0] = [0.0, 0.5, 1.0, 0.5]
    spread = weight_spread(targets, lids=np.array([2]))
    np.testing.assert_allclose(spread, [12**-0.5, 3**-0.5, 0.1])


@pytest.mark.parametrize("scale", [None, 1 / 0.7], ids=["registered", "given"])
def test_unseen_shapes_move_as_the_rig_at_the_given_scale(scale: float | None) -> None:
    rng = np.random.default_rng(1)
    skin, rest = 5 * rng.normal(size=(4, 40, 3)), rng.uniform(-40, 40, size=(40, 3))
    weights = rng.random((20, 4)) * [1, 1, 1, 0]
    moved = 0.7 * np.einsum("ns,spc->npc", weights, skin[:, :10])
    moved[:, 5:] = 0.0  # markers that no reference moves
    skin[:3, 5:10] = 0.0
    found = fit_marker_basis(
        skin, weights, moved, rest=rest, neutral=rest[:10], places=rest[:10], motion_scale=scale
    )
    expected = skin[3, 5:10] * (1.0 if scale is None else 0.7)
    np.testing.assert_allclose(found[3, 5:], expected, rtol=0.03, atol=0.1)


def test_the_slope_is_the_derivative() -> None:
    solver = FrameSolver(fitted(), np.full(SHAPES, 0.1))
    t = np.full((1, SHAPES), 0.4)
    _, slope = solver.linearise(t)
    assert slope is not None
    for shape in range(SHAPES):
        step = np.zeros((1, SHAPES))
        step[0, shape] = 0.05
        ahead, behind = solver.linearise(t + step)[0], solver.linearise(t - step)[0]
        np.testing.assert_allclose((ahead - behind)[0] / 0.1, slope[0, shape], atol=1e-3)


def test_variance_is_nothing_to_speak_of_at_pairs_and_grows_beyond_them() -> None:
    model = fitted(scales=replace(SCALES, tau=0.0))
    at, beyond = model.variance(model.targets), model.variance(3 * model.targets)
    assert (at < model.noise + 1e-6).all()
    assert np.median(beyond / at) > 10


@pytest.mark.parametrize("seed", range(4))
def test_frames_are_solved_as_by_scipy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = fitted(scales=replace(SCALES, eta=0.0))  # then one linearisation is exact
    solver = FrameSolver(model, np.full(SHAPES, 0.05))
    true, start = rng.random(SHAPES), rng.random(SHAPES)
    y = (true @ model.basis.reshape(SHAPES, -1)).reshape(1, MARKERS, 3) + model.offset
    seen = np.ones((1, MARKERS), dtype=bool)
    found = solver.solve(y, seen, start[None])
    held = np.asarray(found.precision[0], float)
    matrix = np.asarray(found.hessian, float)[0] - np.diag(held)  # of the markers
    pulled = matrix @ (np.linalg.solve(matrix, matrix @ (true - start)))

    def cost(t: np.ndarray) -> float:
        d = t - start
        return float(0.5 * d @ (matrix + np.diag(held)) @ d - pulled @ d)

    best = minimize(cost, start, bounds=[(0, 1)] * SHAPES, method="L-BFGS-B", tol=1e-14)
    assert cost(found.targets[0]) <= best.fun + 1e-3 * abs(best.fun)


def test_common_errors_are_the_covariance_of_the_residuals() -> None:
    model = fitted()
    samples = model.residuals.reshape(PAIRS, -1)
    covariance = samples.T @ samples
    scale = np.repeat(np.sqrt(np.diag(covariance).reshape(-1, 3).mean(axis=1)), 3)
    common = model.common_errors
    np.testing.assert_allclose(common.T @ common, covariance / np.outer(scale, scale), atol=1e-9)


@pytest.mark.parametrize("most", [200, 0], ids=["Jacobian per frame", "shared Jacobian"])
def test_correlated_errors_of_visible_markers_weight_the_solve(monkeypatch, most: int) -> None:
    monkeypatch.setattr(frame_solve, "_MAX_DENSE_SHAPES", most)
    rng = np.random.default_rng(5)
    model = fitted(scales=replace(SCALES, eta=0.0))
    solver = FrameSolver(model, np.full(SHAPES, 0.05))
    y, start = 3 * rng.normal(size=(2, MARKERS, 3)), np.full((2, SHAPES), 0.5)
    visible = np.array([[True] * MARKERS, [True, False] + [True] * (MARKERS - 2)])
    found = solver.solve(y, visible, start)
    predictive = model.residual_variance if most == 0 else model.variance(start)
    variance = 0.05**2 + 0.5 * model.residual_variance + predictive
    for n, seen in enumerate(np.repeat(visible, 3, axis=1)):
        r = np.repeat(np.broadcast_to(variance, (2, MARKERS))[n], 3)[seen]
        common = model.common_errors[:, seen]
        weight = np.linalg.inv((np.eye(len(r)) + common.T @ common) * np.sqrt(np.outer(r, r)))
        basis = model.basis.reshape(SHAPES, -1)[:, seen]
        hessian = basis @ weight @ basis.T + np.diag(found.precision[n].astype(float))
        residual = (y[n] - model.offset).ravel()[seen] - start[n] @ basis
        pull = basis @ weight @ residual
        step = minimize(
            lambda d, h=hessian, g=pull: 0.5 * d @ h @ d - g @ d,
            np.zeros(SHAPES),
            bounds=[(-0.5, 0.5)] * SHAPES,
            method="L-BFGS-B",
            tol=1e-14,
        ).x
        np.testing.assert_allclose(found.targets[n], 0.5 + step, atol=2e-3)


def test_keys_that_are_off_have_their_error_found() -> None:
    rng = np.random.default_rng(3)
    basis = 5 * rng.normal(size=(8, 30, 3))
    weights = rng.random((40, 8))
    moved = np.einsum("ns,skc->nkc", weights, basis) + 0.05 * rng.normal(size=(40, 30, 3))
    neutral = rng.uniform(-40, 40, size=(30, 3))
    off = np.clip(weights * (1 + 0.15 * rng.normal(size=weights.shape)), 0, 1)
    exact, inexact = (
        fit_forward_model(keys, moved, expected=basis, neutral=neutral).scales.tau
        for keys in (weights, off)
    )
    assert exact < 0.05
    assert 0.05 < inexact < 0.25


def keyed_with_error(error: float) -> tuple[np.ndarray, np.ndarray, ForwardModel]:
    """Return true weights, keys that are off by a share of them, and the model of the latter."""
    rng = np.random.default_rng(3)
    basis = 5 * rng.normal(size=(8, 30, 3))
    weights = rng.random((40, 8))
    moved = np.einsum("ns,skc->nkc", weights, basis) + 0.05 * rng.normal(size=(40, 30, 3))
    keys = np.clip(weights * (1 + error * rng.normal(size=weights.shape)), 0, 1)
    neutral = rng.uniform(-40, 40, size=(30, 3))
    scales = ForwardScales(alpha=0.15, floor=0.1, eta=0.05, tau=error, curve=0.0)
    model = fit_forward_model(keys, moved, expected=0.8 * basis, neutral=neutral, scales=scales)
    return weights, keys, model


def test_keys_go_to_where_their_markers_put_them() -> None:
    weights, keys, model = keyed_with_error(0.15)
    mode, variance = correct_keys(model, keys, model.scales)
    before, after = (np.sqrt(((each - weights) ** 2).mean()) for each in (keys, mode))
    assert after < 0.5 * before
    assert (variance < 0.15**2 * (keys**2 + 0.04)).all()


def test_keys_without_error_stay() -> None:
    _, keys, model = keyed_with_error(0.0)
    mode, variance = correct_keys(model, keys, model.scales)
    np.testing.assert_array_equal(mode, keys)
    assert not variance.any()


def test_the_variance_of_pairs_left_out_is_that_of_models_without_them(monkeypatch) -> None:
    monkeypatch.setattr(forward_model, "_NOISES_MM", (0.1,))
    scales = replace(SCALES, eta=0.0)
    whole = fitted(scales=scales)
    for left in range(3):
        model = fitted(np.delete(np.arange(PAIRS), left), scales)
        expected = model.variance(whole.targets[[left]])[0] + model.noise
        np.testing.assert_allclose(whole.leave_one_out_variance[left], expected, rtol=1e-3)


def test_keys_of_rigs_of_very_many_shapes_stay(monkeypatch) -> None:
    _, keys, model = keyed_with_error(0.15)
    monkeypatch.setattr(frame_solve, "_MAX_DENSE_SHAPES", 0)
    mode, variance = correct_keys(model, keys, model.scales)
    np.testing.assert_array_equal(mode, keys)
    np.testing.assert_allclose(variance, 0.15**2 * (keys**2 + 0.04))
