"""Offsets of the takes of references, in training and when these takes are mapped."""

from dataclasses import replace

import numpy as np
import pytest

from tests.model.synthetic import (
    MARKERS,
    RIGID,
    markers_of,
    references_of,
    synthetic_face,
)
from usdface.core.assets import References, TrainedMapping
from usdface.model.mapping import take_neutral
from usdface.model.mapping.head_space import find_head_space
from usdface.model.mapping.performer_face import face_of_mapping
from usdface.model.mapping.predict import WeightPredictor
from usdface.model.mapping.take_neutral import find_take_offsets
from usdface.model.mapping.train import train_mapping
from usdface.model.regressions.forward_model import fit_forward_model

pytestmark = pytest.mark.usefixtures("without_comparison")

MADE, OTHER = synthetic_face(noise=0.05), synthetic_face(noise=0.05, seed=4)
CHOSEN = np.arange(0, 1200, 60)
PAIRS, TAKE = 2 * len(CHOSEN), np.repeat([0, 1], len(CHOSEN))
OFFSET = 3 * np.random.default_rng(5).normal(size=(MARKERS, 3))
OFFSET[:RIGID] = 0


def references(offset: float | np.ndarray, **changes: object) -> References:
    """Return pairs of two takes; the markers of the second were applied again."""
    first, second = references_of(MADE, CHOSEN), references_of(OTHER, CHOSEN)
    both = replace(
        first,
        markers=np.concatenate([first.markers, second.markers + offset]),
        weights=np.concatenate([first.weights, second.weights]),
        frames=np.concatenate([first.frames, second.frames]),
        takes=("day one",) * len(CHOSEN) + ("day two",) * len(CHOSEN),
        tuned=np.ones(PAIRS, bool),
        neutral_take="day one",
    )
    return replace(both, **changes)  # type: ignore[arg-type]


def trained(pairs: References) -> TrainedMapping:
    given = {"ranges": MADE.ranges, "gram": MADE.gram, "skin": MADE.shapes}
    return train_mapping(pairs, method="face_map", **given)  # type: ignore[arg-type]


def solve(mapping: TrainedMapping, positions: np.ndarray, take: str) -> np.ndarray:
    markers = markers_of(replace(MADE, positions=positions))
    space = find_head_space(face_of_mapping(mapping), markers, rate=60, take=take)
    placed = space.place(markers)
    return WeightPredictor(mapping).predict(placed.positions, visible=placed.visible).weights


def test_offsets_are_those_of_generalised_least_squares(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(take_neutral, "_OFFSET_DEVIATIONS_MM", (1.2,))
    pairs = references(OFFSET)
    moved = pairs.markers - pairs.neutral
    forward = fit_forward_model(pairs.weights, moved, expected=MADE.shapes, neutral=MADE.neutral)
    found = find_take_offsets(forward, TAKE)
    member = (TAKE == 1) * 1.0
    for marker in range(MARKERS):
        covariance = np.linalg.inv(forward.inverse[marker])
        residual = covariance @ forward.dual[:, marker]
        both = covariance + 1.2**2 * np.outer(member, member)
        expected = 1.2**2 * member @ np.linalg.solve(both, residual)
        np.testing.assert_allclose(found[1, marker], expected, rtol=1e-5, atol=1e-8)
    assert not found[0].any()


def test_two_days_do_not_ruin_each_other() -> None:
    once, again = trained(references(0.0)), trained(references(OFFSET))
    ignored = trained(references(OFFSET, neutral_take=""))
    size = np.sqrt((OFFSET**2).sum(axis=1).mean())
    np.testing.assert_allclose(again.arrays["take_offset_mm"], [0.0, size], rtol=0.1)
    for take, face, offset in (("day one", MADE, 0.0), ("day two", OTHER, OFFSET)):
        expected, found, wrong = (
            np.sqrt(((solve(mapping, face.positions + by, take) - face.weights) ** 2).mean())
            for mapping, by in ((once, 0.0), (again, offset), (ignored, offset))
        )
        assert found < 2 * expected
        assert wrong > 8 * found


@pytest.mark.parametrize("size", [0.0, 0.03])
def test_takes_of_one_application_keep_their_markers(size: float) -> None:
    pairs = references(size * OFFSET)
    np.testing.assert_array_equal(trained(pairs).arrays["pair_markers"], pairs.markers)


def test_another_take_of_that_name_is_not_aligned_by_pairs() -> None:
    mapping = trained(references(OFFSET))
    other = markers_of(synthetic_face(seed=9))
    named, unnamed = (
        find_head_space(face_of_mapping(mapping), other, rate=60, take=take)
        for take in ("day two", "")
    )
    np.testing.assert_array_equal(
        named.move(other.positions, other.visible), unnamed.move(other.positions, other.visible)
    )


def test_positions_are_restored_with_the_offset() -> None:
    mapping = trained(references(OFFSET))
    markers = markers_of(replace(MADE, positions=OTHER.positions + OFFSET))
    space = find_head_space(face_of_mapping(mapping), markers, rate=60, take="day two")
    moved = space.move(markers.positions, markers.visible)
    np.testing.assert_allclose(space.restore(moved.astype(float)), markers.positions, atol=1e-3)
    assert np.sqrt(((moved - OTHER.positions) ** 2).mean()) < 0.2
    assert np.all(np.asarray(space.known_share) < 1)  # the offset's error is in the uncertainty


def test_matched_expressions_correct_an_offset_that_keys_tell_wrongly() -> None:
    face = face_of_mapping(trained(references(OFFSET)))
    frames, placed = face.pairs["day two"]
    wrong = replace(face, pairs=face.pairs | {"day two": (frames, placed + OFFSET / 2)})
    markers = markers_of(replace(MADE, positions=OTHER.positions + OFFSET))
    for each in (face, wrong):
        space = find_head_space(each, markers, rate=60, take="day two")
        moved = space.move(markers.positions, markers.visible)
        assert np.sqrt(((moved - OTHER.positions) ** 2).sum(axis=2).mean()) < 0.5


def test_a_marker_that_is_hidden_in_the_pairs_takes_no_part_in_their_alignment() -> None:
    """Its last place is far off; the others are aligned by the pairs nevertheless."""
    face, hidden = face_of_mapping(trained(references(OFFSET))), RIGID + 1
    markers = markers_of(replace(MADE, positions=OTHER.positions + OFFSET))
    markers.positions[CHOSEN, hidden] = 0
    visible = markers.visible.copy()
    visible[CHOSEN, hidden] = False
    markers = replace(markers, visible=visible, confidence=visible.astype(np.float32))
    space = find_head_space(face, markers, rate=60, take="day two")
    others = np.arange(MARKERS) != hidden
    assert np.ndim(space.pair_offset)
    assert not np.any(np.asarray(space.pair_offset)[hidden])
    away = (np.asarray(space.pair_offset) - OFFSET)[others]
    assert np.sqrt((away**2).sum(axis=1).mean()) < 0.3
    assert space.neutral.offset_mm < 1.1 * np.sqrt((OFFSET**2).sum(axis=1).mean())
