"""Coordinates of the sampler: there and back, volume kept, and the bend taken out."""

import numpy as np

from tests.numerics.manifold.small_process import draw_rows, small_spectrum
from usdface.numerics.manifold.laplace import fit_laplace
from usdface.numerics.manifold.straight_coordinates import (
    StraightEnergy,
    noise_gain,
    phi_of,
    theta_of,
)
from usdface.numerics.manifold.tabulated_energy import SharedTable, TabulatedEnergy

GAIN = 3.0


def test_coordinates_lead_there_and_back_even_where_noise_is_nothing_or_all() -> None:
    theta = np.random.default_rng(0).uniform(-30, 30, (4, 50))
    theta[1, :10] = theta[0, :10] - 300
    theta[1, 10:20] = theta[0, 10:20] + 300
    assert np.allclose(theta_of(phi_of(theta, GAIN), GAIN), theta, atol=1e-10)
    phi = phi_of(theta, GAIN)
    assert np.allclose(phi[0], np.logaddexp(theta[0], np.log(GAIN) + theta[1]))


def test_volume_is_kept_so_that_densities_are_the_same() -> None:
    phi = np.random.default_rng(0).uniform(-3, 3, (4, 20))
    step = 1e-6
    columns = []
    for k in range(4):
        unit = step * np.eye(4)[:, [k]]
        columns.append((theta_of(phi + unit, GAIN) - theta_of(phi - unit, GAIN)) / (2 * step))
    jacobian = np.moveaxis(np.stack(columns, axis=1), 2, 0)
    assert np.allclose(np.linalg.det(jacobian), 1.0, atol=1e-8)


def test_gradients_are_those_of_finite_differences() -> None:
    spectrum = small_spectrum(12)
    rows = draw_rows(spectrum, np.random.default_rng(0), 6)
    energy = TabulatedEnergy(SharedTable(spectrum), rows)
    straight = StraightEnergy(energy, GAIN)
    phi = np.random.default_rng(1).standard_normal((4, 6))
    value, gradient = straight(phi)
    assert np.allclose(value, energy(theta_of(phi, GAIN))[0])
    for k in range(4):
        unit = 1e-5 * np.eye(4)[:, [k]]
        slope = (straight(phi + unit)[0] - straight(phi - unit)[0]) / 2e-5
        assert np.allclose(gradient[k], slope, atol=1e-5)


def test_the_posterior_is_nearer_to_its_gaussian_than_in_theta() -> None:
    """Of energies two standard deviations out: the Gaussian says they are 2 above the mode's."""
    spectrum = small_spectrum(60)
    rows = draw_rows(spectrum, np.random.default_rng(0), 200)
    plain = TabulatedEnergy(SharedTable(spectrum), rows)
    gain = noise_gain(spectrum)
    straight = StraightEnergy(plain, gain)
    start = np.repeat(spectrum.prior.centre[:, None], 200, axis=1)
    wrong = []
    for energy, begin in ((plain, start), (straight, phi_of(start, gain))):
        fit = fit_laplace(energy, begin)
        directions = np.random.default_rng(1).standard_normal((20, 4, 200))
        directions *= 2 / np.linalg.norm(directions, axis=1, keepdims=True)
        above = [energy(fit.theta(white))[0] - fit.energy for white in directions]
        wrong.append(np.quantile(np.abs(np.array(above) - 2.0), 0.9))
    assert wrong[1] < 0.6 * wrong[0]
