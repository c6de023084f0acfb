from dataclasses import replace

import numpy as np
import pytest

from tests.model.synthetic import references_of, synthetic_face
from usdface.core.assets import References
from usdface.core.errors import InputError
from usdface.model.mapping import train
from usdface.model.mapping.candidates import observable_shapes
from usdface.model.mapping.checks import check_references
from usdface.model.mapping.predict import WeightPredictor
from usdface.model.mapping.train import train_mapping
from usdface.model.regressions import MAPPING_METHODS
from usdface.model.regressions.base import Choices

CHOSEN = np.arange(0, 1200, 30)
each_method = pytest.mark.parametrize("method", sorted(MAPPING_METHODS))


def references() -> References:
    return references_of(synthetic_face(), CHOSEN)


@pytest.mark.parametrize("method", [*sorted(set(MAPPING_METHODS) - {"d06"}), "auto"])
def test_a_straight_face_is_recovered(method: str) -> None:
    face = synthetic_face(noise=0.001)
    mapping = train_mapping(
        references_of(face, CHOSEN), ranges=face.ranges, gram=face.gram, method=method
    )
    error = WeightPredictor(mapping).predict(face.positions).weights - face.weights
    assert np.sqrt((error**2).mean()) < 0.03


def test_auto_takes_the_candidate_with_the_least_surface_error_and_keeps_the_table() -> None:
    face = synthetic_face(bend=0.3)
    mapping = train_mapping(references_of(face, CHOSEN), ranges=face.ranges, gram=face.gram)
    errors = [score.vertex_rms_mm for score in mapping.scores]
    assert errors == sorted(errors)
    assert len({(score.method, score.settings) for score in mapping.scores}) == len(errors)
    assert mapping.method == mapping.scores[0].method


def test_without_a_rig_weights_decide_and_surface_error_is_unknown() -> None:
    face = synthetic_face()
    mapping = train_mapping(references(), ranges=face.ranges, gram=None, method="ridge")
    errors = [score.weight_rmse for score in mapping.scores]
    assert errors == sorted(errors)
    assert all(np.isnan(score.vertex_rms_mm) for score in mapping.scores)


@each_method
def test_training_twice_gives_the_same_bits_in_float64_arrays_and_plain_settings(
    method: str,
) -> None:
    face = synthetic_face()
    first = train_mapping(references(), ranges=face.ranges, gram=face.gram, method=method)
    mapping = train.train_mapping(references(), ranges=face.ranges, gram=face.gram, method=method)
    assert first.settings == mapping.settings
    assert sorted(first.arrays) == sorted(mapping.arrays)
    for name, value in first.arrays.items():
        np.testing.assert_array_equal(value, mapping.arrays[name])
    assert all(a.dtype == np.float64 and a.flags.c_contiguous for a in mapping.arrays.values())
    assert all(np.isfinite(a).all() for a in mapping.arrays.values())
    assert all(type(value) in (bool, int, float, str) for value in mapping.settings.values())
    assert all(name.isidentifier() for name in [*mapping.arrays, *mapping.settings])


@each_method
def test_asked_dimensions_are_used(method: str) -> None:
    face = synthetic_face()
    mapping = train_mapping(
        references(), ranges=face.ranges, gram=face.gram, method=method, choices=Choices((7,))
    )
    assert mapping.settings["dimensions"] == 7


def test_the_published_method_takes_dimensions_and_widths_by_cross_validation() -> None:
    face = synthetic_face()
    asked = Choices((2, 4, 8), (2.0, 16.0))
    mapping = train_mapping(
        references(), ranges=face.ranges, gram=face.gram, method="d06", choices=asked
    )
    assert len(mapping.scores) == 12  # two ways to the ridge
    assert len({score.settings for score in mapping.scores}) == 12
    error = {score.settings: score.vertex_rms_mm for score in mapping.scores}
    chosen = {name: mapping.settings[name] for name in ("dimensions", "width", "ridge")}
    best = "dimensions={dimensions} width={width:g} ridge={ridge}".format(**chosen)
    assert error[best] == min(error.values())
    with pytest.raises(InputError, match="ridge has no width to choose"):
        train_mapping(references(), ranges=face.ranges, gram=None, method="ridge", choices=asked)


@each_method
def test_two_pairs_are_the_fewest_that_train(method: str) -> None:
    face = synthetic_face()
    mapping = train_mapping(
        references_of(face, np.array([0, 600])), ranges=face.ranges, gram=face.gram, method=method
    )
    assert np.isfinite(WeightPredictor(mapping).predict(face.positions[:50]).weights).all()


@pytest.mark.parametrize("method", [*sorted(MAPPING_METHODS), "auto"])
def test_a_few_pairs_of_one_short_moment_train(method: str) -> None:
    face = synthetic_face()
    close = references_of(face, np.arange(0, 80, 10))
    mapping = train_mapping(close, ranges=face.ranges, gram=face.gram, method=method)
    assert np.isfinite(WeightPredictor(mapping).predict(face.positions[:50]).weights).all()


def test_without_a_motion_space_the_pairs_span_their_own() -> None:
    face = synthetic_face(noise=0.001)
    pairs = replace(references(), motion=None)
    mapping = train_mapping(pairs, ranges=face.ranges, gram=face.gram)
    error = WeightPredictor(mapping).predict(face.positions).weights - face.weights
    assert np.sqrt((error**2).mean()) < 0.03


def test_weights_beyond_their_range_are_limited() -> None:
    face, pairs = synthetic_face(), references()
    weights = pairs.weights.copy()
    weights[3, 1], weights[5, 0] = 1.2, -0.1
    beyond = replace(pairs, weights=weights)
    kept = check_references(beyond, ranges=face.ranges, gram=face.gram)
    np.testing.assert_array_equal(kept.weights, np.clip(weights, *face.ranges.T))


def test_a_pair_repeated_whole_changes_nothing() -> None:
    face, pairs = synthetic_face(), references()
    twice = np.r_[np.arange(len(CHOSEN)), 4]
    repeated = replace(
        pairs,
        markers=pairs.markers[twice],
        weights=pairs.weights[twice],
        frames=pairs.frames[twice],
        takes=(*pairs.takes, "take"),
        tuned=pairs.tuned[twice],
    )
    first = train_mapping(pairs, ranges=face.ranges, gram=face.gram, method="ridge")
    second = train_mapping(repeated, ranges=face.ranges, gram=face.gram, method="ridge")
    np.testing.assert_array_equal(first.arrays["slope"], second.arrays["slope"])


def test_a_pair_that_is_dropped_takes_its_viseme_and_emotion_with_it() -> None:
    face, pairs = synthetic_face(), references()
    twice = np.r_[0, 0, np.arange(1, len(CHOSEN))]
    names = tuple(str(row) for row in twice)
    repeated = replace(
        pairs,
        markers=pairs.markers[twice],
        weights=pairs.weights[twice],
        frames=pairs.frames[twice],
        takes=("take",) * len(twice),
        tuned=pairs.tuned[twice],
        visemes=names,
        emotions=names,
    )
    kept = check_references(repeated, ranges=face.ranges, gram=face.gram)
    assert kept.visemes == kept.emotions == tuple(str(row) for row in range(len(CHOSEN)))


def broken(fault: str) -> References:
    pairs = references()
    markers, weights = pairs.markers.copy(), pairs.weights.copy()
    if fault == "nan marker":
        markers[4, 7] = np.nan
    elif fault == "nan weight":
        weights[4, 2] = np.nan
    elif fault == "constant":
        markers[:] = markers[0]
    elif fault == "conflict":
        markers[6] = markers[2]
    return replace(pairs, markers=markers, weights=weights)


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ("nan marker", r"pair 5 \(take 'take', frame 120\): markers m07 are not finite; clean"),
        ("nan weight", r"pair 5 \(take 'take', frame 120\): weights shape2 are not finite; tune"),
        ("constant", "no marker moves between the pairs; choose"),
        ("conflict", r"frame 60\) and pair 7 .* same markers but different weights; keep one"),
    ],
)
def test_pairs_that_cannot_be_learned_from_are_named(fault: str, message: str) -> None:
    face = synthetic_face()
    with pytest.raises(InputError, match=message):
        train_mapping(broken(fault), ranges=face.ranges, gram=face.gram)


def test_a_neutral_face_or_motion_that_is_not_finite_is_refused() -> None:
    face, pairs = synthetic_face(), references()
    neutral = pairs.neutral.copy()
    neutral[7, 0] = np.nan
    with pytest.raises(InputError, match="neutral face: markers m07 are not finite; ingest"):
        train_mapping(replace(pairs, neutral=neutral), ranges=face.ranges, gram=face.gram)
    assert pairs.motion is not None
    motion = replace(pairs.motion, components=pairs.motion.components * np.inf)
    with pytest.raises(InputError, match="motion space holds values that are not finite; select"):
        train_mapping(replace(pairs, motion=motion), ranges=face.ranges, gram=face.gram)


def test_ranges_and_a_surface_that_are_not_finite_are_refused() -> None:
    face = synthetic_face()
    ranges = face.ranges.copy()
    ranges[2, 1] = np.nan
    with pytest.raises(InputError, match=r"shape2 has the empty range \[0.0, nan\]"):
        train_mapping(references(), ranges=ranges, gram=face.gram)
    with pytest.raises(InputError, match="gram holds values that are not finite; check the rig"):
        train_mapping(references(), ranges=face.ranges, gram=face.gram * np.nan)


@each_method
def test_markers_that_never_move_do_no_harm(method: str) -> None:
    face = synthetic_face(noise=0.001)
    positions = face.positions.copy()
    positions[:, 9:11] = positions[0, 9:11]  # two on the face, beside those that are rigid
    stuck = replace(face, positions=positions)
    mapping = train_mapping(
        references_of(stuck, CHOSEN), ranges=face.ranges, gram=face.gram, method=method
    )
    prediction = WeightPredictor(mapping).predict(positions)
    assert np.isfinite(prediction.uncertainty).all()
    error = prediction.weights - face.weights
    assert np.sqrt((error**2).mean()) < (0.25 if method == "d06" else 0.03)


def test_one_pair_is_too_few() -> None:
    face = synthetic_face()
    with pytest.raises(InputError, match=r"1 pairs: at least 2 are needed.*tune more"):
        train_mapping(references_of(face, np.array([5])), ranges=face.ranges, gram=face.gram)


def test_more_dimensions_than_pairs_or_motion_are_refused() -> None:
    face = synthetic_face()
    few = references_of(face, CHOSEN[:10])
    with pytest.raises(InputError, match="12 dimensions need at least 13 references, got 10"):
        train_mapping(few, ranges=face.ranges, gram=None, choices=Choices((12,)))
    with pytest.raises(InputError, match=r"30 dimensions asked for but .* has 20"):
        train_mapping(references(), ranges=face.ranges, gram=None, choices=Choices((30,)))
    with pytest.raises(InputError, match="at least 1, got 0"):
        train_mapping(references(), ranges=face.ranges, gram=None, choices=Choices((0,)))


def test_shapes_that_do_not_fit_are_all_listed() -> None:
    face = synthetic_face()
    with pytest.raises(InputError, match=r"(?s)ranges has shape \(5, 2\).*gram has shape \(2, 2\)"):
        train_mapping(references(), ranges=face.ranges[:5], gram=np.eye(2))


def test_an_unknown_method_lists_the_known() -> None:
    with pytest.raises(InputError, match="no method 'magic'; choose one of auto, d06, face_map"):
        train_mapping(references(), ranges=synthetic_face().ranges, gram=None, method="magic")


def test_progress_runs_from_nothing_to_all() -> None:
    heard: list[float] = []
    train.train_mapping(
        references(),
        ranges=synthetic_face().ranges,
        gram=None,
        progress=lambda fraction, message: heard.append(fraction),
    )
    assert heard == sorted(heard)
    assert (heard[0], heard[-1]) == (0.0, 1.0)


def test_shapes_that_no_marker_shows_do_not_decide() -> None:
    rng = np.random.default_rng(0)
    weights = rng.uniform(size=(40, 3))
    near, chance = 0.05 * rng.normal(size=(40, 3)), weights - weights.mean(axis=0)
    gaze = np.array([False, False, True])
    errors = [np.where(gaze, 1.1 * chance, near), np.where(gaze, 1.3 * chance, 2 * near)]
    assert observable_shapes(errors, weights).tolist() == [True, True, False]
    assert observable_shapes([], weights).all()
    assert observable_shapes([chance], weights).all()


def test_a_shape_that_no_pair_uses_decides_too() -> None:
    weights = np.random.default_rng(0).random((40, 2)) * [1.0, 0.0]
    assert observable_shapes([0.1 * weights], weights).tolist() == [True, True]
    assert observable_shapes([weights * 0.1 + [0.0, 0.2]], weights).tolist() == [True, True]


def test_shapes_that_a_method_cannot_predict_are_among_its_errors() -> None:
    """Markers show them, as the default method predicts them."""
    face = synthetic_face(bend=0.3)
    mapping = train_mapping(
        references_of(face, CHOSEN),
        ranges=face.ranges,
        gram=face.gram,
        method="d06",
        choices=Choices(dimensions=(1,)),
    )
    assert mapping.settings["unobservable_shapes"] == 0
