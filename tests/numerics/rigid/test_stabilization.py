"""Head motion out and kept: on a simulated head with a face that moves."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.numerics.simulated_face import hold_head
from usdface.numerics.rigid.rigid_markers import find_rigid_markers
from usdface.numerics.rigid.stabilization import stabilize

RIGID = (0, 1, 2, 3, 4, 5)
HEAD, NECK = np.array([0, 1500, 0]), np.array([0, 1450, 0])


def talking_head(frames=600, noise=0.0):
    """Six markers on the skull, fourteen on skin that moves by centimetres."""
    rng = np.random.default_rng(0)
    rest = rng.uniform(-70, 70, (20, 3)) + HEAD
    t = np.arange(frames) / 60
    skin = np.zeros((frames, 20, 3))
    skin[:, 6:] = np.einsum(
        "fc,cki->fki", np.sin(t[:, None] * [1.0, 2.3, 3.1]) * 6, rng.normal(size=(3, 14, 3))
    )
    face = rest + skin
    turn = Rotation.from_rotvec(
        np.stack([0.3 * np.sin(t), 0.5 * np.sin(0.7 * t), 0.2 * np.sin(1.3 * t)], 1)
    )
    turns = turn.as_matrix()
    moved = np.einsum("fij,fkj->fki", turns, face - NECK) + NECK
    moved += 50 * np.sin(t)[:, None, None]
    return moved + noise * rng.standard_normal(moved.shape), face, turns


def test_the_face_is_what_is_left_and_the_head_goes_back():
    captured, face, turns = talking_head()
    seen = np.ones(captured.shape[:2], bool)
    result = stabilize(captured, seen, rigid=RIGID, neutral=0)
    still = hold_head(captured, result)
    np.testing.assert_allclose(still, face, atol=1e-6)
    np.testing.assert_allclose(result.head_motion[:, :3, :3], turns, atol=1e-9)
    np.testing.assert_allclose(result.head_motion[0], np.eye(4), atol=1e-6)
    back = np.einsum("fij,fkj->fki", result.head_motion[:, :3, :3], still)
    np.testing.assert_allclose(back + result.head_motion[:, None, :3, 3], captured, atol=1e-6)


def test_another_neutral_frame_only_moves_the_whole_space():
    captured, _, _ = talking_head(noise=0.1)
    seen = np.ones(captured.shape[:2], bool)
    a, b = (
        hold_head(captured, stabilize(captured, seen, rigid=RIGID, neutral=neutral))
        for neutral in (0, 300)
    )
    a_distances = np.linalg.norm(a[:, 6:] - a[:, :1], axis=2)
    b_distances = np.linalg.norm(b[:, 6:] - b[:, :1], axis=2)
    np.testing.assert_allclose(a_distances, b_distances, atol=1e-9)  # each frame is moved rigidly
    np.testing.assert_allclose((a[0, 6:] - a[9, 6:]).std(), (b[0, 6:] - b[9, 6:]).std(), rtol=0.01)


def test_frames_without_a_pose_take_one_between_their_neighbours():
    captured, _, turns = talking_head()
    seen = np.ones(captured.shape[:2], bool)
    seen[100:104, :4] = False
    seen[:3] = False
    captured[~seen] = np.nan
    result = stabilize(captured, seen, rigid=RIGID, neutral=10)
    assert result.pose_gap[98:106].tolist() == [0, 0, 1, 2, 2, 1, 0, 0]
    assert result.pose_gap[:4].tolist() == [3, 2, 1, 0]
    relative = result.head_motion[:, :3, :3] @ turns[10]
    error = Rotation.from_matrix(np.swapaxes(relative, 1, 2) @ turns).magnitude()
    assert np.rad2deg(error[99:105]).max() < 0.05
    np.testing.assert_allclose(result.head_motion[0], result.head_motion[3])


def test_a_rigid_marker_that_is_not_seen_at_the_neutral_frame_still_counts():
    captured, _, _ = talking_head(noise=0.05)
    seen = np.ones(captured.shape[:2], bool)
    seen[0, 5] = False
    captured[0, 5] = 0
    result = stabilize(captured, seen, rigid=RIGID, neutral=0)
    without = stabilize(captured, seen, rigid=[m for m in RIGID if m != 5], neutral=0)
    away = np.abs(result.head_motion[1:] - without.head_motion[1:]).max(axis=(1, 2))
    assert away.min() > 1e-6


@pytest.mark.parametrize(
    ("rigid", "hidden", "message"),
    [
        ((0, 1, 2), [0], "2 of 3 rigid markers are seen at the neutral frame"),
        ((0, 1), [], "2 of 2 rigid markers"),
    ],
)
def test_too_few_rigid_markers_are_refused_with_the_remedy(rigid, hidden, message):
    captured, _, _ = talking_head(frames=20)
    seen = np.ones(captured.shape[:2], bool)
    seen[0, hidden] = False
    with pytest.raises(ValueError, match=message + r".*name more rigid markers"):
        stabilize(captured, seen, rigid=rigid, neutral=0)


def test_rigid_markers_on_a_line_are_refused():
    captured = np.zeros((5, 4, 3)) + np.arange(4)[:, None] * [10.0, 20.0, 0.0]
    with pytest.raises(ValueError, match="on a line"):
        stabilize(captured, np.ones((5, 4), bool), rigid=(0, 1, 2, 3), neutral=0)


def test_the_markers_on_the_skull_are_found_among_all():
    captured, _, _ = talking_head(noise=0.15)
    seen = np.random.default_rng(1).random(captured.shape[:2]) > 0.05
    assert find_rigid_markers(captured, seen).indices == RIGID


def test_a_cloud_without_a_rigid_part_is_refused():
    rng = np.random.default_rng(0)
    t = np.linspace(0, 20, 400)[:, None, None]
    captured = rng.uniform(-70, 70, (12, 3)) + 10 * np.sin(t * rng.uniform(1, 3, (12, 3)))
    with pytest.raises(ValueError, match="no set of markers keeps its mutual distances"):
        find_rigid_markers(captured, np.ones((400, 12), bool))


@pytest.mark.parametrize(
    ("frames", "hidden", "message"),
    [
        (1, False, "too few are seen together in two frames or more"),
        (60, True, "only 0 of 20 markers are seen in at least half of the frames, 4 are"),
    ],
)
def test_markers_that_are_hardly_seen_together_are_refused_in_words(frames, hidden, message):
    captured = talking_head(frames)[0]
    seen = np.ones(captured.shape[:2], bool)
    if hidden:
        seen[1:] = False
    with pytest.raises(ValueError, match=message):
        find_rigid_markers(captured, seen)


def test_half_of_the_skull_in_half_of_the_frames_does_not_tell_the_rotation():
    captured, _, _ = talking_head(400)
    seen = np.ones(captured.shape[:2], bool)
    seen[:200, ::2] = seen[200:, 1::2] = False
    found = find_rigid_markers(captured, seen)
    assert not found.is_rigid
    assert np.rad2deg(found.rotation_error) > 2


@pytest.mark.parametrize("noise", [0.08, 0.0], ids=["noisy", "exact"])
@pytest.mark.parametrize("always", [False, True], ids=["in some frames", "in all frames"])
def test_rigid_markers_nearly_on_a_line_measure_no_pose_if_others_do(noise, always):
    """Three of them, 6 mm off a line of 70 mm, turned the face by noise alone: by 1.6 mm."""
    rng = np.random.default_rng(0)
    rigid = np.array([[-60, 95, 30], [0, 110, 55], [62, 92, 28], [20, 100, 50]], float)
    face = np.vstack([rigid, rng.uniform([-60, -80, 20], [60, 60, 70], (30, 3))])
    captured = face + rng.normal(0, noise, (400, 34, 3))
    visible = np.ones((400, 34), bool)
    visible[200:220, 0] = False
    if always:
        visible[:, 0] = False
    body = stabilize(captured, visible, rigid=range(1 if always else 0, 4), neutral=5)
    loose = np.flatnonzero(body.pose_gap)
    if always:
        assert len(loose) < 40, "there is no better pose"
    else:
        np.testing.assert_array_equal(loose, np.arange(200, 220) if noise else [])
