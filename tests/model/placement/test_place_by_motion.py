"""Markers whose labels say nothing: placed by shape and motion, wherever the performer looks."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import KDTree

from tests.model.synthetic import skin_samples
from tests.numerics.small_face import MOUTH, small_actor, small_face
from tests.remembered import coarse_face_skin
from usdface.model.placement import place as place_module
from usdface.model.placement.marker_cloud import marker_cloud
from usdface.model.placement.place import place_markers, pose_errors_at
from usdface.numerics.registration.face_skin import sample_face_skin
from usdface.numerics.registration.skin_placement import explained_share, solve_weights_at
from usdface.numerics.registration.virtual_markers import character_motion, marker_deltas


@pytest.fixture(scope="module")
def face():
    return small_face()


@pytest.fixture(scope="module")
def skin(face):
    return coarse_face_skin(face.points, face.triangles, face.flat_offsets)


def act(face, **turned):
    """One second of motion, which is as well placed as four."""
    return small_actor(face, np.random.default_rng(0), frames=60, **turned)


@pytest.fixture(scope="module")
def actor(face):
    return act(face)


@pytest.fixture(scope="module")
def placed(skin, actor):
    return place(skin, actor.neutral, actor.positions)


def place(skin, neutral, positions, *, visible=None, pins=None):
    labels = tuple(f"m{i}" for i in range(len(neutral)))
    shapes = tuple(f"shape_{i}" for i in range(len(skin.deltas)))
    cloud = marker_cloud(labels, neutral, positions, visible=visible)
    return place_markers(cloud, skin, shapes, pinned=pins)


def errors(face, actor, placed):
    found = placed.virtual.places(face.points)
    return np.linalg.norm(found - face.points[actor.carriers], axis=1)


@pytest.mark.usefixtures("few_starts")
def test_a_rig_of_another_size_has_the_markers_at_the_same_places(face, skin, actor, placed):
    size = 0.3
    small = coarse_face_skin(size * face.points, face.triangles, size * face.flat_offsets)
    found = place(small, actor.neutral, actor.positions).virtual
    away = np.linalg.norm(found.places(face.points) - placed.virtual.places(face.points), axis=1)
    assert np.mean(away > 0.01) < 0.05  # rounding may choose another of two equal samples
    assert found.motion_scale == pytest.approx(size * placed.virtual.motion_scale, rel=0.005)


def test_finds_known_markers_without_landmarks(face, skin, actor, placed):
    error = errors(face, actor, placed)
    assert np.median(error) < 4
    assert np.quantile(error, 0.9) < 8
    moved = skin.to_frame(character_motion(placed.virtual, actor.positions, actor.neutral))
    ranges = np.tile([0.0, 1.0], (len(skin.deltas), 1))
    samples = skin_samples(skin, placed.virtual)
    weights = solve_weights_at(skin, samples, moved, ranges)
    assert explained_share(skin, samples, moved, weights) > 0.9
    assert not placed.by_labels


@pytest.mark.slow
@pytest.mark.usefixtures("two_pose_rounds", "few_starts")
def test_a_head_band_that_slips_does_not_move_the_markers(face, skin, actor, placed):
    rng = np.random.default_rng(1)
    turns, moves = rng.normal(0, 0.02, (len(actor.positions), 3)), rng.normal(0, 3, (3, 1, 1, 3))
    moves = np.repeat(moves, -(-len(actor.positions) // 3), axis=0).reshape(-1, 1, 3)
    away = np.cross(turns[:, None], actor.neutral - actor.neutral.mean(axis=0))
    slipped = actor.positions + away + moves[: len(actor.positions)]
    assert np.median(errors(face, actor, place(skin, actor.neutral, slipped))) < 1.2 * np.median(
        errors(face, actor, placed)
    )


def test_right_places_are_more_probable_than_others_of_a_head_band_that_slips(skin, actor, placed):
    rng = np.random.default_rng(2)
    slipped = actor.positions + rng.normal(0, 5, (len(actor.positions), 1, 3))
    cloud = marker_cloud(tuple(map(str, range(len(actor.neutral)))), actor.neutral, slipped)
    samples = skin_samples(skin, placed.virtual)
    lower = skin.positions[samples] - [0, 15, 0]
    _, others = KDTree(skin.positions).query(lower)
    right, wrong = (
        pose_errors_at(cloud, skin, placed.virtual, each).evidence for each in (samples, others)
    )
    assert right > wrong + 0.1


@pytest.mark.parametrize(("gain", "is_accepted"), [(-1.0, False), (0.009, False), (0.02, True)])
@pytest.mark.parametrize("possible_mm", [0.5, 2.0])
def test_a_placement_without_pose_errors_is_accepted_by_its_evidence(
    skin, actor, placed, monkeypatch, possible_mm, gain, is_accepted
):
    cloud = marker_cloud(tuple(map(str, range(len(actor.neutral)))), actor.neutral, actor.positions)
    samples = skin_samples(skin, placed.virtual)
    none = pose_errors_at(cloud, skin, placed.virtual, samples)
    others = [replace(placed, overturned_gain=gain) for gain in (0.25, 0.5)]
    errors = [replace(none, possible_mm=possible_mm, evidence=0.0)]
    errors += [replace(none, possible_mm=0.0, evidence=evidence) for evidence in (gain, -1.0)]
    results, evidences = iter([placed, *others]), iter(errors)
    monkeypatch.setattr(place_module, "_place", lambda *_: (next(results), samples))
    monkeypatch.setattr(place_module, "pose_errors_at", lambda *_: next(evidences))
    found = place_markers(cloud, skin, ("",) * len(skin.deltas))
    assert found.overturned_gain == (0.25 if is_accepted else 0)


def test_weights_are_followed_from_samples_nearby(skin, actor, placed):
    moved = skin.to_frame(character_motion(placed.virtual, actor.positions, actor.neutral))
    ranges = np.tile([0.0, 1.0], (len(skin.deltas), 1))
    samples = skin_samples(skin, placed.virtual)
    aside = KDTree(skin.positions).query(skin.positions[samples] + (4.0, 2.0, 0.0))[1]
    start = solve_weights_at(skin, samples, moved, ranges)
    near = solve_weights_at(skin, aside, moved, ranges, start=start)
    exact = solve_weights_at(skin, aside, moved, ranges)
    motion = [np.einsum("fs,smc->fmc", w, skin.deltas[:, aside]) for w in (start, near, exact)]
    assert np.abs(motion[0] - motion[2]).max() > 0.5  # [mm]
    assert np.abs(motion[1] - motion[2]).max() < 0.05


@pytest.mark.usefixtures("placed_once", "few_starts")
def test_a_cloud_upside_down_is_noticed(skin, actor, placed):
    over = np.array([-1.0, -1.0, 1.0])
    assert place(skin, actor.neutral * over, actor.positions * over).overturned_gain > 0.1
    assert placed.overturned_gain == 0


def test_upper_and_lower_lip_are_told_apart(face, actor, placed):
    true, found = face.points[actor.carriers], placed.virtual.places(face.points)
    lips = (np.abs(true[:, 0]) < 30) & (np.abs(true[:, 1] - MOUTH) < 12)
    assert lips.sum() >= 4
    np.testing.assert_array_equal(true[lips, 1] < MOUTH, found[lips, 1] < MOUTH)


@pytest.mark.usefixtures("few_starts")
@pytest.mark.parametrize("yaw", [90, 180])
def test_turning_moving_and_resizing_the_performer_changes_nothing(face, skin, placed, yaw):
    actor = act(face, yaw=yaw)
    moved = place(
        skin, actor.neutral * 1.7 + (500, 80, -3000), actor.positions * 1.7 + (500, 80, -3000)
    )
    side = face.points[actor.carriers][:, 0]
    found = moved.virtual.places(face.points)
    clear = np.abs(side) > 12
    np.testing.assert_array_equal(np.sign(found[clear, 0]), np.sign(side[clear]), "left is right")
    assert np.linalg.det(moved.virtual.rotation) == pytest.approx(1)
    step = found - placed.virtual.places(face.points)
    assert np.median(np.linalg.norm(step, axis=1)) < 1.5
    assert moved.virtual.motion_scale * 1.7 == pytest.approx(placed.virtual.motion_scale, rel=0.05)


def test_motion_has_the_scale_of_width_and_height(actor, placed):
    expected = np.sqrt(actor.scale[0] * actor.scale[1])
    assert placed.virtual.motion_scale == pytest.approx(expected, rel=0.06)


def test_markers_are_glued_to_triangles_of_the_surface(face, placed):
    np.testing.assert_allclose(placed.virtual.weights.sum(axis=1), 1)
    corners = np.sort(face.triangles, axis=1)
    mine = np.sort(placed.virtual.points, axis=1)
    assert (mine[:, None] == corners[None]).all(axis=2).any(axis=1).all()


def test_no_marker_lands_inside_the_mouth_or_behind(face, placed):
    assert np.isin(placed.virtual.points, face.skin).all()


def test_deltas_explain_the_motion_of_the_performer(actor, face, placed):
    motion = character_motion(placed.virtual, actor.positions, actor.neutral)
    deltas = marker_deltas(placed.virtual, face.flat_offsets)
    predicted = np.einsum("fs,smc->fmc", actor.weights, deltas)
    correlation = (predicted * motion).sum((0, 2)) / np.sqrt(
        (predicted**2).sum((0, 2)) * (motion**2).sum((0, 2)) + 1e-9
    )
    moving = np.sqrt((motion**2).sum(2).mean(0)) > 1
    assert np.median(correlation[moving]) > 0.95


def test_given_places_alone_align_a_cloud_without_motion(face, skin):
    actor = act(face, yaw=180)
    pins = {i: face.points[actor.carriers[i]] for i in range(0, 70, 6)}
    placed = place(skin, actor.neutral, actor.neutral[None][:0], pins=pins)
    assert np.median(errors(face, actor, placed)) < 6
    assert errors(face, actor, placed)[list(pins)].max() < 2.5  # between samples


def test_mirrored_places_are_refused(face, skin, actor):
    pins = {i: face.points[actor.carriers[i]] for i in range(0, 70, 6)}
    with pytest.raises(ValueError, match="left and right are not exchanged"):
        place(skin, actor.neutral * (-1, 1, 1), actor.neutral[None][:0], pins=pins)


@pytest.mark.usefixtures("placed_once", "few_starts")
def test_frames_with_unseen_markers_are_avoided(face, skin, actor):
    spoiled, visible = actor.positions.copy(), np.ones(actor.positions.shape[:2], bool)
    spoiled[::3, ::5] = 0
    visible[::3, ::5] = False
    placed = place(skin, actor.neutral, spoiled, visible=visible)
    assert np.median(errors(face, actor, placed)) < 3.5


def test_a_take_of_one_frame_is_placed_by_its_shape_alone(face, skin, actor):
    placed = place(skin, actor.neutral, actor.neutral[None])
    assert np.median(errors(face, actor, placed)) < 6


def test_a_surface_that_nothing_moves_is_refused(face):
    with pytest.raises(ValueError, match="the shapes move no part of the surface"):
        sample_face_skin(face.points, face.triangles, 0 * face.flat_offsets)


def test_three_markers_are_too_few():
    with pytest.raises(ValueError, match="at least 4 markers, got 3"):
        marker_cloud(tuple("abc"), np.zeros((3, 3)), np.zeros((4, 3, 3)))
