"""The energy and its gradient, held to the dense formula and to finite differences."""

import numpy as np
import pytest

from tests.numerics.manifold.small_process import dense_energy, draw_rows, small_spectrum
from usdface.numerics.manifold.hyper_posterior import (
    IMPOSSIBLE,
    HyperPrior,
    direct_moments,
    energy_of_moments,
)
from usdface.numerics.manifold.tabulated_energy import SharedTable, TabulatedEnergy


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
    _, gradient = TabulatedEnergy(SharedTable(spectrum), rows)(theta, with_energy=False)
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
        with_energy=True,
    )
    for table, direct in zip(by_table, by_sum, strict=True):
        assert np.allclose(table, direct, rtol=1e-4, atol=1e-3)


def test_what_leaves_the_table_is_impossible() -> None:
    spectrum = small_spectrum()
    energy = TabulatedEnergy(SharedTable(spectrum), np.ones((1, 12)))
    assert energy(np.array([[80.0], [0], [0], [0]]))[0][0] == IMPOSSIBLE


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
