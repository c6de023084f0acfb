"""Samples of a face's skin, what shapes do there, and alignments of clouds."""

import numpy as np
import pytest
from scipy import sparse
from scipy.spatial.transform import Rotation

from tests.numerics.small_face import small_face
from usdface.numerics.registration.cloud_alignment import align_landmarks, align_pairs
from usdface.numerics.registration.face_skin import facing_direction, sample_outer_surface
from usdface.numerics.registration.virtual_markers import deltas_at


@pytest.fixture(scope="module")
def face():
    return small_face()


def test_deltas_are_interpolated_in_triangles(face):
    rng = np.random.default_rng(0)
    corners, shares = face.triangles[::97], rng.dirichlet(np.ones(3), len(face.triangles[::97]))
    by_hand = np.einsum("mk,smkc->scm", shares, face.offsets[:, corners])
    turn = Rotation.from_euler("xyz", [0.1, 0.0, -0.3]).as_matrix()
    for axes, wanted in ((None, by_hand), (turn, turn @ by_hand)):
        at = deltas_at(sparse.csc_array(face.flat_offsets), corners, shares, axes=axes)
        np.testing.assert_allclose(at.toarray().reshape(wanted.shape), wanted, atol=1e-12)


def test_only_skin_seen_from_in_front_is_sampled(face):
    activity = np.linalg.norm(face.offsets, axis=2).max(axis=0)
    facing = facing_direction(face.points, face.triangles, activity)
    np.testing.assert_allclose(facing, (0, 0, 1), atol=0.05)
    samples = sample_outer_surface(face.points, face.triangles, facing=facing, activity=activity)
    assert np.isin(samples.corners, face.skin).mean() > 0.97


def test_a_face_that_looks_elsewhere_is_recognised(face):
    turned = face.points @ np.array([[0, 0, -1], [0, 1, 0], [1, 0, 0]]).T
    activity = np.linalg.norm(face.offsets, axis=2).max(axis=0)
    facing = facing_direction(turned, face.triangles, activity)
    np.testing.assert_allclose(facing, (-1, 0, 0), atol=0.05)


@pytest.mark.parametrize("seed", range(5))
def test_a_turn_is_not_mistaken_for_proportions_of_the_other_face(seed):
    rng = np.random.default_rng(seed)
    cloud = rng.normal(size=(60, 3)) * [60, 80, 30]
    turn = Rotation.from_rotvec(0.4 * rng.normal(size=3))
    proportions = np.array([1.25, 0.85, 1.0])
    targets = proportions * turn.apply(cloud) + [5, 6, 7]
    plain = align_landmarks(cloud, targets)
    found = align_pairs(cloud, targets, weight=np.ones(60))
    off, before = (
        (Rotation.from_matrix(each.rotation) * turn.inv()).magnitude() for each in (found, plain)
    )
    assert off < 0.7 * before  # proportions are believed in part, so a part of the turn is left
    assert found.residual_mm < 0.6 * np.sqrt(((plain.apply(cloud) - targets) ** 2).sum(1).mean())
