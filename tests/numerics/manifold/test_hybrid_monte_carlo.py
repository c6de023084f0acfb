"""Chains against what they should sample, known by quadrature, by algebra or by another sampler."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from tests.numerics.manifold.small_process import (
    dense_energy,
    direct_moments,
    draw_rows,
    small_spectrum,
)
from usdface.numerics.manifold.hybrid_monte_carlo import (
    _PROPOSAL_WIDTH,
    _log_mixture,
    chain_states,
    effective_sample_size,
    sample_chains,
    split_rhat,
    take_hmc_step,
)
from usdface.numerics.manifold.hyper_posterior import (
    HyperPrior,
    SharedTable,
    TabulatedEnergy,
    energy_of_moments,
    noise_gain,
    to_theta,
)
from usdface.numerics.manifold.hyper_sampling import (
    find_modes,
    fit_shared_mode,
    sample_hyperparameters,
    sample_shared,
)
from usdface.numerics.manifold.laplace import LaplaceFit, fit_laplace


class Gaussian:
    """An energy whose every property is known."""

    def __init__(self, chains: int) -> None:
        rng = np.random.default_rng(3)
        root = np.eye(4) + 0.4 * rng.standard_normal((4, 4))
        self.covariance = root @ root.T
        self.precision = np.linalg.inv(self.covariance)
        self.centre = np.arange(4.0)[:, None] * np.ones(chains)

    def __call__(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        gradient = self.precision @ (theta - self.centre)
        return 0.5 * ((theta - self.centre) * gradient).sum(axis=0), gradient


def test_newton_finds_a_gaussian_and_its_spread_at_once() -> None:
    energy = Gaussian(5)
    fit = fit_laplace(energy, np.zeros((4, 5)), iterations=4)
    assert np.allclose(fit.mode, energy.centre, atol=1e-6)
    covariance = np.einsum("abc,dbc->adc", fit.root, fit.root)
    assert np.allclose(covariance, energy.covariance[:, :, None], rtol=1e-4)
    evidence = 0.5 * np.linalg.slogdet(energy.covariance)[1]
    assert np.allclose(fit.log_evidence, evidence, atol=1e-4)
    anywhere = np.random.default_rng(0).standard_normal((4, 5))
    assert np.allclose(fit.theta(fit.whiten(anywhere)), anywhere, atol=1e-12)


@pytest.mark.parametrize("angle", [0.3, 1.5, 2.2])
def test_a_gaussian_is_followed_exactly_however_far_a_step_goes(angle: float) -> None:
    energy = Gaussian(200)
    fit = fit_laplace(energy, np.zeros((4, 200)))
    state = chain_states(energy, fit, np.full((4, 200), 0.5))
    _, acceptance = take_hmc_step(
        np.random.default_rng(0), state, energy, fit, angle=np.full(200, angle)
    )
    assert acceptance.min() > 1 - 1e-4  # the Hessian is a finite difference


def test_energy_beyond_the_gaussian_is_conserved_to_the_square_of_the_step() -> None:
    energy = Gaussian(200)
    fit = fit_laplace(energy, np.zeros((4, 200)))
    wrong = replace(fit, root=1.3 * fit.root, inverse=fit.inverse / 1.3)
    state = chain_states(energy, wrong, np.full((4, 200), 0.8))
    lost = []
    for angle in (0.2, 0.1):
        _, acceptance = take_hmc_step(
            np.random.default_rng(0), state, energy, wrong, angle=np.full(200, angle)
        )
        lost.append(-np.log(acceptance).mean())
    assert 0 < lost[1] < 0.3 * lost[0] < 0.01


def test_chains_have_the_mean_and_covariance_of_what_they_sample() -> None:
    energy = Gaussian(400)
    fit = fit_laplace(energy, np.zeros((4, 400)))
    theta, acceptance = sample_chains(np.random.default_rng(0), energy, fit, keep=100)
    drawn = np.moveaxis(theta, 1, 0).reshape(4, -1)
    assert np.allclose(drawn.mean(axis=1), np.arange(4.0), atol=0.02)
    assert np.allclose(np.cov(drawn), energy.covariance, atol=0.06)
    assert acceptance.mean() > 0.999


def test_posterior_means_and_spreads_agree_with_a_dense_random_walk() -> None:
    """Another sampler, another formula of the density: Metropolis on eq. 8 by Cholesky."""
    rng = np.random.default_rng(0)
    spectrum = small_spectrum(8)
    rows = draw_rows(spectrum, rng, 2)
    table = SharedTable(spectrum)
    chains = np.repeat(rows, 40, axis=0)
    theta = sample_hyperparameters(rng, table, chains)[0]
    ours = np.moveaxis(theta.reshape(200, 4, 2, 40), 3, 1).reshape(-1, 4, 2)
    for row in range(2):
        walk = [theta[-1, :, 40 * row]]
        energy = dense_energy(spectrum, walk[0], rows[row])
        for _ in range(12_000):
            proposal = walk[-1] + 0.8 * rng.standard_normal(4)
            other = dense_energy(spectrum, proposal, rows[row])
            stay = rng.random() > np.exp(min(0.0, energy - other))
            energy = energy if stay else other
            walk.append(walk[-1] if stay else proposal)
        reference = np.array(walk[500:])
        spread = reference.std(axis=0)
        assert np.abs(ours[:, :, row].mean(axis=0) - reference.mean(axis=0)).max() < 0.25
        assert np.allclose(ours[:, :, row].std(axis=0), spread, rtol=0.2)


def test_most_samples_are_worth_as_many_and_chains_agree() -> None:
    rng = np.random.default_rng(0)
    spectrum = small_spectrum(30)
    rows = draw_rows(spectrum, rng, 60)
    table = SharedTable(spectrum)
    found = [sample_hyperparameters(rng, table, rows) for _ in range(3)]
    theta = np.stack([each for each, _, _ in found], axis=1)
    assert np.median(effective_sample_size(theta[:, :1])) >= 150
    assert np.median(split_rhat(theta)) < 1.01
    assert np.quantile(split_rhat(theta), 0.95) < 1.05
    assert 0.65 < np.mean(found[0][1]) < 0.95


def two_modes() -> tuple[SharedTable, np.ndarray]:
    """Few markers, a rough process, a tight prior on the noise: signal, or noise."""
    prior = HyperPrior(medians=(0.1, 0.01, 1.0, 1.0), spread=(2.0, 2.0, 1.0, 1.0))
    spectrum = small_spectrum(8, prior)
    rng = np.random.default_rng(2)
    rows = 1.2 * rng.standard_normal((400, 8)) + spectrum.vectors @ spectrum.trend[:, 0]
    return SharedTable(spectrum), rows


def test_two_modes_are_found_and_both_visited_in_their_proportion() -> None:
    table, rows = two_modes()
    modes = find_modes(table, rows)
    double = np.flatnonzero(modes.double)
    assert len(double) > 3
    chosen = rows[double[:4]]
    many = np.repeat(chosen, 30, axis=0)
    theta, _, again = sample_hyperparameters(np.random.default_rng(0), table, many, keep=200)
    assert again.double.all()
    x = (theta[:, 0] - theta[:, 1]).reshape(200, 4, 30)
    middle = -modes.best.mode[1][double[:4]]
    second = to_theta(modes.second.mode, noise_gain(table.spectrum))
    middle = 0.5 * (middle + (second[0] - second[1])[double[:4]])
    above = (x > middle[:, None]).mean(axis=0)  # of each chain
    assert (above.std(axis=1) < 0.15).all()  # no chain stays where it began
    for row in range(4):
        exact = _share_above(table, chosen[row], middle[row])
        assert above[row].mean() == pytest.approx(exact, abs=0.08)


def _share_above(table: SharedTable, row: np.ndarray, middle: float) -> float:
    """Of the posterior's mass, by a sum over a grid of all four parameters."""
    axes = [
        np.linspace(c - 5 * s, c + 5 * s, n)
        for c, s, n in zip(
            table.spectrum.prior.centre, table.spectrum.prior.spread, (35, 35, 13, 13), strict=True
        )
    ]
    grid = np.stack([each.ravel() for each in np.meshgrid(*axes, indexing="ij")])
    moments = direct_moments(
        table.spectrum, (row @ table.spectrum.vectors)[None], grid[0] - grid[1]
    )
    energy, _ = energy_of_moments(
        grid,
        moments,
        count=len(row),
        centre=table.spectrum.prior.centre[:, None],
        precision=np.array(table.spectrum.prior.spread)[:, None] ** -2.0,
    )
    mass = np.exp(energy.min() - energy)
    return float(mass[grid[0] - grid[1] > middle].sum() / mass.sum())


def test_many_rows_together_find_the_scales_they_were_made_with() -> None:
    rng = np.random.default_rng(0)
    spectrum = small_spectrum(20)
    rows = draw_rows(spectrum, rng, 300)
    table = SharedTable(spectrum)
    shared, mode = sample_shared(rng, table, rows), fit_shared_mode(table, rows).mode[:, 0]
    made = np.log([4.0, 0.05, 1.0, 1.0])
    assert (np.abs(mode - made) < 4 * shared.theta.std(axis=0)).all()
    assert np.abs(mode - made)[[0, 2, 3]].max() < 0.2
    assert shared.theta.shape == (200, 4)
    assert (np.abs(shared.theta.mean(axis=0) - mode) < shared.theta.std(axis=0)).all()


def test_the_shared_mode_of_one_row_is_that_row_s_mode_under_a_narrow_prior_of_the_noise() -> None:
    rng = np.random.default_rng(0)
    spectrum = small_spectrum(15)
    rows = draw_rows(spectrum, rng, 1)
    narrow = replace(spectrum, prior=HyperPrior(spread=(1.5, 0.1, 1.5, 1.5)))
    alone: LaplaceFit = fit_laplace(
        TabulatedEnergy(SharedTable(narrow), rows), narrow.prior.centre[:, None], iterations=30
    )
    shared = fit_shared_mode(SharedTable(spectrum), rows)
    assert np.allclose(shared.mode, alone.mode, atol=1e-3)


def test_jumps_weigh_proposals_by_the_density_of_the_mixture_they_come_from() -> None:
    narrow, wide = (
        LaplaceFit(
            mode=np.full((4, 6), middle),
            energy=np.full(6, 3.0),
            root=np.repeat(size * np.eye(4)[:, :, None], 6, axis=2),
            inverse=np.repeat(np.eye(4)[:, :, None] / size, 6, axis=2),
            log_evidence=np.full(6, 4 * np.log(size) - 3.0),
        )
        for middle, size in ((0.0, 0.5), (1.0, 2.0))
    )
    theta = np.random.default_rng(0).normal(size=(4, 6))
    densities = [
        multivariate_normal(np.full(4, middle), width**2 * np.eye(4)).logpdf(theta.T)
        for middle, width in ((0.0, 0.5 * _PROPOSAL_WIDTH), (1.0, 2.0 * _PROPOSAL_WIDTH))
    ]
    difference = _log_mixture(theta, (narrow, wide)) - np.logaddexp(*densities)
    np.testing.assert_allclose(
        difference, difference[0], atol=1e-12
    )  # up to one constant for all places


def autoregressive(rng: np.random.Generator, rho: float, shape: tuple[int, ...]) -> np.ndarray:
    out = rng.standard_normal(shape)
    for index in range(1, len(out)):
        out[index] = rho * out[index - 1] + np.sqrt(1 - rho**2) * out[index]
    return out


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9])
def test_of_an_autoregressive_series_it_is_the_closed_form(rho: float) -> None:
    series = autoregressive(np.random.default_rng(0), rho, (2000, 4, 50))
    exact = 2000 * 4 * (1 - rho) / (1 + rho)
    assert np.median(effective_sample_size(series)) == pytest.approx(exact, rel=0.12)


def test_lags_are_paired_from_an_even_one() -> None:
    # Correlations of 1, .2, -.3, ...: of lags 2 and 3 the sum is negative, and nothing is added.
    rng = np.random.default_rng(0)
    noise = rng.standard_normal((40002, 1, 8))
    series = noise[2:] + 0.3 * noise[1:-1] - 0.4 * noise[:-2]
    first = (0.3 - 0.3 * 0.4) / (1 + 0.3**2 + 0.4**2)
    assert np.median(effective_sample_size(series)) == pytest.approx(
        40000 / (1 + 2 * first), rel=0.02
    )


def test_draws_that_alternate_count_no_more_than_there_are() -> None:
    series = autoregressive(np.random.default_rng(0), -0.5, (2000, 4, 5))
    assert (effective_sample_size(series) == 8000).all()


def test_chains_of_one_distribution_agree_and_of_two_do_not() -> None:
    series = np.random.default_rng(0).standard_normal((500, 4, 20))
    assert np.abs(split_rhat(series) - 1).max() < 0.02
    series[:, 0] += 3
    assert split_rhat(series).min() > 1.2


def test_one_chain_that_drifts_disagrees_with_itself() -> None:
    series = np.random.default_rng(0).standard_normal((500, 1)) + np.linspace(0, 3, 500)[:, None]
    assert float(split_rhat(series)) > 1.2
