"""Pairs of which the target looks like another pair's source, and not like its own; or rests.

A regression interpolates a wrong pair like any other, and neither the round trip nor the other
pairs contradict it. The surfaces do: aligned to each other, two faces with the same expression
deform alike, even a face with a muzzle.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import BoolArray, FloatArray
from usdface.core.assets import Rig
from usdface.core.controls import Controls, ExpressionPairs
from usdface.core.errors import InputError
from usdface.core.text import first_few
from usdface.model.retarget.control_space import LEAST_WEIGHT
from usdface.model.retarget.face_correspondence import correspond, unit_fields
from usdface.numerics.measure.face_regions import shapes_by_region

_LARGEST_OWN = 0.35
_LEAST_OTHER = 0.6
"""Cosines below which a target is not like its own source, and from which it is like another's. Of
440 right pairs between three heads, by names and their mixtures, one is doubted, and of 343 targets
exchanged at random 312."""

_LEAST_MOTION = 0.05
"""Displacement of an expression, relative to the median pair's, below which it is not judged."""

_LEAST_SOURCE = 0.1
"""Difference of a source shape's weights over the pairs, from which the target is to follow it."""


@dataclass(frozen=True)
class PairDoubt:
    """A pair that may be wrong."""

    pair: int
    """From 0."""
    other: int | None
    """The pair whose source the target resembles; None for the mirror image of its own source."""
    own: float
    similarity: float
    """`own`, `similarity`: cosines of the target's displacements with those of its own source and
    of what it resembles."""


def find_pair_doubts(pairs: ExpressionPairs, source: Rig, target: Rig) -> tuple[PairDoubt, ...]:
    """Return pairs that may be wrong, the worst first.

    Only the targets' shapes are compared: pairs that move joints or attributes are not judged.

    Raises
    ------
    InputError
        If a rig lacks shapes of the pairs or a recognisable face, or no alignment is upright.
    """
    fields = correspond(source, target)
    rest = int(np.linalg.norm(pairs.source, axis=1).argmin())
    unknown = [
        *(name for name in pairs.source_shapes if name not in source.shapes),
        *(name for name in pairs.target.shapes if name not in target.shapes),
    ]
    if unknown:
        raise InputError(f"the pairs have shapes that the rigs lack: {first_few(unknown)}")
    rows = [source.shapes.index(name) for name in pairs.source_shapes]
    columns = [target.shapes.index(name) for name in pairs.target.shapes]
    sources = (pairs.source - pairs.source[rest]) / fields.source_ends[rows]
    weights = (pairs.target.weights - pairs.target.weights[rest]) / fields.target_ends[columns]
    acted = np.tensordot(sources, fields.source[rows], 1)
    keyed = np.tensordot(weights, fields.target[columns], 1)
    likeness = unit_fields(acted) @ unit_fields(keyed).T
    mirrored = acted[:, fields.mirror] * [-1, 1, 1]
    turned = (unit_fields(mirrored) * unit_fields(keyed)).sum(axis=1)
    own = likeness.diagonal().copy()
    np.fill_diagonal(likeness, -1.0)
    others = likeness.argmax(axis=0)
    best = np.maximum(likeness.max(axis=0), turned)
    judged = _moves(acted) & _moves(keyed) & _shapes_alone(pairs.target, rest)
    doubted = np.flatnonzero(judged & (own < _LARGEST_OWN) & (best >= _LEAST_OTHER)).tolist()
    found = [
        PairDoubt(
            pair,
            None if turned[pair] >= _LEAST_OTHER else int(others[pair]),
            float(own[pair]),
            float(turned[pair] if turned[pair] >= _LEAST_OTHER else best[pair]),
        )
        for pair in doubted
    ]
    return tuple(sorted(found, key=lambda each: each.own - each.similarity))


def find_unkeyed_regions(
    pairs: ExpressionPairs, source_parts: Sequence[str], target_parts: Sequence[str]
) -> dict[str, tuple[BoolArray, tuple[str, ...]]]:
    """Return the regions that move in the source, and of which every control of the target rests.

    By region: which source shapes move there, (ns,), and the target's shapes. A target that moves
    joints or attributes has none, as these may be of any region.

    Parameters
    ----------
    source_parts, target_parts : sequence of str
        A name for each shape from which its region can be read (`shape_parts`).
    """
    if not _shapes_alone(pairs.target, 0).all():
        return {}
    moving = np.ptp(pairs.source, axis=0) > _LEAST_SOURCE
    resting = np.ptp(pairs.target.weights, axis=0) < LEAST_WEIGHT
    sources, targets = shapes_by_region(source_parts), shapes_by_region(target_parts)
    found = {}
    for region in [each for each in sources if each in targets]:
        moved = moving & np.isin(np.arange(len(moving)), sources[region])
        if moved.any() and resting[targets[region]].all():
            found[region] = moved, tuple(pairs.target.shapes[i] for i in targets[region].tolist())
    return found


def _moves(fields: FloatArray) -> BoolArray:
    size = np.linalg.norm(fields.reshape(len(fields), -1), axis=1)
    moving = size[size > LEAST_WEIGHT]
    return np.asarray(size > _LEAST_MOTION * (np.median(moving) if len(moving) else 1.0))


def _shapes_alone(target: Controls, rest: int) -> BoolArray:
    """Return which pairs have joints and attributes at rest."""
    still = np.ones(len(target.weights), np.bool_)
    for values in (target.translations, target.rotations, target.scales, target.values):
        away = np.abs(values - values[rest : rest + 1]).reshape(len(values), -1)
        still &= away.max(axis=1, initial=0.0) < LEAST_WEIGHT
    return still
