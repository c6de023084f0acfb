"""Frames worth tuning: what each way of choosing promises."""

import numpy as np
import pytest

from usdface.core.assets import MotionSpace
from usdface.model.mapping.coverage import CoverageModel
from usdface.model.mapping.motion_space import motion_from_pca
from usdface.model.mapping.regions import membership, region_points
from usdface.model.selection.coverage import (
    Coverage,
    choose_next_frames,
    measure_coverage,
    measure_growth,
)
from usdface.model.selection.design import (
    Segment,
    SelectionSpace,
    WeightProposals,
    choose_by_design,
    choose_visemes,
    extreme_frames,
    limit_candidates,
    proposal_error_mm,
    selection_space,
    viseme_frames,
)
from usdface.numerics.regression.pca import fit_pca

NONE = np.zeros(0, dtype=np.int64)
SHAPES = ("jawOpen", "eyeBlinkLeft", "browDownLeft", "mouthSmileLeft")


def small_face(frames: int = 600) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Weights, packed markers and what each shape does: a jaw of 30 mm, a lid of 3 mm."""
    rng = np.random.default_rng(0)
    weights = np.abs(np.sin(np.cumsum(rng.normal(0, 0.15, (frames, 4)), axis=0)))
    weights[:, 1] = np.abs(np.arange(frames) % 60 - 30) < 4  # blinks are short and rare
    shapes = np.zeros((4, 12, 3))
    sizes = (30.0, 3.0, 6.0, 10.0)
    for shape, size in enumerate(sizes):
        shapes[shape, 3 * shape : 3 * shape + 3] = rng.normal(0, size / 3, (3, 3))
    packed = (weights @ shapes.reshape(4, -1)) + rng.normal(0, 0.02, (frames, 36))
    return weights, packed, shapes


def space_of(weights: np.ndarray, packed: np.ndarray) -> tuple[MotionSpace, SelectionSpace]:
    motion = motion_from_pca(fit_pca(packed, dimensions=8), packed)
    return motion, selection_space(motion, weights, SHAPES)


def test_every_region_counts_alike_however_far_it_moves() -> None:
    weights, packed, _ = small_face()
    motion, space = space_of(weights, packed)
    features = space.features(motion.sample)
    assert space.regions == ("brows", "lids", "mouth", "jaw")
    sizes = [(features[:, a:b] ** 2).sum(axis=1).mean() for a, b in space.columns]
    np.testing.assert_allclose(sizes, 1.0, rtol=1e-9)
    np.testing.assert_allclose(features.mean(axis=0), 0.0, atol=1e-9)


def test_a_blink_stands_out_in_its_region_as_a_jaw_does_in_its() -> None:
    weights, packed, _ = small_face()
    motion, space = space_of(weights, packed)
    features = space.features(motion.sample)
    a, b = space.columns[space.regions.index("lids")]
    shut = weights[:, 1] > 0.5
    apart = np.linalg.norm(features[shut][:, a:b].mean(0) - features[~shut][:, a:b].mean(0))
    whole = np.linalg.norm(motion.sample[shut].mean(0) - motion.sample[~shut].mean(0))
    spread = np.sqrt(motion.sample.var(axis=0).sum())
    assert apart > 2 * whole / spread


def test_shapes_without_telling_names_make_one_region() -> None:
    weights, packed, _ = small_face()
    motion = motion_from_pca(fit_pca(packed, dimensions=8), packed)
    space = selection_space(motion, weights, ("s1", "s2", "s3", "s4"))
    assert space.regions == ("face",)
    assert space.features(motion.sample).shape == (len(packed), 8)


def proposals_of(features: np.ndarray, weights: np.ndarray) -> WeightProposals:
    return WeightProposals(features, weights, lambda rows: weights[rows], np.eye(4))


def test_the_design_that_teaches_best_is_taken_and_blinks_are_in_it() -> None:
    weights, packed, _ = small_face()
    motion, space = space_of(weights, packed)
    features = space.features(motion.sample)
    everything = np.ones(len(features), bool)
    proposals = proposals_of(features, weights)
    choice = choose_by_design(
        features, 12, already=NONE, candidates=everything, proposals=proposals
    )
    assert choice.measured_mm[choice.design] == min(choice.measured_mm.values())
    assert len(choice.measured_mm) == 3
    assert len(set(choice.rows.tolist())) == 12
    assert weights[choice.rows, 1].any()
    rng = np.random.default_rng(0)
    picks = [rng.choice(len(features), 12, replace=False) for _ in range(10)]
    by_chance = [proposal_error_mm(features[rows], weights[rows], proposals) for rows in picks]
    assert choice.measured_mm[choice.design] < np.median(by_chance)


def test_no_choice_repeats_a_tuned_frame_or_leaves_the_candidates() -> None:
    weights, packed, _ = small_face(200)
    motion, space = space_of(weights, packed)
    features = space.features(motion.sample)
    candidates = np.arange(200) >= 100
    already = np.array([5, 120, 150])
    designed = choose_by_design(
        features,
        90,
        already=already,
        candidates=candidates,
        proposals=proposals_of(features, weights),
    ).rows
    assert len(set(designed.tolist())) == 90
    assert designed.min() >= 100
    assert not set(designed.tolist()) & set(already.tolist())


def test_a_long_recording_is_thinned_to_its_peaks() -> None:
    rng = np.random.default_rng(0)
    features = rng.normal(size=(1000, 3))
    candidates = rng.random(1000) < 0.7
    pool = limit_candidates(features, candidates, limit=100)
    assert len(pool) == len(set(pool.tolist())) == 100
    assert candidates[pool].all()
    size = (features**2).sum(axis=1)
    assert int(np.where(candidates, size, -1).argmax()) in pool
    np.testing.assert_array_equal(
        limit_candidates(features, candidates, limit=1000), np.flatnonzero(candidates)
    )


def spoken(rng: np.random.Generator, rows: int) -> list[Segment]:
    kinds = [(v, e) for v in ("b", "ae", "s") for e in ("joy", "anger")]
    return [
        Segment(int(row), int(rng.integers(3, 12)), *kinds[int(rng.integers(len(kinds)))])
        for row in np.arange(2, rows, 5)
    ]


def test_every_viseme_of_every_emotion_gets_its_most_typical_frame_once() -> None:
    rng = np.random.default_rng(0)
    features = rng.normal(size=(300, 4))
    segments = spoken(rng, 300)
    found = viseme_frames(features, segments, candidates=np.ones(300, bool))
    assert len(found) == len(set(found.values())) == 6
    for (emotion, viseme), row in found.items():
        own = [s for s in segments if (s.emotion, s.viseme) == (emotion, viseme)]
        middle = np.median(features[[s.row for s in own]], axis=0)
        long = [s for s in own if s.frames >= np.median([s.frames for s in own])]
        nearest = min(long, key=lambda s: np.linalg.norm(features[s.row] - middle))
        assert row == nearest.row


def test_extremes_are_of_each_emotion_and_far_out() -> None:
    rng = np.random.default_rng(0)
    features = rng.normal(size=(400, 3))
    emotion = ["joy"] * 200 + ["anger"] * 200
    far = extreme_frames(
        features, emotion, 10, candidates=np.ones(400, bool), already=np.array([3, 300])
    )
    assert {name: len(rows) for name, rows in far.items()} == {"joy": 10, "anger": 10}
    assert max(far["joy"]) < 200 <= min(far["anger"])
    chosen = [row for rows in far.values() for row in rows]
    assert not {3, 300} & set(chosen)
    size = np.linalg.norm(features, axis=1)
    assert size[chosen].mean() > 1.5 * size.mean()


def test_an_emotion_without_a_frame_to_choose_has_no_extremes() -> None:
    features = np.random.default_rng(0).normal(size=(40, 3))
    emotion = ["joy"] * 20 + ["anger"] * 20
    only_joy = np.arange(40) < 20
    none = np.zeros(0, dtype=np.int64)
    far = extreme_frames(features, emotion, 5, candidates=only_joy, already=none)
    assert (len(far["joy"]), far["anger"]) == (5, [])
    far = extreme_frames(features, emotion, 0, candidates=only_joy, already=none)
    assert far == {"joy": [], "anger": []}


def test_the_papers_count_is_15_visemes_and_10_extremes_an_emotion() -> None:
    rng = np.random.default_rng(0)
    emotions = ("neutral", "joy", "anger", "sadness")
    visemes = [f"v{i}" for i in range(15)]
    segments, emotion_of = [], []
    for emotion in emotions:
        start = len(emotion_of)
        segments += [Segment(start + 5 * i, 5, visemes[i % 15], emotion) for i in range(60)]
        emotion_of += [emotion] * 300
    features = rng.normal(size=(1200, 5))
    choice = choose_visemes(
        features,
        1000,
        segments=segments,
        emotion_of=emotion_of,
        visemes=visemes,
        extremes=10,
        already=NONE,
        candidates=np.ones(1200, bool),
    )
    assert len(set(choice.rows.tolist())) == 15 * 4 + 10 * 4
    assert len(choice.visemes) == 60
    assert len(choice.extremes) == 40
    assert not choice.missing


def test_visemes_that_nobody_speaks_are_named() -> None:
    segments = [Segment(1, 3, "b", "joy"), Segment(5, 3, "s", "anger")]
    choice = choose_visemes(
        np.eye(10),
        4,
        segments=segments,
        emotion_of=["joy"] * 4 + ["anger"] * 6,
        visemes=("b", "ch", "s"),
        extremes=0,
        already=NONE,
        candidates=np.ones(10, bool),
    )
    assert choice.missing == (("joy", "ch"), ("joy", "s"), ("anger", "b"), ("anger", "ch"))


def model_of(shapes: np.ndarray, shown: np.ndarray) -> tuple[CoverageModel, tuple[str, ...]]:
    points = region_points(SHAPES, shapes)
    return CoverageModel(shapes, shown, membership(points, shapes.shape[1])), tuple(points)


def test_coverage_grows_with_every_pair_and_ends_at_the_whole() -> None:
    _, packed, shapes = small_face(150)
    moved = packed.reshape(150, 12, 3)
    rows = np.arange(0, 150, 5)
    model, _ = model_of(shapes, moved[rows])
    growth = measure_growth(model, np.array([7, 8, 9]), moved.__getitem__, 150)
    assert growth.share[0] == 0.0
    assert (np.diff(growth.share) >= -1e-12).all()
    assert growth.next_share[0] >= growth.share[-1] - 1e-12
    assert len(growth.next_share) == 3
    for count in (0, 1, 10, 30):
        model, regions = model_of(shapes, moved[rows[:count]])
        coverage = measure_coverage(model, regions, moved.__getitem__, 150)
        assert coverage.mean == pytest.approx(growth.share[count], abs=1e-9)
        assert coverage.regions == ("brows", "lids", "mouth", "jaw")
        assert coverage.by_region.shape == (150, 4)
        assert ((coverage.face >= 0) & (coverage.face <= 1)).all()
    model, regions = model_of(shapes, moved)
    assert measure_coverage(model, regions, moved.__getitem__, 150).mean > 0.97


def test_the_frame_with_the_least_coverage_is_named_first() -> None:
    weights, packed, shapes = small_face(300)
    motion, space = space_of(weights, packed)
    features = space.features(motion.sample)
    ordinary = np.flatnonzero(weights[:, 1] < 0.5)[::20]
    everything = np.ones(300, dtype=np.bool_)
    further = choose_next_frames(features, features[ordinary], count=3, candidates=everything)
    assert weights[further[0], 1] > 0.5
    moved = packed.reshape(300, 12, 3)
    model, regions = model_of(shapes, moved[ordinary])
    coverage = measure_coverage(model, regions, moved.__getitem__, 300)
    lids = coverage.by_region[:, coverage.regions.index("lids")]
    shut = weights[:, 1] > 0.5
    assert lids[shut].mean() < lids[~shut].mean() - 0.1


def test_the_sufficient_share_counts_frames_with_a_coverage_of_three_quarters_or_more() -> None:
    face = np.array([1.0, 0.8, 0.76, 0.74, 0.1])
    found = Coverage(face, (), np.zeros((5, 0)))
    assert found.sufficient_share == pytest.approx(3 / 5)
    assert found.mean == pytest.approx(0.68)
