import numpy as np
import pytest

from usdface.numerics.measure.performance_error import (
    SurfaceError,
    blink_peak_bias,
    measure_lips,
    measure_shapes,
    relative_jitter,
)
from usdface.numerics.regression.cross_validation import surface_errors_mm, weight_rmse


def acted(frames: int = 400, shapes: int = 4) -> np.ndarray:
    time = np.linspace(0, 12, frames)[:, None]
    return 0.5 + 0.5 * np.sin(time * np.arange(1, shapes + 1))


def test_an_error_of_one_size_is_that_size() -> None:
    errors = np.full((50, 3), -0.2)
    assert weight_rmse(errors) == pytest.approx(0.2)
    shapes = measure_shapes(errors)
    np.testing.assert_allclose(shapes.rmse, 0.2)
    np.testing.assert_allclose(shapes.bias, -0.2)
    np.testing.assert_allclose(shapes.largest, 0.2)


def test_the_surface_by_its_gram_matrix_is_the_surface_point_by_point() -> None:
    rng = np.random.default_rng(0)
    errors, deltas = rng.normal(size=(60, 4)), rng.normal(size=(4, 30, 3))
    distance = np.linalg.norm(np.einsum("fs,svc->fvc", errors, deltas), axis=2)
    gram = np.einsum("svc,tvc->st", deltas, deltas) / 30
    surface = SurfaceError(surface_errors_mm(errors, gram))
    frames = np.sqrt((distance**2).mean(axis=1))
    np.testing.assert_allclose(surface.frames_mm, frames, rtol=1e-12)
    assert surface.rms_mm == pytest.approx(np.sqrt((distance**2).mean()), rel=1e-12)
    assert surface.p95_mm == pytest.approx(np.quantile(frames, 0.95), rel=1e-12)
    assert surface.max_mm == pytest.approx(frames.max(), rel=1e-12)


def test_blinks_count_only_at_their_peaks() -> None:
    truth = acted()
    errors = np.zeros_like(truth)
    high = truth[:, 1] > np.quantile(truth[:, 1], 0.97)
    errors[high, 1] = -0.3
    errors[~high, 1] = 0.9
    assert blink_peak_bias(errors, truth, np.array([1])) == pytest.approx(-0.3)
    assert np.isnan(blink_peak_bias(errors, truth, np.array([], dtype=np.int64)))


def test_eyes_that_are_shut_for_long_are_at_their_peaks_while_shut() -> None:
    truth = np.zeros((200, 2))
    truth[50:70, 1] = 1.0
    errors = np.where(truth > 0, -0.2, 0.5)
    assert blink_peak_bias(errors, truth, np.array([1])) == pytest.approx(-0.2)
    assert blink_peak_bias(errors[60:61], truth[60:61], np.array([1])) == pytest.approx(-0.2)
    for none in (truth[:40], truth[:1], truth[:0]):
        assert np.isnan(blink_peak_bias(np.ones_like(none), none, np.array([0, 1])))


def test_jitter_is_one_for_the_truth_and_grows_with_noise_not_with_an_offset() -> None:
    truth, frames = acted(), np.arange(400)
    noise = np.random.default_rng(0).normal(size=truth.shape)
    assert relative_jitter(truth, truth, frames) == 1.0
    assert relative_jitter(truth + 0.2, truth, frames) == pytest.approx(1.0)
    assert relative_jitter(0.5 * truth, truth, frames) == pytest.approx(0.5)
    few, many = (relative_jitter(truth + s * noise, truth, frames) for s in (1e-3, 1e-2))
    assert 1.0 < few < many


def test_jitter_does_not_see_a_gap_between_frames_as_a_jump() -> None:
    truth = acted()
    kept = np.r_[0:100, 250:400]
    solved = np.where(np.arange(400)[:, None] < 200, truth, truth + 5.0)
    assert relative_jitter(solved[kept], truth[kept], kept) == pytest.approx(1.0)
    sparse = np.arange(0, 400, 7)
    assert np.isnan(relative_jitter(truth[sparse], truth[sparse], sparse))


def test_jitter_over_a_truth_that_stands_still_is_not_known() -> None:
    """It was 100 million times that of the keys."""
    noise = np.random.default_rng(0).normal(0, 0.1, (40, 3))
    assert np.isnan(relative_jitter(noise, np.full((40, 3), 0.3), np.arange(40)))


def test_a_mouth_that_does_not_close_is_told_where_it_should() -> None:
    truth = np.linspace(0, 1, 101)[:, None]
    solved = np.maximum(truth, 0.2)  # never closes further
    lips = measure_lips(truth, solved, np.array([20.0]), rest_mm=0.5)
    np.testing.assert_allclose(lips.truth_mm, 0.5 + 20 * truth[:, 0])
    closed = truth[:, 0] * 20 + 0.5 <= 1.0
    assert lips.closed_bias_mm == pytest.approx((20 * (0.2 - truth[closed, 0])).mean())
    assert lips.rms_mm == pytest.approx(np.sqrt(((20 * (solved - truth)) ** 2).mean()))
    always_open = measure_lips(truth + 1.0, solved, np.array([20.0]), rest_mm=0.5)
    assert np.isnan(always_open.closed_bias_mm)


def test_lips_apart_at_rest_are_closed_where_they_are_no_further_apart() -> None:
    truth = np.array([[0.0], [0.5]])
    lips = measure_lips(truth, truth + 0.05, np.array([20.0]), rest_mm=2.5)
    assert lips.closed_bias_mm == pytest.approx(1.0)
    opened = measure_lips(truth[1:], truth[1:], np.array([20.0]), rest_mm=2.5)
    assert np.isnan(opened.closed_bias_mm)
