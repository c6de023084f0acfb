"""The coordinates of pairs of expressions for regression, and checks of these."""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import BoolArray, relative_distances
from usdface.core.controls import Controls, ControlSpace, ExpressionPairs
from usdface.core.errors import InputError
from usdface.numerics.measure.face_regions import gaze_shapes, mirrored_shapes
from usdface.numerics.motion.rotation_space import mean_rotation


def control_space(controls: Controls) -> ControlSpace:
    """Return the space of some controls, with rotations relative to their mean."""
    return ControlSpace(
        controls.shapes,
        controls.joints,
        controls.attributes,
        mean_rotation(controls.rotations),
        np.where((controls.scales < 0).all(axis=0), -1.0, 1.0),
    )


_EQUAL_SHARE = 0.15
"""Distance below which two expressions are equal, as a share of the median distance."""

CONFLICT_RATIO = 3.0
"""Ratio of target to source distance above which two pairs conflict."""

LEAST_WEIGHT = 1e-4
"""Weight below which a shape counts as unused."""


_ALIKE_SHARE = 0.1
"""[of a shape's largest weight] Largest difference of sides that move alike."""


@dataclass(frozen=True)
class PairConflict:
    """Two pairs whose sources are almost the same and whose targets are not."""

    first: int
    second: int
    """`first`, `second`: Pairs, from 0."""
    source: float
    target: float
    """`source`, `target`: Distances, as shares of the median ones."""


def check_pairs(pairs: ExpressionPairs, where: str) -> None:
    """Refuse pairs that are too few, not finite or all equal."""
    if len(pairs) < 2:
        raise InputError(
            f"{where}: {len(pairs)} pair; at least two are needed, rest and one expression: "
            "key more time codes"
        )
    coordinates = control_space(pairs.target).encode(pairs.target)
    for side, values in (("source", pairs.source), ("target", coordinates)):
        bad = np.argwhere(~np.isfinite(values))
        if len(bad):
            raise InputError(f"{where}: pair {bad[0, 0] + 1} has NaN on its {side} side; key it")
        if np.ptp(values, axis=0).max(initial=0.0) < LEAST_WEIGHT:
            raise InputError(
                f"{where}: all {len(pairs)} pairs have the same {side} expression; key "
                "different ones"
            )


def find_pair_conflicts(pairs: ExpressionPairs) -> tuple[PairConflict, ...]:
    """Return pairs that contradict each other, the worst first (S11, section 4.1)."""
    target = control_space(pairs.target).encode(pairs.target)
    source_distances = relative_distances(pairs.source)
    target_distances = relative_distances(target / np.maximum(np.ptp(target, axis=0), LEAST_WEIGHT))
    first, second = np.triu_indices(len(pairs), 1)
    source, target_side = source_distances[first, second], target_distances[first, second]
    conflicting = (source < _EQUAL_SHARE) & (
        target_side > CONFLICT_RATIO * np.maximum(source, _EQUAL_SHARE / CONFLICT_RATIO)
    )
    conflicts = [
        PairConflict(int(first[i]), int(second[i]), float(source[i]), float(target_side[i]))
        for i in np.flatnonzero(conflicting)
    ]
    return tuple(sorted(conflicts, key=lambda each: each.source - each.target))


def moving_shapes(pairs: ExpressionPairs) -> BoolArray:
    """Return which source shapes differ between pairs; the target does not respond to others."""
    return np.asarray(np.ptp(pairs.source, axis=0) > LEAST_WEIGHT)


def unused_shapes(pairs: ExpressionPairs) -> tuple[str, ...]:
    """Return the source shapes that are the same in every pair."""
    return tuple(np.array(pairs.source_shapes)[~moving_shapes(pairs)].tolist())


def inseparable_sides(pairs: ExpressionPairs) -> tuple[str, ...]:
    """Return the source shapes that move as those of the other side in every pair, without gaze."""
    other = mirrored_shapes(pairs.source_shapes)
    apart = np.abs(pairs.source - pairs.source[:, other]).max(axis=0)
    alike = apart <= _ALIKE_SHARE * np.abs(pairs.source).max(axis=0)
    alike &= moving_shapes(pairs) & (other != np.arange(len(other)))
    alike[gaze_shapes(pairs.source_shapes)] = False
    return tuple(np.array(pairs.source_shapes)[alike].tolist())


def constant_controls(pairs: ExpressionPairs) -> tuple[str, ...]:
    """Return the target's shapes and attributes that are constant over the pairs."""
    target = pairs.target
    still = np.ptp(target.weights, axis=0) < LEAST_WEIGHT
    constant = np.ptp(target.values, axis=0) < LEAST_WEIGHT
    shapes = [name for name, each in zip(target.shapes, still, strict=True) if each]
    return (*shapes, *(n for n, each in zip(target.attributes, constant, strict=True) if each))
