"""Retargeting: round-trip error, direct error if the truth is known, and speed.

A recorded Live Link performance (or else the demo's) on a human head drives a head of another maker
and a dog with 28 shapes, 8 joints and 36 deformer controls.
"""

import time

import numpy as np

from benchmarks._takes import weights_of
from tests.conftest import SHARED_DATA
from usdface.capture.sniff import read_capture
from usdface.core.arrays import FloatArray
from usdface.core.assets import Rig
from usdface.core.controls import ExpressionPairs, shape_controls
from usdface.demo.acting import performance
from usdface.demo.dog import act, dog_rig, expressions
from usdface.demo.rig import demo_rig
from usdface.demo.sculpt import ACTOR
from usdface.model.retarget.control_space import find_pair_conflicts
from usdface.model.retarget.cyclic import CyclicVariant, evaluate_cyclic, sampled_displacements
from usdface.model.retarget.name_matching import match_names
from usdface.model.retarget.train import retarget, train_retargeting
from usdface.usdio.rig.read import read_rig

METHODS = ("auto", "rbf", "kernel_cca", "hybrid", "additive", "ridge", "positions")
EVERY = 8
"""Every n-th frame is measured."""


def run() -> None:
    """Print a table for each target, and the speed of the runtime."""
    source, weights, recorded = _performance()
    what = "livelink_alex on ict_head" if recorded else "the demo's performance on the demo's actor"
    print(f"{what}: {len(weights):,} frames, every {EVERY}th measured\n")
    print("| target | method | round trip mm | 95th percentile | against truth mm |")
    print("|---|---|---|---|---|")
    if recorded:
        cap = read_rig(SHARED_DATA / "rigs" / "facecap_head.usdc")
        _table("facecap_head, pairs by name", _named_pairs(source, cap), source, cap, weights)
    dog = dog_rig()
    names, poses = expressions(source.shapes)
    pairs = ExpressionPairs(names, source.shapes, poses, act(source.shapes, poses))
    used = np.abs(poses).max(axis=0) > 0
    truth = act(source.shapes, weights[::EVERY])
    _table("dog, 34 pairs", pairs, source, dog, weights, truth.weights)
    shown = act(source.shapes, weights[::EVERY] * used).weights
    _table("dog, what the pairs show", pairs, source, dog, weights * used, shown)
    torn = contradicted(pairs)
    label = f"dog, {len(find_pair_conflicts(torn))} conflicts added"
    _table(label, torn, source, dog, weights * used, shown)
    _table(f"{label}, as published", torn, source, dog, weights * used, shown, published=True)
    winner = ExpressionPairs(names, source.shapes, poses, act(source.shapes, strongest(poses)))
    apart = act(source.shapes, strongest(weights[::EVERY] * used)).weights
    _table("dog that does one thing at a time", winner, source, dog, weights * used, apart)
    _blind(pairs, source, weights * used)
    _speed(pairs, weights)


def _performance() -> tuple[Rig, FloatArray, bool]:
    recording = SHARED_DATA / "livelink_alex"
    if recording.is_dir():
        rig = read_rig(SHARED_DATA / "rigs" / "ict_head.usdc")
        clip = weights_of(read_capture(next(recording.glob("*.csv"))).take)
    else:
        rig, clip = demo_rig(ACTOR), performance().weights
    weights = np.zeros((len(clip.values), len(rig.shapes)))
    for match in match_names(clip.names, rig.shapes).matches:
        column = clip.names.index(match.source[0][0])
        for name, share in match.target:
            weights[:, rig.shapes.index(name)] += share * clip.values[:, column]
    return rig, np.clip(weights, 0.0, 1.0), recording.is_dir()


def _named_pairs(source: Rig, target: Rig) -> ExpressionPairs:
    matches = match_names(source.shapes, target.shapes).matches
    left = np.zeros((len(matches) + 1, len(source.shapes)))
    right = np.zeros((len(matches) + 1, len(target.shapes)))
    for row, match in enumerate(matches, start=1):
        for expression, out, names in (
            (match.source, left, source.shapes),
            (match.target, right, target.shapes),
        ):
            for name, weight in expression:
                out[row, names.index(name)] = weight
    labels = ("rest", *(match.name for match in matches))
    return ExpressionPairs(labels, source.shapes, left, shape_controls(target.shapes, right))


def strongest(weights: FloatArray) -> FloatArray:
    """Return weights of which the largest suppress the others, so that shapes do not add up."""
    most = np.maximum(weights.max(axis=1, keepdims=True), 1e-9)
    return weights * (weights / most) ** 2


def contradicted(pairs: ExpressionPairs) -> ExpressionPairs:
    """Add six pairs with sources almost equal to others and different targets."""
    again = np.array([1, 5, 12, 18, 24, 30])
    rng = np.random.default_rng(0)
    rows = pairs.rows(np.concatenate([np.arange(len(pairs)), again]))
    source = rows.source.copy()
    moving = np.abs(pairs.source).max(axis=0) > 0
    source[len(pairs) :] += 0.02 * rng.random((len(again), source.shape[1])) * moving
    target = pairs.target.rows(np.concatenate([np.arange(len(pairs)), (again + 7) % len(pairs)]))
    return ExpressionPairs(rows.names, rows.source_shapes, source, target)


def _table(
    label: str,
    pairs: ExpressionPairs,
    source: Rig,
    target: Rig,
    weights: FloatArray,
    truth: FloatArray | None = None,
    *,
    published: bool = False,
) -> None:
    found = evaluate_cyclic(
        pairs,
        weights[::EVERY],
        methods=("rbf", "kernel_cca", "hybrid") if published else METHODS,
        rig=source,
        target_rig=target,
        variant=CyclicVariant(truth=truth, published=published),
    )
    for each in found:
        errors = each.mean_vertex_mm
        direct = "" if each.direct_mm is None else f"{each.direct_mm.mean():.3f}"
        print(
            f"| {label} | {each.method} | {errors.mean():.3f} | "
            f"{np.percentile(errors, 95):.3f} | {direct} |"
        )


def _blind(pairs: ExpressionPairs, source: Rig, weights: FloatArray) -> None:
    """Print the method that `auto` chooses without the performance."""
    surface = sampled_displacements(source, pairs.source_shapes)
    blind = train_retargeting(pairs, surface=surface)
    seen = train_retargeting(pairs, surface=surface, performance=weights)
    seen_of = {(score.method, score.settings): score.cyclic_mm for score in seen.scores}
    best = blind.scores[0]
    print(
        f"\nauto chooses {blind.method} without the performance and {seen.method} with it; on the "
        f"performance {seen_of[best.method, best.settings]:.3f} and "
        f"{seen.scores[0].cyclic_mm:.3f} mm"
    )


def _speed(pairs: ExpressionPairs, weights: FloatArray) -> None:
    many = np.tile(weights, (max(1, 100_000 // len(weights)), 1))
    print("\n| runtime to the dog, every control | frames/s | times real time at 60 | wanted |")
    print("|---|---|---|---|")
    for method in ("additive", "hybrid"):
        trained = train_retargeting(pairs, method=method)
        times = []
        for _ in range(3):
            start = time.perf_counter()
            for first in range(0, len(many), 8192):
                retarget(trained, many[first : first + 8192])
            times.append(time.perf_counter() - start)
        rate = len(many) / min(times)
        print(f"| {method} | {rate:,.0f} | {rate / 60:,.0f}× | ≥ 1,000× |")
