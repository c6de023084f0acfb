"""Keys of which only the largest were set."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from usdface.core.assets import References, TrainedMapping
from usdface.model.mapping import uncertainty, unset_keys
from usdface.model.mapping.motion_space import fit_motion_space
from usdface.model.mapping.predict import WeightPredictor
from usdface.model.mapping.train import train_mapping
from usdface.model.regressions.bent_weights import unbend
from usdface.model.regressions.forward_model import ForwardScales, fit_forward_model

pytestmark = pytest.mark.usefixtures("without_comparison")

PAIRS, SHAPES, MARKERS, SET = 20, 24, 40, 5
RNG = np.random.default_rng(5)
NEUTRAL = RNG.uniform(-60, 60, size=(MARKERS, 3))
CENTRES = NEUTRAL[RNG.integers(0, MARKERS, SHAPES)]
REACH = np.exp(-0.5 * ((CENTRES[:, None] - NEUTRAL) ** 2).sum(axis=2) / 25**2)
RIG = 6 * REACH[:, :, None] * RNG.normal(size=(SHAPES, 1, 3))
PERFORMER = RIG * (1 + 0.2 * RNG.normal(size=(SHAPES, 1, 1)))
"""Shapes of the rig, and of the performer, whose motion is larger or smaller."""


def drawn(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return weights, of which a third is 0, and displacements."""
    rng = np.random.default_rng(seed)
    weights = np.clip(0.25 * rng.normal(size=(count, SHAPES)) + 0.1, 0, 1)
    moved = np.einsum("ns,skc->nkc", weights, PERFORMER)
    return weights, moved + 0.05 * rng.normal(size=moved.shape)


WEIGHTS, MOVED = drawn(PAIRS, 1)


def largest() -> np.ndarray:
    limit = np.sort(WEIGHTS, axis=1)[:, [-SET]]
    return np.where(WEIGHTS >= limit, WEIGHTS, 0.0)


def trained(keys: np.ndarray) -> TrainedMapping:
    names = tuple(f"m{marker}" for marker in range(MARKERS))
    pairs = References(
        marker_names=names,
        shape_names=tuple(f"shape{shape}" for shape in range(SHAPES)),
        markers=NEUTRAL + MOVED,
        weights=keys,
        frames=np.arange(0, 100 * PAIRS, 100),
        takes=("take",) * PAIRS,
        tuned=np.ones(PAIRS, np.bool_),
        rigid=(),
        neutral=NEUTRAL,
        rig_file=Path("rig.usd"),
        rig_prim="/Rig",
        motion=fit_motion_space([NEUTRAL + MOVED], dimensions=20, sample_count=PAIRS),
    )
    ranges = np.tile([0.0, 1.0], (SHAPES, 1))
    gram = np.einsum("smc,tmc->st", RIG, RIG) / MARKERS
    return train_mapping(pairs, ranges=ranges, gram=gram, skin=RIG, method="face_map")


def error(mapping: TrainedMapping) -> float:
    weights, moved = drawn(200, 2)
    found = WeightPredictor(mapping).predict(NEUTRAL + moved).weights
    return float(np.sqrt(((found - weights) ** 2).mean()))


def test_weights_that_were_not_set_are_found(monkeypatch) -> None:
    found = trained(largest())
    assert found.settings["unset_keys"] > 0
    monkeypatch.setattr(unset_keys, "_CRITICAL_T", np.inf)
    as_set = trained(largest())
    assert as_set.settings["unset_keys"] == 0
    assert error(found) < 0.8 * error(as_set)


def test_half_of_the_error_that_they_leave_grows_with_the_motion(monkeypatch) -> None:
    found = trained(largest())
    _, moved = drawn(50, 2)
    with_error = WeightPredictor(found).predict(NEUTRAL + moved)
    monkeypatch.setattr(uncertainty, "_unset_variance", lambda *given: 0.0)
    without = WeightPredictor(found).predict(NEUTRAL + moved)
    arrays = found.arrays
    gram, left = arrays["uncertainty_grams"][0], arrays["forward_scales"][5]
    keys = unbend(arrays["forward_targets"], arrays["forward_scales"][4])
    of_pairs, of_frames = (np.einsum("ns,st,nt->n", w, gram, w) for w in (keys, without.weights))
    expected = left**2 * np.trace(gram) * (1 + of_frames / of_pairs.mean()) / 2
    added = (with_error.uncertainty**2 - without.uncertainty**2)[:, 0]
    np.testing.assert_allclose(added, expected, rtol=1e-4)
    assert 0 < left < found.settings["unset_keys"]


@pytest.mark.parametrize("deviation", [0.0, 0.15])
def test_keys_with_and_without_errors_count_as_set(deviation: float) -> None:
    off = 1 + deviation * np.random.default_rng(6).normal(size=WEIGHTS.shape)
    assert trained(np.clip(WEIGHTS * off, 0, 1)).settings["unset_keys"] == 0


def test_few_pairs_count_as_set() -> None:
    forward = fit_forward_model(largest()[:7], MOVED[:7], expected=RIG, neutral=NEUTRAL)
    assert unset_keys.with_unset_keys(forward, lambda unset: forward) is forward


def test_keys_without_zeros_are_not_tested() -> None:
    forward = fit_forward_model(WEIGHTS + 0.01, MOVED, expected=RIG, neutral=NEUTRAL)
    assert unset_keys.with_unset_keys(forward, lambda unset: 1 / 0) is forward


def test_the_likelihood_is_that_of_the_joint_normal_distribution() -> None:
    """Without quadratic term, so that the Jacobian is the basis."""
    scales = ForwardScales(eta=0.0, tau=0.1, curve=0.0, unset=0.08)
    keys = largest()
    forward = fit_forward_model(keys, MOVED, expected=RIG, neutral=NEUTRAL, scales=scales)
    variance = np.repeat(forward.leave_one_out_variance, 3, axis=1)
    slope, errors = forward.basis.reshape(SHAPES, -1), scales.key_variance(keys)
    expected = [
        multivariate_normal.logpdf(
            residual.ravel(), cov=np.diag(own) + slope.T @ np.diag(each) @ slope
        )
        for residual, own, each in zip(forward.residuals, variance, errors, strict=True)
    ]
    found = unset_keys._log_likelihood(forward)
    assert found is not None
    constant = -1.5 * MARKERS * np.log(2 * np.pi)
    np.testing.assert_allclose(found + constant, expected, rtol=1e-3)


def test_rigs_of_very_many_shapes_are_not_tested(monkeypatch) -> None:
    monkeypatch.setattr("usdface.model.regressions.frame_solve._MAX_DENSE_SHAPES", 0)
    forward = fit_forward_model(largest(), MOVED, expected=RIG, neutral=NEUTRAL)
    assert unset_keys._log_likelihood(forward) is None
    other = replace(forward)
    assert unset_keys.with_unset_keys(forward, lambda unset: other) is forward
