"""The two-state search against enumeration; swaps against what must not be one."""

import itertools

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from tests.numerics.simulated_face import simulate_face
from usdface.numerics.motion.noise import marker_noise
from usdface.numerics.repair.fit_low_rank import choose_rank, fit_low_rank
from usdface.numerics.repair.low_rank import fill_missing, predict_from_others
from usdface.numerics.repair.relabeling import Swap, apply_swaps, find_swaps, likeliest_states


@pytest.mark.parametrize("seed", range(20))
def test_the_likeliest_course_is_the_best_of_all_courses(seed):
    rng = np.random.default_rng(seed)
    gain, toggle = rng.normal(0, 2, 9), rng.normal(1, 3, 9)
    toggle[0] = abs(toggle[0])

    def total(states):
        changes = np.diff(np.concatenate([[0], states])) != 0
        return gain[np.array(states, bool)].sum() - toggle[changes].sum()

    best = max(itertools.product((0, 1), repeat=9), key=total)
    assert total(likeliest_states(gain, toggle).astype(int)) == pytest.approx(total(best))


def test_applying_swaps_twice_restores_everything():
    values = np.random.default_rng(0).random((20, 5, 3))
    changed = values.copy()
    swaps = (Swap(0, 3, 2, 9), Swap(1, 4, 5, 20))
    apply_swaps(changed, swaps)
    np.testing.assert_array_equal(changed[2:9, 0], values[2:9, 3])
    apply_swaps(changed, swaps)
    np.testing.assert_array_equal(changed, values)


def test_a_face_without_swaps_has_none():
    face = simulate_face(frames=2000, noise=0.15, dropout_share=0.05)
    model = fit_low_rank(face.truth, face.visible)
    filled = fill_missing(model, face.truth, face.visible)
    assert find_swaps(filled, face.visible, model=model, noise=0.15, neutral=0) == ()


def test_a_swap_to_the_end_of_a_short_take_is_found_by_its_only_jump():
    face = simulate_face(frames=300, markers=20, seed=1)
    distances = np.linalg.norm(face.truth[0] - face.truth[0, 4], axis=1)
    swap = Swap(*sorted((4, int(distances.argsort()[1]))), 225, 300)
    positions = face.truth + 0.1 * np.random.default_rng(0).standard_normal(face.truth.shape)
    apply_swaps(positions, (swap,))
    model = fit_low_rank(positions, face.visible)
    assert find_swaps(positions, face.visible, model=model, noise=0.1, neutral=0) == (swap,)


def test_a_marker_is_predicted_from_the_others_as_linear_regression_does():
    rng = np.random.default_rng(0)
    drive = gaussian_filter1d(rng.standard_normal((3000, 4)), 10, axis=0)
    hidden = drive @ rng.standard_normal((4, 24)) * 25
    data = (hidden + 0.1 * rng.standard_normal((3000, 24))).reshape(3000, 8, 3)
    model = fit_low_rank(data, np.ones((3000, 8), bool))
    others = np.delete(data, 5, axis=1).reshape(3000, -1)
    design = np.column_stack([np.ones(3000), others])
    fitted = design @ np.linalg.lstsq(design, data[:, 5], rcond=None)[0]
    assert np.abs(predict_from_others(model, data)[:, 5] - fitted).std() < 0.02


def test_filling_equals_predicting_the_marker_alone():
    face = simulate_face(frames=800, noise=0.1)
    model = fit_low_rank(face.truth, face.visible)
    good = face.visible.copy()
    good[:, 11] = False
    filled = fill_missing(model, face.truth, good)
    predicted = predict_from_others(model, face.truth)
    np.testing.assert_allclose(filled[:, 11], predicted[:, 11], atol=1e-6)
    np.testing.assert_array_equal(filled[:, :11], face.truth[:, :11])


def test_a_short_take_affords_fewer_directions_than_a_long_one():
    long, short = (simulate_face(frames=n, noise=0.3, seed=3) for n in (4000, 300))
    ranks = []
    for take in (short, long):
        noise = marker_noise(take.truth, take.visible)
        model = fit_low_rank(take.truth, take.visible, noise=noise)
        ranks.append(choose_rank(take.truth, take.visible, start=model, noise=noise))
    assert ranks[0] < ranks[1]


def test_a_marker_without_a_good_sample_is_named():
    good = np.ones((50, 4), bool)
    good[:, 2] = False
    with pytest.raises(ValueError, match=r"markers \[2\]"):
        fit_low_rank(np.zeros((50, 4, 3)), good)
