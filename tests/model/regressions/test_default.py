"""What is particular to the default method; what all methods share is in test_train."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.model.synthetic import RIGID, SyntheticFace, references_of, sample_skin, synthetic_face
from usdface.core.assets import TrainedMapping
from usdface.core.errors import InputError
from usdface.core.rig_logic import Combination
from usdface.model.mapping import regions
from usdface.model.mapping.predict import WeightPredictor
from usdface.model.mapping.train import train_mapping
from usdface.model.regressions import face_map, frame_solve
from usdface.model.regressions.base import Choices, RestPlaces
from usdface.model.regressions.bent_weights import bend, unbend, unbend_slope

pytestmark = pytest.mark.usefixtures("without_comparison")

CHOSEN = np.arange(0, 1200, 30)


def trained(*, skin: bool, bent: float = 0.0, chosen: np.ndarray = CHOSEN) -> TrainedMapping:
    face = synthetic_face(bend=bent)
    return train_mapping(
        references_of(face, chosen),
        ranges=face.ranges,
        gram=face.gram,
        skin=sample_skin(face.shapes.reshape(len(face.shapes), -1)) if skin else None,
        method="face_map",
    )


def rms(mapping: TrainedMapping, *, seed: int, bent: float = 0.0) -> float:
    face = synthetic_face(bend=bent, seed=seed)
    error = WeightPredictor(mapping).predict(face.positions).weights - face.weights
    return float(np.sqrt((error**2).mean()))


def test_geometry_helps_where_pairs_are_few() -> None:
    few = np.arange(0, 1200, 200)
    with_skin = rms(trained(skin=True, chosen=few), seed=3)
    without = rms(trained(skin=False, chosen=few), seed=3)
    assert with_skin < 0.8 * without


@pytest.mark.parametrize("skin", [False, True])
def test_more_dimensions_than_the_take_moves_in_do_no_harm(skin: bool) -> None:
    """Six shapes without noise move in six dimensions; the other components are still."""
    face = synthetic_face(noise=0.0)
    pairs = references_of(face, CHOSEN)
    assert pairs.motion is not None
    still = np.where(np.arange(len(pairs.motion.variances)) < 6, pairs.motion.variances, 0.0)
    mapping = train_mapping(
        replace(pairs, motion=replace(pairs.motion, variances=still)),
        ranges=face.ranges,
        gram=face.gram,
        skin=sample_skin(face.shapes.reshape(len(face.shapes), -1)) if skin else None,
        method="face_map",
        choices=Choices((20,)),
    )
    error = WeightPredictor(mapping).predict(face.positions).weights - face.weights
    assert np.sqrt((error**2).mean()) < 0.02


def saturating(seed: int) -> SyntheticFace:
    """Skin that gives way the less the further it has moved."""
    face = synthetic_face(seed=seed)
    moved = face.positions - face.neutral
    far = np.linalg.norm(moved, axis=2, keepdims=True)
    return replace(face, positions=face.neutral + moved / (1 + far / 15))


@pytest.mark.parametrize("skin", [False, True])
def test_it_is_better_than_a_line_on_skin_that_saturates(skin: bool) -> None:
    face, new = saturating(0), saturating(3)
    errors = []
    for method in ("ridge", "face_map"):
        mapping = train_mapping(
            references_of(face, CHOSEN),
            ranges=face.ranges,
            gram=face.gram,
            skin=sample_skin(face.shapes.reshape(len(face.shapes), -1)) if skin else None,
            method=method,
        )
        error = WeightPredictor(mapping).predict(new.positions).weights - new.weights
        errors.append(np.sqrt((error**2).mean()))
    assert errors[1] < 0.8 * errors[0]


def test_the_curve_finds_skin_that_slows_down() -> None:
    face = synthetic_face()
    slowing = 1.4 * face.weights - 0.4 * face.weights**2
    positions = face.neutral + np.einsum("fs,smc->fmc", slowing, face.shapes)
    mapping = train_mapping(
        references_of(replace(face, positions=positions), CHOSEN),
        ranges=face.ranges,
        gram=face.gram,
        skin=sample_skin(face.shapes.reshape(len(face.shapes), -1)),
        method="face_map",
    )
    assert 0.25 < float(mapping.settings["curve"]) < 0.5


def test_ranges_of_any_width_give_the_same_face() -> None:
    """A shape of range [0, 2] at twice the weight is the same shape."""
    face = synthetic_face(bend=0.2)
    first = trained(skin=True, bent=0.2)
    wide = replace(
        face,
        weights=2 * face.weights,
        ranges=2 * face.ranges,
        shapes=face.shapes / 2,
        gram=face.gram / 4,
    )
    second = train_mapping(
        references_of(wide, CHOSEN),
        ranges=wide.ranges,
        gram=wide.gram,
        skin=sample_skin(wide.shapes.reshape(len(wide.shapes), -1)),
        method="face_map",
    )
    new = synthetic_face(bend=0.2, seed=3).positions[:200]
    expected = 2 * WeightPredictor(first).predict(new).weights
    np.testing.assert_allclose(WeightPredictor(second).predict(new).weights, expected, atol=1e-6)


def test_skin_of_other_shapes_is_refused() -> None:
    face = synthetic_face()
    skin = sample_skin(face.shapes.reshape(len(face.shapes), -1))
    pairs = references_of(face, CHOSEN)
    with pytest.raises(InputError, match="references have 6 shapes; sample the rig's shapes"):
        train_mapping(pairs, ranges=face.ranges, gram=face.gram, skin=skin[:4])
    with pytest.raises(InputError, match="skin holds values that are not finite"):
        train_mapping(pairs, ranges=face.ranges, gram=face.gram, skin=skin * np.nan)


def test_skin_samples_are_points_that_move(monkeypatch: pytest.MonkeyPatch) -> None:
    face = synthetic_face()
    flat = face.shapes.reshape(len(face.shapes), -1)
    whole = sample_skin(flat)
    np.testing.assert_array_equal(whole, face.shapes[:, RIGID:])
    monkeypatch.setattr(regions, "SKIN_POINTS", 7)
    assert sample_skin(flat).shape == (len(face.shapes), 7, 3)


@given(
    weight=st.floats(-0.5, 1.5, allow_nan=False),
    curve=st.sampled_from([0.0, 0.15, 0.3, 0.45, 0.9]),
)
def test_unbending_undoes_bending(weight: float, curve: float) -> None:
    bent = bend(np.array([weight]), curve)
    np.testing.assert_allclose(unbend(bent, curve), weight, atol=1e-9)
    assert bend(np.array([0.0, 1.0]), curve).tolist() == [0.0, 1.0]


@pytest.mark.parametrize("curve", [0.0, 0.3, 0.45])
def test_the_slope_of_unbending_is_its_derivative(curve: float) -> None:
    bent, step = np.linspace(-0.2, 1.2, 15), 1e-6
    difference = unbend(bent + step, curve) - unbend(bent - step, curve)
    inside = np.abs(bent * (1 - bent)) > 1e-3  # at 0 and 1 the second derivative jumps
    np.testing.assert_allclose(
        unbend_slope(bent, curve)[inside], (difference / (2 * step))[inside], rtol=1e-6
    )


def test_shapes_that_references_only_use_together_are_told_apart() -> None:
    """A wink that no reference shows is a wink."""
    face = synthetic_face()
    both = face.weights.copy()
    both[:, 1] = both[:, 0]  # as lids close together

    def markers(weights: np.ndarray) -> np.ndarray:
        return face.neutral + np.einsum("fs,smc->fmc", weights, face.shapes)

    shown = replace(face, weights=both, positions=markers(both))
    mapping = train_mapping(
        references_of(shown, np.arange(0, 1200, 30)),
        ranges=face.ranges,
        gram=face.gram,
        skin=sample_skin(face.shapes.reshape(len(face.shapes), -1)),
        method="face_map",
    )
    wink = np.zeros((5, both.shape[1]))
    wink[:, 0] = np.linspace(0.2, 1.0, 5)
    found = WeightPredictor(mapping).predict(markers(wink)).weights
    assert found[-1, 0] > 0.75
    assert found[-1, 1] < 0.25


def test_the_regression_itself_knows_a_wink_though_both_eyes_close_in_all_takes() -> None:
    """Components of the takes would pass half of a wink to the other eye."""
    face = synthetic_face()
    one_side = (face.neutral[:, 0] > np.median(face.neutral[:, 0]))[:, None]
    shapes = face.shapes.copy()
    shapes[0] *= one_side
    shapes[1] *= ~one_side
    both = face.weights.copy()
    both[:, 1] = both[:, 0]
    noise = np.random.default_rng(0).normal(0, 0.1, face.positions.shape)
    performed = face.neutral + 1.2 * np.einsum("fs,smc->fmc", both, shapes) + noise
    mapping = train_mapping(
        references_of(replace(face, weights=both, positions=performed), CHOSEN),
        ranges=face.ranges,
        gram=face.gram,
        skin=sample_skin(shapes.reshape(len(shapes), -1)),
        method="face_map",
    )
    wink = np.full((1, len(shapes)), 0.5)
    wink[:, :2] = [1.0, 0.0]
    moved = 1.2 * np.einsum("fs,smc->fmc", wink, shapes).reshape(1, -1)
    assert face_map.METHOD.prepare_process is not None
    predict = face_map.METHOD.prepare_process(mapping.arrays, mapping.settings)
    np.testing.assert_allclose(predict(moved)[0][0, :2], [1.0, 0.0], atol=0.05)
    _, deviation = predict(np.array([[1.0], [3.0], [9.0]]) * moved)
    assert (np.diff(deviation[:, :2], axis=0) > 0).all()  # farther from the references


def test_rigs_of_very_many_shapes_are_solved_without_a_matrix_for_each_frame(monkeypatch) -> None:
    """Without the quadratic part both ways minimise the same sum."""
    mapping = trained(skin=True)
    new = synthetic_face(seed=3).positions[:100]
    each = WeightPredictor(mapping).predict(new)
    monkeypatch.setattr(frame_solve, "_MAX_DENSE_SHAPES", 0)
    shared = WeightPredictor(mapping).predict(new)
    assert np.abs(shared.weights - each.weights).mean() < 0.02
    ratio = shared.uncertainty[:, 0] / each.uncertainty[:, 0]
    assert 0.3 < np.median(ratio) < 3


def test_many_shapes_share_regions(monkeypatch) -> None:
    alone = rms(trained(skin=True), seed=3)
    monkeypatch.setattr(face_map, "_MAX_REGIONS", 3)
    mapping = trained(skin=True)
    assert len(mapping.arrays["projection"]) <= 3
    assert rms(mapping, seed=3) < 2 * alone


def test_a_pair_keyed_for_another_frame_is_named() -> None:
    face = synthetic_face()
    pairs = references_of(face, CHOSEN)
    rng = np.random.default_rng(0)
    keys = np.clip(pairs.weights * (1 + 0.05 * rng.normal(size=pairs.weights.shape)), 0, 1)
    keys[7] = 1 - keys[7]
    mapping = train_mapping(
        replace(pairs, weights=keys),
        ranges=face.ranges,
        gram=face.gram,
        skin=sample_skin(face.shapes.reshape(len(face.shapes), -1)),
        method="face_map",
    )
    assert str(mapping.settings["contradicted"]).startswith(f"take {CHOSEN[7]} (")


def test_markers_do_not_move_a_tongue_that_the_jaw_moves_as_it_moves_them() -> None:
    """Points of the tongue move with the jaw as chin markers do; none of these is on it."""
    face = synthetic_face()
    pairs = references_of(face, CHOSEN)
    shapes = np.concatenate([face.shapes, np.zeros((1, *face.shapes.shape[1:]))])
    inner = 1.02 * shapes[:, RIGID : RIGID + 4]
    inner[-1] = 5.0
    shapes[:, RIGID : RIGID + 4] *= 1.1  # the rig's skin is a little off, and the tongue is not
    mapping = train_mapping(
        replace(
            pairs,
            shape_names=(*pairs.shape_names, "tongueOut"),
            weights=np.column_stack([pairs.weights, np.zeros(len(pairs.weights))]),
        ),
        ranges=np.tile([0.0, 1.0], (len(shapes), 1)),
        gram=np.einsum("smc,tmc->st", shapes, shapes) / shapes.shape[1],
        skin=np.concatenate([shapes, inner], axis=1),
        method="face_map",
    )
    moved = face.positions[:200].copy()
    moved[:, RIGID : RIGID + 4] += 2.0
    assert WeightPredictor(mapping).predict(moved).weights[:, -1].max() < 0.02


def test_gaze_without_keys_stays_at_rest() -> None:
    """A shape of the lids' markers that no pair keys takes motion that the references lack."""
    face = synthetic_face()
    pairs = references_of(face, CHOSEN)
    lids = np.zeros((1, *face.shapes.shape[1:]))
    lids[:, RIGID : RIGID + 4] = 3.0
    shapes = np.concatenate([face.shapes, lids])
    moved = face.positions[:200].copy()
    moved[:, RIGID : RIGID + 4] += 2.0
    found = []
    for name in ("eyeLookUp_L", "other"):
        mapping = train_mapping(
            replace(
                pairs,
                shape_names=(*pairs.shape_names, name),
                weights=np.column_stack([pairs.weights, np.zeros(len(pairs.weights))]),
            ),
            ranges=np.tile([0.0, 1.0], (len(shapes), 1)),
            gram=np.einsum("smc,tmc->st", shapes, shapes) / shapes.shape[1],
            skin=shapes,
            method="face_map",
        )
        found.append(WeightPredictor(mapping).predict(moved).weights[:, -1].max())
    assert found[0] < 0.01
    assert found[1] > 0.3


@pytest.mark.parametrize("count", [2, 3, 4])
def test_very_few_pairs_give_what_geometry_can(count: int) -> None:
    face = synthetic_face()
    mapping = train_mapping(
        references_of(face, np.arange(0, 1200, 1200 // count)[:count]),
        ranges=face.ranges,
        gram=face.gram,
        skin=sample_skin(face.shapes.reshape(len(face.shapes), -1)),
        rest=RestPlaces(face.neutral[RIGID:]),
        method="face_map",
    )
    found = WeightPredictor(mapping).predict(face.positions[:50])
    assert np.isfinite(found.weights).all()
    assert np.isfinite(found.uncertainty).all()


def test_in_betweens_of_the_rig_are_followed() -> None:
    """Skin that leaves the line between neutral and full shape, as lids do around an eyeball."""
    aside = 0.4 * synthetic_face().shapes[:, :, [1, 2, 0]]

    def between(seed: int) -> SyntheticFace:
        face = synthetic_face(seed=seed)
        hat = 1 - np.abs(face.weights - 0.5) / 0.5
        moved = np.einsum("fs,smc->fmc", hat, aside)
        return replace(face, positions=face.positions + moved)

    face, new, errors = between(0), between(3), []
    in_betweens = tuple(
        Combination(f"{name}@0.5", (name,), weights=(0.5,))
        for name in references_of(face, CHOSEN).shape_names
    )
    for combinations in ((), in_betweens):
        motion = [face.shapes, aside] if combinations else [face.shapes]
        mapping = train_mapping(
            replace(references_of(face, CHOSEN), combinations=combinations),
            ranges=face.ranges,
            gram=face.gram,
            skin=np.concatenate(motion),
            method="face_map",
        )
        solved = WeightPredictor(mapping).predict(new.positions).weights
        errors.append(float(np.sqrt(((solved - new.weights) ** 2).mean())))
    assert errors[1] < 0.7 * errors[0]
