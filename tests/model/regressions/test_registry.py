"""The registry, and Gaussian RBF as published and as ours."""

import numpy as np
import pytest

from tests.model.synthetic import references_of, synthetic_face
from usdface.model.mapping.predict import WeightPredictor
from usdface.model.mapping.train import train_mapping
from usdface.model.regressions import MAPPING_METHODS, RETARGET_METHODS
from usdface.model.regressions.base import Choices, Face, Pairs
from usdface.model.regressions.gaussian_rbf import PUBLISHED
from usdface.model.regressions.shape_sides import ShapeSides
from usdface.numerics.regression.rbf_ridge import (
    centre_widths,
    gaussian_design,
    reestimate_ridge,
    rotate,
)

CHOSEN = np.arange(0, 1200, 30)


def pairs_of_a_face() -> Pairs:
    face = synthetic_face(bend=0.2)
    references = references_of(face, CHOSEN)
    motion = references.motion
    assert motion is not None
    flat = references.markers.reshape(len(CHOSEN), -1)
    coordinates = (flat - motion.mean) @ motion.components.T
    return Pairs(
        coordinates, references.weights, Face(ShapeSides.divided(face.ranges), face.gram, motion)
    )


def test_one_registry_serves_mappings_and_retargetings() -> None:
    assert set(MAPPING_METHODS) == {
        "ridge", "d06", "rbf", "face_map", "multiquadric", "kernel_cca", "hybrid"
    }  # fmt: skip
    assert set(RETARGET_METHODS) == {"ridge", "rbf", "kernel_cca", "hybrid", "additive"}
    for name in ("ridge", "kernel_cca", "hybrid"):
        assert MAPPING_METHODS[name] is RETARGET_METHODS[name]
    assert RETARGET_METHODS["rbf"] is MAPPING_METHODS["multiquadric"]


def test_the_paper_s_own_iteration_can_choose_the_ridge() -> None:
    pairs = pairs_of_a_face()
    iterated = [each for each in PUBLISHED.candidates(pairs) if each["ridge"] == "iterated"]
    fitted = PUBLISHED.fit(pairs, iterated[0])
    centres = pairs.inputs[:, :4]
    widths = centre_widths(centres, multiple=2.0)
    rotated = rotate(gaussian_design(centres, centres, widths), pairs.outputs)
    np.testing.assert_allclose(fitted.arrays["ridge"], reestimate_ridge(rotated, start=1e-3))


def test_each_centre_may_have_a_width_of_its_own() -> None:
    pairs, method = pairs_of_a_face(), MAPPING_METHODS["rbf"]
    tried = method.candidates(pairs, Choices((8,)))
    choices = [each for each in tried if each["widths"] == "per centre"]
    fitted = method.fit(pairs, choices[0])
    assert len(np.unique(fitted.arrays["widths"])) > 10


@pytest.mark.parametrize("name", MAPPING_METHODS)
def test_a_head_placed_a_hair_aside_has_the_same_face(name: str) -> None:
    """Cleaned takes have components that hardly move: what moves there is never the face."""
    face = synthetic_face(bend=0.2, noise=5e-4)
    mapping = train_mapping(
        references_of(face, CHOSEN),
        ranges=face.ranges,
        gram=face.gram,
        method=name,
        choices=Choices((20,)),
    )
    before = WeightPredictor(mapping).predict(face.positions[:200]).weights
    after = WeightPredictor(mapping).predict(face.positions[:200] + 0.02).weights
    np.testing.assert_allclose(after, before, atol=0.03)
