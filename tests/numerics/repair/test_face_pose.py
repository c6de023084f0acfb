"""The head's pose from the face alone, against the dense likelihood minimised by SciPy."""

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from usdface.numerics.repair.face_pose import interpolation_precision, pose_by_face
from usdface.numerics.repair.low_rank import LowRankModel

RNG = np.random.default_rng(3)
MARKERS, RANK = 20, 4
MODEL = LowRankModel(
    mean=RNG.normal(scale=40.0, size=3 * MARKERS),
    components=np.linalg.qr(RNG.normal(size=(3 * MARKERS, RANK)))[0].T,
    variances=np.array([900.0, 400.0, 100.0, 50.0]),
    noise=np.linspace(0.1, 0.3, MARKERS),
)
CENTRE = MODEL.mean.reshape(-1, 3).mean(axis=0)
COVARIANCE = (MODEL.components.T * MODEL.variances) @ MODEL.components
COVARIANCE += np.diag(np.repeat(MODEL.noise**2, 3))


def captured(frames: int, degrees: float) -> tuple[np.ndarray, np.ndarray]:
    """Draw frames of the model in random poses: positions, and poses (frames, 4, 4)."""
    still = RNG.multivariate_normal(MODEL.mean, COVARIANCE, frames).reshape(frames, MARKERS, 3)
    poses = np.tile(np.eye(4), (frames, 1, 1))
    axes = RNG.normal(size=(frames, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    poses[:, :3, :3] = Rotation.from_rotvec(np.deg2rad(degrees) * axes).as_matrix()
    poses[:, :3, 3] = RNG.normal(scale=300.0, size=(frames, 3))
    return still @ poses[:, :3, :3].swapaxes(1, 2) + poses[:, None, :3, 3], poses


def by_face(positions: np.ndarray, seen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return pose_by_face(
        MODEL, positions, seen, precision=np.zeros((len(positions), 6)), centre=CENTRE
    )


def displacement(pose: np.ndarray, other: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """Return how far two poses take the same captured markers apart."""
    one, two = ((positions - each[:3, 3]) @ each[:3, :3] for each in (pose, other))
    return np.linalg.norm(one - two, axis=1)


def test_the_pose_maximises_the_likelihood_of_the_markers_seen() -> None:
    positions, _ = captured(4, 30.0)
    seen = RNG.random((4, MARKERS)) < 0.8
    poses, _ = by_face(positions, seen)
    for x, known, pose in zip(positions, seen, poses, strict=True):
        rows = np.repeat(known, 3)
        root = np.linalg.inv(np.linalg.cholesky(COVARIANCE[np.ix_(rows, rows)]))

        def residual(p: np.ndarray, x=x, known=known, rows=rows, root=root) -> np.ndarray:
            still = (x - p[3:]) @ Rotation.from_rotvec(p[:3]).as_matrix()
            return root @ (still[known].ravel() - MODEL.mean[rows])

        start = np.append(Rotation.from_matrix(pose[:3, :3]).as_rotvec() + 0.05, pose[:3, 3] + 3.0)
        best = least_squares(residual, start, x_scale=np.repeat([0.01, 1.0], 3)).x
        wanted = np.eye(4)
        wanted[:3, :3], wanted[:3, 3] = Rotation.from_rotvec(best[:3]).as_matrix(), best[3:]
        # Cauchy weights make a few hundredths of the noise.
        assert displacement(pose, wanted, x[known]).max() < 0.15


@pytest.mark.parametrize("degrees", [2.0, 90.0, 179.0])
def test_errors_are_of_the_stated_variance_in_any_pose(degrees: float) -> None:
    positions, truth = captured(300, degrees)
    poses, variance = by_face(positions, np.ones((300, MARKERS), bool))
    away = [displacement(*each) for each in zip(poses, truth, positions, strict=True)]
    assert np.mean(np.square(away)) == pytest.approx(variance.mean(), rel=0.5)


def test_swapped_labels_and_outliers_do_not_count() -> None:
    positions, truth = captured(50, 10.0)
    positions[:, [2, 9]] = positions[:, [9, 2]]
    positions[:, 5] += 30.0
    poses, _ = by_face(positions, np.ones((50, MARKERS), bool))
    away = [displacement(*each) for each in zip(poses, truth, positions, strict=True)]
    assert np.median(away) < 0.3


def test_frames_beyond_the_model_have_more_variance() -> None:
    positions, _ = captured(40, 10.0)
    seen = np.ones((40, MARKERS), bool)
    _, usual = by_face(positions, seen)
    pushed = positions + RNG.normal(scale=4.0, size=positions.shape)
    _, unusual = by_face(pushed, seen)
    assert np.median(unusual) > 20 * np.median(usual)


def test_markers_on_one_point_have_an_uncertain_pose() -> None:
    positions = np.full((2, MARKERS, 3), 7.0)
    poses, variance = by_face(positions, np.ones((2, MARKERS), bool))
    assert np.isfinite(poses).all()
    assert variance.min() > 10


def test_no_frames_have_no_poses() -> None:
    poses, variance = by_face(np.empty((0, MARKERS, 3)), np.empty((0, MARKERS), bool))
    assert poses.shape == (0, 4, 4)
    assert variance.shape == (0,)


def test_a_precise_prior_keeps_the_expected_pose() -> None:
    still = RNG.multivariate_normal(MODEL.mean, COVARIANCE, 30).reshape(30, MARKERS, 3)
    turned = Rotation.from_rotvec([0.0, 0.02, 0.0]).apply((still - CENTRE).reshape(-1, 3))
    positions = turned.reshape(still.shape) + CENTRE
    seen = np.ones((30, MARKERS), bool)
    kept, certain = pose_by_face(
        MODEL, positions, seen, precision=np.full((30, 6), 1e9), centre=CENTRE
    )
    np.testing.assert_allclose(kept, np.tile(np.eye(4), (30, 1, 1)), atol=1e-3)
    assert certain.max() < 1e-4


def test_interpolated_poses_are_as_uncertain_as_they_are_wrong() -> None:
    seconds = np.arange(6000) / 60
    turns = 0.2 * np.sin(2 * np.pi * 0.4 * seconds) + 0.1 * np.sin(2 * np.pi * 0.93 * seconds)
    poses = np.tile(np.eye(4), (6000, 1, 1))
    poses[:, :3, :3] = Rotation.from_rotvec(np.outer(turns, [0.0, 1.0, 0.0])).as_matrix()
    measured = np.ones(6000, bool)
    for length in (7, 31):
        for start in range(200 + 10 * length, 5800, 400):
            measured[start : start + length] = False
    precision = interpolation_precision(poses, measured, CENTRE)[:, 1]
    wrong = np.interp(np.arange(6000), np.flatnonzero(measured), turns[measured]) - turns
    levels = np.unique(precision[~measured])
    assert len(levels) == 3
    for level in levels:  # of the next power of two: up to four times the error's square
        away = np.sqrt(np.mean(wrong[precision == level] ** 2))
        assert 0.2 * level**-0.5 < away < 1.2 * level**-0.5
    assert not precision[measured].any()


def test_at_the_ends_of_a_take_poses_are_held() -> None:
    poses = np.tile(np.eye(4), (500, 1, 1))
    poses[:, 1, 3] = 0.5 * np.arange(500)  # a straight line is interpolated exactly
    measured = np.ones(500, bool)
    measured[:8] = measured[200] = False
    precision = interpolation_precision(poses, measured, CENTRE)[:, 4]
    np.testing.assert_allclose(precision[[0, 7]] ** -0.5, [0.5 * 8, 0.5])
    assert precision[200] ** -0.5 == pytest.approx(0.01)
