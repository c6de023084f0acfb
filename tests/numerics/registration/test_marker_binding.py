"""The affine map from a performer's face to a mesh, and motion that tells of wrong places."""

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from usdface.numerics.registration.marker_binding import (
    choose_by_motion,
    fit_proportions,
    motion_agreement,
)


def cloud(count: int = 60) -> np.ndarray:
    rng = np.random.default_rng(0)
    angles = rng.uniform(-1, 1, (count, 2))
    bulge = np.sqrt(np.maximum(2.2 - (angles**2).sum(axis=1), 0))
    return np.column_stack([70 * angles[:, 0], 90 * angles[:, 1], 50 * bulge])


def test_a_similarity_is_found_to_the_last_digit() -> None:
    at = cloud()
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    fitted = fit_proportions(at, 1.2 * at @ turn.T + [1, 2, 3], weight=np.ones(len(at)))
    np.testing.assert_allclose(fitted.linear, 1.2 * turn, atol=1e-9)
    assert fitted.away_mm.max() < 1e-6


def test_most_of_a_difference_in_proportions_is_found() -> None:
    at = cloud()
    wanted = np.diag([1.15, 0.95, 1.05])
    fitted = fit_proportions(at, at @ wanted.T, weight=np.ones(len(at)))
    similar = fit_proportions(at, at @ (1.05 * np.eye(3)).T, weight=np.ones(len(at)))
    assert np.abs(fitted.linear - wanted).max() < 0.4 * np.abs(similar.linear - wanted).max()


def test_a_few_markers_in_wrong_places_do_not_turn_the_face() -> None:
    at = cloud()
    places = at.copy()
    places[:4] += [0, 40, 0]
    fitted = fit_proportions(at, places, weight=np.ones(len(at)))
    assert np.abs(fitted.linear - np.eye(3)).max() < 0.02
    assert fitted.away_mm[:4].min() > 30
    assert fitted.away_mm[4:].max() < 4


def test_fewer_than_four_markers_are_refused() -> None:
    with pytest.raises(ValueError, match="3 markers; an affine map needs at least 4"):
        fit_proportions(cloud(3), cloud(3), weight=np.ones(3))


def test_two_exchanged_markers_stand_out_by_their_motion() -> None:
    rng = np.random.default_rng(0)
    at = cloud()
    kernel = np.exp(-((cdist(at, at) / 50) ** 2)) + 1e-6 * np.eye(len(at))
    moved = np.linalg.cholesky(kernel) @ rng.normal(size=(len(at), 600)) * 4
    paths = moved.reshape(len(at), 200, 3).transpose(1, 0, 2) + rng.normal(
        0, 0.15, (200, len(at), 3)
    )
    first = 0
    second = int(np.linalg.norm(at - at[0], axis=1).argmax())
    exchanged = paths.copy()
    exchanged[:, [first, second]] = paths[:, [second, first]]
    odd = motion_agreement(exchanged, cdist(at, at))
    assert set(np.argsort(-odd)[:2].tolist()) == {first, second}
    assert odd[[first, second]].min() > 3
    assert motion_agreement(paths, cdist(at, at)).max() < 3


def test_distances_that_give_no_covariance_give_no_nan() -> None:
    distances = np.full((40, 40), 100.0)  # one marker is near all, and they are far from each other
    distances[0] = distances[:, 0] = 5.0
    np.fill_diagonal(distances, 0.0)
    moved = np.random.default_rng(0).normal(0, 3, (60, 40, 3))
    assert np.isfinite(motion_agreement(moved, distances)).all()


def test_markers_on_one_line_are_told_apart_by_the_side_that_they_move_with() -> None:
    """Ten on each of two lips that touch, whose corners alone join them, and ten on each side."""
    x = np.tile(np.arange(10) * 4.0, 4)
    side = np.repeat([1, -1, 1, -1], 10)
    y = np.repeat([12.0, -12.0, 0.0, 0.0], 10)
    rng = np.random.default_rng(0)
    jaw = rng.uniform(0, 15, 80)
    moved = np.zeros((80, 40, 3))
    moved[:, :, 1] = -jaw[:, None] * (side < 0)
    moved += rng.normal(0, 0.2, moved.shape)
    lips = np.arange(20, 40)
    misplaced = rng.random(20) < 0.5
    first = np.concatenate([side[:20], np.where(misplaced, -side[20:], side[20:])])
    sides = np.concatenate([first, -first[lips]])
    at = np.column_stack([np.append(x, x[lips]), np.append(y, y[lips])])
    distances = cdist(at, at) + 40 * (sides[:, None] != sides)
    chosen = choose_by_motion(moved, distances, lips, np.zeros(20))
    np.testing.assert_array_equal(chosen, misplaced)
    still = choose_by_motion(np.zeros_like(moved), distances, lips, np.full(20, 0.1))
    assert not still.any()
    assert choose_by_motion(moved, distances, lips, np.full(20, 100.0)).sum() == 0
