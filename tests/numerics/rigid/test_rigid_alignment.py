"""Head pose by least squares: against scipy, against known motion, and against what goes wrong."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from usdface.numerics.rigid.rigid_alignment import (
    align_rigid,
    align_rigid_robust,
    optimal_rotations,
    remove_motion,
)


def moving_body(frames=200, points=8, noise=0.0, depth=1.0, seed=0):
    rng = np.random.default_rng(seed)
    reference = rng.uniform(-70, 70, (points, 3)) * [1, 1, depth]
    rotations = Rotation.random(frames, random_state=seed).as_matrix()
    translations = rng.normal(0, 500, (frames, 3))
    captured = np.einsum("fij,kj->fki", rotations, reference) + translations[:, None]
    return (
        captured + noise * rng.standard_normal(captured.shape),
        reference,
        rotations,
        translations,
    )


def angles_deg(a, b):
    return np.rad2deg(Rotation.from_matrix(np.swapaxes(a, 1, 2) @ b).magnitude())


def test_agrees_with_scipy_frame_by_frame():
    captured, reference, _, _ = moving_body(noise=3.0)
    weights = np.random.default_rng(1).uniform(0.1, 1, captured.shape[:2])
    ours = align_rigid(captured, reference, weights=weights)
    for frame, rotation in enumerate(ours.rotations):
        w = weights[frame][:, None] / weights[frame].sum()
        x, y = captured[frame], reference
        x, y = x - (w * x).sum(0), y - (w * y).sum(0)
        theirs, _ = Rotation.align_vectors(x, y, weights=weights[frame])
        np.testing.assert_allclose(rotation, theirs.as_matrix(), atol=1e-10)


def test_known_motion_is_recovered_and_taken_out():
    captured, reference, rotations, translations = moving_body()
    found = align_rigid(captured, reference)
    np.testing.assert_allclose(found.rotations, rotations, atol=1e-12)
    np.testing.assert_allclose(found.translations, translations, atol=1e-9)
    np.testing.assert_allclose(
        remove_motion(captured, found), np.broadcast_to(reference, captured.shape), atol=1e-9
    )


def test_matrices_put_stabilised_points_back():
    captured, reference, _, _ = moving_body(noise=1.0)
    found = align_rigid(captured, reference)
    still = np.concatenate([remove_motion(captured, found), np.ones((*captured.shape[:2], 1))], 2)
    np.testing.assert_allclose(
        (still @ np.swapaxes(found.matrices(), 1, 2))[..., :3], captured, atol=1e-9
    )


@pytest.mark.parametrize("depth", [1.0, 0.05, 0.0], ids=["deep", "shallow", "flat"])
def test_never_a_reflection(depth):
    captured, reference, rotations, _ = moving_body(frames=2000, points=3, noise=1.0, depth=depth)
    found = align_rigid(captured, reference)
    np.testing.assert_allclose(np.linalg.det(found.rotations), 1, atol=1e-12)
    assert np.median(angles_deg(found.rotations, rotations)) < 3


def test_a_missing_point_pulls_neither_centroid():
    captured, reference, rotations, _ = moving_body()
    seen = np.random.default_rng(2).random(captured.shape[:2]) > 0.3
    captured[~seen] = np.nan
    found = align_rigid(captured, reference, weights=seen)
    enough = seen.sum(axis=1) >= 3
    np.testing.assert_allclose(found.rotations[enough], rotations[enough], atol=1e-10)


def test_two_points_or_a_line_do_not_determine_a_pose():
    captured, reference, _, _ = moving_body(frames=4)
    seen = np.ones(captured.shape[:2], bool)
    seen[1, 2:] = False
    found = align_rigid(captured, reference, weights=seen)
    assert found.determined.tolist() == [True, False, True, True]
    line = np.outer(np.linspace(-50, 50, 8), [1.0, 2.0, 3.0])
    assert not align_rigid(line[None] + 5.0, line).determined.any()


def test_a_swap_and_a_stray_do_not_turn_the_head():
    captured, reference, rotations, _ = moving_body(frames=500, points=10, noise=0.15)
    captured[::2, [0, 1]] = captured[::2, [1, 0]]
    captured[::3, 2] += 40.0
    seen = np.ones(captured.shape[:2], bool)
    plain = angles_deg(align_rigid(captured, reference).rotations, rotations)
    robust = align_rigid_robust(captured, reference, visible=seen)
    assert plain.max() > 5
    assert angles_deg(robust.rotations, rotations).max() < 0.5
    assert robust.weights[::2, :2].max() < 1e-3


def test_without_outliers_robust_is_as_good_as_plain():
    captured, reference, rotations, _ = moving_body(frames=2000, points=10, noise=0.15)
    seen = np.ones(captured.shape[:2], bool)
    plain = angles_deg(align_rigid(captured, reference).rotations, rotations).mean()
    robust = angles_deg(align_rigid_robust(captured, reference, visible=seen).rotations, rotations)
    assert robust.mean() < 1.15 * plain


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_closed_form_equals_the_decomposition(sign):
    rng = np.random.default_rng(0)
    matrices = rng.normal(size=(500, 3, 3)) * rng.uniform(1e-6, 1e6, (500, 1, 1))
    matrices = matrices * (sign * np.sign(np.linalg.det(matrices)))[:, None, None]
    U, _, Vt = np.linalg.svd(matrices)
    U[:, :, 2] *= np.linalg.det(U @ Vt)[:, None]
    rotations, determined = optimal_rotations(matrices, rank_tolerance=1e-3)
    np.testing.assert_allclose(rotations[determined], (U @ Vt)[determined], atol=1e-9)
    assert determined.mean() > 0.98
