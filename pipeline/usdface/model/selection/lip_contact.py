"""Contact of the lips: where the performer's touch, the character's touch.

Least squares leaves a closed mouth open by a millimetre or two, a small error that is very visible.
Where the performer's lips touch, weights of the mouth are changed until the character's do, with
the least change of the surface.
"""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import FloatArray, IntArray
from usdface.core.deformer import Deformer
from usdface.model.selection.baseline import BlendshapeEquation, Positions
from usdface.numerics.measure.face_regions import jaw_opener, shapes_by_region
from usdface.numerics.measure.performance_error import LipPairs, find_lip_pairs, gap_of_keys

NEAR_LIPS_MM = 15.0
"""Largest distance of a lip marker from the line of contact."""

STILL, CARRIED = 0.25, 0.5
"""Shares of the jaw's largest motion below which a marker is of the upper lip, above which of the
lower."""

CONTACT_MM = 0.7
"""Distance of upper and lower lip markers beyond that of the neutral face up to which lips touch: a
few times the noise of a marker."""

LEAST_OPENING = 0.05
"""Share of the largest opening below which shapes alone are not changed: they would reach their
limits without closing the mouth."""

TOUCHING_MM = 0.2
MAX_ROUNDS = 8
_RIDGE_SHARE = 1e-3


@dataclass(frozen=True)
class Lips:
    """Lips of the character and lip markers."""

    pairs: LipPairs
    upper: IntArray
    lower: IntArray
    """`upper`, `lower`: (n,): pairs of markers, one above the other."""
    columns: IntArray
    """(n,): shapes that may be changed: the mouth's and the jaw's."""
    opening: FloatArray
    """(n,): change of the lips' distance by each of them at 1 [mm]."""


def find_lips(
    equation: BlendshapeEquation, deformer: Deformer, parts: tuple[str, ...]
) -> Lips | None:
    """Return lips; None if the markers or `parts`, of the rig's shapes, do not show them."""
    jaw, regions = jaw_opener(parts), shapes_by_region(parts)
    if jaw is None or "mouth" not in regions:
        return None
    offsets = deformer.shapes.target_offsets()
    pairs = find_lip_pairs(deformer.neutral, offsets, jaw_open=jaw, mouth=regions["mouth"])
    if pairs is None:
        return None
    places = equation.virtual.places(deformer.neutral)
    meet = (deformer.neutral[pairs.lower] + deformer.neutral[pairs.upper]) / 2
    near = np.linalg.norm(places[:, None] - meet[None], axis=2).min(axis=1) < NEAR_LIPS_MM
    carried = np.linalg.norm(equation.deltas[jaw], axis=1)
    carried = carried / max(float(carried.max()), 1e-12)
    above = np.flatnonzero(near & (carried < STILL))
    below = np.flatnonzero(near & (carried > CARRIED))
    if not len(above) or not len(below):
        return None
    across = places - np.outer(places @ pairs.direction, pairs.direction)
    partner = np.linalg.norm(across[below][:, None] - across[above][None], axis=2).argmin(axis=1)
    columns = np.union1d(regions["mouth"], regions.get("jaw", np.zeros(0, np.int64)))
    opening = gap_of_keys(pairs, offsets)[columns]
    return Lips(pairs, above[partner], below, columns.astype(np.int64), opening)


def keep_lip_contact(
    equation: BlendshapeEquation,
    deformer: Deformer,
    lips: Lips,
    positions: Positions,
    weights: FloatArray,
) -> FloatArray:
    """Close the character's lips at frames at which the performer's are closed.

    Returns (frames, shapes), within the ranges; other frames and shapes are unchanged.

    Parameters
    ----------
    positions : (frames, markers, 3) float array
        Stabilised [mm].
    weights : (frames, shapes) float array
    """
    closed = np.flatnonzero(captured_gap_mm(equation, lips, positions) < CONTACT_MM)
    out = weights.copy()
    low, high = equation.ranges[lips.columns].T
    gram = deformer.shapes.gram()[np.ix_(lips.columns, lips.columns)]
    gram = gram + _RIDGE_SHARE * np.trace(gram) * np.eye(len(gram))
    size = np.abs(lips.opening)
    able = size >= LEAST_OPENING * size.max(initial=0.0)
    for _ in range(MAX_ROUNDS):
        gap = lip_gap_mm(deformer, lips, out[closed])
        open_rows = closed[gap > TOUCHING_MM]
        if not len(open_rows):
            break
        for row, excess in zip(open_rows, gap[gap > TOUCHING_MM], strict=True):
            weights = out[row, lips.columns]
            # Weights at their limits are left out; the others make up for them.
            free = np.where(lips.opening > 0, weights > low + 1e-9, weights < high - 1e-9)
            if not (free & able).any():
                continue
            step = np.linalg.solve(gram[np.ix_(free, free)], lips.opening[free])
            step *= -excess / max(float(step @ lips.opening[free]), 1e-12)
            weights[free] += step
            out[row, lips.columns] = np.clip(weights, low, high)
    return out


def captured_gap_mm(equation: BlendshapeEquation, lips: Lips, positions: Positions) -> FloatArray:
    """Return the distance of the performer's lips beyond that of the neutral: (frames,) [mm]."""
    motion = equation.motion(positions)
    between = motion[:, lips.upper] - motion[:, lips.lower]
    return np.asarray((between @ lips.pairs.direction).mean(axis=1))


def lip_gap_mm(deformer: Deformer, lips: Lips, weights: FloatArray) -> FloatArray:
    """Return the lips' distance beyond that of the neutral face: (frames,) [mm]."""
    shapes = deformer.shapes
    return shapes.key_weights(weights) @ gap_of_keys(lips.pairs, shapes.key_offsets)
