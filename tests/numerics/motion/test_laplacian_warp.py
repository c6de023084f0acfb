"""The warp against eq. 12 solved densely, and what an animator may count on."""

import math

import numpy as np
import pytest

from usdface.numerics.motion.laplacian_warp import (
    Insertion,
    ease_weights,
    reach_frames,
    solve_warp,
    stretch_motion,
    warp_motion,
)

CONTROLS = 5


def walk(rng: np.random.Generator, frames: int) -> np.ndarray:
    return np.cumsum(rng.normal(0, 0.02, (frames, CONTROLS)), axis=0)


def dense(
    motion: np.ndarray, insertions: list[Insertion], *, blend: int, keep: float
) -> np.ndarray:
    """Eq. 12 as it is printed: stacked rows, solved by least squares."""
    n = len(motion)
    difference = np.diff(np.eye(n), axis=0)
    rows, right = [difference], [difference @ motion]
    kept = np.ones(n, bool)
    for each in insertions:
        kept[max(each.start - blend, 0) : each.stop + blend] = False
        for key, weight, frame in zip(
            each.keys, each.weights, range(each.start, each.stop), strict=True
        ):
            rows.append(math.sqrt(weight) * np.eye(n)[[frame]])
            right.append(math.sqrt(weight) * key[None])
    rows.append(math.sqrt(keep) * np.eye(n)[kept])
    right.append(math.sqrt(keep) * motion[kept])
    return np.linalg.lstsq(np.concatenate(rows), np.concatenate(right), rcond=None)[0]


def insertion(rng: np.random.Generator, start: int, count: int) -> Insertion:
    return Insertion(start, rng.random((count, CONTROLS)), rng.uniform(0.1, 30.0, count))


@pytest.mark.parametrize("keep", [0.3, 1.0, 50.0])
def test_windows_give_what_the_whole_printed_equation_gives(keep: float):
    rng = np.random.default_rng(0)
    motion = walk(rng, 700)
    insertions = [insertion(rng, s, c) for s, c in ((150, 20), (0, 9), (215, 40), (660, 40))]
    warped = warp_motion(motion, insertions, blend=7, keep=keep)
    np.testing.assert_allclose(warped, dense(motion, insertions, blend=7, keep=keep), atol=1e-10)


def test_held_outside_it_is_the_equation_with_an_endless_weight():
    rng = np.random.default_rng(0)
    motion = walk(rng, 120)
    each = insertion(rng, 50, 12)
    warped = warp_motion(motion, [each], blend=8)
    weights = np.full(120, 1e12)
    distance = np.arange(1.0, 9.0)
    weights[42:50] = 2 / distance**2
    weights[62:70] = 2 / distance[::-1] ** 2
    weights[50:62] = each.weights
    targets = motion.copy()
    targets[50:62] = each.keys
    difference = np.diff(np.eye(120), axis=0)
    full = difference.T @ difference + np.diag(weights)
    expected = motion + np.linalg.solve(full, weights[:, None] * (targets - motion))
    np.testing.assert_allclose(warped, expected, atol=1e-10)


def test_outside_the_blend_not_one_bit_changes():
    rng = np.random.default_rng(0)
    motion = walk(rng, 500)
    warped = warp_motion(motion, [insertion(rng, 200, 50)], blend=10)
    outside = np.r_[0:190, 260:500]
    assert np.array_equal(warped[outside], motion[outside])
    assert (warped[190:260] != motion[190:260]).all()


def test_heavy_keys_are_met_and_light_ones_give_way():
    rng = np.random.default_rng(0)
    motion, keys = walk(rng, 200), rng.random((30, CONTROLS))
    errors = [
        np.abs(warp_motion(motion, [Insertion(90, keys, np.full(30, w))])[90:120] - keys).max()
        for w in (1.0, 100.0, 1e6)
    ]
    assert errors[0] > errors[1] > errors[2]
    assert errors[2] < 1e-5


def test_inserting_the_motion_itself_changes_nothing():
    motion = walk(np.random.default_rng(0), 200)
    same = Insertion(80, motion[80:120], np.full(40, 3.0))
    np.testing.assert_array_equal(warp_motion(motion, [same]), motion)


def test_the_change_fades_without_a_kink_at_the_outer_end():
    motion = np.zeros((100, 1))
    warped = warp_motion(motion, [Insertion(50, np.ones((50, 1)), np.full(50, 1e6))], blend=20)
    steps = np.diff(warped[25:50, 0])
    assert (steps >= 0).all()
    assert steps[5] < 0.1 * steps.max()
    expected = (np.arange(1, 21) / 21) ** 2
    np.testing.assert_allclose(warped[30:50, 0], expected, atol=0.03)


def test_two_controls_warped_together_are_as_each_alone():
    rng = np.random.default_rng(0)
    motion, each = walk(rng, 150), insertion(rng, 60, 20)
    together = warp_motion(motion, [each])
    for c in range(CONTROLS):
        alone = warp_motion(
            motion[:, [c]], [Insertion(each.start, each.keys[:, [c]], each.weights)]
        )
        np.testing.assert_allclose(together[:, [c]], alone, atol=1e-13)


def test_reach_is_where_a_change_is_lost_in_rounding():
    rng = np.random.default_rng(0)
    motion = walk(rng, 300)
    warped = dense(motion, [insertion(rng, 100, 10)], blend=0, keep=1.0)
    assert reach_frames(1.0) == 44
    assert np.abs(warped - motion)[110 + 44 :].max() < 1e-12


def test_the_reach_of_any_weight_is_known():
    """However strongly frames are held, a change is divided by at least the weight a frame."""
    reaches = [reach_frames(10.0**power) for power in range(-3, 309)]
    assert reaches == sorted(reaches, reverse=True)
    assert reaches[-1] == 1


def test_eased_weights_are_symmetric_and_full_in_the_middle():
    weights = ease_weights(40, 20.0, ease=8)
    np.testing.assert_allclose(weights, weights[::-1])
    assert (weights[8:32] == 20.0).all()
    assert 0 < weights[0] < 1.0


def test_nothing_that_holds_is_refused():
    with pytest.raises(ValueError, match="undetermined"):
        solve_warp(np.zeros((4, 1)), np.zeros((4, 1)), np.zeros(4))


def test_a_stretched_motion_keeps_its_ends_and_never_overshoots():
    rng = np.random.default_rng(0)
    motion = rng.random((30, CONTROLS))
    for frames in (11, 30, 77):
        stretched = stretch_motion(motion, frames)
        assert stretched.shape == (frames, CONTROLS)
        np.testing.assert_allclose(stretched[[0, -1]], motion[[0, -1]], atol=1e-15)
        assert (stretched <= motion.max(axis=0) + 1e-12).all()
        assert (stretched >= motion.min(axis=0) - 1e-12).all()
    np.testing.assert_allclose(stretch_motion(motion, 59)[::2], motion, atol=1e-12)
