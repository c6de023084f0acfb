from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.model.synthetic import (
    RIGID,
    SyntheticFace,
    align_markers,
    markers_of,
    references_of,
    synthetic_face,
)
from usdface.core.assets import MotionSpace, TrainedMapping
from usdface.model.mapping.head_space import find_head_space
from usdface.model.mapping.motion_space import fit_motion_space, motion_without_errors
from usdface.model.mapping.performer_face import face_of_mapping
from usdface.model.mapping.predict import WeightPredictor
from usdface.model.mapping.train import train_mapping
from usdface.numerics.rigid import pose_error
from usdface.numerics.rigid.pose_error import ExpressionMotion, expression_motion

pytestmark = pytest.mark.usefixtures("without_comparison")

SHAPES, MARKERS, FRAMES = 8, 30, 400
BAND = np.arange(26, MARKERS)
"""Markers that no shape moves."""


def face() -> tuple[np.ndarray, np.ndarray]:
    """Return a neutral, and the displacements of its markers by each shape [mm]."""
    rng = np.random.default_rng(3)
    neutral = rng.uniform(-60, 60, (MARKERS, 3))
    middles = neutral[rng.permutation(26)[:SHAPES]]
    near = np.exp(-0.5 * ((neutral - middles[:, None]) ** 2).sum(axis=2) / 25.0**2)
    near[:, BAND] = 0
    return neutral, near[:, :, None] * rng.normal(0, 6, (SHAPES, 1, 3))


def acted(turn_deviation: float, move_mm: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return weights, markers without and with errors of the pose, which the band does not show."""
    rng = np.random.default_rng(4)
    neutral, shapes = face()
    weights = np.clip(rng.normal(0.2, 0.3, (FRAMES, SHAPES)), 0, 1)
    still = neutral + np.tensordot(weights, shapes, 1) + rng.normal(0, 0.05, (FRAMES, MARKERS, 3))
    turns, moves = rng.normal(0, turn_deviation, (FRAMES, 3)), rng.normal(0, move_mm, (FRAMES, 3))
    moved = still + np.cross(turns[:, None], neutral - neutral.mean(axis=0)) + moves[:, None]
    moved[:, BAND] = still[:, BAND]
    return weights, still, moved


def model(weights: np.ndarray) -> ExpressionMotion:
    neutral, shapes = face()
    return expression_motion(shapes, weights[:20], neutral, rigid=BAND)


SEEN = np.ones((FRAMES, MARKERS), bool)


def test_errors_of_a_band_that_slips_are_found_and_removed() -> None:
    weights, still, moved = acted(0.02, 1.5)
    errors = model(weights).find_errors(moved, SEEN)
    found = np.sqrt(np.diag(errors.covariance))
    np.testing.assert_allclose(found, [0.02] * 3 + [1.5] * 3, rtol=0.15)
    on_skin = np.arange(26)
    away = (errors.remove(moved, SEEN) - still)[:, on_skin]
    before = (moved - still)[:, on_skin]
    assert np.sqrt((away**2).mean()) < 0.1 * np.sqrt((before**2).mean())
    assert errors.remove(moved[:0], SEEN[:0]).shape == (0, MARKERS, 3)


def test_a_good_stabilisation_is_left_as_it_is() -> None:
    weights, still, _ = acted(0, 0)
    errors = model(weights).find_errors(still, SEEN)
    assert errors.size_mm == 0
    np.testing.assert_array_equal(errors.remove(still, SEEN), still)


@pytest.mark.parametrize("count", range(5))
def test_few_markers_on_skin_tell_no_error(count: int) -> None:
    """Such as those of a take whose other markers are hidden."""
    weights, still, moved = acted(0.02, 1.5)
    seen = SEEN.copy()
    seen[:, count:26] = False
    for positions in (still, moved):
        errors = model(weights).find_errors(positions, seen)
        assert errors.size_mm == errors.mean_mm == 0


@pytest.mark.parametrize("off_mm", [0, 0.3])
def test_markers_on_a_line_tell_no_error(off_mm: float) -> None:
    """A rotation about it moves none of them."""
    rng = np.random.default_rng(0)
    neutral = np.linspace(-40, 40, 12)[:, None] * np.eye(3)[0]
    neutral += rng.normal(0, off_mm / np.sqrt(2), neutral.shape)
    shapes = rng.normal(0, 4, (2, 12, 3))
    expected = expression_motion(shapes, rng.random((5, 2)), neutral, rigid=np.array([], int))
    moved = neutral + np.tensordot(rng.random((60, 2)), shapes, 1)
    errors = expected.find_errors(moved, np.ones((60, 12), bool))
    assert errors.size_mm == errors.mean_mm == 0


def test_likelihood_is_that_of_the_dense_covariance(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pose_error, "_NOISE_ROUNDS", 1)  # with the departure of the mean motion
    weights, _, moved = acted(0.02, 1.5)
    expressions = model(weights)
    seen = SEEN.copy()
    seen[:, [2, 5]] = False
    found = expressions.likelihood(moved, seen)
    used = np.repeat(~expressions.rigid_markers & seen[0], 3)
    rigid = expressions.rigid.reshape(6, -1)[:, used]
    basis = expressions.components.reshape(-1, 3 * MARKERS)[:, used]
    departure = pose_error._DEPARTURE_SHARE**2 * expressions.motion2
    noise = np.repeat(pose_error._NOISE_MM**2 + departure, 3)[used]
    inverse = np.linalg.inv(basis.T @ basis + np.diag(noise))
    displaced = (moved - expressions.neutral).reshape(FRAMES, -1)[:, used]
    np.testing.assert_allclose(found.information[7], rigid @ inverse @ rigid.T, rtol=1e-6)
    np.testing.assert_allclose(found.score, displaced @ inverse @ rigid.T, rtol=1e-6, atol=1e-6)
    covariance = rigid.T @ np.diag(pose_error._START) @ rigid + np.linalg.inv(inverse)
    chi2 = np.einsum("fi,ij,fj->f", displaced, np.linalg.inv(covariance), displaced)
    density = -0.5 * (chi2 + np.linalg.slogdet(covariance)[1] - np.log(pose_error._START).sum())
    np.testing.assert_allclose(found.evidence * (used.sum() - 6), density, rtol=1e-6)


def test_distribution_is_the_most_probable() -> None:
    """Of the estimates x ~ N(m, S + I^-1), for information I that is equal in all frames."""
    weights, _, moved = acted(0.02, 1.5)
    found = model(weights).likelihood(moved, SEEN)
    information = np.broadcast_to(found.information.mean(axis=0), found.information.shape)
    mean, covariance, _ = pose_error._maximise(information, found.score)
    estimates = found.score @ np.linalg.inv(information[0])
    np.testing.assert_allclose(mean, estimates.mean(axis=0), atol=1e-6)
    expected = np.cov(estimates.T, bias=True) - np.linalg.inv(information[0])
    scale = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(
        covariance / scale / scale[:, None], expected / scale / scale[:, None], atol=0.02
    )


def test_reapplied_markers_are_no_errors_of_the_pose() -> None:
    weights, still, moved = acted(0.02, 1.5)
    shift = np.random.default_rng(5).normal(0, 1, (MARKERS, 3))
    errors = model(weights).find_errors(moved + shift, SEEN)
    away = (errors.remove(moved + shift, SEEN) - still)[:, :26]
    assert (away - away.mean(axis=0)).std() < 0.2


def test_markers_that_the_rig_does_not_move_so_hardly_count() -> None:
    """Such as a marker on a lid, placed beside it: in a fifth of the frames it moves by 15 mm."""
    weights, still, moved = acted(0.02, 1.5)
    blinks = np.where(np.arange(FRAMES) % 5 == 0, 15.0, 0.0)
    moved[:, :2] += blinks[:, None, None] * [0.0, -1.0, 0.0]
    away = (model(weights).find_errors(moved, SEEN).remove(moved, SEEN) - still)[:, 2:26]
    assert np.sqrt((away**2).mean()) < 0.3


def test_expressions_held_for_most_of_a_take_are_no_offset_of_the_markers() -> None:
    """A performer's motion departs from the rig's: at rest, the markers are where they were."""
    weights, _, _ = acted(0, 0)
    neutral, shapes = face()
    rng = np.random.default_rng(8)
    held = np.where(np.arange(FRAMES)[:, None] < 100, 0.0, rng.uniform(0.6, 1, SHAPES))
    other = shapes * np.exp(0.3 * rng.normal(size=(SHAPES, 1, 1)))
    moves = np.cumsum(rng.normal(0, 0.2, (FRAMES, 3)), axis=0)
    positions = neutral + np.tensordot(held, other, 1) + moves[:, None]
    positions[:, BAND] = neutral[BAND]
    found = model(weights).find_errors(positions, SEEN)
    assert np.sqrt((found.offset[:26] ** 2).sum(axis=1).mean()) < 0.1


def test_unknown_expressions_are_no_errors_of_the_pose() -> None:
    """A part that no shape moves so."""
    weights, still, _ = acted(0, 0)
    swelling = np.random.default_rng(6).uniform(0, 4, FRAMES)
    cheek = np.argsort(np.linalg.norm(face()[0] - face()[0][0], axis=1))[:5]
    still[:, cheek] += swelling[:, None, None] * [0.0, 0.6, 0.8]
    assert model(weights).find_errors(still, SEEN).size_mm == 0


def test_expected_motion_is_that_of_random_weights() -> None:
    neutral, shapes = face()
    expressions = expression_motion(shapes, np.zeros((0, SHAPES)), neutral, rigid=BAND)
    uniform = np.random.default_rng(0).uniform(-0.5, 0.5, (200_000, SHAPES))
    flat = shapes.reshape(SHAPES, -1)
    expected = flat.T @ (uniform.T @ uniform / len(uniform)) @ flat
    mean = np.diag(expected).reshape(MARKERS, 3).mean(axis=1)
    np.testing.assert_allclose(expressions.motion2, mean, atol=0.02 * mean.max())
    other = pose_error._SHAPE_DEPARTURE * np.random.default_rng(1).normal(
        0, 1, (20_000, SHAPES, 3, 3)
    )
    scaled = np.sqrt(1 / 12) * np.einsum("fsab,smb->fma", other, shapes).reshape(20_000, -1)
    expected += scaled.T @ scaled / len(scaled)
    components = expressions.components.reshape(len(expressions.components), -1)
    np.testing.assert_allclose(components.T @ components, expected, atol=0.05 * expected.max())


def test_motion_space_is_that_of_the_frames_without_errors() -> None:
    weights, _, moved = acted(0.02, 1.5)
    errors = model(weights).find_errors(moved, SEEN)
    changed = motion_without_errors(space_of(moved), errors)
    expected = space_of(errors.remove(moved, SEEN))
    np.testing.assert_allclose(changed.mean, expected.mean, atol=1e-6)
    assert changed.total_variance == pytest.approx(expected.total_variance)
    frames = changed.mean + changed.sample @ changed.components
    np.testing.assert_allclose(frames, expected.mean + expected.sample @ expected.components)


def space_of(frames: np.ndarray) -> MotionSpace:
    """Return all components: errors that are left out have no part in the sample."""
    return fit_motion_space([frames], dimensions=3 * MARKERS)


def slipped(made: SyntheticFace, seed: int) -> SyntheticFace:
    """Return the face as stabilised by a band that slips: the markers move, the band does not."""
    rng = np.random.default_rng(seed)
    slow = np.cumsum(rng.normal(0, 0.15, (len(made.positions), 6)), axis=0)
    slow *= np.array([0.02] * 3 + [1.5] * 3) / slow.std(axis=0)
    away = np.cross(slow[:, None, :3], made.neutral - made.neutral.mean(axis=0))
    moved = made.positions + away + slow[:, None, 3:]
    moved[:, :RIGID] = made.positions[:, :RIGID]
    return replace(made, positions=moved)


def trained(made: SyntheticFace) -> TrainedMapping:
    return train_mapping(
        references_of(made, np.arange(0, 1200, 30)),
        ranges=made.ranges,
        gram=made.gram,
        skin=made.shapes,
        method="face_map",
    )


def without_expressions(mapping: TrainedMapping) -> TrainedMapping:
    kept = {k: v for k, v in mapping.arrays.items() if not k.startswith("expression_")}
    return replace(mapping, arrays=kept)


def test_a_slip_is_removed_from_references_and_takes() -> None:
    good, other = synthetic_face(noise=0.1), synthetic_face(noise=0.1, seed=1)
    mapping, expected = trained(slipped(good, 2)), trained(good)
    assert mapping.settings["pose_error_mm"] > 1
    assert expected.settings["pose_error_mm"] == 0
    errors = []
    for each, take in ((expected, other), (mapping, slipped(other, 3)), (mapping, other)):
        placed = align_markers(each, markers_of(take), rate=60.0)
        found = WeightPredictor(each).predict(placed.positions, visible=placed.visible).weights
        errors.append(np.sqrt(((found - other.weights) ** 2).mean()))
    assert max(errors) < 0.03
    uncorrected = without_expressions(expected)
    placed = align_markers(uncorrected, markers_of(slipped(other, 3)), rate=60)
    found = WeightPredictor(uncorrected).predict(placed.positions, visible=placed.visible).weights
    assert np.sqrt(((found - other.weights) ** 2).mean()) > 1.5 * max(errors)


@pytest.mark.parametrize("with_rig", [True, False])
def test_the_face_tells_that_the_head_band_was_put_on_again(with_rig: bool) -> None:
    mapping, other = trained(synthetic_face(noise=0.1)), synthetic_face(noise=0.1, seed=1)
    if not with_rig:
        mapping = without_expressions(mapping)
    turn = Rotation.from_euler("xyz", [4, -3, 2], degrees=True).as_matrix()
    moved = other.positions @ turn.T + [3.0, -5.0, 2.0]
    moved[:, : len(other.rigid)] = other.positions[:, : len(other.rigid)]
    positions = moved.astype(np.float32)
    space = find_head_space(
        face_of_mapping(mapping), markers_of(other, positions=positions), rate=60.0
    )
    assert space.moved_mm > 3
    away = space.move(positions, np.ones(positions.shape[:2], bool)) - other.positions
    assert np.sqrt((away[:, len(other.rigid) :] ** 2).sum(axis=2).mean()) < 0.3


def test_a_mapping_without_a_rig_removes_nothing() -> None:
    made = synthetic_face()
    mapping = train_mapping(
        references_of(made, np.arange(0, 1200, 30)), ranges=made.ranges, gram=None, method="ridge"
    )
    assert face_of_mapping(mapping).expressions is None
    assert find_head_space(face_of_mapping(mapping), markers_of(made), rate=60).pose_errors is None


def _faces_moved(expressions: ExpressionMotion, count: int) -> np.ndarray:
    """Return displacements drawn from the distribution, (count, markers, 3) [mm]."""
    rng = np.random.default_rng(5)
    scores = rng.standard_normal((count, len(expressions.components)))
    variance = pose_error._NOISE_MM**2 + pose_error._DEPARTURE_SHARE**2 * expressions.motion2
    own = rng.standard_normal((count, MARKERS, 3)) * np.sqrt(variance)[:, None]
    return np.tensordot(scores, expressions.components, 1) + own


def _aligned_size_mm(
    expressions: ExpressionMotion, moved: np.ndarray, markers: np.ndarray
) -> float:
    """Return the displacement of all markers by NumPy's least squares over some of them [mm]."""
    rigid = expressions.rigid
    system = rigid[:, markers].reshape(6, -1).T
    pose = np.linalg.lstsq(system, moved[:, markers].reshape(len(moved), -1).T)[0]
    displaced = np.tensordot(pose.T, rigid, 1)
    return float(np.sqrt((displaced**2).sum(axis=2).mean()))


def test_error_of_an_alignment_is_that_of_drawn_expressions() -> None:
    expressions = model(acted(0, 0)[0])
    moved = _faces_moved(expressions, 20_000)
    for markers in (np.arange(6), np.arange(3, 20), BAND):
        expected = _aligned_size_mm(expressions, moved, markers)
        assert expressions.alignment_error_mm(markers) == pytest.approx(expected, rel=0.03)


def test_steadiest_markers_are_nearly_the_best_of_all_sets() -> None:
    expressions = model(acted(0, 0)[0])
    some = np.arange(0, 26, 3)  # of nine markers, all sets of five or more are tried
    every = [
        np.array(chosen)
        for count in range(5, len(some) + 1)
        for chosen in combinations(some.tolist(), count)
    ]
    best = min(map(expressions.alignment_error_mm, every))
    found = expressions.steadiest_markers(np.isin(np.arange(MARKERS), some))
    assert set(found) <= set(some.tolist())
    assert expressions.alignment_error_mm(found) < 1.1 * best
    assert best < 0.8 * expressions.alignment_error_mm(some)


def test_markers_that_no_expression_moves_are_the_steadiest() -> None:
    expressions = model(acted(0, 0)[0])
    found = expressions.steadiest_markers(np.ones(MARKERS, bool))
    assert np.isin(BAND, found).sum() >= 3


def test_collinear_and_missing_markers_do_not_tell_the_pose() -> None:
    expressions = model(acted(0, 0)[0])
    line = replace(expressions, neutral=expressions.neutral * [1.0, 0.0, 0.0])
    assert line.alignment_error_mm(np.arange(MARKERS)) == np.inf
    for few in (0, 2):
        assert expressions.alignment_error_mm(np.arange(few)) == np.inf
    assert not len(expressions.steadiest_markers(np.zeros(MARKERS, bool)))
