"""Fields over the surface, and predictions of left-out markers, against the dense formulas."""

import numpy as np
import pytest
from scipy.spatial.distance import cdist
from scipy.special import polygamma

from tests.numerics.manifold.small_process import (
    dense_covariance,
    dense_parts,
    draw_rows,
    small_places,
    small_spectrum,
)
from usdface.numerics.manifold.hyper_posterior import HyperPrior
from usdface.numerics.manifold.posterior_prediction import (
    average_dual_weights,
    calibrate_spread,
    join_moments,
    leave_markers_out,
    mix_variances,
    predict_mean,
    predict_variance,
    prior_shares,
    surface_basis,
)
from usdface.numerics.manifold.surface_fields import fit_covariance


def dense_prediction(spectrum, theta, row, cross, places) -> tuple[np.ndarray, np.ndarray]:  # type: ignore[no-untyped-def]
    """Mean and variance at points under one theta, as any textbook has them."""
    _, trend = dense_parts(spectrum)
    v0, _, a0, a1 = np.exp(theta)
    scale = np.array([a0, a1, a1, a1])
    here = np.concatenate([np.ones((len(places), 1)), places], axis=1)
    k = v0 * cross + (here * scale) @ trend.T
    solved = np.linalg.solve(dense_covariance(spectrum, theta), np.c_[row, k.T])
    own = v0 + (here**2 * scale).sum(axis=1)
    return k @ solved[:, 0], own - np.einsum("pi,ip->p", k, solved[:, 1:])


@pytest.mark.parametrize("markers", [12, 60])
def test_mean_and_variance_are_those_of_the_mixture_over_samples(markers: int) -> None:
    rng = np.random.default_rng(0)
    spectrum, at = small_spectrum(markers), small_places(markers)
    places = np.concatenate([at, rng.standard_normal((400, 3))])
    covariance = fit_covariance(cdist(at, at), length_scale=1.0)
    cross = covariance.cross(cdist(at, places))
    rows = draw_rows(spectrum, rng, 3)
    theta = np.log([3.0, 0.1, 1.0, 1.0])[:, None] + 0.5 * rng.standard_normal((20, 4, 3))
    basis = surface_basis(spectrum, cross, places)
    moments = average_dual_weights(spectrum, rows, theta)
    mean, variance = predict_mean(basis, moments)[0].T, predict_variance(basis, moments)
    for chain in range(3):
        each = [
            dense_prediction(spectrum, theta[s, :, chain], rows[chain], cross, places)
            for s in range(20)
        ]
        means = np.array([m for m, _ in each])
        exact = np.mean([v for _, v in each], axis=0) + means.var(axis=0)
        assert np.allclose(mean[chain], means.mean(axis=0), atol=2e-3)
        assert np.allclose(variance[chain], exact, rtol=2e-3, atol=5e-3)


def test_at_markers_without_noise_it_meets_them_and_is_sure() -> None:
    rng = np.random.default_rng(0)
    spectrum, at = small_spectrum(12), small_places(12)
    cross = fit_covariance(cdist(at, at), length_scale=1.0).cross(cdist(at, at))
    rows = draw_rows(spectrum, rng, 3)
    theta = np.repeat(np.log([4.0, 1e-5, 1.0, 1.0])[None, :, None], 3, axis=2)
    basis = surface_basis(spectrum, cross, at)
    moments = average_dual_weights(spectrum, rows, theta)
    assert np.allclose(predict_mean(basis, moments)[0].T, rows, atol=0.02)
    assert predict_variance(basis, moments).max() < 0.02


def test_batches_put_together_are_one_batch_and_axes_add_up() -> None:
    rng = np.random.default_rng(0)
    spectrum = small_spectrum(12)
    rows, theta = draw_rows(spectrum, rng, 6), 0.1 * rng.standard_normal((7, 4, 6))
    whole = average_dual_weights(spectrum, rows, theta)
    halves = [
        average_dual_weights(spectrum, rows[s], theta[..., s]) for s in (slice(3), slice(3, 6))
    ]
    joined = join_moments(halves)
    assert np.allclose(whole.mean, joined.mean, rtol=1e-4, atol=1e-4)
    assert np.allclose(whole.covariance, joined.covariance, rtol=1e-4, atol=1e-4)
    mixed = mix_variances(whole, np.array([1.0, 0.0, 2.0]))
    assert np.allclose(mixed.covariance[1], whole.covariance[3] + 2 * whole.covariance[5])
    assert np.allclose(mixed.constant, whole.constant[::3] + 2 * whole.constant[2::3])


def test_left_out_errors_are_those_of_fits_without_the_marker() -> None:
    rng = np.random.default_rng(0)
    spectrum = small_spectrum(12)
    row = draw_rows(spectrum, rng, 1)
    theta = np.log([4.0, 0.05, 1.0, 1.0])
    errors, expected = leave_markers_out(spectrum, row, theta[None, :, None])
    whole = dense_covariance(spectrum, theta)
    for marker in range(12):
        others = np.arange(12) != marker
        weights = np.linalg.solve(whole[np.ix_(others, others)], whole[others, marker])
        assert errors[0, marker] == pytest.approx(row[0, marker] - weights @ row[0, others])
        variance = whole[marker, marker] - weights @ whole[others, marker]
        assert expected[0, marker] ** 2 == pytest.approx(variance)


def test_a_marker_left_out_with_its_nearest_is_predicted_from_the_rest() -> None:
    rng = np.random.default_rng(0)
    spectrum = small_spectrum(12)
    row = draw_rows(spectrum, rng, 1)
    theta = np.log([4.0, 0.05, 1.0, 1.0])
    errors, expected = leave_markers_out(spectrum, row, theta[None, :, None], with_nearest=True)
    whole, alike = dense_covariance(spectrum, theta), dense_parts(spectrum)[0].copy()
    np.fill_diagonal(alike, -1.0)
    for marker in range(12):
        others = ~np.isin(np.arange(12), [marker, alike[marker].argmax()])
        weights = np.linalg.solve(whole[np.ix_(others, others)], whole[others, marker])
        assert errors[0, marker] == pytest.approx(row[0, marker] - weights @ row[0, others])
        variance = whole[marker, marker] - weights @ whole[others, marker]
        assert expected[0, marker] ** 2 == pytest.approx(variance)


def test_intervals_widen_where_and_along_which_axis_markers_surprise() -> None:
    rng = np.random.default_rng(0)
    places = rng.uniform(-100, 100, (60, 3))
    covariance = fit_covariance(cdist(places, places), length_scale=30.0)
    z = rng.standard_normal((200, 3, 60)) * np.array([1.0, 3.0, 0.5])[:, None]
    z[..., places[:, 0] > 0] *= 2.0
    points = np.array([[-60.0, 0, 0], [60.0, 0, 0]])
    found = calibrate_spread(
        z.reshape(-1, 60),
        np.ones((600, 60)),
        covariance.matrix(),
        covariance.cross(cdist(places, points)),
    )
    assert found.of_axes[1] / found.of_axes[0] == pytest.approx(3.0, rel=0.1)
    assert found.of_axes[2] / found.of_axes[0] == pytest.approx(0.5, rel=0.1)
    assert found.of_points[1] / found.of_points[0] > 1.3


def test_the_prior_counts_as_a_few_markers_where_no_marker_is() -> None:
    prior = HyperPrior()
    variance = polygamma(1, prior.markers / 2)  # of the logarithm of a mean of squares
    assert variance == pytest.approx(prior.spread[0] ** 2, rel=0.2)
    similar, level = np.array([0.0, 1.0, 0.6]), np.array([1.0, 1.0, 20.0])
    for markers in (5, 50):
        weight = prior.markers / (prior.markers + markers)
        added = prior_shares(similar, level, prior, markers=markers)
        np.testing.assert_allclose(added, [weight * 8.0, 0.0, 0.0], rtol=1e-5)


def test_what_samples_do_not_agree_on_is_part_of_the_variance_of_a_marker_left_out() -> None:
    rng = np.random.default_rng(0)
    spectrum = small_spectrum(12)
    row = draw_rows(spectrum, rng, 1)
    thetas = rng.normal(size=(5, 4))
    each = [leave_markers_out(spectrum, row, theta[None, :, None]) for theta in thetas]
    errors, expected = leave_markers_out(spectrum, row, thetas[:, :, None])
    of_each = np.stack([one for one, _ in each])
    np.testing.assert_allclose(errors, of_each.mean(axis=0))
    total = np.mean([one**2 for _, one in each], axis=0) + of_each.var(axis=0)
    np.testing.assert_allclose(expected**2, total)


def test_widened_intervals_hold_nineteen_of_twenty_along_every_axis() -> None:
    rng = np.random.default_rng(0)
    places = rng.uniform(-100, 100, (60, 3))
    covariance = fit_covariance(cdist(places, places), length_scale=30.0)
    wide = np.array([1.0, 3.0, 0.5])
    z = rng.standard_normal((200, 3, 60)) * wide[:, None]
    cross = covariance.cross(cdist(places, places))
    found = calibrate_spread(z.reshape(-1, 60), np.ones((600, 60)), covariance.matrix(), cross)
    np.testing.assert_allclose(found.of_axes, wide, rtol=0.05)
    np.testing.assert_allclose(found.of_points, 1.0, rtol=0.15)
