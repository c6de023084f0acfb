"""A basis calibrated from tuned pairs: between what was registered and what was tuned."""

import numpy as np
import pytest

from usdface.numerics.solve.blendshape_equation import solve_weights
from usdface.numerics.solve.calibrated_basis import calibrate_deltas, solve_calibrated


@pytest.fixture
def performer():
    """Return registered deltas, what they really are, a neutral that is off, weights, motion."""
    rng = np.random.default_rng(0)
    registered = rng.normal(size=(15, 40, 3)) * 3
    gain = np.exp(0.4 * rng.normal(size=(15, 1, 1)))
    true = registered * gain + rng.normal(size=registered.shape) * 0.8
    offset = rng.normal(size=(40, 3)) * 1.5
    weights = np.clip(rng.uniform(-0.8, 1, (160, 15)), 0, 1)
    motion = np.einsum("fs,smc->fmc", weights, true) + offset
    return registered, true, offset, weights, motion + rng.normal(0, 0.2, motion.shape)


def rmse(a, b):
    return float(np.sqrt(((a - b) ** 2).mean()))


def test_few_pairs_beat_the_registered_basis_on_frames_they_did_not_show(performer):
    registered, _, _, weights, motion = performer
    before = solve_weights(registered, motion[60:], method="bounded").weights
    for pairs, share in ((10, 0.8), (25, 0.4), (60, 0.15)):
        basis = calibrate_deltas(registered, motion[:pairs], weights[:pairs])
        after = solve_calibrated(basis, motion[60:])
        assert rmse(after, weights[60:]) < share * rmse(before, weights[60:])


def test_many_pairs_recover_deltas_and_neutral(performer):
    registered, true, offset, weights, motion = performer
    basis = calibrate_deltas(registered, motion, weights, stretch=(2.0, 1.0))
    assert rmse(basis.deltas, true) < 0.15 * rmse(registered, true)
    assert rmse(basis.offset, offset) < 0.15 * rmse(offset, 0)


def test_pairs_that_agree_with_the_rig_change_nothing(performer):
    registered, _, _, weights, _ = performer
    motion = np.einsum("fs,smc->fmc", weights, registered)
    basis = calibrate_deltas(registered, motion, weights)
    np.testing.assert_allclose(basis.deltas, registered, atol=1e-9)
    np.testing.assert_allclose(basis.offset, 0, atol=1e-9)


def test_a_shape_no_pair_shows_keeps_its_registered_deltas(performer):
    registered, _, _, weights, motion = performer
    unseen = weights[:30].copy()
    unseen[:, 4] = 0
    basis = calibrate_deltas(registered, motion[:30], unseen)
    np.testing.assert_allclose(basis.deltas[4], registered[4], atol=1e-12)


def test_is_the_same_estimate_as_ridge_regression_in_the_primal(performer):
    registered, _, _, weights, motion = performer
    w, m = weights[:12], motion[:12]
    basis = calibrate_deltas(registered, m, w, stretch=(1.0, 0.5))
    marker = 7
    own = (registered**2).sum(axis=2)
    allowed = own[:, marker] + 0.25 * own[:, marker].mean() + 0.05**2
    design = np.column_stack([w, np.ones(12)])
    penalty = np.diag(np.r_[1 / allowed, 1 / 3.0**2]) * 0.3**2
    change = np.linalg.solve(
        design.T @ design + penalty, design.T @ (m[:, marker] - w @ registered[:, marker])
    )
    np.testing.assert_allclose(basis.deltas[:, marker] - registered[:, marker], change[:-1])
    np.testing.assert_allclose(basis.offset[marker], change[-1])


def test_reports_the_error_of_pairs_left_out(performer):
    registered, _, _, weights, motion = performer
    basis = calibrate_deltas(registered, motion[:50], weights[:50])
    seen = solve_calibrated(basis, motion[60:])
    assert basis.weight_rmse == pytest.approx(rmse(seen, weights[60:]), rel=0.5)


def test_markers_without_trust_have_no_say(performer):
    registered, _, _, weights, motion = performer
    spoiled = motion.copy()
    spoiled[:, 3] = 1e3 * np.random.default_rng(1).normal(size=(160, 3))
    trust = np.ones(40)
    trust[3] = 0
    clean = calibrate_deltas(registered, motion[:30], weights[:30], marker_trust=trust)
    rough = calibrate_deltas(registered, spoiled[:30], weights[:30], marker_trust=trust)
    np.testing.assert_allclose(
        solve_calibrated(rough, spoiled[60:]), solve_calibrated(clean, motion[60:]), atol=1e-9
    )


def test_weights_stay_within_the_ranges(performer):
    registered, _, _, weights, motion = performer
    ranges = np.tile([0.1, 0.6], (15, 1))
    basis = calibrate_deltas(registered, motion[:30], weights[:30], ranges=ranges)
    found = solve_calibrated(basis, motion, ranges=ranges)
    assert (found >= 0.1).all()
    assert (found <= 0.6).all()


def test_a_confident_prior_is_followed(performer):
    registered, _, _, weights, motion = performer
    basis = calibrate_deltas(registered, motion[:30], weights[:30])
    wanted = np.random.default_rng(2).uniform(0, 1, weights.shape)
    found = solve_calibrated(basis, motion, prior=wanted, prior_precision=1e9 * np.eye(15))
    np.testing.assert_allclose(found, wanted, atol=1e-3)


@pytest.mark.parametrize(
    ("pairs", "message"), [(1, "at least 2 tuned pairs, got 1"), (0, "at least 2")]
)
def test_too_few_pairs_are_refused(performer, pairs, message):
    registered, _, _, weights, motion = performer
    with pytest.raises(ValueError, match=message):
        calibrate_deltas(registered, motion[:pairs], weights[:pairs])


def test_two_pairs_are_enough_to_start_with(performer):
    registered, _, _, weights, motion = performer
    basis = calibrate_deltas(registered, motion[:2], weights[:2])
    assert np.isfinite(solve_calibrated(basis, motion[:5])).all()


def test_arrays_that_do_not_fit_are_refused(performer):
    registered, _, _, weights, motion = performer
    with pytest.raises(ValueError, match="do not fit together"):
        calibrate_deltas(registered, motion[:9, :5], weights[:9])
