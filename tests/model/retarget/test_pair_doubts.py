"""Pairs whose target looks like another pair's source are named; right ones are not."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.steps.small_shot import coarse_rig
from usdface.core.assets import Rig
from usdface.core.controls import ExpressionPairs, shape_controls
from usdface.core.deformer import Deformer
from usdface.core.errors import InputError
from usdface.demo.sculpt import ACTOR
from usdface.model.placement.shape_parts import shape_parts
from usdface.model.retarget.name_matching import transfer_by_names
from usdface.model.retarget.pair_doubts import find_pair_doubts, find_unkeyed_regions
from usdface.numerics.measure.face_regions import shapes_by_region
from usdface.usdio.rig.read import read_rig


@pytest.fixture(scope="module")
def faces() -> tuple[Rig, Rig]:
    return coarse_rig(ACTOR), coarse_rig()


def pairs_by_name(source: Rig, target: Rig) -> ExpressionPairs:
    """A pair at rest, one for every shape that has a counterpart, and twenty mixtures."""
    transfer = transfer_by_names(source.shapes, target.shapes)
    used = np.flatnonzero(transfer.matrix.any(axis=1))
    rng = np.random.default_rng(0)
    mixed = np.zeros((20, len(source.shapes)))
    for row in mixed:
        row[rng.choice(used, 4, replace=False)] = rng.uniform(0.3, 1, 4)
    weights = np.vstack([np.zeros(len(source.shapes)), np.eye(len(source.shapes))[used], mixed])
    return ExpressionPairs(
        names=tuple(str(index) for index in range(len(weights))),
        source_shapes=source.shapes,
        source=weights,
        target=shape_controls(transfer.target, weights @ transfer.matrix),
    )


def keyed(pairs: ExpressionPairs, weights: np.ndarray) -> ExpressionPairs:
    return replace(pairs, target=replace(pairs.target, weights=weights))


def pair_of(pairs: ExpressionPairs, shape: str) -> int:
    alone = np.eye(len(pairs.source_shapes))[pairs.source_shapes.index(shape)]
    return int((pairs.source == alone).all(axis=1).argmax())


def test_an_open_jaw_keyed_as_a_smile_is_named(faces: tuple[Rig, Rig]) -> None:
    pairs = pairs_by_name(*faces)
    assert find_pair_doubts(pairs, *faces) == ()
    jaw, smile = pair_of(pairs, "jawOpen"), pair_of(pairs, "mouthSmileLeft")
    weights = pairs.target.weights.copy()
    weights[jaw] = weights[smile]
    (doubt,) = find_pair_doubts(keyed(pairs, weights), *faces)
    assert (doubt.pair, doubt.other) == (jaw, smile)
    assert doubt.own < 0.35 < 0.6 < doubt.similarity


def test_a_wink_of_the_other_eye_is_named_without_its_counterpart(faces: tuple[Rig, Rig]) -> None:
    pairs = pairs_by_name(*faces)
    wink, other = pair_of(pairs, "eyeBlinkLeft"), pair_of(pairs, "eyeBlinkRight")
    weights = pairs.target.weights.copy()
    weights[wink] = weights[other]
    rows = np.setdiff1d(np.arange(len(pairs)), [other])
    (doubt,) = find_pair_doubts(keyed(pairs, weights).rows(rows), *faces)
    assert rows[doubt.pair] == wink
    assert doubt.other is None


def test_a_pair_that_moves_attributes_is_not_judged(faces: tuple[Rig, Rig]) -> None:
    pairs = pairs_by_name(*faces)
    jaw, smile = pair_of(pairs, "jawOpen"), pair_of(pairs, "mouthSmileLeft")
    weights, values = pairs.target.weights.copy(), np.zeros((len(pairs), 1))
    weights[jaw], values[jaw] = weights[smile], 10
    wrong = keyed(pairs, weights)
    by_attribute = replace(wrong.target, attributes=("rig.jaw",), values=values)
    assert find_pair_doubts(replace(wrong, target=by_attribute), *faces) == ()


def test_regions_that_the_source_moves_and_no_pair_keys_are_named(faces: tuple[Rig, Rig]) -> None:
    pairs = pairs_by_name(*faces)
    parts = [shape_parts(rig, Deformer(rig)) for rig in faces]
    assert find_unkeyed_regions(pairs, *parts) == {}
    brows = shapes_by_region(parts[1])["brows"]
    weights = pairs.target.weights.copy()
    weights[:, brows] = 0.1
    rest = keyed(pairs, weights)
    (found,) = find_unkeyed_regions(rest, *parts).items()
    assert found[0] == "brows"
    moved, controls = found[1]
    assert [faces[0].shapes[i] for i in np.flatnonzero(moved)] == [
        name for name in faces[0].shapes if "brow" in name.lower()
    ]
    assert controls == tuple(faces[1].shapes[i] for i in brows)
    still = replace(rest, source=rest.source * ~moved)
    assert find_unkeyed_regions(still, *parts) == {}
    values = rest.source[:, :1]
    by_attribute = replace(rest.target, attributes=("rig.brows",), values=values)
    assert find_unkeyed_regions(replace(rest, target=by_attribute), *parts) == {}


def test_right_pairs_of_heads_of_two_makers_are_not_doubted(shared_data: Path) -> None:
    ict, cap = (
        read_rig(shared_data / "rigs" / f"{name}.usdc") for name in ("ict_face", "facecap_head")
    )
    for faces in ((ict, cap), (cap, ict)):
        pairs = pairs_by_name(*faces)
        assert find_pair_doubts(pairs, *faces) == ()
        weights = pairs.target.weights.copy()
        weights[1:] = np.roll(weights[1:], 7, axis=0)
        assert len(find_pair_doubts(keyed(pairs, weights), *faces)) > 0.6 * (len(pairs) - 1)


def test_pairs_of_other_rigs_are_refused(faces: tuple[Rig, Rig]) -> None:
    pairs = pairs_by_name(*faces)
    with pytest.raises(InputError, match="lack: jaw"):
        find_pair_doubts(replace(pairs, source_shapes=("jaw", *pairs.source_shapes[1:])), *faces)
