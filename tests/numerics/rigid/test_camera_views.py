"""Points seen by several cameras: exact where pictures are, least reprojection error where not."""

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from usdface.numerics.rigid.camera_views import CameraPose, average_heads, triangulate_points


def around(angles: list[float], distance: float = 800.0) -> list[CameraPose]:
    """Cameras on a circle about the origin, which look at it; y down."""
    turns = [Rotation.from_euler("y", angle, degrees=True) for angle in angles]
    return [CameraPose(turn.as_matrix(), np.array([0.0, 0.0, distance])) for turn in turns]


def seen_by(points: np.ndarray, poses: list[CameraPose]) -> np.ndarray:
    """Return x / z and y / z in each camera's space: (views, ..., 2)."""
    local = [points @ pose.rotation.T + pose.translation for pose in poses]
    return np.stack([each[..., :2] / each[..., 2:] for each in local])


POINTS = np.random.default_rng(0).normal(size=(6, 30, 3)) * 60


@pytest.mark.parametrize("angles", [[0.0, 25.0], [-40.0, 0.0, 40.0]])
def test_points_come_back(angles: list[float]) -> None:
    poses = around(angles)
    found = triangulate_points(seen_by(POINTS, poses), np.ones((len(poses), 6, 30)), poses)
    np.testing.assert_allclose(found, POINTS, atol=1e-6)


def test_the_weighted_reprojection_error_is_least() -> None:
    rng, poses = np.random.default_rng(1), around([-20.0, 15.0, 50.0])
    seen = seen_by(POINTS, poses) + rng.normal(size=(3, 6, 30, 2)) * 2e-3
    weights = rng.uniform(0.1, 1.0, (3, 6, 30))
    found = triangulate_points(seen, weights, poses)
    for at in ((0, 0), (3, 7), (5, 29)):

        def error(point, at=at):
            left = seen_by(point, poses) - seen[(slice(None), *at)]
            return (np.sqrt(weights[(slice(None), *at)])[:, None] * left).ravel()

        best = least_squares(error, POINTS[at], xtol=1e-15, ftol=1e-15, gtol=1e-15).x
        np.testing.assert_allclose(found[at], best, atol=1e-4)


def test_a_view_that_is_not_trusted_hardly_counts() -> None:
    poses = around([-30.0, 0.0, 30.0])
    seen, weights = seen_by(POINTS, poses), np.ones((3, 6, 30))
    seen[2, :, 4] += 0.02  # 16 mm off at that distance
    even = triangulate_points(seen, weights, poses)
    weights[2, :, 4] = 0.01
    doubted = triangulate_points(seen, weights, poses)
    assert np.linalg.norm(even - POINTS, axis=2)[:, 4].min() > 3
    assert np.linalg.norm(doubted - POINTS, axis=2)[:, 4].max() < 1


def test_what_one_camera_sees_is_nowhere() -> None:
    poses = around([0.0, 20.0])
    seen, weights = seen_by(POINTS, poses), np.ones((2, 6, 30))
    weights[1, 2, 3] = 0
    seen[0, 4, 5] = np.nan
    found = triangulate_points(seen, weights, poses)
    assert sorted(zip(*np.nonzero(np.isnan(found[..., 0])), strict=True)) == [(2, 3), (4, 5)]
    one = [poses[0], poses[0]]  # parallel rays
    twice = triangulate_points(seen_by(POINTS, one), np.ones((2, 6, 30)), one)
    assert np.isnan(twice).all()


def heads_of(points: np.ndarray, *others: np.ndarray) -> np.ndarray:
    """What cameras measure by themselves: points of any size, place and turn, (views, 6, 30, 3)."""
    rng = np.random.default_rng(2)
    heads = []
    for size, seen in zip((0.9, 1.1), (points, *others), strict=True):
        turn = Rotation.random(6, random_state=rng).as_matrix()
        heads.append(size * seen @ turn + rng.normal(size=(6, 1, 3)) * 500)
    return np.stack(heads)


RIGID = np.r_[np.ones(20), np.zeros(10)]


def test_heads_are_averaged_where_the_points_are() -> None:
    """Whatever size, place and turn each camera gives its head: alike, they are the points."""
    weights = np.ones((2, 6, 30))
    np.testing.assert_allclose(
        average_heads(POINTS, heads_of(POINTS, POINTS), weights, RIGID), POINTS
    )
    other = POINTS.copy()
    other[:, 25, 0] += np.tile([7.0, -7.0], 3)  # no rigid point, and no offset that stays
    heads = heads_of(POINTS, other)
    for weight in (1.0, 1 / 9):
        weights[1, :, 25] = weight
        off = np.linalg.norm(average_heads(POINTS, heads, weights, RIGID) - POINTS, axis=2)
        np.testing.assert_allclose(off[:, 25], 7 * weight / (1 + weight), rtol=1e-6)
        assert np.delete(off, 25, axis=1).max() < 1e-9


def test_a_point_that_cameras_put_on_other_skin_does_not_jump_where_one_loses_it() -> None:
    other = POINTS.copy()
    other[:, 25] += (3.0, 0.0, 4.0)
    weights = np.ones((2, 6, 30))
    weights[0, 1, 25], weights[1, 3:, 25] = 0.1, 0.0
    off = average_heads(POINTS, heads_of(POINTS, other), weights, RIGID) - POINTS
    np.testing.assert_allclose(off[:, 25], np.tile([1.5, 0, 2.0], (6, 1)), atol=1e-9)
    assert np.abs(np.delete(off, 25, axis=1)).max() < 1e-9
