"""The head's pose from the face alone, against the dense likelihood minimised by SciPy."""

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from usdface.numerics.repair.face_pose import pose_by_face
from usdface.numerics.repair.low_rank import LowRankModel

RNG = np.random.default_rng(3)
MARKERS, RANK = 20, 4
MODEL = LowRankModel(
    mean=RNG.normal(scale=40.0, size=3 * MARKERS),
    components=np.linalg.qr(RNG.normal(size=(3 * MARKERS, RANK)))[0].T,
    variances=np.array([900.0, 400.0, 100.0, 50.0]),
    noise=np.linspace(0.1, 0.3, MARKERS),
)
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


def displacement(pose: np.ndarray, other: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """Return how far two poses take the same captured markers apart."""
    one, two = ((positions - each[:3, 3]) @ each[:3, :3] for each in (pose, other))
    return np.linalg.norm(one - two, axis=1)


def test_the_pose_maximises_the_likelihood_of_the_markers_seen() -> None:
    positions, _ = captured(4, 30.0)
    seen = RNG.random((4, MARKERS)) < 0.8
    poses, _ = pose_by_face(MODEL, positions, seen)
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
    poses, variance = pose_by_face(MODEL, positions, np.ones((300, MARKERS), bool))
    away = [displacement(*each) for each in zip(poses, truth, positions, strict=True)]
    assert np.mean(np.square(away)) == pytest.approx(variance.mean(), rel=0.5)


def test_swapped_labels_and_outliers_do_not_count() -> None:
    positions, truth = captured(50, 10.0)
    positions[:, [2, 9]] = positions[:, [9, 2]]
    positions[:, 5] += 30.0
    poses, _ = pose_by_face(MODEL, positions, np.ones((50, MARKERS), bool))
    away = [displacement(*each) for each in zip(poses, truth, positions, strict=True)]
    assert np.median(away) < 0.3


def test_frames_beyond_the_model_have_more_variance() -> None:
    positions, _ = captured(40, 10.0)
    seen = np.ones((40, MARKERS), bool)
    _, usual = pose_by_face(MODEL, positions, seen)
    pushed = positions + RNG.normal(scale=4.0, size=positions.shape)
    _, unusual = pose_by_face(MODEL, pushed, seen)
    assert np.median(unusual) > 20 * np.median(usual)


def test_no_frames_have_no_poses() -> None:
    poses, variance = pose_by_face(MODEL, np.empty((0, MARKERS, 3)), np.empty((0, MARKERS), bool))
    assert poses.shape == (0, 4, 4)
    assert variance.shape == (0,)
