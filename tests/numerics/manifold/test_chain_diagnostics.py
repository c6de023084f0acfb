"""Effective sample size and R-hat on series whose answers are known."""

import numpy as np
import pytest

from usdface.numerics.manifold.chain_diagnostics import effective_sample_size, split_rhat


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
