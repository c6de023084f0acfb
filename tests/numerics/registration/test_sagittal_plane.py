import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from usdface.numerics.registration.sagittal_plane import plane_by_reflection, plane_of_pairs


def mirrored_cloud(rng: np.random.Generator, *, pairs: int = 16, middle: int = 6) -> np.ndarray:
    """Left points, their mirror images, and points in between: about x = 0, facing +Z."""
    left = rng.uniform([8, -70, -30], [60, 70, 30], (pairs, 3))
    return np.concatenate([left, left * [-1, 1, 1], rng.normal(size=(middle, 3)) * [0, 50, 20]])


@pytest.mark.parametrize("yaw", [0, 40, 170, 260])
def test_the_plane_of_named_pairs_is_exact_wherever_the_head_looks(yaw: int) -> None:
    cloud = mirrored_cloud(np.random.default_rng(0))
    turn = Rotation.from_euler("yz", [yaw, 5], degrees=True)
    moved = turn.apply(cloud) + np.array([100, 20, -7])
    pairs = np.stack([np.arange(16), np.arange(16) + 16], axis=1)
    plane = plane_of_pairs(moved, pairs, np.arange(32, 38))
    np.testing.assert_allclose(plane.normal, turn.apply([1, 0, 0]), atol=1e-9)
    np.testing.assert_allclose(plane.mirrored(moved[:16]), moved[16:32], atol=1e-9)
    frame = plane.levelled_frame()
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(frame) == pytest.approx(1)


@pytest.mark.parametrize("yaw", [0, 65, 130])
def test_without_labels_the_plane_is_found_by_reflection(yaw: int) -> None:
    rng = np.random.default_rng(1)
    cloud = mirrored_cloud(rng) + rng.normal(0, 1.0, (38, 3))
    turn = Rotation.from_euler("yz", [yaw, 4], degrees=True)
    moved = turn.apply(cloud) + np.array([100, 20, -7])
    plane = plane_by_reflection(moved)
    true = turn.apply([1, 0, 0])
    assert np.degrees(np.arccos(min(abs(plane.normal @ true), 1.0))) < 2.0
    away = np.linalg.norm(plane.mirrored(moved[:16]) - moved[16:32], axis=1)
    assert np.median(away) < 4.0


def test_one_swapped_pair_hardly_turns_the_plane() -> None:
    rng = np.random.default_rng(2)
    cloud = mirrored_cloud(rng)
    cloud[16] += [0, 30, 0]
    pairs = np.stack([np.arange(16), np.arange(16) + 16], axis=1)
    plane = plane_of_pairs(cloud, pairs, np.arange(32, 38))
    assert np.degrees(np.arccos(plane.normal[0])) < 0.5
