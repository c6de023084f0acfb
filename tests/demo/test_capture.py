"""The simulated capture: markers on skin, a head that moves, and faults to find."""

import numpy as np
import pytest

from tests.demo.posed_head import posed
from usdface.core.arrays import columns_by_name
from usdface.demo.acting import ActedPerformance
from usdface.demo.capture import (
    MARKER_RADIUS,
    NOISE_MM,
    SWAPPED_LABELS,
    ActorFace,
    MarkerSet,
    demo_markers,
    head_poses,
    simulate_capture,
)
from usdface.demo.head import DemoHead, HeadPart

SimulatedCapture = tuple[np.ndarray, np.ndarray]
"""Positions, and whether each is visible."""


@pytest.fixture(scope="module")
def markers(actor: DemoHead) -> MarkerSet:
    return demo_markers(actor)


@pytest.fixture(scope="module")
def captured(actor: DemoHead, acted: ActedPerformance, markers: MarkerSet) -> SimulatedCapture:
    return simulate_capture(actor, acted, markers)


def stabilised(captured: SimulatedCapture, acted: ActedPerformance) -> np.ndarray:
    poses = head_poses(acted)
    turn, shift = poses[:, :3, :3], poses[:, :3, 3]
    return np.einsum("fji,fmj->fmi", turn, captured[0] - shift[:, None])


def test_there_are_102_markers_with_their_own_names_and_places(markers: MarkerSet) -> None:
    assert len(markers.names) == len(set(markers.names)) == 102
    assert len(set(markers.points)) == 102
    assert len(markers.rigid) >= 8
    assert set(markers.rigid) <= set(markers.names)


def test_left_and_right_markers_mirror_each_other(actor: DemoHead, markers: MarkerSet) -> None:
    at = dict(zip(markers.names, markers.points, strict=True))
    left = [name for name in markers.names if "_L" in name]
    assert left
    for name in left:
        assert actor.mirror[at[name]] == at[name.replace("_L", "_R")]


def test_markers_sit_on_the_skin(
    actor: DemoHead, acted: ActedPerformance, markers: MarkerSet, captured: SimulatedCapture
) -> None:
    assert set(actor.parts[markers.points]) <= {HeadPart.SKIN, HeadPart.EARS}
    local = stabilised(captured, acted)[0]
    distance = np.linalg.norm(local - actor.points[markers.points], axis=1)
    assert np.all(np.abs(distance - MARKER_RADIUS) < 6.0 * NOISE_MM)


def test_markers_keep_apart(actor: DemoHead, markers: MarkerSet) -> None:
    points = actor.points[markers.points]
    apart = np.linalg.norm(points[:, None] - points[None], axis=-1)
    np.fill_diagonal(apart, np.inf)
    assert apart.min() > 2.5


def test_rigid_markers_move_with_the_skull_alone(
    acted: ActedPerformance, markers: MarkerSet, captured: SimulatedCapture
) -> None:
    rigid = [markers.names.index(name) for name in markers.rigid]
    local = stabilised(captured, acted)[:, rigid]
    spread = np.abs(local - np.median(local, axis=0)).max()
    assert spread < 0.8 + 6.0 * NOISE_MM  # skin slides a little over the brow and the nose


def test_the_head_moves_as_heads_do(captured: SimulatedCapture, acted: ActedPerformance) -> None:
    assert 10.0 < np.abs(acted.rotation).max() < 25.0
    middle = captured[0].mean(axis=1)
    assert 1300.0 < middle[:, 1].mean() < 1700.0
    assert 15.0 < np.ptp(middle, axis=0).max() < 150.0
    step = np.linalg.norm(np.diff(head_poses(acted)[:, :3, 3], axis=0), axis=1)
    assert step.max() * 120.0 < 800.0


def test_gaps_range_from_single_frames_to_half_a_second(captured: SimulatedCapture) -> None:
    lengths = []
    for column in captured[1].T:
        edges = np.flatnonzero(np.diff(np.concatenate([[1], column.astype(int), [1]])))
        lengths += list(edges[1::2] - edges[::2])
    assert min(lengths) == 1
    assert 30 <= max(lengths) <= 75
    assert 0.002 < 1.0 - captured[1].mean() < 0.03


def test_the_neutral_frame_is_seen_whole(
    captured: SimulatedCapture, acted: ActedPerformance
) -> None:
    assert np.all(captured[1][acted.neutral_frame - acted.weights.first_frame])


def test_swapped_labels_are_where_the_capture_says(
    markers: MarkerSet, captured: SimulatedCapture, acted: ActedPerformance
) -> None:
    local = stabilised(captured, acted)
    for first, last, one, other in SWAPPED_LABELS:
        a, b = markers.names.index(one), markers.names.index(other)
        rest = local[first - 1, a] - local[first - 1, b]
        swapped = local[first, a] - local[first, b]
        assert rest @ swapped < 0.0
        assert last > first


def test_the_actor_is_not_the_character(
    actor: DemoHead, acted: ActedPerformance, markers: MarkerSet
) -> None:
    """The same weights move the actor's own face another way than its shapes say."""
    face = ActorFace(actor, markers.points)
    clip = acted.weights
    weights = columns_by_name(clip.values[600:601], clip.names, tuple(actor.shapes))[0]
    named = dict(zip(actor.shapes, weights, strict=True))
    plain = posed(actor, named)[markers.points]
    difference = np.linalg.norm(face.pose(weights) - plain, axis=1)
    assert 0.5 < difference.max() < 8.0


def test_skin_moves_without_jumps_as_a_shape_comes_on(actor: DemoHead, markers: MarkerSet) -> None:
    face = ActorFace(actor, markers.points)
    rows = np.zeros((101, len(actor.shapes)))
    for name in ("jawOpen", "eyeBlinkLeft", "mouthSmileLeft", "browInnerUp"):
        rows[:] = 0.0
        rows[:, list(actor.shapes).index(name)] = np.linspace(0.0, 1.0, len(rows))
        path = np.stack([face.pose(row) for row in rows])
        reach = np.linalg.norm(path[-1] - path[0], axis=-1).max()
        assert np.linalg.norm(np.diff(path, axis=0), axis=-1).max() < 0.025 * reach, name


def test_the_actor_at_rest_is_the_head_at_rest(actor: DemoHead) -> None:
    face = ActorFace(actor, np.arange(len(actor.points)))
    np.testing.assert_allclose(face.pose(np.zeros(len(actor.shapes))), actor.points, atol=1e-9)


def test_capturing_twice_gives_the_same_take(
    actor: DemoHead, acted: ActedPerformance, markers: MarkerSet, captured: SimulatedCapture
) -> None:
    again = simulate_capture(actor, acted, markers)
    np.testing.assert_array_equal(again[0], captured[0])
    np.testing.assert_array_equal(again[1], captured[1])
