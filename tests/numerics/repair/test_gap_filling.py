"""Gaps: short ones along the curve, long ones from the others, none beyond what was allowed."""

import numpy as np
import pytest

from usdface.numerics.repair.gap_filling import choose_spline_limit, fill_gaps


def tracks(frames=400, markers=3, noise=0.0):
    t = np.arange(frames)[:, None, None] / 60
    phase = np.arange(markers)[:, None] + np.arange(3)
    smooth = 20 * np.sin(t * 2 + phase) + 3 * np.sin(t * 7 + 2 * phase)
    return smooth + noise * np.random.default_rng(0).standard_normal(smooth.shape)


def hidden(shape, start, stop, marker=1):
    visible = np.ones(shape[:2], bool)
    visible[start:stop, marker] = False
    return visible


def test_a_cubic_track_is_recovered_exactly():
    t = np.arange(60.0)
    truth = np.stack([t**3 / 900, 5 - t**2 / 30, 2 * t], 1)[:, None]
    visible = hidden(truth.shape, 30, 35, 0)
    points, found, _ = fill_gaps(
        np.where(visible[..., None], truth, 0),
        visible,
        max_gap=10,
        prediction=truth + 1.0,
        spline_limit=5,
    )
    np.testing.assert_allclose(points, truth, atol=1e-9)
    assert found.sum() == 5


def test_a_gap_is_filled_up_to_the_limit_and_never_past_it():
    points, visible = tracks(), hidden((400, 3), 100, 120)

    def filled_up_to(max_gap):
        return fill_gaps(points, visible, max_gap=max_gap, prediction=points + 1.0, spline_limit=8)

    _, filled, confidence = filled_up_to(20)
    assert filled.sum() == 20
    assert (confidence[filled] < 1).all()
    _, filled, confidence = filled_up_to(19)
    assert not filled.any()
    assert (confidence[100:120, 1] == 0).all()


@pytest.mark.parametrize("rate", [30.0, 60.0, 120.0])
def test_confidence_is_what_a_face_remembers_of_the_nearest_sample(rate):
    visible = hidden((400, 3), 100, 120)
    _, _, confidence = fill_gaps(
        tracks(), visible, max_gap=20, prediction=tracks() + 1, spline_limit=8, rate=rate
    )
    away = np.minimum(np.arange(1, 21), np.arange(20, 0, -1)) / rate
    expected = np.maximum(np.exp(-((away / 0.15) ** 2)), 0.01)
    np.testing.assert_allclose(confidence[100:120, 1], expected, rtol=1e-6)


def test_a_prediction_that_is_off_by_a_constant_is_corrected_from_both_ends():
    points, visible = tracks(), hidden((400, 3), 100, 200)
    filled, _, _ = fill_gaps(
        np.where(visible[..., None], points, 0),
        visible,
        max_gap=200,
        prediction=points + np.array([3, -2, 1]),
        spline_limit=8,
    )
    np.testing.assert_allclose(filled, points, atol=1e-9)


def test_a_gap_with_too_few_other_markers_is_filled_along_the_curve():
    points = tracks()
    visible = np.ones((400, 3), bool)
    visible[100:110] = False
    filled, found, _ = fill_gaps(
        points, visible, max_gap=200, prediction=points + 5, spline_limit=4
    )
    assert found[100:110].all()
    assert np.abs(filled - points).max() < 0.5


def test_seen_samples_are_never_touched():
    points, visible = tracks(noise=1), np.random.default_rng(1).random((400, 3)) > 0.2
    filled, _, confidence = fill_gaps(
        points, visible, max_gap=50, prediction=points + 1, spline_limit=8
    )
    np.testing.assert_array_equal(filled[visible], points[visible])
    assert (confidence[visible] == 1).all()


def test_the_spline_reaches_farther_the_worse_the_prediction():
    points = tracks(frames=2000, markers=8)
    seen = np.ones((2000, 8), bool)
    rng = np.random.default_rng(0)
    bad, good = (points + size * rng.standard_normal(points.shape) for size in (5, 1e-3))
    assert choose_spline_limit(points, seen, bad, noise=0) > choose_spline_limit(
        points, seen, good, noise=0
    )
