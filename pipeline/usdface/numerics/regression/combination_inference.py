"""Inference of the functions that drive a rig's correctives, from rows of weights.

Rows hold weights as evaluated by a rig, or as set by an animator. Every corrective is compared with
the functions of rigs (`core.rig_logic`): in-betweens of one shape, and the product, minimum or
harmonic mean of up to four shapes and in-betweens. Candidates are parts that are above 0 wherever
the corrective is. The function of r parts is chosen that minimises over n rows the information
criterion of Schwarz (1978), with Cauchy errors, as a rig may do something else in some rows::

    sum over rows of log(1 + (error / rounding)^2)  +  r log(n)

The knots of in-betweens count as parameters too, the more the less round they are. The function
must leave less than a tenth of the corrective's energy.
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
"""Of a weight: the error of half precision is 5e-4 near 1, and the errors of factors add up."""

_ACTIVE_WEIGHT = 0.01
"""Smaller weights are at rest; animators set none so small."""

_TIED_SCORE = 1.0
"""Difference of scores below which two functions are not distinguished: a likelihood ratio of e."""

_MOST_PARTS = 4
_MOST_CANDIDATES = 14
"""Most parts, by correlation with the corrective, of which triples and more are tried: the number
of combinations grows with the fourth power."""

_KNOTS = np.arange(21) / 20
"""Weights at which in-betweens are sculpted."""

_LEFT_SHARE = 0.1
"""Largest share of a corrective's energy that its function may leave."""


@dataclass(frozen=True)
class _Fit:
    parts: tuple[str, ...]
    mode: CombinationMode
    knots: tuple[float, float, float] | None
    """Of an in-between: weights at which it rises from 0, is 1, and is 0 again."""
    score: float
    left: float
    """Residual share of the energy."""

    @property
    def function(self) -> tuple[object, ...]:
        """The function without its score."""
        return frozenset(self.parts), self.mode, self.knots


def infer_combinations(
    shapes: Sequence[str], weights: FloatArray, driven: Sequence[str], values: FloatArray
) -> tuple[Combination, ...]:
    """Infer which shapes drive others, and by which functions.

    Returns combinations in the order of `order_combinations`, without correctives that are at rest
    in all rows or follow none of the functions.

    Parameters
    ----------
    shapes : sequence of str
        Possible drivers.
    weights : (rows, shapes) float array
    driven : sequence of str
        Correctives.
    values : (rows, driven) float array
        Their weights in the same rows.
    """
    factors = dict(zip(shapes, np.maximum(weights, 0.0).T, strict=True))
    columns = dict(zip(driven, values.T, strict=True))
    inbetweens = {
        name: _most_likely(_inbetweens(factors, column)) for name, column in columns.items()
    }
    known = {name: columns[name] for name, fits in inbetweens.items() if fits}
    fits = {
        name: _most_likely(
            [
                *inbetweens[name],
                *_products(factors if inbetweens[name] else factors | known, column),
            ]
        )
        for name, column in columns.items()
    }
    inferred = [_combination(name, fit) for name, fit in _choose(fits).items()]
    return order_combinations(inferred, (*shapes, *driven), source="inferred logic")


def _combination(name: str, fit: _Fit) -> Combination:
    if fit.knots is None:
        return Combination(name, fit.parts, fit.mode)
    low, peak, high = fit.knots
    return Combination(name, fit.parts, fit.mode, (peak,), ((low, high),))


def _most_likely(fits: Iterable[_Fit]) -> list[_Fit]:
    """Return the best function and those tied with it; none if its residual is too large."""
    ordered = sorted(fits, key=lambda fit: fit.score)
    if not ordered or ordered[0].left >= _LEFT_SHARE:
        return []
    return [fit for fit in ordered if fit.score < ordered[0].score + _TIED_SCORE]


def _choose(fits: dict[str, list[_Fit]]) -> dict[str, _Fit]:
    """Choose a function for each corrective, among tied ones one that no other corrective has.

    Both sides of a face often have the same weights in few rows, and separate correctives.
    """
    claims = Counter[tuple[object, ...]]()
    chosen = {}
    for name in sorted((name for name in fits if fits[name]), key=lambda name: len(fits[name])):
        best = min(fits[name], key=lambda fit: (claims[fit.function], fit.score))
        claims[best.function] += 1
        chosen[name] = best
    return {name: chosen[name] for name in fits if name in chosen}


def _candidates(factors: dict[str, FloatArray], wanted: FloatArray) -> list[str]:
    """Return the factors that are active wherever a corrective is, by descending correlation."""
    active = wanted > _ACTIVE_WEIGHT
    if not active.any():
        return []
    able = [name for name, factor in factors.items() if (factor[active] > 0).all()]

    def correlation(name: str) -> float:
        factor = factors[name]
        return float(factor @ wanted) / max(float(np.linalg.norm(factor)), 1e-12)

    return sorted(able, key=correlation, reverse=True)


def _scores(predicted: FloatArray, wanted: FloatArray, costs: FloatArray | float) -> FloatArray:
    """Return scores and residual shares of the energy of functions: (2, functions)."""
    count = len(wanted)
    squared = (predicted - wanted[:, None]) ** 2
    scores = np.log1p(squared / _WEIGHT_ROUNDING**2).sum(axis=0) + costs * np.log(count)
    return np.stack([scores, squared.sum(axis=0) / max(float((wanted**2).sum()), 1e-12)])


def _inbetweens(factors: dict[str, FloatArray], wanted: FloatArray) -> Iterator[_Fit]:
    """Yield the best triangular function of each shape."""
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
    """Return the number of parameters of a knot: 0 at the ends, more the less round it is."""
    costs = np.full(knots.shape, 3.0)
    for divisor, cost in ((10, 2.0), (4, 1.0), (2, 0.5), (1, 0.0)):
        costs[np.isclose(knots * divisor % 1, 0) | np.isclose(knots * divisor % 1, 1)] = cost
    return costs


def _products(factors: dict[str, FloatArray], wanted: FloatArray) -> Iterator[_Fit]:
    """Yield the best combinations of each number of parts, of each mode."""
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
