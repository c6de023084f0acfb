"""Rotations stay rotations, and near a mean they are vectors."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from usdface.numerics.motion.rotation_space import (
    mean_rotation,
    multiply_quaternions,
    normalize_quaternions,
    rotation_vectors,
    rotations_at,
)


def random_rotations(rng: np.random.Generator, *shape: int, spread: float = 0.6) -> np.ndarray:
    vectors = rng.normal(0, spread, (int(np.prod(shape)), 3))
    return Rotation.from_rotvec(vectors).as_quat(scalar_first=True).reshape(*shape, 4)


def test_vectors_are_those_of_scipy():
    rng = np.random.default_rng(0)
    q, mean = random_rotations(rng, 200), random_rotations(rng, 1)[0]
    expected = (
        Rotation.from_quat(mean, scalar_first=True).inv() * Rotation.from_quat(q, scalar_first=True)
    ).as_rotvec()
    np.testing.assert_allclose(rotation_vectors(q, mean), expected, atol=1e-12)


def test_there_and_back_is_the_same_rotation_whatever_its_sign():
    rng = np.random.default_rng(0)
    q = random_rotations(rng, 50, 8)
    signs = rng.choice([-1.0, 1.0], (50, 8, 1))
    mean = mean_rotation(q)
    back = rotations_at(rotation_vectors(q * signs, mean), mean)
    np.testing.assert_allclose(np.abs(np.einsum("nji,nji->nj", back, q)), 1.0, atol=1e-12)


def test_the_mean_is_that_of_scipy_and_blind_to_signs():
    rng = np.random.default_rng(0)
    q = random_rotations(rng, 40, spread=0.3)
    signs = rng.choice([-1.0, 1.0], (40, 1))
    expected = Rotation.from_quat(q, scalar_first=True).mean().as_quat(scalar_first=True)
    assert abs(mean_rotation(q * signs) @ expected) == pytest.approx(1.0, abs=1e-12)


def test_half_way_between_two_turns_of_one_axis_is_half_the_angle():
    quarter = Rotation.from_rotvec([[0, 0, 0], [0, np.pi / 2, 0]]).as_quat(scalar_first=True)
    mean = mean_rotation(quarter)
    vectors = rotation_vectors(quarter, mean)
    between = rotations_at(vectors.mean(axis=0), mean)
    turned = Rotation.from_quat(between, scalar_first=True).as_rotvec()
    np.testing.assert_allclose(turned, [0, np.pi / 4, 0], atol=1e-12)


def test_whatever_vector_comes_out_is_a_rotation():
    rng = np.random.default_rng(0)
    mean = random_rotations(rng, 5)
    anything = rotations_at(rng.normal(0, 40, (1000, 5, 3)), mean)
    np.testing.assert_allclose(np.linalg.norm(anything, axis=-1), 1.0, atol=1e-12)
    none = rotations_at(np.zeros((5, 3)), mean)
    np.testing.assert_allclose(none, mean, atol=1e-15)


def test_products_are_those_of_scipy():
    rng = np.random.default_rng(0)
    a, b = random_rotations(rng, 20), random_rotations(rng, 20)
    expected = Rotation.from_quat(a, scalar_first=True) * Rotation.from_quat(b, scalar_first=True)
    np.testing.assert_allclose(
        Rotation.from_quat(multiply_quaternions(a, b), scalar_first=True).as_matrix(),
        expected.as_matrix(),
        atol=1e-12,
    )


def test_a_zero_quaternion_is_no_rotation():
    with pytest.raises(ValueError, match="no rotation"):
        normalize_quaternions(np.zeros((1, 4)))


def test_vectors_go_the_shorter_way_round_whatever_the_sign_of_a_quaternion():
    rng = np.random.default_rng(0)
    q, mean = random_rotations(rng, 200), random_rotations(rng, 1)[0]
    np.testing.assert_allclose(rotation_vectors(-q, mean), rotation_vectors(q, mean), atol=1e-12)
    assert np.linalg.norm(rotation_vectors(-q, mean), axis=1).max() <= np.pi + 1e-12
