"""Combination shapes (correctives): shapes of a rig that other shapes drive.

With ``f_j`` the factor of its part j, the weight of a combination is one of::

    product   f_1 f_2 ...
    minimum   min(f_1, f_2, ...)
    smooth    n / (1/f_1 + 1/f_2 + ...), the harmonic mean

A part with its peak at weight 1 has the factor ``max(w, 0)``. One with a peak p below 1 is an
in-between: piecewise linear, 0 outside a span and 1 at p; the span is given, or extends to the
neighbouring peaks of the same part, with 0 and 1. A part may be a combination itself.

Blender, Maya (`combinationShape`: multiplication, lowest weighting, lowest weighting smooth) and
Simplex (`solveType`: allMul, min, and mulAvgAll, which is the harmonic mean of two parts) have
these modes under other names.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from usdface.core.arrays import FloatArray, IntArray, RealArray, columns_by_name, index_of
from usdface.core.errors import InputError
from usdface.core.text import first_few, pluralize

CombinationMode = Literal["product", "minimum", "smooth"]
COMBINATION_MODES: tuple[CombinationMode, ...] = get_args(CombinationMode)

_LEAST_FACTOR = 1e-12
"""Lower limit of factors in a harmonic mean."""


@dataclass(frozen=True)
class Combination:
    """One shape that others drive."""

    shape: str
    """The driven shape."""
    parts: tuple[str, ...]
    """Shapes that drive it; some may be combinations themselves."""
    mode: CombinationMode = "product"
    weights: tuple[float, ...] = ()
    """(parts,): peak of each part, in (0-1]; empty: 1 for all."""
    spans: tuple[tuple[float, float], ...] = ()
    """(parts, 2): weights at which each in-between is 0; empty: the neighbouring peaks."""

    @property
    def part_weights(self) -> tuple[float, ...]:
        """Peak of each part: (parts,)."""
        return self.weights or (1.0,) * len(self.parts)

    def __str__(self) -> str:
        """Return it as in tables: ``smile_jaw = smile * jaw@0.5 (minimum)``."""
        missing = len(self.parts)  # messages also name combinations with too few weights
        weights, spans = (*self.weights, *[1.0] * missing), (*self.spans, *[None] * missing)
        parts = [
            part
            + ("" if weight == 1.0 else f"@{weight:g}")
            + ("" if weight == 1.0 or span is None else f"[{span[0]:g} {span[1]:g}]")
            for part, weight, span in zip(self.parts, weights, spans, strict=False)
        ]
        mode = "" if self.mode == "product" else f" ({self.mode})"
        return f"{self.shape} = {' * '.join(parts)}{mode}"


def order_combinations(
    combinations: Iterable[Combination], shapes: Iterable[str], *, source: object
) -> tuple[Combination, ...]:
    """Check combinations against a rig, and sort them topologically: parts first.

    `InputError` with all combinations of missing shapes, in cycles, or defined twice.

    Parameters
    ----------
    shapes : iterable of str
        All shapes of the rig, with driven ones.
    source : object
        Named in messages.
    """
    given, known = list(combinations), set(shapes)
    faults = [fault for combination in given for fault in _faults(combination, known)]
    names = [combination.shape for combination in given]
    faults += [f"{name} is stated {names.count(name)} times" for name in dict.fromkeys(names)
               if names.count(name) > 1]  # fmt: skip
    if not faults:
        ordered, remaining = list[Combination](), given
        while remaining:
            waiting = {combination.shape for combination in remaining}
            ready = [one for one in remaining if not waiting & set(one.parts)]
            if not ready:
                faults.append(f"a cycle: {_cycle(remaining)}")
                break
            ordered += ready
            remaining = [one for one in remaining if one not in ready]
    if faults:
        raise InputError(
            f"{source}: {pluralize(len(faults), 'combination')} cannot be used: "
            f"{first_few(faults)}; correct them"
        )
    return tuple(ordered)


def _faults(combination: Combination, known: set[str]) -> list[str]:
    faults = []
    missing = [name for name in (combination.shape, *combination.parts) if name not in known]
    if missing:
        faults.append(f"{combination}: {first_few(missing)} is no shape of the rig")
    if not combination.parts:
        faults.append(f"{combination.shape}: has no parts")
    if len(set(combination.parts)) < len(combination.parts):
        faults.append(f"{combination}: names a part twice")
    if combination.mode not in COMBINATION_MODES:
        faults.append(
            f"{combination.shape}: its mode is {combination.mode!r}, not "
            f"{', '.join(COMBINATION_MODES)}"
        )
    if len(combination.part_weights) != len(combination.parts):
        faults.append(
            f"{combination.shape}: {len(combination.weights)} weights for "
            f"{len(combination.parts)} parts"
        )
    elif not all(0.0 < weight <= 1.0 for weight in combination.part_weights):  # NaN included
        faults.append(f"{combination.shape}: its weights must be above 0 and at most 1")
    elif len(combination.spans) not in (0, len(combination.parts)):
        faults.append(
            f"{combination.shape}: {len(combination.spans)} spans for "
            f"{len(combination.parts)} parts"
        )
    elif not all(
        weight == 1.0 or low < weight < high
        for weight, (low, high) in zip(combination.part_weights, combination.spans, strict=False)
    ):
        faults.append(f"{combination.shape}: a span does not hold its part's weight")
    return faults


def _cycle(remaining: Sequence[Combination]) -> str:
    parts = {combination.shape: combination.parts for combination in remaining}
    path = [remaining[0].shape]
    while path[-1] not in path[:-1]:
        path.append(next(part for part in parts[path[-1]] if part in parts))
    return " <- ".join(path[path.index(path[-1]) :])


@dataclass(frozen=True)
class _Step:
    """Combinations of one mode and number of parts, evaluated together."""

    mode: CombinationMode
    columns: IntArray
    """(n,): columns of the results."""
    parts: IntArray
    """(n, parts): columns of the parts."""
    low: FloatArray
    peak: FloatArray
    high: FloatArray
    """`low`, `peak`, `high`: (n, parts): weights at which a factor rises from 0, is 1, and is 0
    again; infinite `high` for a factor that is not limited."""

    def factors(self, weights: FloatArray) -> FloatArray:
        """Return (frames, n, parts)."""
        at = weights[:, self.parts]
        rising = (at - self.low) / (self.peak - self.low)
        finite = np.isfinite(self.high)
        falling = np.where(finite, (self.high - at) / np.where(finite, self.high - self.peak, 1), 9)
        bent = np.where(finite, np.minimum(rising, falling), rising)
        return np.asarray(np.maximum(bent, 0.0))

    def slopes(self, weights: FloatArray) -> FloatArray:
        """Return the right derivative of `factors`."""
        at = weights[:, self.parts]
        finite = np.isfinite(self.high)
        down = np.where(finite, -1 / np.where(finite, self.high - self.peak, 1), 0.0)
        out = np.where(at < self.peak, 1 / (self.peak - self.low), down)
        out = np.where(finite | (at < self.peak), out, 1 / (self.peak - self.low))
        return np.asarray(np.where((at < self.low) | (at >= self.high), 0.0, out))

    def gains(self, factors: FloatArray) -> FloatArray:
        """Return the derivatives of `combine`: (frames, n, parts)."""
        count = factors.shape[2]
        if self.mode == "product":
            rest = [np.delete(factors, part, axis=2).prod(axis=2) for part in range(count)]
            return np.stack(rest, axis=2)
        if self.mode == "minimum":
            return np.asarray(factors.argmin(axis=2)[:, :, None] == np.arange(count), np.float64)
        above = np.maximum(factors, _LEAST_FACTOR)
        return np.asarray(combine(factors, self.mode)[:, :, None] ** 2 / (count * above**2))


def combine(factors: FloatArray, mode: CombinationMode) -> FloatArray:
    """Return combinations of factors, along their last axis."""
    if mode == "product":
        return np.asarray(factors.prod(axis=-1))
    if mode == "minimum":
        return np.asarray(factors.min(axis=-1))
    mean = factors.shape[-1] / (1 / np.maximum(factors, _LEAST_FACTOR)).sum(axis=-1)
    return np.asarray(np.where(factors.min(axis=-1) > 0, mean, 0.0))


class RigLogic:
    """The combination shapes of a rig as functions of its animated shapes.

    Parameters
    ----------
    shapes : sequence of str
        Animated shapes.
    combinations : sequence of Combination
        From `order_combinations`.
    """

    def __init__(self, shapes: Sequence[str], combinations: Sequence[Combination]) -> None:
        self.shapes = tuple(shapes)
        self.combinations = tuple(combinations)
        self.driven = frozenset(each.shape for each in combinations)
        """Names of the combinations."""
        column = index_of((*self.shapes, *(each.shape for each in combinations)))
        level = dict.fromkeys(self.shapes, 0)
        for each in combinations:
            level[each.shape] = 1 + max(level[part] for part in each.parts)
        knots: dict[str, set[float]] = {}
        for each in combinations:
            for part, weight in zip(each.parts, each.part_weights, strict=True):
                if not each.spans:
                    knots.setdefault(part, {0.0, 1.0}).add(weight)

        def key(each: Combination) -> tuple[int, str, int]:
            return level[each.shape], each.mode, len(each.parts)

        self._steps = [
            _step(list(group), column, knots)
            for _, group in groupby(sorted(combinations, key=key), key)
        ]

    def evaluate(self, weights: ArrayLike) -> FloatArray:
        """Return the weights of all shapes, combinations last: (frames, shapes + combinations).

        `weights`: (frames, shapes), of the animated shapes.
        """
        given = np.asarray(weights, dtype=np.float64)
        out = np.zeros((len(given), len(self.shapes) + len(self.combinations)))
        out[:, : len(self.shapes)] = given
        for step in self._steps:
            out[:, step.columns] = combine(step.factors(out), step.mode)
        return out

    def slopes(self, weights: ArrayLike) -> FloatArray:
        """Return the Jacobian of the combinations: (frames, combinations, shapes)."""
        values, links = self.link_slopes(self.evaluate(weights)), self.links
        out = np.zeros((len(values), len(self.combinations), len(self.shapes)))
        for column, (combination, shape) in enumerate(links.tolist()):
            out[:, combination, shape] += values[:, column]
        return out

    @cached_property
    def links(self) -> IntArray:
        """Combination and shape of each path from a shape to a combination: (links, 2)."""
        return np.array([link[:2] for step in self._paths for link in step], np.int64).reshape(
            -1, 2
        )

    @cached_property
    def _paths(self) -> list[list[tuple[int, int, int, int]]]:
        """Links of each step: combination, shape, index of its gain, and previous link or -1."""
        count = len(self.shapes)
        known: dict[int, list[tuple[int, int]]] = {}
        paths, number = [], 0
        for step in self._steps:
            links = []
            for gain, (row, part) in enumerate(np.ndindex(step.parts.shape)):
                column, target = int(step.parts[row, part]), int(step.columns[row])
                for shape, before in [(column, -1)] if column < count else known[column]:
                    links.append((target - count, shape, gain, before))
                    known.setdefault(target, []).append((shape, number))
                    number += 1
            paths.append(links)
        return paths

    def link_slopes(self, values: FloatArray) -> FloatArray:
        """Return the derivatives along `links`, by the chain rule: (frames, links).

        `values`: (frames, shapes + combinations), from `evaluate`.
        """
        slopes = [np.ones((len(values), 1))]
        for step, links in zip(self._steps, self._paths, strict=True):
            gains = step.gains(step.factors(values)) * step.slopes(values)
            index = np.array(links, np.int64)
            slope = gains.reshape(len(values), -1)[:, index[:, 2]]
            if (index[:, 3] >= 0).any():
                slope = slope * np.concatenate(slopes, axis=1)[:, index[:, 3] + 1]
            slopes.append(slope)
        return np.concatenate(slopes[1:], axis=1) if self._steps else np.zeros((len(values), 0))

    def tables(self) -> list[dict[str, object]]:
        """Return the combinations in the order of evaluation, for JSON; ``high`` may be None."""
        return [
            {
                "shape": int(step.columns[row]),
                "mode": step.mode,
                "parts": step.parts[row].tolist(),
                "low": step.low[row].tolist(),
                "peak": step.peak[row].tolist(),
                "high": [None if np.isinf(each) else each for each in step.high[row].tolist()],
            }
            for step in self._steps
            for row in range(len(step.columns))
        ]

    def complete(self, weights: RealArray, names: Sequence[str]) -> FloatArray:
        """Return weights by name, followed by the combinations they drive: (frames, shapes).

        `weights`: (frames, names); missing shapes are 0, combinations among `names` are left out.
        """
        every = self.evaluate(columns_by_name(weights, names, self.shapes))
        free = [column for column, name in enumerate(names) if name not in self.driven]
        return np.concatenate([weights[:, free], every[:, len(self.shapes) :]], axis=1)


def _step(group: list[Combination], column: dict[str, int], knots: dict[str, set[float]]) -> _Step:
    supports = np.array([_supports(each, knots) for each in group])
    return _Step(
        mode=group[0].mode,
        columns=np.array([column[each.shape] for each in group], np.int64),
        parts=np.array([[column[part] for part in each.parts] for each in group], np.int64),
        low=supports[:, :, 0],
        peak=supports[:, :, 1],
        high=supports[:, :, 2],
    )


def _supports(
    combination: Combination, knots: dict[str, set[float]]
) -> list[tuple[float, float, float]]:
    """Return `low`, `peak` and `high` of each part's factor."""
    supports = []
    for index, (part, peak) in enumerate(
        zip(combination.parts, combination.part_weights, strict=True)
    ):
        if peak == 1.0:
            supports.append((0.0, 1.0, np.inf))
        elif combination.spans:
            supports.append((combination.spans[index][0], peak, combination.spans[index][1]))
        else:
            below = max(knot for knot in knots[part] if knot < peak)
            supports.append((below, peak, min(knot for knot in knots[part] if knot > peak)))
    return supports


def logic_of(names: Sequence[str], combinations: Sequence[Combination]) -> RigLogic | None:
    """Return the logic over some of a rig's shapes and its drivers; None without combinations."""
    if not combinations:
        return None
    driven = {each.shape for each in combinations}
    driving = [part for each in combinations for part in each.parts if part not in driven]
    shapes = dict.fromkeys((*(name for name in names if name not in driven), *driving))
    return RigLogic(tuple(shapes), combinations)
