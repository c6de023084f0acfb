"""Song et al. (2011) as mappings: what is particular to them; what all share is in test_train."""

from dataclasses import replace

import numpy as np
import pytest

from tests.model.synthetic import references_of, synthetic_face
from usdface.model.mapping.predict import WeightPredictor
from usdface.model.mapping.train import train_mapping
from usdface.model.regressions import MAPPING_METHODS, hybrid, kernel_cca, multiquadric

pytestmark = pytest.mark.usefixtures("without_comparison")

CHOSEN = np.arange(0, 1200, 30)
PEERS = ("multiquadric", "kernel_cca", "hybrid")


def trained(method: str, **face: float):
    made = synthetic_face(**face)
    references = references_of(made, CHOSEN)
    mapping = train_mapping(references, ranges=made.ranges, gram=made.gram, method=method)
    return made, mapping


def error_on_slow_starters(method: str) -> float:
    """Train on shapes whose first half moves the skin less than their second; weights' error."""
    face = synthetic_face()
    moved = 0.3 * face.weights + 0.7 * face.weights**2
    positions = face.neutral + np.einsum("fs,smc->fmc", moved, face.shapes)
    face = replace(face, positions=positions)
    mapping = train_mapping(
        references_of(face, CHOSEN), ranges=face.ranges, gram=face.gram, method=method
    )
    off = WeightPredictor(mapping).predict(face.positions).weights - face.weights
    return float(np.sqrt((off**2).mean()))


@pytest.mark.parametrize("method", PEERS)
def test_they_bend_where_a_line_cannot(method: str) -> None:
    assert error_on_slow_starters(method) < 0.9 * error_on_slow_starters("ridge")


def test_the_multiquadric_meets_its_pairs() -> None:
    face, mapping = trained("multiquadric")
    assert mapping.settings["smooth"] is False
    met = WeightPredictor(mapping).predict(face.positions[CHOSEN]).weights
    np.testing.assert_allclose(met, face.weights[CHOSEN], atol=1e-8)


def test_the_hybrid_is_the_blend_of_its_parts() -> None:
    _, mapping = trained("hybrid", bend=0.3)
    alpha, arrays = float(mapping.settings["alpha"]), mapping.arrays
    assert 0.0 <= alpha <= 1.0
    rows = np.random.default_rng(0).normal(size=(20, int(mapping.settings["dimensions"]))) * 5
    parts = (multiquadric.METHOD, kernel_cca.METHOD)
    network, regression = (part.predict(arrays, mapping.settings, rows) for part in parts)
    blended = hybrid.METHOD.predict(arrays, mapping.settings, rows)
    np.testing.assert_allclose(blended, alpha * network + (1 - alpha) * regression, atol=1e-12)


@pytest.mark.parametrize("method", PEERS)
def test_two_faces_alike_that_are_keyed_apart_do_not_break_training(method: str) -> None:
    face = synthetic_face()
    references = references_of(face, CHOSEN)
    markers, weights = references.markers.copy(), references.weights.copy()
    markers[9] = markers[4] + 1e-13  # not the same bits, so nobody refuses it beforehand
    weights[9, 0] = 1.0 - weights[4, 0]
    mapping = train_mapping(
        replace(references, markers=markers, weights=weights),
        ranges=face.ranges,
        gram=face.gram,
        method=method,
    )
    assert np.isfinite(WeightPredictor(mapping).predict(face.positions).weights).all()


@pytest.mark.parametrize("method", PEERS)
def test_pairs_all_keyed_the_same_predict_that(method: str) -> None:
    face = synthetic_face()
    references = references_of(face, CHOSEN)
    same = np.tile(references.weights[3], (len(CHOSEN), 1))
    mapping = train_mapping(
        replace(references, weights=same), ranges=face.ranges, gram=face.gram, method=method
    )
    predicted = WeightPredictor(mapping).predict(face.positions[CHOSEN]).weights
    np.testing.assert_allclose(predicted, same, atol=1e-6)


def test_they_are_registered() -> None:
    assert set(PEERS) <= set(MAPPING_METHODS)
