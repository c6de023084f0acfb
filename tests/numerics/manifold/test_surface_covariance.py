"""Positive definite whatever the distances; eq. 7 where eq. 7 is a covariance."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import cdist

from usdface.numerics.manifold.surface_fields import fit_covariance, similarity

SHAPES = ("creased", "published")


def circle_distances(count: int) -> np.ndarray:
    """Along a circle: Gaussians of these are no covariance."""
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    apart = np.abs(angle[:, None] - angle)
    return np.minimum(apart, 2 * np.pi - apart)


def test_eq_7_over_the_circle_has_negative_eigenvalues_and_ours_has_none() -> None:
    between = circle_distances(40)
    raw = np.exp(-0.5 * (between / 2.0) ** 2)
    assert np.linalg.eigvalsh(raw)[0] < -0.01
    covariance = fit_covariance(between, length_scale=2.0, shape="published")
    assert np.linalg.eigvalsh(covariance.matrix())[0] > -1e-9
    assert 0 < covariance.clipped < 0.1


def test_where_it_is_a_covariance_nothing_is_changed() -> None:
    places = np.random.default_rng(0).standard_normal((20, 3))
    between = cdist(places, places)
    covariance = fit_covariance(between, length_scale=1.0, shape="published")
    assert np.allclose(covariance.matrix(), np.exp(-0.5 * between**2), atol=1e-4)
    assert covariance.clipped < 1e-4
    cross = covariance.cross(between)
    assert np.allclose(cross, covariance.matrix(), atol=1e-4)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10**6), scale=st.floats(0.05, 50.0), shape=st.sampled_from(SHAPES))
def test_with_any_distances_no_point_has_a_negative_variance(
    seed: int, scale: float, shape: str
) -> None:
    """Distances of no space at all: symmetric random numbers."""
    rng = np.random.default_rng(seed)
    between = rng.random((9, 9)) * 10
    between = np.triu(between, 1) + np.triu(between, 1).T
    covariance = fit_covariance(between, length_scale=scale, shape=shape)  # type: ignore[arg-type]
    K = covariance.matrix()
    assert np.linalg.eigvalsh(K)[0] > -1e-8
    distances = rng.random((9, 25)) * 10
    cross = covariance.cross(distances).astype(float)
    left = 1.0 - np.einsum("pi,ij,pj->p", cross, np.linalg.pinv(K, rcond=1e-7), cross)
    nearest = similarity(distances, scale, shape=shape).max(axis=0)  # type: ignore[arg-type]
    least = 0.25 * (1 - nearest**2) if shape == "creased" else 0.0
    assert (left > least - 1e-3).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"length_scale": 0.0}, "length scale must be positive"),
        ({"length_scale": float("nan")}, "length scale must be positive"),
        ({"shape": "box"}, "no covariance 'box'; there are creased, published"),
        ({"between": np.full((3, 3), np.inf)}, "not finite"),
    ],
)
def test_nonsense_is_refused(change: dict[str, object], message: str) -> None:
    given_values = {"between": np.ones((3, 3)) - np.eye(3), "length_scale": 1.0} | change
    with pytest.raises(ValueError, match=message):
        fit_covariance(given_values.pop("between"), **given_values)  # type: ignore[arg-type]
