"""The blendshape equation: known weights in, the same weights out."""

from functools import partial

import numpy as np
import pytest
from scipy import optimize

from usdface.numerics.solve.blendshape_equation import (
    MarkerKeys,
    _checked,
    solve_least_squares,
    solve_weights,
)
from usdface.numerics.solve.blendshapes import BlendShapes, ChannelKeys, Key


@pytest.fixture
def deltas():
    return np.random.default_rng(0).normal(size=(12, 30, 3)) * 4


@pytest.fixture
def weights():
    rng = np.random.default_rng(1)
    return np.clip(rng.uniform(-0.3, 0.9, (50, 12)), 0, 1)


def rank_of(deltas, trust=None):
    return _checked(deltas, np.zeros((1, *deltas.shape[1:])), None, trust).rank()


def motion_of(weights, deltas):
    return np.einsum("fs,smc->fmc", weights, deltas)


def solve_bounded(*given, **options):
    return solve_weights(*given, **options).weights


@pytest.mark.parametrize("solve", [solve_least_squares, solve_bounded])
def test_either_solve_recovers_known_weights(deltas, weights, solve):
    np.testing.assert_allclose(solve(deltas, motion_of(weights, deltas)), weights, atol=1e-7)


def test_known_weights_leave_no_residual(deltas, weights):
    solve = solve_weights(deltas, motion_of(weights, deltas))
    assert solve.residual_mm.max() < 1e-6
    assert rank_of(deltas) == 12


def test_plain_least_squares_is_the_pseudoinverse(deltas):
    motion = np.random.default_rng(2).normal(size=(7, 30, 3))
    expected = motion.reshape(7, -1) @ np.linalg.pinv(deltas.reshape(12, -1))
    np.testing.assert_allclose(solve_least_squares(deltas, motion), expected, atol=1e-10)


def test_turning_or_scaling_both_sides_changes_nothing(deltas, weights):
    noisy = motion_of(weights, deltas) + np.random.default_rng(3).normal(size=(50, 30, 3))
    turn = np.linalg.qr(np.random.default_rng(4).normal(size=(3, 3)))[0] * 7.5
    before = solve_weights(deltas, noisy).weights
    after = solve_weights(deltas @ turn, noisy @ turn).weights
    np.testing.assert_allclose(after, before, atol=1e-7)


def test_weights_stay_within_the_rigs_ranges(deltas):
    ranges = np.column_stack([np.linspace(-1, 0, 12), np.linspace(0.2, 2, 12)])
    motion = np.random.default_rng(5).normal(size=(40, 30, 3)) * 20
    found = solve_weights(deltas, motion, ranges=ranges).weights
    assert (found >= ranges[:, 0]).all()
    assert (found <= ranges[:, 1]).all()
    assert (found < 0).any()


def test_unseen_markers_have_no_say(deltas, weights):
    motion = motion_of(weights, deltas)
    visible = np.random.default_rng(6).random((50, 30)) > 0.3
    motion[~visible] = np.nan
    solve = solve_weights(deltas, motion, visible=visible)
    np.testing.assert_allclose(solve.weights, weights, atol=1e-7)
    np.testing.assert_array_equal(np.isnan(solve.residual_mm), ~visible)


def test_a_marker_without_trust_has_no_say(deltas, weights):
    motion = motion_of(weights, deltas)
    motion[:, 4] += 50
    trust = np.ones(30)
    trust[4] = 0
    solve = solve_weights(deltas, motion, marker_trust=trust)
    np.testing.assert_allclose(solve.weights, weights, atol=1e-7)


@pytest.mark.parametrize("solve", [solve_least_squares, solve_bounded])
def test_a_frame_that_sees_nothing_is_at_rest(deltas, weights, solve):
    motion = motion_of(weights, deltas)
    visible = np.ones(motion.shape[:2], bool)
    visible[1] = False
    solved = solve(deltas, motion, visible=visible)
    assert (solved[1] == 0).all()
    np.testing.assert_allclose(solved[2:], weights[2:], atol=1e-6)


def test_markers_without_trust_tell_no_shapes_apart(deltas):
    trust = np.zeros(deltas.shape[1])
    trust[:2] = 1
    rank = rank_of(deltas, trust)
    assert rank == np.linalg.matrix_rank(deltas[:, :2].reshape(len(deltas), -1))
    assert rank < len(deltas)


def test_in_betweens_are_solved_as_they_bend():
    rng = np.random.default_rng(7)
    points, full = np.arange(20), rng.normal(size=(5, 20, 3)) * 5
    half = 0.5 * full[0] + rng.normal(size=(20, 3)) * 5  # far from half of the full target
    tracks = [ChannelKeys(0, [Key(0.5, points, half), Key(1.0, points, full[0])])]
    tracks += [ChannelKeys(i, [Key(1.0, points, full[i])]) for i in range(1, 5)]
    shapes = BlendShapes(20, 5, tracks)
    keys = MarkerKeys(
        deltas=np.concatenate([[half], full]),
        channels=np.array([0, 0, 1, 2, 3, 4]),
        key_weights=shapes.key_weights,
    )
    truth = rng.uniform(0, 1, (60, 5))
    motion = shapes.offsets(truth)
    straight = solve_weights(full, motion)
    bent = solve_weights(full, motion, keys=keys)
    np.testing.assert_allclose(bent.weights, truth, atol=1e-5)
    assert np.abs(straight.weights - truth).max() > 0.1


def test_rank_tells_that_shapes_are_alike(deltas):
    twins = np.concatenate([deltas, deltas[:2]])
    assert rank_of(twins) == 12


def test_names_the_frame_that_is_not_finite(deltas):
    motion = np.zeros((9, 30, 3))
    motion[4, 2] = np.nan
    with pytest.raises(ValueError, match="index 4"):
        solve_weights(deltas, motion)


def test_more_shapes_than_markers_can_tell_apart_still_fit():
    rng = np.random.default_rng(9)
    deltas = rng.normal(size=(120, 20, 3)) * 4
    weights = np.where(rng.random((30, 120)) < 0.1, rng.uniform(0, 1, (30, 120)), 0)
    solve = solve_weights(deltas, motion_of(weights, deltas))
    assert rank_of(deltas) == 60
    assert (
        solve.residual_mm.mean() < 0.1 * np.linalg.norm(motion_of(weights, deltas), axis=2).mean()
    )
    assert (solve.weights >= 0).all()
    assert (solve.weights <= 1).all()


def test_no_frames_give_no_weights(deltas):
    assert solve_weights(deltas, np.zeros((0, 30, 3))).weights.shape == (0, 12)


@pytest.mark.parametrize("solve", [solve_least_squares, partial(solve_bounded, ridge=1.0)])
def test_a_marker_trusted_four_times_is_that_marker_four_times(deltas, weights, solve):
    rng = np.random.default_rng(2)
    motion = motion_of(weights, deltas) + rng.normal(size=(50, 30, 3))
    trust = np.ones(30)
    trust[[3, 7]] = 4
    copies = np.repeat(np.arange(30), trust.astype(int))
    told = solve(deltas, motion, marker_trust=trust)
    copied = solve(deltas[:, copies], motion[:, copies])
    np.testing.assert_allclose(told, copied, atol=1e-9)


def test_local_costs_match_a_general_solver():
    rng = np.random.default_rng(11)
    deltas, noise, ridge = rng.normal(size=(6, 9, 3)) * 4, 1.5, 2.0
    ranges = np.array([[0, 1], [-1, 1], [-0.5, 0], [0, 0.4], [-1, 2], [0.1, 1]])
    motion = rng.normal(size=(5, 9, 3)) * 3
    trust = rng.uniform(0.2, 1, 9)
    found = solve_weights(
        deltas,
        motion,
        ranges=ranges,
        marker_trust=trust,
        ridge=ridge,
        noise_mm=noise,
    ).weights
    for frame, weights in zip(motion, found, strict=True):
        cost = np.zeros(6)
        for row, shape in enumerate(deltas):
            energy = trust * (shape**2).sum(axis=1)
            size = np.sqrt((energy * (shape**2).sum(axis=1)).sum() / energy.sum())
            seen = np.sqrt((energy * (frame**2).sum(axis=1)).sum() / energy.sum())
            cost[row] = noise**2 * size / (seen + noise)

        def objective(halves, frame=frame, cost=cost):
            up, down = halves.reshape(2, -1)
            off = ((frame - np.einsum("s,smc->mc", up - down, deltas)) ** 2).sum(axis=1)
            size = 2 * cost @ (up + down)
            return (trust * off).sum() + ridge * ((up - down) ** 2).sum() + size

        bounds = [(max(lo, 0), max(hi, 0)) for lo, hi in ranges]
        bounds += [(max(-hi, 0), max(-lo, 0)) for lo, hi in ranges]
        start = np.array([low for low, _ in bounds])
        other = optimize.minimize(objective, start, bounds=bounds, options={"ftol": 1e-14}).x
        np.testing.assert_allclose(weights, other[:6] - other[6:], atol=1e-4)


def test_costs_mean_the_same_on_a_face_of_another_size(deltas, weights):
    noisy = motion_of(weights, deltas) + np.random.default_rng(3).normal(size=(50, 30, 3))
    small = solve_weights(deltas, noisy, ridge=1.0, noise_mm=2.0)
    large = solve_weights(9 * deltas, 9 * noisy, ridge=81.0, noise_mm=18.0)
    np.testing.assert_allclose(large.weights, small.weights, atol=1e-7)


def test_markers_that_hardly_move_draw_on_few_shapes_and_others_as_before():
    rng = np.random.default_rng(12)
    deltas = np.zeros((12, 40, 3))
    deltas[:6, :20], deltas[6:, 20:] = rng.normal(size=(2, 6, 20, 3)) * 5
    weights = np.column_stack([rng.uniform(0.3, 1, (40, 6)), np.zeros((40, 6))])
    moved = motion_of(weights, deltas) + 0.7 * rng.normal(size=(40, 40, 3))
    options = {"ridge": 1.0}
    plain = solve_weights(deltas, moved, **options).weights
    local = solve_weights(deltas, moved, **options, noise_mm=1.2).weights
    assert local[:, 6:].mean() < 0.75 * plain[:, 6:].mean()
    np.testing.assert_allclose(local[:, :6], plain[:, :6], atol=0.01)


def test_tied_shapes_are_one_shape(deltas, weights):
    noisy = motion_of(weights, deltas) + np.random.default_rng(3).normal(size=(50, 30, 3))
    tied = solve_weights(deltas, noisy, tied=[(2, 5)]).weights
    merged = np.delete(deltas, 5, axis=0)
    merged[2] += deltas[5]
    single = solve_weights(merged, noisy).weights
    np.testing.assert_array_equal(tied[:, 2], tied[:, 5])
    np.testing.assert_allclose(np.delete(tied, 5, axis=1), single, atol=1e-8)
