"""Shares of a blend: inverse variances, and what SciPy's solver finds."""

import numpy as np
import pytest
from scipy.optimize import minimize

from usdface.numerics.regression.convex_blend import blend_shares


def random_covariances(outputs: int, members: int) -> np.ndarray:
    rng = np.random.default_rng(0)
    common = rng.normal(size=(outputs, 1, 30)) * 2  # errors that all members make
    errors = common + rng.normal(size=(outputs, members, 30)) * rng.uniform(0.2, 2, (members, 1))
    return np.einsum("oit,ojt->oij", errors, errors) / 30


def test_independent_errors_are_weighed_by_inverse_variance() -> None:
    variances = np.array([[1.0, 2.0, 4.0], [3.0, 3.0, 3.0]])
    shares = blend_shares(np.einsum("oi,ij->oij", variances, np.eye(3)))
    expected = 1 / variances / (1 / variances).sum(axis=1, keepdims=True)
    np.testing.assert_allclose(shares, expected.T)


@pytest.mark.parametrize("members", [1, 2, 3, 4])
def test_no_solver_finds_a_blend_of_less_variance(members: int) -> None:
    covariance = random_covariances(12, members)
    shares = blend_shares(covariance)
    assert (shares >= 0).all()
    np.testing.assert_allclose(shares.sum(axis=0), 1.0)
    for own, share in zip(covariance, shares.T, strict=True):
        found = minimize(
            lambda s, own=own: s @ own @ s,
            np.full(members, 1 / members),
            bounds=[(0, 1)] * members,
            constraints={"type": "eq", "fun": lambda s: s.sum() - 1},
            method="SLSQP",
            options={"ftol": 1e-12},
        )
        assert share @ own @ share <= found.fun * (1 + 1e-6)


def test_a_member_that_errs_as_a_better_one_does_is_not_heard() -> None:
    errors = np.random.default_rng(0).normal(size=(2, 200))
    members = np.stack([errors[0], errors[0] + errors[1]])  # the first, and the first made worse
    shares = blend_shares((members @ members.T / 200)[None])
    assert shares[0, 0] > 0.9


@pytest.mark.parametrize("shape", [(3, 2), (3, 2, 4), (3, 9, 9), (3, 0, 0)])
def test_what_cannot_be_blended_is_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="members"):
        blend_shares(np.ones(shape))
