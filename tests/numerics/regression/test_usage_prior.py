"""Expected weights: exact ones stay, doubtful ones follow the rows, as the integrals say."""

import numpy as np
from scipy import integrate, stats

from usdface.numerics.regression.usage_prior import expected_weights

ROWS = np.array([[0.0], [0.0], [0.0], [0.3], [0.8]])


def test_an_exact_weight_stays_as_it_is() -> None:
    seen = np.array([[0.0], [1e-6], [0.04], [0.5], [1.0]])
    for error in (0.0, 1e-8):
        found = expected_weights(seen, np.full(seen.shape, error), ROWS)
        np.testing.assert_allclose(found, seen, rtol=0, atol=1e-12)


def test_a_doubtful_weight_is_the_mean_of_its_posterior() -> None:
    x, error = 0.12, 0.05

    def density(w: float) -> float:
        prior = 1.0 + sum(stats.norm.pdf(w, row, 0.1) for row in (0.3, 0.8))
        return prior * stats.norm.pdf(x, w, error)

    at_rest = 3 * stats.norm.pdf(x, 0.0, error)
    first, mass = (
        integrate.quad(lambda w, n=n: w**n * density(w), -2, 3, points=(0.1, 0.3))[0]
        for n in (1, 0)
    )
    found = expected_weights(np.array([[x]]), np.array([[error]]), ROWS)
    np.testing.assert_allclose(found, first / (mass + at_rest), rtol=1e-6)


def test_errors_of_shapes_at_rest_shrink() -> None:
    rng = np.random.default_rng(0)
    truth = np.where(rng.random((4000, 3)) < 0.7, 0.0, rng.random((4000, 3)))
    seen = truth + rng.normal(0, 0.05, truth.shape)
    found = expected_weights(seen, np.full(seen.shape, 0.05), truth[:50])
    assert ((found - truth) ** 2).mean() < 0.6 * ((seen - truth) ** 2).mean()
