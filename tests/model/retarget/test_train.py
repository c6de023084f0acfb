"""Retargeting: laws that hold for every method, and what each promises."""

from dataclasses import replace

import numpy as np
import pytest

from tests.usdio.small_creature import creature_acts, human_moves
from usdface.core.controls import Controls, ExpressionPairs, shape_controls
from usdface.core.errors import InputError
from usdface.model.regressions import RETARGET_METHODS
from usdface.model.retarget.control_space import (
    check_pairs,
    constant_controls,
    control_space,
    find_pair_conflicts,
    inseparable_sides,
    unused_shapes,
)
from usdface.model.retarget.train import (
    EQUAL_ROUND_TRIP_MM,
    OVERSHOOT_MARGIN,
    make_examples,
    retarget,
    round_trip,
    train_retargeting,
    unspanned_shares,
)
from usdface.steps.retarget.train import pair_notes

SHAPES = ("jawOpen", "eyeBlink", "smile")


def pairs_of(
    source: np.ndarray, target: Controls, shapes: tuple[str, ...] = SHAPES
) -> ExpressionPairs:
    return ExpressionPairs(("",) * len(source), shapes, source, target)


def creature_pairs(count: int = 34) -> ExpressionPairs:
    source = np.random.default_rng(0).random((count, 3)) ** 2
    source[0] = 0.0
    return pairs_of(source, creature_acts(source))


def linear_pairs(count: int = 30, shapes: int = 6) -> tuple[ExpressionPairs, np.ndarray]:
    rng = np.random.default_rng(0)
    matrix = rng.random((shapes, 9)) / shapes
    source = np.concatenate([np.zeros((1, shapes)), np.eye(shapes), rng.random((count, shapes))])
    names = tuple(f"s{i}" for i in range(shapes))
    target = shape_controls(tuple(f"t{i}" for i in range(9)), source @ matrix)
    return pairs_of(source, target, names), matrix


@pytest.mark.parametrize("method", ["rbf", "additive"])
def test_every_pair_is_met(method: str) -> None:
    pairs = creature_pairs()
    made = retarget(train_retargeting(pairs, method=method), pairs.source)
    np.testing.assert_allclose(made.weights, pairs.target.weights, atol=1e-8)
    np.testing.assert_allclose(made.values, pairs.target.values, atol=1e-8)
    np.testing.assert_allclose(made.translations, pairs.target.translations, atol=1e-8)
    np.testing.assert_allclose(
        np.abs(np.einsum("fji,fji->fj", made.rotations, pairs.target.rotations)), 1.0, atol=1e-12
    )


@pytest.mark.parametrize("method", ["ridge", "additive"])
def test_a_linear_relation_is_recovered_between_and_beyond_the_pairs(method: str) -> None:
    pairs, matrix = linear_pairs()
    trained = train_retargeting(pairs, method=method)
    unseen = np.random.default_rng(1).random((200, 6))
    np.testing.assert_allclose(retarget(trained, unseen).weights, unseen @ matrix, atol=2e-3)


@pytest.mark.parametrize("method", list(RETARGET_METHODS))
def test_rotations_stay_rotations_and_scales_positive(method: str) -> None:
    trained = train_retargeting(creature_pairs(), method=method)
    wild = np.random.default_rng(0).normal(0, 3, (500, 3))
    made = retarget(trained, wild)
    np.testing.assert_allclose(np.linalg.norm(made.rotations, axis=2), 1.0, atol=1e-12)
    assert (made.scales > 0).all()
    assert all(np.isfinite(part).all() for part in (made.weights, made.translations, made.values))


@pytest.mark.parametrize("method", list(RETARGET_METHODS))
def test_a_control_in_other_units_leaves_all_others_as_they_are(method: str) -> None:
    pairs = creature_pairs()
    target = replace(
        pairs.target, values=pairs.target.values * 180, translations=pairs.target.translations * 10
    )
    made, again = (
        retarget(train_retargeting(each, method=method), human_moves(60))
        for each in (pairs, replace(pairs, target=target))
    )
    np.testing.assert_allclose(again.weights, made.weights, atol=1e-6)
    np.testing.assert_allclose(again.values / 180, made.values, atol=1e-6)
    np.testing.assert_allclose(again.translations / 10, made.translations, atol=1e-6)


@pytest.mark.parametrize("method", list(RETARGET_METHODS))
def test_shapes_that_no_pair_moves_have_no_effect(method: str) -> None:
    pairs = creature_pairs()
    still = np.column_stack([pairs.source, np.zeros(34), np.full(34, 0.3)])
    given = pairs_of(still, pairs.target, (*SHAPES, "tongueOut", "browDown"))
    trained = train_retargeting(given, method=method)
    moves = human_moves(30)
    resting = np.column_stack([moves, np.tile([0.0, 0.3], (30, 1))])
    made = retarget(trained, np.column_stack([moves, moves[:, :2]]))
    np.testing.assert_allclose(made.values, retarget(trained, resting).values, atol=1e-9)


def test_shapes_that_hardly_move_in_inexact_pairs_do_not_run_wild() -> None:
    """Pairs of gains of 5 %, in which some shapes move to 0.01 only; tested at half weight."""
    rng = np.random.default_rng(0)
    source = np.vstack([np.zeros(12), rng.random((25, 12)) * 10 ** -np.linspace(0, 2, 12)])
    matrix = rng.random((12, 20)) / 3
    target = source @ matrix
    target[1:] *= 1 + 0.05 * rng.standard_normal((25, 1))
    shapes = tuple(f"t{i}" for i in range(20))
    pairs = pairs_of(source, shape_controls(shapes, target), tuple("abcdefghijkl"))
    unseen = 0.5 * np.eye(12)
    trained = train_retargeting(pairs, method="auto")
    error = retarget(trained, unseen).weights - unseen @ matrix
    assert np.linalg.norm(error) < 0.6 * np.linalg.norm(unseen @ matrix)


def test_what_pairs_of_both_sides_hardly_show_is_not_amplified() -> None:
    """The sides differ by 0.003, and the target's range cuts its weights in a few pairs."""
    rng = np.random.default_rng(0)
    both = rng.random((40, 6)) * (rng.random((40, 6)) < 0.4)
    both[0] = 0
    other = np.clip(both + 0.003 * rng.standard_normal(both.shape) * (both > 0), 0, 1)

    def act(weights: np.ndarray) -> np.ndarray:
        return np.clip(1.05 * (weights + 0.2 * np.roll(weights, -1, axis=1)), 0, 1)

    source, names = np.hstack([both, other]), tuple("abcdefghijkl")
    trained = train_retargeting(pairs_of(source, shape_controls(names, act(source)), names))
    one_side = np.hstack([both, 0 * both])
    error = retarget(trained, one_side).weights - act(one_side)
    assert np.linalg.norm(error) < 0.75 * np.linalg.norm(act(one_side))  # 0.71: half on each side
    assert trained.method != "additive"
    additive = next(each for each in trained.scores if each.method == "additive")
    assert additive.overshoot > trained.scores[0].overshoot + OVERSHOOT_MARGIN


def test_halfway_between_two_turned_ears_is_half_the_turn() -> None:
    source = np.array([[0.0, 0, 0], [0, 0, 1.0]])
    trained = train_retargeting(pairs_of(source, creature_acts(source)), method="ridge")
    made = retarget(trained, np.array([[0.0, 0, 0.5]])).rotations[0, 1]
    assert 2 * np.arccos(made[0]) == pytest.approx(0.6, abs=1e-3)


def test_joints_and_attributes_never_run_far_beyond_the_pairs() -> None:
    pairs = creature_pairs()
    trained = train_retargeting(pairs, method="ridge")
    values = retarget(trained, np.full((1, 3), 100.0)).values
    span = np.ptp(pairs.target.values, axis=0)
    assert (values <= pairs.target.values.max(axis=0) + 0.5 * span + 1e-9).all()


def test_alpha_one_is_the_network_and_zero_the_correlation() -> None:
    pairs = creature_pairs()
    trained = train_retargeting(pairs, method="hybrid", alpha=0.5)
    frames = human_moves(60)
    keyed = np.linspace(0, 1, 60)
    network = train_retargeting(pairs, method="rbf")
    kernel = replace(trained, method="kernel_cca")
    one = control_space(pairs.target)
    blend = one.encode(retarget(trained, frames, alpha=keyed))
    parts = [one.encode(retarget(each, frames)) for each in (network, kernel)]
    free = [one.encode(retarget(trained, frames, alpha=np.full(60, a))) for a in (1.0, 0.0)]
    np.testing.assert_allclose(free[0], parts[0], atol=1e-9)
    np.testing.assert_allclose(free[1], parts[1], atol=1e-9)
    middle = keyed[:, None] * parts[0] + (1 - keyed[:, None]) * parts[1]
    inside = np.abs(blend - middle).max(axis=1) < 1e-9
    assert inside.mean() > 0.9  # the rest touches a limit


@pytest.mark.parametrize("method", list(RETARGET_METHODS))
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_retargeting_whose_arrays_do_not_fit_is_refused_or_read(method: str) -> None:
    """Each array missing, one row short, and empty: nothing but InputError may escape."""
    trained = train_retargeting(creature_pairs(), method=method)
    source = creature_pairs().source[:3]
    refused = 0
    for array, value in trained.arrays.items():
        left = {other: each for other, each in trained.arrays.items() if other != array}
        for arrays in (left, left | {array: value[1:]}, left | {array: np.zeros((0,))}):
            try:
                retarget(replace(trained, arrays=arrays), source)
            except InputError:
                refused += 1
    assert refused >= len(trained.arrays)


@pytest.mark.parametrize("which", ["creature", "linear"])
def test_auto_returns_expressions_no_worse_than_any_method(which: str) -> None:
    pairs = creature_pairs() if which == "creature" else linear_pairs()[0]
    performance = np.random.default_rng(3).random((100, pairs.source.shape[1])) ** 3
    trained = train_retargeting(pairs, performance=performance)
    examples = make_examples(pairs)

    def cyclic(method: str, settings: dict) -> float:
        error = round_trip(examples, method, settings, performance) - performance
        return float(np.sqrt((error**2).mean(axis=1)).mean())

    best = cyclic(trained.method, trained.settings)
    for name, method in RETARGET_METHODS.items():
        for settings in method.retarget_candidates:
            assert best <= cyclic(name, settings) + EQUAL_ROUND_TRIP_MM, name
    assert best == pytest.approx(trained.scores[0].cyclic_mm)


def test_the_round_trip_loses_nothing_where_the_target_is_the_source() -> None:
    source = np.concatenate([np.zeros((1, 5)), np.eye(5), np.random.default_rng(0).random((20, 5))])
    names = tuple("abcde")
    pairs = pairs_of(source, shape_controls(names, source), names)
    unseen = np.random.default_rng(1).random((50, 5))
    back = round_trip(make_examples(pairs), "additive", {}, unseen)
    np.testing.assert_allclose(back, unseen, atol=1e-6)


def test_conflicting_pairs_are_named_and_others_are_not() -> None:
    pairs = creature_pairs(20)
    assert find_pair_conflicts(pairs) == ()
    source = np.concatenate([pairs.source, pairs.source[[7]] + 0.005])
    target = creature_acts(np.concatenate([pairs.source, 1 - pairs.source[[7]]]))
    conflicts = find_pair_conflicts(pairs_of(source, target))
    assert [(each.first, each.second) for each in conflicts] == [(7, 20)]
    assert conflicts[0].target > 3 * conflicts[0].source


def test_pairs_at_the_same_place_that_disagree_do_not_stop_the_training() -> None:
    pairs = creature_pairs(12)
    source = np.concatenate([pairs.source, pairs.source[[3]]])
    target = creature_acts(np.concatenate([pairs.source, 1 - pairs.source[[3]]]))
    trained = train_retargeting(pairs_of(source, target))
    assert np.isfinite(retarget(trained, human_moves(20)).weights).all()


def test_shapes_and_controls_that_nothing_uses_are_named() -> None:
    pairs = creature_pairs()
    source = np.concatenate([pairs.source, np.zeros((34, 1))], axis=1)
    still = replace(pairs.target, values=pairs.target.values * [1, 0] + [0, 0.3])
    pairs = pairs_of(source, still, (*SHAPES, "tongueOut"))
    assert unused_shapes(pairs) == ("tongueOut",)
    assert constant_controls(pairs) == ("rig/lattice.dfm:curl",)
    assert train_retargeting(pairs, method="ridge").arrays["unused"].tolist() == [0, 0, 0, 1]


def test_sides_that_no_pair_moves_apart_are_named() -> None:
    weights = np.random.default_rng(0).random((8, 1)) * [1, 0.95, 1, 0.2, 0, 1, 1]
    names = ("smile_L", "smile_R", "blinkLeft", "blinkRight", "jawOpen", "lookUp_L", "lookUp_R")
    pairs = pairs_of(weights, shape_controls(("t",), weights[:, :1]), names)
    assert inseparable_sides(pairs) == ("smile_L", "smile_R")
    (told,) = [note for note in pair_notes(pairs) if "both sides" in note]
    assert told.endswith("(add pairs of one side): 2 source shapes, smile_L, smile_R")


def test_order_of_pairs_does_not_matter() -> None:
    pairs = creature_pairs()
    turned = np.random.default_rng(2).permutation(34)
    frames = human_moves(50)
    for method in ("rbf", "ridge", "additive"):
        one = retarget(train_retargeting(pairs, method=method), frames)
        other = retarget(train_retargeting(pairs.rows(turned), method=method), frames)
        np.testing.assert_allclose(one.weights, other.weights, atol=1e-7)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda p: p.rows(np.array([0])), "1 pair; at least two"),
        (lambda p: p.rows(np.zeros(5, int)), "same source expression"),
        (lambda p: replace(p, target=p.target.rows([3] * 34)), "same target expression"),
        (
            lambda p: replace(p, source=np.where(p.source > 0.5, np.nan, p.source)),
            "NaN on its source",
        ),
        (
            lambda p: replace(p, target=replace(p.target, values=p.target.values + np.nan)),
            "NaN on its target",
        ),
    ],
)
def test_pairs_that_teach_nothing_are_refused(change, message: str) -> None:
    with pytest.raises(InputError, match=message):
        check_pairs(change(creature_pairs()), "x.pairs.usda")


def test_a_method_that_is_not_there_is_refused_with_those_that_are() -> None:
    with pytest.raises(InputError, match="choose one of auto, ridge, rbf"):
        train_retargeting(creature_pairs(), method="magic")


@pytest.mark.parametrize("method", ["additive", "hybrid"])
def test_mirrored_joints_stay_mirrored(method: str) -> None:
    """A scale of -1 came back as 0.000001, which shrinks what the joint carries to a plane."""
    pairs = creature_pairs()
    scales = pairs.target.scales.copy()
    scales[:, 2] = [-1.0, 1.0, 0.8]
    scales[:, 2, 0] -= 0.2 * pairs.source[:, 0]
    pairs = replace(pairs, target=replace(pairs.target, scales=scales))
    made = retarget(train_retargeting(pairs, method=method), pairs.source)
    np.testing.assert_allclose(made.scales, scales, atol=1e-2)


def test_controls_come_back_from_their_coordinates_whatever_their_size() -> None:
    target = creature_pairs().target
    sizes = np.exp(np.random.default_rng(0).normal(size=target.scales.shape))
    given = replace(target, scales=sizes)
    space = control_space(given)
    back = space.decode(space.encode(given))
    np.testing.assert_allclose(back.scales, sizes, rtol=1e-12)
    np.testing.assert_allclose(back.translations, given.translations, atol=1e-12)
    np.testing.assert_allclose(back.weights, given.weights)
    np.testing.assert_allclose(back.values, given.values)


def test_one_side_is_no_sum_of_pairs_with_both() -> None:
    both = np.random.default_rng(0).random((12, 2))[:, [0, 1, 1]]
    both[0] = 0
    trained = train_retargeting(pairs_of(both, shape_controls(("t",), both[:, :1])), method="rbf")
    one_side = np.random.default_rng(1).random((50, 1)) * [0.0, 0.0, 1.0]
    np.testing.assert_allclose(unspanned_shares(trained, one_side), [0, 0.25, 0.25], atol=1e-9)
    np.testing.assert_allclose(unspanned_shares(trained, 3 * both), 0, atol=1e-9)
