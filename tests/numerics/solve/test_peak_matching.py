"""Region-wise scale: a blink closes the eye on every face."""

import numpy as np
import pytest

from tests.numerics.small_face import small_face
from usdface.numerics.solve.blendshape_equation import solve_weights
from usdface.numerics.solve.peak_matching import effective_size, match_peaks, shape_evidence


@pytest.fixture(scope="module")
def take():
    """Return deltas, motion whose lids go only 60 % as far, weights, and the blinks' columns."""
    face, rng = small_face(), np.random.default_rng(0)
    blinks = [face.names.index("blinkL"), face.names.index("blinkR")]
    lids = np.linalg.norm(face.offsets[blinks], axis=2).argsort(axis=1)[:, -3:].ravel()
    carriers = np.concatenate([face.skin[rng.permutation(len(face.skin))[:120]], lids])
    deltas = face.offsets[:, carriers]
    weights = np.clip(rng.uniform(-2, 1, (300, len(deltas))), 0, 1)
    weights[::6, blinks] = 1
    seen = deltas.copy()
    seen[blinks] *= 0.6
    return deltas, np.einsum("fs,smc->fmc", weights, seen), weights, blinks


def test_blinks_reach_their_range_after_matching(take):
    deltas, motion, weights, blinks = take
    before = solve_weights(deltas, motion, ridge=10).weights
    gain = match_peaks(deltas, motion, blinks)
    after = solve_weights(deltas, motion * gain[:, None], ridge=10).weights
    shut = weights[:, blinks] == 1
    assert before[:, blinks][shut].mean() < 0.7
    assert after[:, blinks][shut].mean() > 0.9


def test_markers_that_do_not_blink_keep_their_scale(take):
    deltas, motion, _, blinks = take
    gain = match_peaks(deltas, motion, blinks)
    far = np.linalg.norm(deltas[blinks], axis=2).max(axis=0) < 0.5
    np.testing.assert_array_equal(gain[far], 1)
    assert (gain > 1.3).any()


def test_a_shape_the_take_does_not_show_changes_nothing(take):
    deltas, motion, weights, blinks = take
    still = motion - np.einsum("fs,smc->fmc", weights[:, blinks], 0.6 * deltas[blinks])
    np.testing.assert_array_equal(match_peaks(deltas, still, blinks), 1)


def lid_and_brow() -> tuple[np.ndarray, np.ndarray]:
    """A blink and a brow; the last marker goes twice as far with the brow as with the blink."""
    deltas = np.zeros((2, 21, 3))
    deltas[0, :10, 1], deltas[1, 10:20, 1] = -6.0, 12.0
    deltas[0, 20, 1], deltas[1, 20, 0] = -6.0, 12.0
    weights = np.zeros((100, 2))
    weights[::4, 0], weights[1::4, 1] = 1.0, 1.0
    return deltas, np.einsum("fs,smc->fmc", weights * [0.6, 1.0], deltas)


def test_a_marker_takes_the_gain_by_its_share_in_the_shape() -> None:
    gain = match_peaks(*lid_and_brow(), [0], ridge=0.0)
    np.testing.assert_allclose(gain[:10], 1 / 0.6, rtol=0.05)
    np.testing.assert_array_equal(gain[10:20], 1.0)
    assert gain[20] - 1 == pytest.approx((1 / 0.6 - 1) / 4, rel=0.1)


def test_a_shape_that_goes_below_zero_alone_is_no_hindrance() -> None:
    deltas, motion = lid_and_brow()
    deltas[1] *= -1
    ranges = np.array([[0.0, 1.0], [-1.0, 0.0]])
    gain = match_peaks(deltas, motion, [0], ranges=ranges, ridge=0.0)
    np.testing.assert_allclose(gain[:10], 1 / 0.6, rtol=0.05)


def lids_and_brow(blinks: np.ndarray, fold: float) -> tuple[np.ndarray, np.ndarray]:
    """Two blinks with a lid's marker each, 18 markers of a brow; lids follow it by a share."""
    rng = np.random.default_rng(0)
    deltas = np.zeros((3, 20, 3))
    deltas[0, 0], deltas[1, 1] = (0, -9, 3), (0, -9, 3)
    deltas[2, 2:] = rng.normal(loc=(0, 8, 0), size=(18, 3))
    brow = np.clip(np.cumsum(rng.normal(size=400)) * 0.1, -1, 1)
    motion = np.einsum("fs,smc->fmc", np.column_stack([blinks, brow]), deltas)
    motion[:, :2] += fold * brow[:, None, None] * np.array([0, 8.0, 0])
    return deltas, motion + 0.1 * rng.normal(size=motion.shape)


def test_blinks_that_the_brow_does_not_predict_are_shown() -> None:
    blinks = np.zeros((400, 2))
    blinks[::9] = 0.6  # lids that travel six tenths of the character's
    evidence = shape_evidence(*lids_and_brow(blinks, fold=0.8), [0, 1], surface_mm=[9.5, 9.5])
    assert evidence.marked.all()
    assert evidence.shown
    np.testing.assert_allclose(evidence.independent_peaks, 0.6, atol=0.1)


def test_winks_of_one_eye_are_shown() -> None:
    blinks = np.zeros((400, 2))
    blinks[::9, 0] = 0.6
    evidence = shape_evidence(*lids_and_brow(blinks, fold=0.8), [0, 1], surface_mm=[9.5, 9.5])
    assert evidence.independent_peaks.mean() < 0.4
    assert evidence.alone.tolist() == [True, False]
    assert evidence.shown


def test_a_wink_counts_in_full_at_a_marker_above_the_margin_of_the_lid() -> None:
    """The surface moves twice as far as the markers, which see half of a blink."""
    blinks = np.zeros((400, 2))
    blinks[::9, 0] = 0.6
    above = {"shapes": [0, 1], "surface_mm": [18.0, 18.0]}
    wink = shape_evidence(*lids_and_brow(blinks, fold=0.8), **above)
    assert wink.marked.all()
    assert wink.independent_peaks.max() < 0.4
    assert wink.shown
    blinks[::9, 1] = 0.6
    assert not shape_evidence(*lids_and_brow(blinks, fold=0.8), **above).shown
    assert not shape_evidence(*lids_and_brow(blinks / 2, fold=0.8), **above).shown
    blinks[::9, 1] = 0.0
    assert not shape_evidence(*lids_and_brow(blinks / 2, fold=0.8), **above).shown


def test_a_lid_that_the_other_follows_by_less_shows_no_wink() -> None:
    blinks = np.zeros((400, 2))
    blinks[::9] = (0.5, 0.2)
    evidence = shape_evidence(*lids_and_brow(blinks, fold=0.8), [0, 1], surface_mm=[9.5, 9.5])
    assert not evidence.alone.any()
    assert not evidence.shown


def test_lids_that_follow_the_brow_show_no_blink() -> None:
    evidence = shape_evidence(
        *lids_and_brow(np.zeros((400, 2)), fold=0.8), [0, 1], surface_mm=[9.5, 9.5]
    )
    assert evidence.marked.all()
    assert not evidence.shown
    assert evidence.independent_peaks.max() < 0.1


def test_a_marker_beside_the_lid_does_not_mark_it() -> None:
    blinks = np.zeros((400, 2))
    blinks[::9] = 1.0
    deltas, motion = lids_and_brow(blinks, fold=0.0)
    evidence = shape_evidence(deltas, motion, [0, 1], surface_mm=[9.5, 40.0])
    assert evidence.marked.tolist() == [True, False]
    assert evidence.independent_peaks[1] == pytest.approx(9.5 / 40.0, abs=0.05)


def test_an_effective_size_leaves_out_points_that_stay() -> None:
    moved = np.random.default_rng(0).normal(size=(3, 30, 3))
    padded = np.concatenate([moved, np.zeros((3, 900, 3))], axis=1)
    np.testing.assert_allclose(effective_size(padded), effective_size(moved))
    assert effective_size(np.full((1, 5, 3), 2.0)) == pytest.approx(np.sqrt(12.0))
