import numpy as np
from scipy.spatial.transform import Rotation

from usdface.numerics.rigid.rigid_alignment import align_rigid
from usdface.numerics.rigid.stabilization import align_by_prior


def moving_head(rng: np.random.Generator, *, frames: int = 240):
    """Twenty markers: eight of the skull, six that move now and then, six that move always."""
    reference = rng.normal(size=(20, 3)) * [60, 80, 25]
    own = np.zeros((frames, 20, 3))
    own[100:160, 8:14, 1] = 9.0
    own[:, 14:, 1] = 8 * np.sin(np.arange(frames) / 9)[:, None]
    turn = Rotation.from_rotvec(np.deg2rad(np.linspace(0, 25, frames))[:, None] * [0, 1, 0])
    captured = np.einsum("fij,fmj->fmi", turn.as_matrix(), reference + own) + np.array([10, 20, 30])
    return reference, captured, turn


def error_degrees(found, turn) -> np.ndarray:
    return np.degrees((Rotation.from_matrix(found.rotations) * turn.inv()).magnitude())


def test_skin_that_moves_for_a_while_does_not_turn_the_head() -> None:
    rng = np.random.default_rng(0)
    reference, captured, turn = moving_head(rng)
    prior = np.array([1.0] * 14 + [4.0] * 6)
    seen = np.ones(captured.shape[:2], bool)
    found = align_by_prior(captured, reference, visible=seen, skin_motion_mm=prior, rate=60.0)
    plain = align_rigid(captured, reference, weights=seen / prior**2)
    assert error_degrees(found, turn).max() < 0.3
    assert error_degrees(found, turn).max() < 0.2 * error_degrees(plain, turn).max()


def test_a_marker_that_is_not_seen_says_nothing() -> None:
    rng = np.random.default_rng(1)
    reference, captured, turn = moving_head(rng)
    seen = np.ones(captured.shape[:2], bool)
    seen[50:90, 3] = False
    captured[50:90, 3] = 1e4
    found = align_by_prior(
        captured, reference, visible=seen, skin_motion_mm=np.full(20, 1.0), rate=60.0
    )
    assert error_degrees(found, turn)[50:90].max() < 1.0


def test_turning_the_capture_turns_the_pose() -> None:
    rng = np.random.default_rng(2)
    reference, captured, _ = moving_head(rng)
    seen, prior = np.ones(captured.shape[:2], bool), np.full(20, 2.0)
    turn = Rotation.from_euler("xz", [30, 70], degrees=True)
    here = align_by_prior(captured, reference, visible=seen, skin_motion_mm=prior, rate=60.0)
    there = align_by_prior(
        captured @ turn.as_matrix().T, reference, visible=seen, skin_motion_mm=prior, rate=60.0
    )
    np.testing.assert_allclose(there.rotations, turn.as_matrix() @ here.rotations, atol=1e-9)
