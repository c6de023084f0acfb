"""The smoother against a sparse solve, and its choice of strength in the cosine domain."""

import numpy as np
import pytest
from scipy.fft import dct
from scipy.sparse import diags_array, identity
from scipy.sparse.linalg import spsolve
from scipy.spatial.transform import Rotation

from usdface.numerics.repair import smoothing
from usdface.numerics.repair.smoothing import (
    gcv_penalties,
    significant_detail,
    smooth_poses,
    smooth_take,
    smooth_tracks,
)


def penalties_of(y):
    return gcv_penalties(dct(y, axis=0, norm="ortho"))


def test_equals_a_direct_solve(monkeypatch):
    y = np.random.default_rng(0).standard_normal(600)
    differences = diags_array([-1.0, 3.0, -3.0, 1.0], offsets=[0, 1, 2, 3], shape=(597, 600))
    direct = spsolve((identity(600) + 50.0 * differences.T @ differences).tocsc(), y)
    monkeypatch.setattr(smoothing, "gcv_penalties", lambda spectrum: np.full(1, 50.0))
    ours = smooth_tracks(y[:, None])[:, 0]
    np.testing.assert_allclose(ours, direct, atol=1e-9)


def test_a_head_that_turns_at_the_ends_of_a_take_turns_on():
    """Mirrored series would stop there, and move the face by as much as the head in some frames."""
    frames, noise = np.arange(600), 0.1
    turning = (100 * np.sin((frames - 40) / 25.0))[:, None]
    found = smooth_tracks(turning + noise * np.random.default_rng(1).standard_normal((600, 1)))
    assert np.abs(found - turning)[[*range(8), *range(-8, 0)]].max() < 3 * noise


def test_a_constant_is_untouched_and_scale_and_shift_pass_through():
    y = np.random.default_rng(0).standard_normal((300, 2))
    np.testing.assert_allclose(smooth_tracks(np.full((50, 1), 7.0)), 7.0)
    base = smooth_tracks(y)
    moved = smooth_tracks(1e3 * y + 5)
    np.testing.assert_allclose(moved, 1e3 * base + 5, atol=1e-5)
    np.testing.assert_array_equal(penalties_of(1e3 * y + 5), penalties_of(y))


@pytest.mark.parametrize("noise", [0.05, 0.3])
def test_noise_is_removed_and_more_of_it_is_smoothed_more(noise):
    rng = np.random.default_rng(0)
    truth = np.sin(np.arange(4000) / 40.0)[:, None] * [5.0, 1.0]
    noisy = truth + noise * rng.standard_normal(truth.shape)
    assert np.abs(smooth_tracks(noisy) - truth).std() < 0.3 * noise
    penalties = penalties_of(noisy)
    assert penalties[1] > penalties[0]


def test_series_of_known_noise_alone_are_shrunk_to_their_mean():
    rng = np.random.default_rng(0)
    noise = rng.standard_normal((2000, 200)) + 5
    left = smooth_tracks(noise, noise=1.0) - noise.mean(axis=0)
    assert (left**2).mean() < 0.5 * ((smooth_tracks(noise) - noise.mean(axis=0)) ** 2).mean()
    slow = np.sin(np.arange(2000) / 100)[:, None] + 0.2 * rng.standard_normal((2000, 1))
    np.testing.assert_allclose(smooth_tracks(slow, noise=0.2), smooth_tracks(slow), atol=0.01)


def test_a_rare_movement_comes_back_and_noise_does_not():
    rng = np.random.default_rng(0)
    rest = 0.15 * rng.standard_normal((5000, 4, 3))
    event = np.exp(-(((np.arange(5000) - 2500) / 10.0) ** 2))
    rest[:, 2] += 2.0 * event[:, None]
    detail = significant_detail(rest, noise=np.full(4, 0.15))
    np.testing.assert_allclose(
        detail[2490:2511, 2], 2.0 * event[2490:2511, None] * [1, 1, 1], atol=0.35
    )
    assert np.abs(detail[:, [0, 1, 3]]).max() < 0.2
    assert (detail[:, [0, 1, 3]] == 0).mean() > 0.95


def test_expressions_weaker_than_the_noise_stay():
    rng, noise = np.random.default_rng(0), 0.4
    shapes = np.linalg.qr(rng.standard_normal((90, 13)))[0].T
    slow = np.sin(np.arange(2000)[:, None] / rng.uniform(15, 40, 13))
    truth = slow * np.append(np.full(12, 20.0), 2.0) @ shapes  # the last: 0.2 mm in each coordinate
    positions = (truth + noise * rng.standard_normal(truth.shape)).reshape(2000, 30, 3)
    smooth_take(positions, noise=np.full(30, noise))
    error = positions.reshape(truth.shape) - truth
    assert error.std() < 0.25 * noise
    along = positions.reshape(truth.shape) @ shapes[-1]
    assert along.std() == pytest.approx((truth @ shapes[-1]).std(), rel=0.05)


@pytest.mark.parametrize("frames", [1, 3])
def test_short_takes_are_as_they_were(frames):
    positions = np.random.default_rng(0).standard_normal((frames, 4, 3))
    before = positions.copy()
    smooth_take(positions, noise=np.ones(4))
    np.testing.assert_allclose(positions, before, atol=1e-12)


def test_short_series_are_returned_as_they_are():
    np.testing.assert_array_equal(smooth_tracks(np.eye(3)), np.eye(3))


def test_smoothed_poses_stay_rigid_and_lose_their_jitter():
    rng = np.random.default_rng(0)
    t = np.arange(1500) / 60
    true = Rotation.from_rotvec(np.stack([0.3 * np.sin(t), 0.5 * np.sin(0.7 * t), 0 * t], 1))
    motion = np.tile(np.eye(4), (1500, 1, 1))
    motion[:, :3, :3] = (
        true * Rotation.from_rotvec(0.01 * rng.standard_normal((1500, 3)))
    ).as_matrix()
    motion[:, :3, 3] = 100 * np.sin(t)[:, None]
    smooth = smooth_poses(motion, center=[0.0, 0.0, 0.0])
    R = smooth[:, :3, :3]
    np.testing.assert_allclose(np.linalg.det(R), 1, atol=1e-12)
    assert (true.inv() * Rotation.from_matrix(R)).magnitude().mean() < 0.005


@pytest.mark.parametrize("degrees_per_second", [36.0, 200.0])
def test_smoothed_poses_follow_a_performer_who_turns_around(degrees_per_second):
    t = np.arange(1200) / 60
    yaw, nod = np.radians(degrees_per_second * t), 0.2 * np.sin(2 * t)
    true = Rotation.from_euler("YX", np.stack([yaw, nod], axis=1))
    noise = Rotation.from_rotvec(0.002 * np.random.default_rng(0).standard_normal((1200, 3)))
    motion = np.tile(np.eye(4), (1200, 1, 1))
    motion[:, :3, :3] = (true * noise).as_matrix()
    smooth = Rotation.from_matrix(smooth_poses(motion, center=np.zeros(3))[:, :3, :3])
    assert (true.inv() * smooth).magnitude().max() < 0.01
