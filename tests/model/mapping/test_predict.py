from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from tests.model.synthetic import MARKERS, SyntheticFace, references_of, synthetic_face
from tests.usdio.small_rig import small_rig
from usdface.core.assets import TrainedMapping
from usdface.core.errors import InputError
from usdface.model.mapping import uncertainty
from usdface.model.mapping.head_space import MINIMUM_SHARE
from usdface.model.mapping.motion_space import marker_coordinates, motion_of, noise_variance
from usdface.model.mapping.performer_face import face_of_mapping
from usdface.model.mapping.predict import WeightPredictor, basis_of
from usdface.model.mapping.train import train_mapping
from usdface.model.regressions import MAPPING_METHODS, REMOVED_METHODS, find_method


def trained(face: SyntheticFace, method: str = "ridge") -> TrainedMapping:
    chosen = np.arange(0, len(face.positions), 30)
    return train_mapping(
        references_of(face, chosen), ranges=face.ranges, gram=face.gram, method=method
    )


def test_weights_stay_within_their_ranges() -> None:
    face = synthetic_face(bend=0.5)
    weights = WeightPredictor(trained(face)).predict(face.positions * 1.2).weights
    assert weights.min() >= 0.0
    assert weights.max() <= 1.0


def test_frames_do_not_depend_on_their_neighbours() -> None:
    face = synthetic_face()
    mapping = trained(face, "rbf")
    whole = WeightPredictor(mapping).predict(face.positions)
    part = WeightPredictor(mapping).predict(face.positions[500:510])
    np.testing.assert_allclose(part.weights, whole.weights[500:510], atol=1e-12)
    np.testing.assert_allclose(part.uncertainty, whole.uncertainty[500:510], rtol=1e-4)


def test_unseen_markers_are_spoken_for_by_the_others() -> None:
    face = synthetic_face(noise=0.01)
    mapping = trained(face)
    visible = np.ones(face.positions.shape[:2], dtype=bool)
    visible[:, [6, 11, 17]] = False
    hidden = face.positions.copy()
    hidden[~visible] = np.nan
    prediction = WeightPredictor(mapping).predict(hidden, visible=visible)
    whole = WeightPredictor(mapping).predict(face.positions)
    assert np.sqrt(((prediction.weights - whole.weights) ** 2).mean()) < 0.02
    assert prediction.uncertainty[:, 0].mean() > whole.uncertainty[:, 0].mean()


@pytest.mark.parametrize("method", ["ridge", "face_map"])
def test_filled_samples_move_weights_as_others_and_are_believed_as_far_as_known(
    method: str, monkeypatch
) -> None:
    monkeypatch.setattr(uncertainty, "_LEAST_KEY_ERROR", 0.0)  # of the keys, not of the samples
    face = synthetic_face()
    mapping, clip = trained(face, method), face.positions[500:600]
    confidence = np.ones(clip.shape[:2], np.float32)
    confidence[10:20] = 0.95  # a sample seen just before
    confidence[30:40, ::2] = 0.05
    confidence[50:60] = 0.01
    seen = WeightPredictor(mapping).predict(clip)
    found = WeightPredictor(mapping).predict(clip, confidence=confidence)
    np.testing.assert_array_equal(found.weights, seen.weights)
    ratio = found.uncertainty[:, 0] / seen.uncertainty[:, 0]
    assert (np.delete(ratio, [*range(30, 40), *range(50, 60)]) == 1).all()
    assert ratio[30:40].min() > 1.1
    unseen = WeightPredictor(mapping).predict(clip, visible=confidence > 0.02)
    np.testing.assert_allclose(found.uncertainty[50:60], unseen.uncertainty[50:60], rtol=0.4)
    alone = WeightPredictor(mapping).predict(clip[35:36], confidence=confidence[35:36])
    np.testing.assert_allclose(alone.uncertainty, found.uncertainty[35:36], rtol=1e-3)


def test_with_no_marker_seen_nothing_is_certain() -> None:
    face = synthetic_face()
    mapping = trained(face)
    prediction = WeightPredictor(mapping).predict(
        np.full((3, MARKERS, 3), np.nan),
        visible=np.zeros((3, MARKERS), dtype=bool),
    )
    assert np.isfinite(prediction.weights).all()
    seen = WeightPredictor(mapping).predict(face.positions[:3]).uncertainty[:, 0]
    assert (prediction.uncertainty[:, 0] > 10 * seen).all()


def test_a_frame_below_the_stated_share_of_markers_is_named() -> None:
    face = synthetic_face()
    visible = np.ones((3, MARKERS), dtype=bool)
    least = int(np.ceil(MINIMUM_SHARE * MARKERS))
    visible[1, least:] = False
    visible[2, least - 1 :] = False
    prediction = WeightPredictor(trained(face)).predict(face.positions[:3], visible=visible)
    assert prediction.few_markers.tolist() == [False, False, True]


def test_a_region_whose_markers_the_take_lacks_has_no_markers() -> None:
    mapping = trained(synthetic_face())
    table = np.ones((3, MARKERS))
    table[1, 2:] = table[2, :2] = 0
    mapping = replace(
        mapping,
        arrays=mapping.arrays | {"region_markers": table},
        settings=mapping.settings | {"regions": "face,brows,mouth", "pairs": 9, "tuned": 9},
    )
    for lost, without in ((1, ()), (2, ("brows",))):
        basis = basis_of(mapping, small_rig(), missing=mapping.marker_names[:lost])
        assert basis is not None
        assert basis.regions_without_markers == without


def test_a_mapping_without_any_of_its_arrays_is_refused_or_read() -> None:
    """Each array missing: nothing but InputError may escape, where a take is mapped."""
    mapping = trained(synthetic_face())
    settings = mapping.settings | {"pairs": 9, "tuned": 9}
    refused = set()
    for array in mapping.arrays:
        left = {other: each for other, each in mapping.arrays.items() if other != array}
        damaged = replace(mapping, arrays=left, settings=settings)
        for read in (face_of_mapping, partial(basis_of, rig=small_rig())):
            try:
                read(damaged)
            except InputError:
                refused.add(array)
    assert {"motion_components", "takes_sample", "forward_dual", "forward_scales"} <= refused


@pytest.mark.parametrize("takes", ["[", "7", "[{}]"])
def test_takes_of_pairs_that_cannot_be_read_are_refused(takes: str) -> None:
    mapping = trained(synthetic_face())
    damaged = replace(mapping, settings=mapping.settings | {"pair_takes": takes})
    with pytest.raises(InputError, match="pairs do not fit its takes"):
        face_of_mapping(damaged)


def test_uncertainty_is_low_at_references_and_grows_with_strange_faces() -> None:
    face = synthetic_face()
    mapping = trained(face)
    at_references = WeightPredictor(mapping).predict(face.positions[::30]).uncertainty[:, 0]
    medians = []
    for gain in (1.0, 2.0, 4.0, 8.0):
        strange = face.neutral + gain * (face.positions - face.neutral)
        medians.append(np.median(WeightPredictor(mapping).predict(strange).uncertainty[:, 0]))
    assert medians == sorted(medians)
    assert medians[-1] > 5 * at_references.max()


def test_residual_tells_a_swapped_pair_of_markers() -> None:
    face = synthetic_face()
    mapping = trained(face)
    swapped = face.positions.copy()
    swapped[:, [8, 15]] = swapped[:, [15, 8]]
    clean = WeightPredictor(mapping).predict(face.positions).residual_mm[:, 0]
    assert WeightPredictor(mapping).predict(swapped).residual_mm[:, 0].min() > 5 * clean.max()


def test_no_frames_give_no_weights() -> None:
    face = synthetic_face()
    assert WeightPredictor(trained(face)).predict(face.positions[:0]).weights.shape == (0, 6)


def test_positions_that_do_not_fit_are_refused() -> None:
    face = synthetic_face()
    mapping = trained(face)
    with pytest.raises(InputError, match=r"the mapping reads \(frames, 24, 3\)"):
        WeightPredictor(mapping).predict(face.positions[:, :5])
    broken = face.positions.copy()
    broken[7, 3] = np.nan
    with pytest.raises(InputError, match="marker m03 of frame index 7 is not finite; clean"):
        WeightPredictor(mapping).predict(broken)
    with pytest.raises(InputError, match="visible has shape"):
        WeightPredictor(mapping).predict(face.positions, visible=np.ones((2, 2), dtype=bool))


@pytest.mark.parametrize("method", ["ridge", "rbf", "face_map"])
def test_takes_in_single_precision_are_told_as_in_double(method: str) -> None:
    face = synthetic_face(noise=0.05)
    mapping = trained(face, method)
    single = face.positions.astype(np.float32)
    found = WeightPredictor(mapping).predict(single)
    wanted = WeightPredictor(mapping).predict(single.astype(np.float64))
    np.testing.assert_allclose(found.weights, wanted.weights, atol=1e-5)
    np.testing.assert_allclose(found.uncertainty, wanted.uncertainty, rtol=1e-3)
    np.testing.assert_allclose(found.residual_mm, wanted.residual_mm, atol=1e-4)


@pytest.mark.parametrize("name", sorted(MAPPING_METHODS))
def test_a_mapping_whose_arrays_do_not_fit_is_refused_or_read(name: str) -> None:
    """Each array missing, one row short, and empty: nothing but InputError may escape."""
    face = synthetic_face(frames=300)
    mapping = trained(face, name)
    refused = 0
    for array, value in mapping.arrays.items():
        left = {other: each for other, each in mapping.arrays.items() if other != array}
        for arrays in (left, left | {array: value[1:]}, left | {array: np.zeros((0,))}):
            try:
                WeightPredictor(replace(mapping, arrays=arrays)).predict(face.positions[:4])
            except InputError:
                refused += 1
    assert refused > len(mapping.arrays)


@pytest.mark.parametrize("name", sorted(set(MAPPING_METHODS) - {"face_map"}))
def test_blocks_of_frames_equal_the_method_that_was_judged_cut_off_at_the_ranges(name: str) -> None:
    face = synthetic_face(bend=0.5)
    mapping = trained(face, name)
    z = marker_coordinates(motion_of(mapping), face.positions)
    exact = find_method(name).predict(mapping.arrays, mapping.settings, z)
    exact = np.clip(exact, mapping.ranges[:, 0], mapping.ranges[:, 1])
    found = WeightPredictor(mapping).predict(face.positions).weights
    np.testing.assert_allclose(found, exact, atol=1e-9)


@pytest.mark.parametrize("name", sorted(REMOVED_METHODS))
def test_a_mapping_by_a_method_of_earlier_versions_is_to_be_trained_again(name: str) -> None:
    face = synthetic_face()
    with pytest.raises(InputError, match=f"trained by {name}, which was removed .*; train again"):
        WeightPredictor(replace(trained(face), method=name)).predict(face.positions)
    with pytest.raises(InputError, match=f"^method {name} was removed in .*; use auto or face_map"):
        trained(face, name)


def test_a_regression_on_components_of_earlier_versions_is_to_be_trained_again() -> None:
    face = synthetic_face()
    mapping = trained(face, "face_map")
    earlier = mapping.arrays | {"slope": mapping.arrays["slope"][:20]}
    with pytest.raises(InputError, match=r"reads 20 values a frame, such as .*; train it again"):
        WeightPredictor(replace(mapping, arrays=earlier)).predict(face.positions)


def test_arrays_that_earlier_versions_added_are_not_read() -> None:
    face = synthetic_face()
    mapping = trained(face, "face_map")
    more = replace(mapping, arrays=mapping.arrays | {"condensed_dual": np.ones((2, 4, 6))})
    np.testing.assert_array_equal(
        WeightPredictor(more).predict(face.positions).weights,
        WeightPredictor(mapping).predict(face.positions).weights,
    )


def test_unseen_markers_are_told_by_the_gaussian_of_the_motion_given_the_seen_ones() -> None:
    face = synthetic_face(bend=0.5, noise=0.3)
    motion = references_of(face, np.arange(0, 1200, 100)).motion
    assert motion is not None
    visible = np.ones((20, MARKERS), bool)
    visible[:, 7:15] = False
    found = marker_coordinates(motion, face.positions[:20], visible=visible)
    # the textbook's conditional mean: cov(z, x) cov(x, x)^-1 (x - mean), x = components' z + noise
    seen = np.repeat(visible[0], 3)
    basis = motion.components[:, seen]
    between = motion.variances[:, None] * basis
    within = basis.T @ between + noise_variance(motion) * np.eye(seen.sum())
    offsets = (face.positions[:20].reshape(20, -1) - motion.mean)[:, seen]
    np.testing.assert_allclose(found, offsets @ np.linalg.solve(within, between.T), atol=1e-8)
