"""Rotations of the skin's motion against SciPy's alignment of vectors."""

import numpy as np
from scipy.spatial.transform import Rotation

from usdface.numerics.rigid.skin_rotation import skin_rotations


def test_skin_turns_as_by_scipy() -> None:
    rng = np.random.default_rng(0)
    predicted = rng.normal(size=(50, 3, 3)) * [[[3.0], [5.0], [0.05]]]
    truth = Rotation.from_rotvec([[0, 0.3, 0], [0.2, 0, 0.1], [1.0, 0, 0]]).as_matrix()
    measured = 1.3 * np.einsum("mij,fmj->fmi", truth, predicted)
    measured[0, 0] = np.nan
    visible = np.isfinite(measured).all(axis=2)
    neutral = 1e3 * np.eye(3)  # no marker is another's neighbour
    found = skin_rotations(neutral, predicted, measured, visible=visible)
    for marker, rotation in enumerate(found):
        rows = visible[:, marker]
        m, y = predicted[rows, marker], measured[rows, marker]
        unturned = 0.3 * (m**2).sum() / 3 + len(predicted)
        expected, _ = Rotation.align_vectors(
            np.concatenate([y, np.eye(3)]),
            np.concatenate([m, np.eye(3)]),
            weights=np.append(np.ones(len(y)), np.full(3, unturned)),
        )
        np.testing.assert_allclose(rotation, expected.as_matrix(), atol=1e-6)
    still = Rotation.from_matrix(found[2]).magnitude()
    assert still < 0.01


def test_neighbours_share_the_rotation_of_the_skin() -> None:
    predicted = np.random.default_rng(1).normal(size=(80, 2, 3)) * [[[6.0], [0.01]]]
    turn = Rotation.from_rotvec([0, 0, 0.4])
    measured = np.einsum("ij,fmj->fmi", turn.as_matrix(), predicted)
    visible = np.ones(predicted.shape[:2], bool)
    angles = [
        Rotation.from_matrix(
            skin_rotations(np.diag([0, away, 0])[:2], predicted, measured, visible=visible)[1]
        ).magnitude()
        for away in (5.0, 100.0)
    ]
    assert angles[0] > 0.25
    assert angles[1] < 0.01
