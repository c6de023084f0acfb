import numpy as np
import pytest
from scipy.optimize import lsq_linear

from usdface.numerics.solve.banded_smoothing import (
    FixedLagSmoother,
    cutoff_penalty,
    smooth_within_bounds,
)


def dense(tracks: np.ndarray, penalty: float, trust: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    frames = len(tracks)
    second = np.diff(np.eye(frames), 2, axis=0)
    root = np.sqrt(trust)
    matrix = np.vstack([np.diag(root), np.sqrt(penalty) * second])
    return matrix, np.vstack([root[:, None] * tracks, np.zeros((frames - 2, tracks.shape[1]))])


def example(frames: int = 80) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    time = np.arange(frames)[:, None]
    tracks = 0.5 + 0.8 * np.sin(time / [5.0, 9.0, 17.0]) + 0.1 * rng.normal(size=(frames, 3))
    return tracks, rng.uniform(0.1, 1.0, frames)


def test_it_is_the_bounded_least_squares_solution() -> None:
    tracks, trust = example()
    found = smooth_within_bounds(
        tracks, penalty=4.0, trust=trust, lower=np.zeros(3), upper=np.ones(3)
    )
    matrix, right = dense(tracks, 4.0, trust)
    for column in range(3):
        wanted = lsq_linear(matrix, right[:, column], bounds=(0, 1), tol=1e-12).x
        np.testing.assert_allclose(found[:, column], wanted, atol=2e-5)
    assert found.min() == 0.0
    assert found.max() == 1.0


def test_a_straight_line_is_not_bent_and_a_cutoff_is_halved() -> None:
    line = np.linspace(0.1, 0.9, 50)[:, None]
    smoothed = smooth_within_bounds(
        line, penalty=100.0, trust=np.ones(50), lower=np.zeros(1), upper=np.ones(1)
    )
    np.testing.assert_allclose(smoothed, line, atol=1e-9)
    wave = np.sin(2 * np.pi * 10.0 * np.arange(600) / 60.0)[:, None]
    halved = smooth_within_bounds(
        wave,
        penalty=cutoff_penalty(10.0, 60.0),
        trust=np.ones(600),
        lower=-np.ones(1) * 2,
        upper=np.ones(1) * 2,
    )
    np.testing.assert_allclose(halved[200:400], wave[200:400] / 2, atol=1e-6)


@pytest.mark.parametrize("lag", [0, 1, 4])
def test_a_lagging_smoother_says_what_the_whole_take_up_to_there_says(lag: int) -> None:
    tracks, trust = example(40)
    smoother = FixedLagSmoother(3, penalty=4.0, lag=lag)
    given = [smoother.push(row, each) for row, each in zip(tracks, trust, strict=True)]
    assert [row is None for row in given] == [t < lag for t in range(40)]
    for t in range(max(lag, 3), 40):
        matrix, right = dense(tracks[: t + 1], 4.0, trust[: t + 1])
        wanted = np.linalg.lstsq(matrix, right)[0][t - lag]
        np.testing.assert_allclose(given[t], wanted, atol=1e-4)
    owed = smoother.finish()
    assert len(owed) == lag
    matrix, right = dense(tracks, 4.0, trust)
    if lag:
        np.testing.assert_allclose(owed, np.linalg.lstsq(matrix, right)[0][-lag:], atol=1e-4)


def test_what_cannot_be_smoothed_is_refused() -> None:
    ones, bounds = np.ones((5, 1)), {"lower": np.zeros(1), "upper": np.ones(1)}
    with pytest.raises(ValueError, match="not finite"):
        smooth_within_bounds(ones * np.nan, penalty=1.0, trust=np.ones(5), **bounds)
    with pytest.raises(ValueError, match="half the rate of 60"):
        cutoff_penalty(40.0, 60.0)


@pytest.mark.parametrize("cutoff", [2.0, 5.0, 20.0])
def test_whatever_the_cutoff_a_motion_of_its_frequency_is_halved(cutoff: float) -> None:
    wave = np.sin(2 * np.pi * cutoff * np.arange(1200) / 60.0)[:, None]
    halved = smooth_within_bounds(
        wave,
        penalty=cutoff_penalty(cutoff, 60.0),
        trust=np.ones(1200),
        lower=np.full(1, -2.0),
        upper=np.full(1, 2.0),
    )
    np.testing.assert_allclose(halved[500:700], wave[500:700] / 2, atol=1e-6)


@pytest.mark.parametrize("penalty", [1e0, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7])
def test_at_any_cutoff_nothing_within_the_bounds_is_better(penalty: float) -> None:
    rng = np.random.default_rng(0)
    walks = 1 + np.cumsum(0.08 * rng.normal(size=(300, 40)), axis=0)  # to and fro beyond the bounds
    tracks = np.abs(walks % 2.4 - 1.2) - 0.1 + 0.05 * rng.normal(size=walks.shape)
    trust = rng.uniform(0.25, 1, 300)
    found = smooth_within_bounds(
        tracks, penalty=penalty, trust=trust, lower=np.zeros(40), upper=np.ones(40)
    )
    matrix, right = dense(tracks, penalty, trust)
    uphill = matrix.T @ (matrix @ found - right)  # the sum's gradient
    assert (found >= 0).all()
    assert (found <= 1).all()
    slack = 2e-8 * (1 + penalty)  # a weight is a billionth beyond its bound before it is held
    assert np.abs(uphill[(found > 0) & (found < 1)]).max() < slack
    assert uphill[found == 0].min() > -slack
    assert uphill[found == 1].max() < slack
