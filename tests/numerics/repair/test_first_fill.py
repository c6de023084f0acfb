"""The first fill of a fit: lines over short gaps, and regressions that trust no filled value."""

import numpy as np
import pytest

from usdface.numerics.repair.fit_low_rank import first_fill, fit_low_rank
from usdface.numerics.repair.low_rank import fill_missing

FRAMES, MARKERS, NOISE_MM = 200, 30, 0.1
GAP = slice(70, 130)
TOGETHER = [4, 5, 6]
"""Markers unseen at the same time."""


@pytest.fixture
def take() -> np.ndarray:
    """Five slow expressions move all markers, and are largest within the gap."""
    rng = np.random.default_rng(0)
    t = np.arange(FRAMES)[:, None] / 60
    drive = np.sin(t * [2.0, 3.1, 4.3, 5.9, 7.1] + np.arange(5))
    drive *= 1.0 + np.exp(-(((np.arange(FRAMES) - 100) / 25.0) ** 2))[:, None]
    shapes = rng.normal(0, 2, (5, MARKERS, 3))
    rest = rng.uniform(-70, 70, (MARKERS, 3))
    return (
        rest
        + np.einsum("fk,kmi->fmi", drive, shapes)
        + rng.normal(0, NOISE_MM, (FRAMES, MARKERS, 3))
    )


def hidden(take: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    good = np.ones(take.shape[:2], bool)
    good[GAP, TOGETHER] = False
    return np.where(good[..., None], take, np.nan), good


def rms(found: np.ndarray, take: np.ndarray) -> float:
    return float(np.sqrt(np.mean((found - take)[GAP, TOGETHER] ** 2)))


def test_markers_unseen_together_follow_those_that_are_seen(take):
    filled = first_fill(*hidden(take))
    assert rms(filled, take) < 2 * NOISE_MM
    np.testing.assert_array_equal(filled[:70], take[:70])


def test_a_fit_to_a_short_take_fills_its_long_gaps_as_well_as_measured(take):
    positions, good = hidden(take)
    positions = np.nan_to_num(positions).astype(np.float32)
    model = fit_low_rank(positions, good)
    assert rms(fill_missing(model, positions, good), take) < 2 * NOISE_MM


def test_short_gaps_are_lines_constant_at_the_ends():
    take = np.arange(40.0)[:, None, None] * np.ones((40, 3, 3))
    good = np.ones((40, 3), bool)
    good[:4, 0] = good[20:25, 1] = good[-2:, 2] = False
    filled = first_fill(np.where(good[..., None], take, np.nan), good)
    np.testing.assert_allclose(filled[:4, 0], 4.0)
    np.testing.assert_allclose(filled[20:25, 1], take[20:25, 1])
    np.testing.assert_allclose(filled[-2:, 2], 37.0)


@pytest.mark.parametrize("seen", [1, 2, 30], ids=["one sample", "two samples", "all others gone"])
def test_gaps_that_cannot_be_regressed_stay_near_the_samples(seen):
    take = np.random.default_rng(1).normal(0, 1, (60, 3, 3))
    good = np.ones((60, 3), bool)
    good[seen:, 0] = False
    if seen == 30:
        good[40:55] = False
    filled = first_fill(np.where(good[..., None], take, np.nan), good)
    assert np.isfinite(filled).all()
    assert np.abs(filled).max() < 10.0
