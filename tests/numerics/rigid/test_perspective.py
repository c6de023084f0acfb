"""A head that is projected by a pinhole comes back as it was."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from usdface.numerics.rigid.perspective import PinholeCamera, unproject_head
from usdface.numerics.rigid.rigid_alignment import align_rigid

CAMERA = PinholeCamera(900.0, (320.0, 240.0))
SKULL, RIGHT_EYE, LEFT_EYE = np.arange(12), np.array([12]), np.array([13])


def projected(rng: np.random.Generator, frames: int = 40) -> tuple[np.ndarray, np.ndarray]:
    """Landmarks as a model gives them, and the points in the camera's space [mm]."""
    shape = rng.normal(size=(20, 3)) * [40, 50, 25]
    shape -= shape[SKULL].mean(axis=0)
    shape[[12, 13]] *= 63.0 / np.linalg.norm(shape[12] - shape[13])
    turn = Rotation.from_euler("yxz", rng.uniform(-25, 25, (frames, 3)), degrees=True)
    stand = rng.uniform([-80, -60, -900], [80, 60, -350], (frames, 3))
    points = np.einsum("fij,pj->fpi", turn.as_matrix(), shape) + stand[:, None]
    depth = -points[..., 2]
    x = CAMERA.center[0] + CAMERA.focal_pixels * points[..., 0] / depth
    y = CAMERA.center[1] - CAMERA.focal_pixels * points[..., 1] / depth
    pixels_per_mm = CAMERA.focal_pixels / depth[:, SKULL].mean(axis=1)
    z = (depth - depth[:, SKULL].mean(axis=1)[:, None]) * pixels_per_mm[:, None]
    return np.stack([x, y, z], axis=-1), points


def unprojected(landmarks: np.ndarray, seen: np.ndarray, camera: PinholeCamera) -> np.ndarray:
    return unproject_head(
        landmarks,
        seen,
        rigid=SKULL,
        eyes=(RIGHT_EYE, LEFT_EYE),
        eye_distance_mm=63.0,
        camera=camera,
    )


def test_a_projected_head_comes_back_as_it_was() -> None:
    landmarks, points = projected(np.random.default_rng(0))
    seen = np.ones(len(points), bool)
    seen[7] = False
    landmarks[7] = np.nan
    found = unprojected(landmarks, seen, CAMERA)
    assert np.isnan(found[7]).all()
    np.testing.assert_allclose(found[seen], points[seen], atol=1e-9)


def test_without_the_focal_length_the_head_is_bent() -> None:
    """What the camera is needed for: millimetres that a mapping would take for expression."""
    landmarks, points = projected(np.random.default_rng(1))
    flat = unprojected(landmarks, np.ones(len(points), bool), PinholeCamera(9e4, CAMERA.center))
    still = points[0] - points[0].mean(axis=0)
    for found, least, most in ((points, 0.0, 1e-6), (flat, 1.0, 30.0)):
        pose = align_rigid(found, still)
        left = found - (still @ pose.rotations.transpose(0, 2, 1) + pose.translations[:, None])
        assert least <= np.sqrt((left**2).sum(axis=2).mean()) < most


def test_no_face_is_refused() -> None:
    with pytest.raises(ValueError, match="no frame has a face"):
        unprojected(np.full((3, 20, 3), np.nan), np.zeros(3, bool), CAMERA)
