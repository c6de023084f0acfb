"""Find by which other shapes each corrective of a rig is driven, from rows of weights.

Rows hold weights as a rig evaluated them, or as an animator set them. Every corrective is compared
with the functions that rigs use (`core.rig_logic`): in-betweens of one shape, then the product, the
minimum or the harmonic mean of up to four shapes and in-betweens. A part must be above 0 wherever
the corrective is, which leaves few. Among functions the one of r parts is taken that
minimises over n rows (Schwarz 1978, with errors of Cauchy's distribution: a row on which
the rig does something else says as much as any)

    sum over rows of log(1 + (error / rounding)^2)  +  r log(n)

where the knots of in-betweens count for more the less round they are,

and taken only if it leaves less than a tenth of the corrective's energy.
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from usdface.core.arrays import FloatArray
from usdface.core.rig_logic import (
    COMBINATION_MODES,
    Combination,
    CombinationMode,
    combine,
    order_combinations,
)

_WEIGHT_ROUNDING = 2e-3
"""Of a weight: half precision errs by 5e-4 near 1, and the errors of factors add up."""

_ACTIVE_WEIGHT = 0.01
"""Of a weight: no animator keys finer, so that what is below counts as rest."""

_TIED_SCORE = 1.0
"""Difference of scores below which rows do not tell two functions apart: a factor of e."""

_MOST_PARTS = 4
_MOST_CANDIDATES = 14
"""Parts, those that go with the corrective most closely, of which triples and more are tried: their
number grows with the fourth power."""

_KNOTS = np.arange(21) / 20
"""Weights at which in-betweens are sculpted: round ones."""

_LEFT_SHARE = 0.1
"""Most of a corrective's energy that logic may leave; else it stays a shape of its own."""


@dataclass(frozen=True)
class _Fit:
    parts: tuple[str, ...]
    mode: CombinationMode
    knots: tuple[float, float, float] | None
    """Of an in-between: where it leaves 0, is 1, and is 0 again."""
    score: float
    left: float
    """Share of the energy."""

    @property
    def function(self) -> tuple[object, ...]:
        """What it says, without how well."""
        return frozenset(self.parts), self.mode, self.knots


def infer_combinations(
    shapes: Sequence[str], weights: FloatArray, driven: Sequence[str], values: FloatArray
) -> tuple[Combination, ...]:
    """Find which shapes drive others.

    Parameters
    ----------
    shapes : sequence of str
        That may drive.
    weights : (rows, shapes) float array
    driven : sequence of str
        That may be driven.
    values : (rows, driven) float array
        Their weights in the same rows.

    Returns
    -------
    tuple of Combination
        As `order_combinations` gives them; without those for which no logic was found: shapes that
        the rows leave at rest, or that follow none of these functions.
    """
    factors = dict(zip(shapes, np.maximum(weights, 0.0).T, strict=True))
    columns = dict(zip(driven, values.T, strict=True))
    bends = {name: _likeliest(_inbetweens(factors, column)) for name, column in columns.items()}
    known = {name: columns[name] for name, fits in bends.items() if fits}
    fits = {
        name: _likeliest(
            [*bends[name], *_products(factors if bends[name] else factors | known, column)]
        )
        for name, column in columns.items()
    }
    found = [_stated(name, fit) for name, fit in _choose(fits).items()]
    return order_combinations(found, (*shapes, *driven), source="inferred logic")


def _stated(name: str, fit: _Fit) -> Combination:
    if fit.knots is None:
        return Combination(name, fit.parts, fit.mode)
    low, peak, high = fit.knots
    return Combination(name, fit.parts, fit.mode, (peak,), ((low, high),))


def _likeliest(fits: Iterable[_Fit]) -> list[_Fit]:
    """Return the likeliest function and those like it; none if all leave much."""
    ordered = sorted(fits, key=lambda fit: fit.score)
    if not ordered or ordered[0].left >= _LEFT_SHARE:
        return []
    return [fit for fit in ordered if fit.score < ordered[0].score + _TIED_SCORE]


def _choose(fits: dict[str, list[_Fit]]) -> dict[str, _Fit]:
    """Choose a function for each corrective; where rows do not tell, one that no other has.

    Shapes of both sides often move alike in few rows: each has a corrective of its own.
    """
    claims = Counter[tuple[object, ...]]()
    chosen = {}
    for name in sorted((name for name in fits if fits[name]), key=lambda name: len(fits[name])):
        best = min(fits[name], key=lambda fit: (claims[fit.function], fit.score))
        claims[best.function] += 1
        chosen[name] = best
    return {name: chosen[name] for name in fits if name in chosen}


def _candidates(factors: dict[str, FloatArray], wanted: FloatArray) -> list[str]:
    """Return what is active wherever a corrective is, what goes with it most closely first."""
    active = wanted > _ACTIVE_WEIGHT
    if not active.any():
        return []
    able = [name for name, each in factors.items() if (each[active] > 0).all()]

    def closeness(name: str) -> float:
        each = factors[name]
        return float(each @ wanted) / max(float(np.linalg.norm(each)), 1e-12)

    return sorted(able, key=closeness, reverse=True)


def _scores(predicted: FloatArray, wanted: FloatArray, costs: FloatArray | float) -> FloatArray:
    """Return score and share of the energy left of functions: (2, functions)."""
    count = len(wanted)
    squared = (predicted - wanted[:, None]) ** 2
    scores = np.log1p(squared / _WEIGHT_ROUNDING**2).sum(axis=0) + costs * np.log(count)
    return np.stack([scores, squared.sum(axis=0) / max(float((wanted**2).sum()), 1e-12)])


def _inbetweens(factors: dict[str, FloatArray], wanted: FloatArray) -> Iterator[_Fit]:
    """Yield the likeliest straight rise and fall of single shapes, at round weights."""
    knots = _KNOTS[np.array(list(combinations(range(len(_KNOTS)), 3)))].T
    low, peak, high = knots
    costs = 1 + _knot_cost(knots).sum(axis=0)
    for name in _candidates(factors, wanted):
        at = factors[name][:, None]
        bent = np.minimum((at - low) / (peak - low), (high - at) / (high - peak))
        scores = _scores(np.maximum(bent, 0.0), wanted, costs)
        row = int(scores[0].argmin())
        yield _Fit((name,), "product", tuple(knots[:, row].tolist()), *scores[:, row].tolist())


def _knot_cost(knots: FloatArray) -> FloatArray:
    """Return how many parameters a knot counts for: 0 at the ends, more the less round it is."""
    costs = np.full(knots.shape, 3.0)
    for divisor, cost in ((10, 2.0), (4, 1.0), (2, 0.5), (1, 0.0)):
        costs[np.isclose(knots * divisor % 1, 0) | np.isclose(knots * divisor % 1, 1)] = cost
    return costs


def _products(factors: dict[str, FloatArray], wanted: FloatArray) -> Iterator[_Fit]:
    """Yield the likeliest combinations of each number of parts, of each mode."""
    names = _candidates(factors, wanted)
    for count in range(1, _MOST_PARTS + 1):
        able = names if count < 3 else names[:_MOST_CANDIDATES]
        rows = np.array(list(combinations(range(len(able)), count)), np.int64)
        if not len(rows):
            continue
        stack = np.stack([factors[name] for name in able], axis=1)[:, rows]
        for mode in COMBINATION_MODES if count > 1 else COMBINATION_MODES[:1]:
            scores = _scores(combine(stack, mode), wanted, count)
            for row in np.flatnonzero(scores[0] < scores[0].min() + _TIED_SCORE).tolist():
                parts = tuple(able[index] for index in rows[row].tolist())
                yield _Fit(parts, mode, None, *scores[:, row].tolist())
