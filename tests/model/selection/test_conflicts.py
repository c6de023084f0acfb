"""Pairs that contradict each other are found, and pairs that merely differ are not."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from tests.model.selection.test_design import SHAPES, small_face
from usdface.core.assets import References
from usdface.model.selection.coverage import conflict_text, find_reference_conflicts


def pairs_of_a_face(count: int = 40) -> References:
    weights, packed, _ = small_face()
    rows = np.arange(0, len(weights), len(weights) // count)[:count]
    return References(
        marker_names=tuple(f"m{i}" for i in range(12)),
        shape_names=SHAPES,
        markers=packed[rows].reshape(count, 12, 3),
        weights=weights[rows],
        frames=rows,
        takes=("kitchen",) * count,
        tuned=np.ones(count, bool),
        rigid=(),
        neutral=np.zeros((12, 3)),
        rig_file=Path("rig.usda"),
        rig_prim="/Hero",
    )


def with_twin(references: References, shape: str, value: float) -> References:
    """Repeat the first pair, noise apart, with another weight of one shape."""
    noise = np.random.default_rng(1).normal(0, 0.02, references.markers[:1].shape)
    weights = references.weights[:1].copy()
    weights[0, references.shape_names.index(shape)] = value
    return replace(
        references,
        markers=np.concatenate([references.markers, references.markers[:1] + noise]),
        weights=np.concatenate([references.weights, weights]),
        frames=np.append(references.frames, 9999),
        takes=(*references.takes, "kitchen"),
        tuned=np.append(references.tuned, True),
    )


def test_pairs_that_follow_one_rule_do_not_conflict() -> None:
    assert find_reference_conflicts(pairs_of_a_face()) == []


def test_alike_markers_with_unlike_weights_are_named() -> None:
    references = pairs_of_a_face()
    for shape in ("jawOpen", "eyeBlinkLeft"):
        own = references.weights[0, references.shape_names.index(shape)]
        other = 1.0 if own < 0.5 else 0.0
        found = find_reference_conflicts(with_twin(references, shape, other))
        assert (found[0].first, found[0].second, found[0].shape) == (0, 40, shape)
        assert "pair 1 (kitchen 0) and pair 41 (kitchen 9999)" in conflict_text(
            with_twin(references, shape, other), found[0]
        )


def test_a_twin_with_the_same_weights_is_no_conflict() -> None:
    references = pairs_of_a_face()
    own = float(references.weights[0, 0])
    assert find_reference_conflicts(with_twin(references, "jawOpen", own)) == []


def test_a_conflict_over_a_shape_that_no_other_pair_uses_is_of_a_size() -> None:
    references = pairs_of_a_face()
    lid = references.shape_names.index("eyeBlinkLeft")
    weights = references.weights.copy()
    weights[:, lid] = 0.0
    found = find_reference_conflicts(
        with_twin(replace(references, weights=weights), "eyeBlinkLeft", 1.0)
    )
    assert (found[0].second, found[0].shape) == (40, "eyeBlinkLeft")
    assert 1.0 < found[0].times < 1e4


def test_few_pairs_tell_nothing() -> None:
    assert find_reference_conflicts(pairs_of_a_face(4)) == []


def test_a_shape_of_large_weights_does_not_hide_the_others_of_its_region() -> None:
    references = with_twin(pairs_of_a_face(), "jawOpen", 1.0)
    references = replace(references, shape_names=(*SHAPES[:3], "jawForward"))
    (found,) = find_reference_conflicts(references)
    (scaled,) = find_reference_conflicts(
        replace(references, weights=references.weights * [1.0, 1.0, 1.0, 10.0])
    )
    assert (scaled.first, scaled.second, scaled.shape) == (found.first, found.second, "jawOpen")
