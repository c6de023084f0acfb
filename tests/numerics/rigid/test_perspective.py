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


def test_radial_distortion_is_undone_as_cardano_does() -> None:
    """One term: r + k r³ = d, a depressed cubic, whose real root is known."""
    k = 0.2
    camera = PinholeCamera(900.0, (320.0, 240.0), (k, 0.0))
    seen = np.random.default_rng(2).uniform([0, 0], [640, 480], (200, 2))
    away = (seen - camera.center) / 900.0
    d = np.linalg.norm(away, axis=1)
    half, root = d / (2 * k), np.sqrt((d / (2 * k)) ** 2 + 1 / (3 * k) ** 3)
    r = np.cbrt(half + root) + np.cbrt(half - root)
    expected = away * (r / d)[:, None] * 900.0 + camera.center
    np.testing.assert_allclose(camera.undistort(seen), expected, atol=1e-3)


def distorted(place: np.ndarray, terms: tuple[float, ...]) -> np.ndarray:
    """Where points over the focal length are seen: OpenCV's formula, written out."""
    k1, k2, p1, p2, k3 = (*terms, 0, 0, 0)[:5]
    x, y = place[..., 0], place[..., 1]
    r = np.hypot(x, y)
    radial = 1 + k1 * r**2 + k2 * r**4 + k3 * r**6
    tangential = (
        2 * p1 * x * y + p2 * (r**2 + 2 * x**2),
        p1 * (r**2 + 2 * y**2) + 2 * p2 * x * y,
    )
    return place * radial[..., None] + np.stack(tangential, axis=-1)


@pytest.mark.parametrize(
    "terms", [(-0.3, 0.1), (0.2, -0.25, 3e-3, -5e-3), (-0.3, 0.1, 1e-3, 4e-3, -0.02)]
)
def test_distorted_points_come_back(terms: tuple[float, ...]) -> None:
    camera = PinholeCamera(700.0, (330.0, 230.0), terms)
    place = np.random.default_rng(3).uniform(-0.4, 0.4, (300, 2))
    shown = distorted(place, terms) * 700.0 + camera.center
    found = camera.undistort(shown)
    np.testing.assert_allclose(found, place * 700.0 + camera.center, atol=1e-3)
    cv2 = pytest.importorskip("cv2", reason="OpenCV comes with the extra usdface[track]")
    matrix = np.array([[700.0, 0, 330], [0, 700, 230], [0, 0, 1]])
    stop = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 500, 1e-12)
    five = np.array((*terms, 0, 0, 0)[:5])
    other = cv2.undistortPoints(shown[:, None], matrix, five, P=matrix, criteria=stop)
    np.testing.assert_allclose(found, other.reshape(-1, 2), atol=2e-3)


def test_where_the_lens_folds_nothing_is_seen() -> None:
    """Of r - r³ / 3 the picture is folded beyond r = 1, where it shows 2 / 3."""
    camera = PinholeCamera(100.0, (0.0, 0.0), (-1 / 3, 0.0))
    found = camera.undistort(np.array([[66.0, 0.0], [67.0, 0.0], [0.0, -300.0]]))
    np.testing.assert_array_equal(np.isnan(found[:, 0]), [False, True, True])


def test_a_head_seen_through_a_distorting_lens_comes_back_as_it_was() -> None:
    landmarks, points = projected(np.random.default_rng(0))
    terms = (-0.25, 0.05, 1e-3, -2e-3, 0.01)
    camera = PinholeCamera(CAMERA.focal_pixels, CAMERA.center, terms)
    place = (landmarks[..., :2] - CAMERA.center) / CAMERA.focal_pixels
    landmarks[..., :2] = distorted(place, terms) * CAMERA.focal_pixels + CAMERA.center
    seen = np.ones(len(points), bool)
    np.testing.assert_allclose(unprojected(landmarks, seen, camera), points, atol=0.01)
    assert np.abs(unprojected(landmarks, seen, CAMERA) - points).max() > 1.0
