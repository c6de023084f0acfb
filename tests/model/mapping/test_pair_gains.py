"""Gains of pairs: found where keys are scaled, not where single keys are wrong."""

from dataclasses import replace

import numpy as np

from usdface.core.assets import MotionSpace
from usdface.model.mapping.corrected_pairs import correct_pairs, fit_pairs_forward
from usdface.model.mapping.pair_gains import gain_groups
from usdface.model.regressions.base import Face, Pairs
from usdface.model.regressions.shape_sides import ShapeSides

UPPER = ("browInnerUp", "browDown_L", "browDown_R", "eyeBlink_L", "eyeBlink_R")
LOWER = ("jawOpen", "jawLeft", "mouthFunnel", "mouthPucker", "mouthSmile_L", "mouthSmile_R")
SHAPES = UPPER + LOWER
PAIRS, MARKERS = 40, 24


def simulated(seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return true weights, markers' displacements and neutral of a face in two halves."""
    rng = np.random.default_rng(seed)
    basis = np.zeros((len(SHAPES), MARKERS, 3))
    half = MARKERS // 2
    basis[: len(UPPER), :half] = 6 * rng.normal(size=(len(UPPER), half, 3))
    basis[len(UPPER) :, half:] = 6 * rng.normal(size=(len(LOWER), half, 3))
    weights = 0.7 * rng.random((PAIRS, len(SHAPES)))
    noise = 0.05 * rng.normal(size=(PAIRS, MARKERS, 3))
    moved = np.einsum("ns,skc->nkc", weights, basis) + noise
    return weights, moved, rng.uniform(-50, 50, (MARKERS, 3))


def pairs_of(keys: np.ndarray, moved: np.ndarray, neutral: np.ndarray) -> Pairs:
    """Return pairs of a face whose rig is not known: the forward model is learnt from them."""
    flat = moved.reshape(len(moved), -1)
    motion = MotionSpace(neutral.ravel(), np.eye(flat.shape[1]), np.ones(flat.shape[1]), 1.0, flat)
    ranges = np.tile([0.0, 1.0], (len(SHAPES), 1))
    face = Face(ShapeSides.divided(ranges), np.eye(len(SHAPES)), motion, neutral=neutral)
    return Pairs(flat, keys, face, moved + neutral)


def variance_of(pairs: Pairs, authors: tuple[str, ...] = ()) -> float:
    return gain_groups(fit_pairs_forward(pairs), SHAPES, 3.0, authors)[1]


def test_pairs_of_two_animators_get_one_gain() -> None:
    weights, moved, neutral = simulated()
    gains = np.resize((1.15, 0.85), PAIRS)
    pairs = pairs_of(weights * gains[:, None], moved, neutral)
    assert 0.1 < np.sqrt(variance_of(pairs)) < 0.2
    corrected = correct_pairs(pairs, SHAPES)
    assert np.std(corrected.log_factor + np.log(gains)) < 0.35 * np.std(np.log(gains))
    np.testing.assert_allclose(corrected.log_factor.mean(), 0, atol=1e-9)
    np.testing.assert_array_equal(corrected.original_keys, pairs.outputs)
    before, after = (
        np.sqrt(((each / each.mean() - weights / weights.mean()) ** 2).mean())
        for each in (pairs.outputs, corrected.pairs.outputs)
    )
    assert after < 0.5 * before


def test_exact_keys_and_keys_that_err_one_by_one_have_no_gains() -> None:
    weights, moved, neutral = simulated()
    assert variance_of(pairs_of(weights, moved, neutral)) == 0
    for seed in range(3):
        error = 1 + 0.15 * np.random.default_rng(seed).normal(size=weights.shape)
        assert variance_of(pairs_of(weights * error, moved, neutral)) == 0


def test_a_gain_of_one_half_of_the_face_is_none() -> None:
    weights, moved, neutral = simulated()
    keys = weights.copy()
    keys[::2, : len(UPPER)] *= 1.2
    assert variance_of(pairs_of(keys, moved, neutral)) == 0


def test_few_pairs_and_faces_of_one_part_have_no_gains() -> None:
    weights, moved, neutral = simulated()
    keys = weights * np.resize((1.2, 0.8), PAIRS)[:, None]
    assert variance_of(pairs_of(keys[:10], moved[:10], neutral)) == 0
    forward = fit_pairs_forward(pairs_of(keys, moved, neutral))
    assert gain_groups(forward, ("browInnerUp",) * len(SHAPES), 3.0, ())[1] == 0


def test_authors_share_a_gain_more_exact_than_those_of_pairs() -> None:
    weights, moved, neutral = simulated()
    authors = tuple(np.resize(("anna", "bob"), 16))
    gains = np.resize((1.12, 0.9), 16)
    rng = np.random.default_rng(1)
    keys = weights[:16] * gains[:, None] * (1 + 0.1 * rng.normal(size=(16, len(SHAPES))))
    pairs = pairs_of(keys, moved[:16], neutral)
    factors, alone = (
        correct_pairs(replace(pairs, authors=known), SHAPES).log_factor for known in (authors, ())
    )
    assert len(set(factors.round(9))) == 2
    error, error_alone = (np.std(each + np.log(gains)) for each in (factors, alone))
    assert error < 0.5 * error_alone
    assert error < 0.4 * np.std(np.log(gains))
    chosen = np.array([0, 2, 3])
    assert replace(pairs, authors=authors).rows(chosen).authors == ("anna", "anna", "bob")


def test_authors_of_equal_gain_and_of_one_half_of_the_face_have_none() -> None:
    weights, moved, neutral = simulated()
    authors = tuple(np.resize(("anna", "bob", ""), PAIRS))
    for seed in range(3):
        error = 1 + 0.1 * np.random.default_rng(seed).normal(size=weights.shape)
        assert variance_of(pairs_of(weights * error, moved, neutral), authors) == 0
    keys = weights.copy()
    keys[::3, : len(UPPER)] *= 1.2
    assert variance_of(pairs_of(keys, moved, neutral), authors) == 0
