"""The energy and its gradient against the dense formula and finite differences; coordinates."""

import numpy as np
import pytest

from tests.numerics.manifold.small_process import (
    dense_energy,
    direct_moments,
    draw_rows,
    small_spectrum,
)
from usdface.numerics.manifold.hyper_posterior import (
    REJECTED_ENERGY,
    HyperPrior,
    PhiEnergy,
    SharedTable,
    TabulatedEnergy,
    energy_of_moments,
    noise_gain,
    to_phi,
    to_theta,
)
from usdface.numerics.manifold.laplace import fit_laplace

GAIN = 3.0


def test_the_energy_is_eq_8_with_the_prior() -> None:
    rng = np.random.default_rng(0)
    spectrum = small_spectrum()
    rows = draw_rows(spectrum, rng, 30)
    theta = spectrum.prior.centre[:, None] + 1.5 * rng.standard_normal((4, 30))
    energy, _ = TabulatedEnergy(SharedTable(spectrum), rows)(theta)
    exact = [dense_energy(spectrum, theta[:, i], rows[i]) for i in range(30)]
    assert np.allclose(energy, exact, rtol=1e-6, atol=1e-5)


def test_the_gradient_is_that_of_finite_differences() -> None:
    rng = np.random.default_rng(0)
    spectrum = small_spectrum()
    rows = draw_rows(spectrum, rng, 10)
    theta = spectrum.prior.centre[:, None] + rng.standard_normal((4, 10))
    _, gradient = TabulatedEnergy(SharedTable(spectrum), rows)(theta)
    step = 1e-5
    for chain in range(10):
        for parameter in range(4):
            up, down = theta[:, chain].copy(), theta[:, chain].copy()
            up[parameter] += step
            down[parameter] -= step
            slope = dense_energy(spectrum, up, rows[chain])
            slope = (slope - dense_energy(spectrum, down, rows[chain])) / (2 * step)
            assert gradient[parameter, chain] == pytest.approx(slope, rel=1e-4, abs=1e-4)


def test_tables_and_sums_say_the_same() -> None:
    rng = np.random.default_rng(0)
    spectrum = small_spectrum(42)
    rows = draw_rows(spectrum, rng, 40)
    theta = spectrum.prior.centre[:, None] + 1.5 * rng.standard_normal((4, 40))
    by_table = TabulatedEnergy(SharedTable(spectrum), rows)(theta)
    moments = direct_moments(spectrum, rows @ spectrum.vectors, theta[0] - theta[1])
    by_sum = energy_of_moments(
        theta,
        moments,
        count=42,
        centre=spectrum.prior.centre[:, None],
        precision=np.full((4, 1), 1.5**-2),
    )
    for table, direct in zip(by_table, by_sum, strict=True):
        assert np.allclose(table, direct, rtol=1e-4, atol=1e-3)


def test_what_leaves_the_table_is_impossible() -> None:
    spectrum = small_spectrum()
    energy = TabulatedEnergy(SharedTable(spectrum), np.ones((1, 12)))
    assert energy(np.array([[80.0], [0], [0], [0]]))[0][0] == REJECTED_ENERGY


def test_chains_do_not_know_of_each_other() -> None:
    rng = np.random.default_rng(0)
    spectrum = small_spectrum()
    rows, theta = draw_rows(spectrum, rng, 5), rng.standard_normal((4, 5))
    table = SharedTable(spectrum)
    together, _ = TabulatedEnergy(table, rows)(theta)
    alone, _ = TabulatedEnergy(table, rows[3:4])(theta[:, 3:4])
    assert together[3] == pytest.approx(alone[0], rel=1e-12)


@pytest.mark.parametrize("median", [0.0, -1.0, np.inf, np.nan])
def test_a_prior_needs_positive_medians(median: float) -> None:
    with pytest.raises(ValueError, match="must be positive"):
        HyperPrior(medians=(1.0, median, 1.0, 1.0))


def test_coordinates_lead_there_and_back_even_where_noise_is_nothing_or_all() -> None:
    theta = np.random.default_rng(0).uniform(-30, 30, (4, 50))
    theta[1, :10] = theta[0, :10] - 300
    theta[1, 10:20] = theta[0, 10:20] + 300
    assert np.allclose(to_theta(to_phi(theta, GAIN), GAIN), theta, atol=1e-10)
    phi = to_phi(theta, GAIN)
    assert np.allclose(phi[0], np.logaddexp(theta[0], np.log(GAIN) + theta[1]))


def test_volume_is_kept_so_that_densities_are_the_same() -> None:
    phi = np.random.default_rng(0).uniform(-3, 3, (4, 20))
    step = 1e-6
    columns = []
    for k in range(4):
        unit = step * np.eye(4)[:, [k]]
        columns.append((to_theta(phi + unit, GAIN) - to_theta(phi - unit, GAIN)) / (2 * step))
    jacobian = np.moveaxis(np.stack(columns, axis=1), 2, 0)
    assert np.allclose(np.linalg.det(jacobian), 1.0, atol=1e-8)


def test_gradients_are_those_of_finite_differences() -> None:
    spectrum = small_spectrum(12)
    rows = draw_rows(spectrum, np.random.default_rng(0), 6)
    energy = TabulatedEnergy(SharedTable(spectrum), rows)
    of_phi = PhiEnergy(energy, GAIN)
    phi = np.random.default_rng(1).standard_normal((4, 6))
    value, gradient = of_phi(phi)
    assert np.allclose(value, energy(to_theta(phi, GAIN))[0])
    for k in range(4):
        unit = 1e-5 * np.eye(4)[:, [k]]
        slope = (of_phi(phi + unit)[0] - of_phi(phi - unit)[0]) / 2e-5
        assert np.allclose(gradient[k], slope, atol=1e-5)


def test_the_posterior_is_nearer_to_its_gaussian_than_in_theta() -> None:
    """Of energies two standard deviations out: the Gaussian says they are 2 above the mode's."""
    spectrum = small_spectrum(60)
    rows = draw_rows(spectrum, np.random.default_rng(0), 200)
    plain = TabulatedEnergy(SharedTable(spectrum), rows)
    gain = noise_gain(spectrum)
    of_phi = PhiEnergy(plain, gain)
    start = np.repeat(spectrum.prior.centre[:, None], 200, axis=1)
    wrong = []
    for energy, begin in ((plain, start), (of_phi, to_phi(start, gain))):
        fit = fit_laplace(energy, begin)
        directions = np.random.default_rng(1).standard_normal((20, 4, 200))
        directions *= 2 / np.linalg.norm(directions, axis=1, keepdims=True)
        above = [energy(fit.theta(white))[0] - fit.energy for white in directions]
        wrong.append(np.quantile(np.abs(np.array(above) - 2.0), 0.9))
    assert wrong[1] < 0.6 * wrong[0]
