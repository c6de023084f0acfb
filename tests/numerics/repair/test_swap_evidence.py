"""The evidence of swaps against its definition, and the sparse search against the whole one."""

import numpy as np
import pytest

from tests.numerics.simulated_face import hold_head, simulate_face
from usdface.numerics.repair import relabeling
from usdface.numerics.repair.fit_low_rank import fit_low_rank
from usdface.numerics.repair.low_rank import fill_missing
from usdface.numerics.repair.relabeling import find_swaps, likeliest_states
from usdface.numerics.repair.swap_evidence import (
    likely_pairs,
    open_window,
    suspicious_pairs,
    weigh_swap,
)
from usdface.numerics.rigid.stabilization import stabilize

STEP_SCALE = 0.9


@pytest.fixture(scope="module")
def swapped():
    face = simulate_face(frames=1500, noise=0.15, swapped_share=0.2, dropout_share=0.02)
    neutral = int(np.argmax(face.visible[:, list(face.rigid)].sum(axis=1)))
    head = stabilize(face.captured, face.visible, rigid=face.rigid, neutral=neutral)
    still = hold_head(face.captured, head)
    model = fit_low_rank(still, face.visible)
    return still, face.visible, model


def square(vectors):
    return (vectors**2).sum(axis=-1)


def test_a_pair_lies_as_far_off_as_hiding_both_says(swapped):
    still, visible, model = swapped
    window = open_window(still, visible, model)
    complete = fill_missing(model, still, visible)
    for pair in likely_pairs(still, visible, model, 0.15, STEP_SCALE)[::40]:
        both = [pair.first, pair.second]
        good = np.ones_like(visible)
        good[:, both] = False
        expected = complete - fill_missing(model, complete, good)
        away = (pair.mixing @ window.offsets[both].reshape(6, -1)).reshape(2, 3, -1)
        np.testing.assert_allclose(away.transpose(2, 0, 1), expected[:, both], atol=2e-4)


def test_pairs_that_are_passed_over_hold_no_hint(swapped):
    still, visible, model = swapped
    seen = np.ones_like(visible)
    complete = fill_missing(model, still, visible)
    window = open_window(complete, seen, model)
    pairs = likely_pairs(complete, seen, model, 0.15, STEP_SCALE)
    found = suspicious_pairs(pairs, window, step_scale=STEP_SCALE)
    hinted = []
    for pair in pairs:
        a, b = pair.first, pair.second
        x, y = complete[:, a], complete[:, b]
        away = (pair.mixing @ window.offsets[[a, b]].reshape(6, -1)).reshape(2, 3, -1)
        x_away, y_away = away.transpose(0, 2, 1)
        x_place = square(x_away) - square(x_away + y - x)
        y_place = square(y_away) - square(y_away + x - y)
        place = np.minimum(x_place, y_place) / pair.residual_variance
        x_jump = square(x[1:] - y[:-1]) - square(np.diff(x, axis=0))
        y_jump = square(y[1:] - x[:-1]) - square(np.diff(y, axis=0))
        jump = np.maximum(x_jump, y_jump) / STEP_SCALE**2
        hinted.append((place > 4).any() or (jump < -20).any())
    np.testing.assert_array_equal(found, hinted)
    assert 0 < np.count_nonzero(found) < len(pairs) / 2


@pytest.mark.parametrize("frames", [97, 700])
def test_swaps_do_not_depend_on_how_many_frames_are_looked_at_at_once(swapped, monkeypatch, frames):
    still, visible, model = swapped
    whole = find_swaps(still, visible, model=model, noise=0.15, neutral=0)
    monkeypatch.setattr("usdface.core.arrays._BLOCK_FRAMES", frames)
    assert whole
    assert find_swaps(still, visible, model=model, noise=0.15, neutral=0) == whole


def test_a_search_of_telling_frames_alone_finds_what_the_whole_take_does(swapped):
    still, visible, model = swapped
    window = open_window(still, visible, model)
    noise = 0.15
    found = find_swaps(still, visible, model=model, noise=0.15, neutral=0)
    scale = relabeling._jump_scale(still, visible, noise)
    of_whole = set()
    for pair in likely_pairs(still, visible, model, noise, scale):
        gain, toggle = weigh_swap(pair, window, step_scale=scale)
        for start, stop in relabeling.runs(likeliest_states(gain, toggle)):
            of_whole.add((pair.first, pair.second, start, stop))
    assert {(s.first, s.second, s.start, s.stop) for s in found} <= of_whole
