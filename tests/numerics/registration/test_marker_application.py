from itertools import combinations, product

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import multivariate_normal

from usdface.core.arrays import BoolArray, FloatArray
from usdface.numerics.registration.marker_application import (
    _EXPRESSION_SHARES,
    _NOISE_MM,
    _OFFSET_DEVIATIONS_MM,
    NEAR_MM,
    _most_probable_offset,
    compare_neighbours,
    find_offset,
    measure_distances,
    measure_stretch,
)

MARKERS = 40
RNG = np.random.default_rng(3)
NEUTRAL = RNG.uniform([-60, -70, 0], [60, 70, 60], size=(MARKERS, 3))
SHAPES = RNG.normal(size=(3, MARKERS, 3)) * 3.0
SHAPES[:, :8] = 0.0
GLUE = RNG.normal(size=(MARKERS, 3)) * 3.0 / np.sqrt(3)


def performance(seed: int, frames: int = 900) -> FloatArray:
    """Three expressions that come and go, each in its own time."""
    rng = np.random.default_rng(seed)
    waves = np.sin(
        np.arange(frames)[:, None] / 60 * rng.uniform(1.5, 6.0, 3) + rng.uniform(0, 6, 3)
    )
    weights = np.clip(waves, 0.0, 1.0)
    moved = NEUTRAL + np.einsum("fs,smc->fmc", weights, SHAPES)
    return np.asarray(moved + 0.05 * rng.normal(size=moved.shape))


def seen(positions: FloatArray) -> BoolArray:
    return np.ones(positions.shape[:2], bool)


def offset_of(
    others: FloatArray, usable: BoolArray | None = None, neutral: FloatArray | None = None
) -> FloatArray:
    ours = performance(0)
    return find_offset(
        ours,
        seen(ours),
        others,
        seen(others) if usable is None else usable,
        neutral=NEUTRAL,
        others_neutral=np.full_like(NEUTRAL, np.nan) if neutral is None else neutral,
    )[0]


def test_distances_are_those_of_the_markers_seen() -> None:
    frames = performance(1)
    usable = seen(frames)
    usable[:, 3] = False
    frames[:, 3] = 1e4
    away = np.sqrt(((np.delete(frames - NEUTRAL, 3, axis=1)) ** 2).sum(axis=2).mean(axis=1))
    np.testing.assert_allclose(measure_distances(frames, usable, NEUTRAL), away, rtol=1e-6)


def test_a_frame_is_no_nearer_without_the_markers_that_move() -> None:
    """Nor is it taken at its word where those that are left hardly do."""
    frames = performance(1)
    usable = seen(frames)
    usable[::2, 8:20] = False
    away = measure_distances(frames, usable, NEUTRAL)
    whole = measure_distances(frames, seen(frames), NEUTRAL)
    assert 0.8 < np.median(away[::2] / whole[::2]) < 1.25
    usable[::2, 8:30] = False
    assert np.isinf(measure_distances(frames, usable, NEUTRAL)[::2]).all()


def rms(offset: FloatArray) -> float:
    return float(np.sqrt((offset**2).sum(axis=1).mean()))


def test_a_recording_has_no_offset_from_itself() -> None:
    assert rms(offset_of(performance(0))) < 1e-5


def test_another_performance_of_the_same_markers_has_next_to_none() -> None:
    assert rms(offset_of(performance(1))) < 0.1


def test_markers_that_sit_elsewhere_are_found_whatever_the_face_does() -> None:
    found = offset_of(performance(1) + GLUE)
    assert rms(GLUE) > 2.5
    assert rms(found - GLUE) < rms(GLUE) / 5


def test_a_neutral_face_tells_the_offset_of_a_take_that_acts_otherwise() -> None:
    """All its frames have expressions that the performer's do not show."""
    rng = np.random.default_rng(9)
    strange = rng.uniform(0.5, 1.5, (900, 3)) @ rng.normal(size=(3, MARKERS * 3))
    acted = performance(1) + 2.0 * strange.reshape(-1, MARKERS, 3) + GLUE
    error = rms(offset_of(acted) - GLUE)
    assert error > 2.0
    assert rms(offset_of(acted, neutral=NEUTRAL + GLUE) - GLUE) < 0.6 * error


def test_a_neutral_face_that_smiles_is_not_an_offset() -> None:
    smile = NEUTRAL + 0.8 * SHAPES[2]
    assert rms(offset_of(performance(1), neutral=smile)) < 0.2
    assert rms(offset_of(performance(1) + GLUE, neutral=smile + GLUE) - GLUE) < rms(GLUE) / 4


def test_the_offset_is_the_conditional_mean_of_the_most_likely_variances() -> None:
    rng = np.random.default_rng(6)
    variance, rigid = np.array([9.0, 4.0, 1.0, 0.0, 0.0]), rng.normal(size=(2, 5))
    alike = np.ones((2, 2))
    for smile in (0.0, 3.0):
        shown = rng.normal(size=5) + np.array([[0.1], [smile]]) * np.sqrt(variance)
        best = (-np.inf, shown[0])
        for prior, *shares in product(
            _OFFSET_DEVIATIONS_MM, _EXPRESSION_SHARES, _EXPRESSION_SHARES
        ):
            error = np.diag(np.kron(np.square(shares), variance) + _NOISE_MM**2)
            offset = prior**2 * np.eye(5) + rigid.T @ rigid
            whole = np.kron(alike, offset) + error
            density = multivariate_normal.logpdf(shown.ravel(), cov=whole)
            both = np.kron(np.ones((1, 2)), offset)
            best = max(
                best, (density, both @ np.linalg.solve(whole, shown.ravel())), key=lambda x: x[0]
            )
        found = _most_probable_offset(shown, variance, rigid)[0]
        np.testing.assert_allclose(found, best[1], rtol=1e-6)


def test_unseen_markers_say_nothing() -> None:
    others = performance(1) + GLUE
    usable = np.random.default_rng(5).random(others.shape[:2]) < 0.98
    usable[:, 11] = False
    others[~usable] = 1e4
    found = offset_of(others, usable)
    assert not found[11].any()
    assert rms(np.delete(found - GLUE, 11, axis=0)) < rms(GLUE) / 2


def test_a_second_of_a_take_is_left_as_it_is() -> None:
    found = offset_of(performance(1, frames=30) + GLUE)
    assert not found.any()


def test_only_markers_put_on_again_part_the_ranges_of_distances() -> None:
    ours, others = performance(0), performance(1)
    assert compare_neighbours(ours, seen(ours), others, seen(others)) == 0
    turned = (others + GLUE) @ Rotation.from_rotvec([0.2, 0.1, 0]).as_matrix().T
    found = compare_neighbours(ours, seen(ours), turned, seen(turned))
    middle, gaps = np.median(ours, axis=0), []
    for first, second in combinations(range(MARKERS), 2):  # brute force
        if np.linalg.norm(middle[first] - middle[second]) < NEAR_MM:
            here, there = (
                np.quantile(np.linalg.norm(at[:, first] - at[:, second], axis=1), [0.002, 0.998])
                for at in (ours, others + GLUE)
            )
            gaps.append(max(there[0] - here[1], here[0] - there[1]))
    assert found == pytest.approx(np.mean(np.array(gaps) > 0.5))
    assert found > 0.02


def test_stretch_is_that_of_the_affine_map_without_its_rotation() -> None:
    turn = Rotation.from_euler("xyz", [10, 20, -5], degrees=True).as_matrix()
    stretched = NEUTRAL @ np.diag([1.1, 1.0, 0.95]) @ turn.T + [3.0, 4.0, 5.0]
    found = measure_stretch(NEUTRAL, stretched, np.eye(3 * MARKERS))
    np.testing.assert_allclose(found.stretch, [1.1, 1.0, 0.95], atol=1e-6)
    assert found.chi2 < 1e-6


def test_random_shifts_stretch_within_the_error() -> None:
    rng = np.random.default_rng(8)
    errors = []
    for _ in range(200):
        shift = rng.normal(size=NEUTRAL.shape) * 2.0
        found = measure_stretch(NEUTRAL, NEUTRAL + shift, 4.0 * np.eye(3 * MARKERS))
        errors.append(np.log(found.stretch) / found.error)
    # The principal axes are those of the largest stretch: a little more than one error.
    assert 0.8 < np.sqrt(np.mean(np.square(errors))) < 1.6


def test_an_expression_that_stretches_the_face_is_within_the_error() -> None:
    """An open jaw makes a face longer; without it the stretch is as certain as that of a skull."""
    jaw = np.where(NEUTRAL[:, 1:2] < -20, [0.0, -12.0, 0.0], 0.0)
    alone = np.eye(3 * MARKERS)
    long = measure_stretch(NEUTRAL, NEUTRAL + jaw, alone)
    assert (np.abs(np.log(long.stretch)) > 4 * long.error).any()
    known = alone + np.outer(jaw, jaw)
    found = measure_stretch(NEUTRAL, NEUTRAL + jaw, known)
    assert (np.abs(np.log(found.stretch)) < found.error).all()
    other = measure_stretch(NEUTRAL, NEUTRAL * [1.08, 1.0, 1.0] + jaw, known)
    assert np.log(other.stretch[0]) > 4 * other.error[0]
