"""What the blendshape equation says of weights: where they put the markers, and how far off."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from benchmarks.real_captures import explained_positions
from tests.usdio.small_rig import small_rig
from usdface.core.deformer import Deformer
from usdface.model.retarget.cyclic import SurfaceMetric
from usdface.model.selection.baseline import BlendshapeEquation
from usdface.numerics.registration.virtual_markers import VirtualMarkers, motion_by_rig
from usdface.numerics.solve.blendshape_equation import MarkerKeys
from usdface.numerics.solve.blendshapes import BlendShapes, ChannelKeys, Key

MARKERS = 12


def bent_equation(
    *, scale: float = 1.0, turn: np.ndarray | None = None
) -> tuple[BlendshapeEquation, BlendShapes]:
    """Three shapes, the first with an in-between that lies off its straight way."""
    rng = np.random.default_rng(0)
    everywhere = np.arange(MARKERS)
    full, aside = 5 * rng.normal(size=(3, MARKERS, 3)), rng.normal(size=(MARKERS, 3))
    tracks = [ChannelKeys(channel, [Key(1.0, everywhere, full[channel])]) for channel in range(3)]
    tracks[0] = ChannelKeys(0, [*tracks[0].keys, Key(0.5, everywhere, 0.7 * full[0] + aside)])
    shapes = BlendShapes(MARKERS, 3, tracks)
    virtual = VirtualMarkers(
        points=np.repeat(everywhere[:, None], 3, axis=1),
        weights=np.repeat([[1.0, 0.0, 0.0]], MARKERS, axis=0),
        motion_scale=scale,
        rotation=np.eye(3) if turn is None else turn,
    )
    equation = BlendshapeEquation(
        virtual=virtual,
        deltas=shapes.target_offsets().toarray().reshape(3, MARKERS, 3),
        keys=MarkerKeys(
            shapes.key_offsets.toarray().reshape(-1, MARKERS, 3),
            shapes.key_channels,
            shapes.key_weights,
        ),
        neutral=rng.normal(size=(MARKERS, 3)) * 50,
        ranges=np.tile([0.0, 1.0], (3, 1)),
        trust=np.ones(MARKERS),
        gain=np.ones(MARKERS),
    )
    return equation, shapes


def test_without_in_betweens_the_first_solve_is_the_solution() -> None:
    equation, bent = bent_equation()
    everywhere = np.arange(MARKERS)
    tracks = [
        ChannelKeys(channel, [Key(1.0, everywhere, offsets)])
        for channel, offsets in enumerate(equation.deltas)
    ]
    straight = BlendShapes(MARKERS, 3, tracks)
    assert straight.is_linear
    assert not bent.is_linear
    keys = MarkerKeys(equation.deltas, straight.key_channels, straight.key_weights)
    seen = equation.neutral + straight.offsets(np.random.default_rng(3).random((20, 3))) + 0.3
    once, again = (
        replace(equation, keys=replace(keys, linear=each)).propose(seen) for each in (True, False)
    )
    np.testing.assert_allclose(once, again, atol=1e-9)


def test_weights_explain_what_the_deformer_shows_in_betweens_included() -> None:
    equation, shapes = bent_equation()
    weights = np.random.default_rng(1).random((20, 3))
    shown = equation.neutral + shapes.offsets(weights)
    np.testing.assert_allclose(explained_positions(equation, weights), shown, atol=1e-9)
    np.testing.assert_allclose(equation.residual_mm(shown, weights), 0.0, atol=1e-9)


@pytest.mark.parametrize("method", ["explained", "residual_mm"])
def test_the_performer_has_another_size_and_looks_elsewhere(method: str) -> None:
    quarter = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    scale = 1.4
    equation, shapes = bent_equation(scale=scale, turn=quarter)
    weights = np.random.default_rng(1).random((20, 3))
    # character = scale * (performer turned): so the performer's is the inverse turn, unscaled
    moved = np.einsum("ij,fmj->fmi", quarter.T, shapes.offsets(weights) / scale)
    if method == "explained":
        found = explained_positions(equation, weights) - equation.neutral
        np.testing.assert_allclose(found, moved, atol=1e-9)
    else:
        away = equation.residual_mm(equation.neutral + moved, weights)
        np.testing.assert_allclose(away, 0.0, atol=1e-9)


def test_what_is_proposed_for_a_pose_is_that_pose() -> None:
    equation, shapes = bent_equation()
    weights = np.random.default_rng(1).random((20, 3))
    proposed = equation.propose(equation.neutral + shapes.offsets(weights))
    assert np.abs(proposed - weights).max() < 0.05


def test_errors_of_poses_are_removed_from_proposals_and_residuals() -> None:
    quarter = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    equation, shapes = bent_equation(scale=1.4, turn=quarter)
    rng = np.random.default_rng(1)
    weights = rng.random((200, 3))
    still = equation.neutral + shapes.offsets(weights) @ quarter / 1.4
    turns, moves = rng.normal(0, 0.03, (200, 1, 3)), rng.normal(0, 2, (200, 1, 3))
    slipped = still + np.cross(turns, equation.neutral - equation.neutral.mean(axis=0)) + moves
    seen = np.ones(slipped.shape[:2], np.bool_)
    motion = motion_by_rig(equation.virtual, equation.deltas, equation.neutral, rigid=())
    corrected = replace(equation, pose_errors=motion.find_errors(slipped, seen))
    wrong, found = (np.abs(e.propose(slipped) - weights).mean() for e in (equation, corrected))
    assert found < 0.5 * wrong
    wrong, found = (e.residual_mm(slipped, weights).mean() for e in (equation, corrected))
    assert found < 0.5 * wrong


def key_weights_of_shares(shapes: BlendShapes, end: float, weights: np.ndarray) -> np.ndarray:
    return shapes.key_weights(weights / end)


@pytest.mark.parametrize("end", [100.0, 0.1, -1.0])
def test_a_proposal_is_the_same_share_of_any_range(end: float) -> None:
    equation, shapes = bent_equation()
    weights = np.random.default_rng(2).random((20, 3))
    seen = equation.neutral + shapes.offsets(weights) + 0.3
    other = replace(
        equation,
        deltas=equation.deltas / end,
        ranges=np.sort(equation.ranges * end, axis=1),
        keys=replace(equation.keys, key_weights=partial(key_weights_of_shares, shapes, end)),
    )
    np.testing.assert_allclose(other.propose(seen) / end, equation.propose(seen), atol=1e-6)


def test_motion_is_enlarged_by_the_gain_before_it_is_explained() -> None:
    equation, shapes = bent_equation()
    weights = np.random.default_rng(1).random((20, 3))
    gained = replace(equation, gain=np.linspace(1.0, 2.5, MARKERS))
    moved = shapes.offsets(weights) / gained.gain[:, None]
    np.testing.assert_allclose(
        gained.propose(equation.neutral + moved),
        equation.propose(equation.neutral + shapes.offsets(weights)),
        atol=1e-9,
    )


def test_errors_there_and_back_are_measured_where_shapes_bend() -> None:
    rig = small_rig()  # eyeBlink has an in-between
    deformer = Deformer(rig)
    first, second = np.random.default_rng(0).random((2, 12, len(rig.shapes)))
    apart = np.linalg.norm(deformer.points(first) - deformer.points(second), axis=2)
    found = SurfaceMetric(rig).mean_vertex_mm(first, second)
    np.testing.assert_allclose(found, apart.mean(axis=1), atol=1e-12)


def test_a_marker_without_a_place_has_no_residual() -> None:
    equation, shapes = bent_equation()
    weights = np.random.default_rng(1).random((20, 3))
    shown = equation.neutral + shapes.offsets(weights)
    shown[:, 4] += 30.0
    assert equation.residual_mm(shown, weights).min() > 5.0
    placed = replace(equation, unplaced=(4,))
    np.testing.assert_allclose(placed.residual_mm(shown, weights), 0.0, atol=1e-9)


def test_a_hidden_marker_has_no_residual() -> None:
    equation, shapes = bent_equation()
    weights = np.random.default_rng(1).random((20, 3))
    shown, visible = equation.neutral + shapes.offsets(weights), np.ones((20, MARKERS), np.bool_)
    shown[:10, 4] += 30.0  # where it was last seen
    visible[:10, 4] = False
    visible[3] = False
    away = equation.residual_mm(shown, weights, visible=visible)
    np.testing.assert_allclose(away, 0.0, atol=1e-9)
