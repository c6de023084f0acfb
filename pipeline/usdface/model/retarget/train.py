"""Training and application of a retargeting: from source weights to target controls, and back.

`auto` chooses the regression with the smallest round-trip error, source to target to source (S11,
Song et al. 2011, section 6.3), on mixtures of the pairs or on a performance. A map that amplifies
what the pairs hardly show, such as differences of the sides, is inverted exactly; so regressions
are left out by which parts of an expression move the target farther than all of it.
"""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import Arrays, FloatArray, sample_frames
from usdface.core.controls import (
    Controls,
    ControlSpace,
    ExpressionPairs,
    Retargeting,
    RetargetScore,
)
from usdface.core.errors import InputError
from usdface.core.progress import Progress, silent
from usdface.model.regressions import RETARGET_METHODS, find_retarget_method
from usdface.model.regressions.base import Pairs, Settings
from usdface.model.regressions.hybrid import predict_blended
from usdface.model.regressions.kernel_cca import PUBLISHED_LINES
from usdface.model.retarget.control_space import check_pairs, control_space, moving_shapes

PROBE_COUNT = 384
"""Number of mixtures of pairs on which round-trip errors are measured, and of parts of pairs."""

OVERSHOOT_MARGIN = 0.1
"""Overshoot beyond the least of all candidates, from which a regression is not chosen."""

_MOST_FRAMES = 768
"""Maximum number of frames of a performance on which they are measured instead."""

_RANGE_MARGIN = 0.5
"""Range of a joint or attribute beyond that of the pairs, as a share of its span in them."""

EQUAL_ROUND_TRIP_MM = 5e-3
"""Invisible difference of round-trip errors; below it, the error at the pairs decides."""

_LEAST_SINGULAR = 0.01
"""Smallest singular value of pairs that spans a direction, relative to the largest."""

PAIR_ERROR_DIGITS = 9
"""Decimals of errors at the pairs and overshoots; further ones are rounding, which depends on the
machine."""

_LEAST_SPAN = 1e-9


@dataclass(frozen=True)
class Examples:
    """Pairs as arrays, for regression in both directions."""

    space: ControlSpace
    source: FloatArray
    target: FloatArray
    """`source`, `target`: (pairs, ns) and (pairs, k): differences from rest."""
    used: FloatArray
    """(ns,): 1 for source shapes that differ between pairs, 0 for others, which have no effect."""
    source_rest: FloatArray
    target_rest: FloatArray
    """`source_rest`, `target_rest`: (ns,) and (k,)"""
    source_ranges: FloatArray
    target_ranges: FloatArray
    """`source_ranges`, `target_ranges`: (ns, 2) and (k, 2)"""
    spans: FloatArray
    """(k,): range of each target coordinate over the pairs; 1 if it is constant."""
    units: FloatArray
    """(k,): unit of each target coordinate: 1 for weights, the span for joints and attributes, so
    that distances over the target do not depend on degrees or centimetres."""


@dataclass(frozen=True)
class _Fit:
    method: str
    settings: Settings
    forward: Arrays
    backward: Arrays


def train_retargeting(
    pairs: ExpressionPairs,
    *,
    method: str = "auto",
    shape_ranges: FloatArray | None = None,
    surface: FloatArray | None = None,
    performance: FloatArray | None = None,
    alpha: float | None = None,
    published: bool = False,
    progress: Progress = silent,
) -> Retargeting:
    """Train a retargeting on expression pairs.

    Parameters
    ----------
    method : str
        A key of `RETARGET_METHODS`, or ``auto``.
    shape_ranges : (target shapes, 2) float array, optional
        Limits of the target's weights; by default 0 to 1, extended to the values in the pairs.
    surface : (source shapes, points, 3) float array, optional
        Displacements of points of the source's surface by each shape at weight 1 [mm].
    performance : (frames, source shapes) float array, optional
        Frames on which methods are compared, instead of mixtures of the pairs.
    alpha : float, optional
        Fixed share of the multiquadric in the hybrid [0-1].
    published : bool, optional
        Whether kernel CCA uses ordinary least squares over few components.
    """
    check_pairs(pairs, "these pairs")
    examples = make_examples(pairs, shape_ranges=shape_ranges)
    probes = make_probes(examples, performance)
    tried: list[tuple[RetargetScore, _Fit]] = []
    candidates = _candidates(method, alpha, published=published)
    for number, (each, settings) in enumerate(candidates, start=1):
        fitted = _fit(each, settings, examples)
        tried.append((_score(fitted, examples, probes, surface), fitted))
        progress(number / len(candidates), f"tried {each}")
    limit = min(score.overshoot for score, _ in tried) + OVERSHOOT_MARGIN
    kept = [score.cyclic_mm for score, _ in tried if score.overshoot <= limit]
    equal = min(kept) + EQUAL_ROUND_TRIP_MM

    def rank(item: tuple[RetargetScore, _Fit]) -> tuple[bool, float, float]:
        score = item[0]
        return score.overshoot > limit, max(score.cyclic_mm, equal), score.pair_error

    tried.sort(key=rank)
    best = tried[0][1]
    return Retargeting(
        **vars(examples.space),
        method=best.method,
        source_shapes=pairs.source_shapes,
        rest=examples.target_rest,
        ranges=examples.target_ranges,
        arrays=best.forward
        | {
            "source_rest": examples.source_rest,
            "target_units": examples.units,
            "unused": 1 - examples.used,
            "unfollowed": np.zeros(len(examples.used)),
            "pair_span": _span(examples.source),
        },
        settings=best.settings,
        scores=tuple(score for score, _ in tried),
        target_rig=pairs.target_rig,
        target_prim=pairs.target_prim,
    )


def predict_coordinates(
    trained: Retargeting, source: FloatArray, *, alpha: FloatArray | None = None
) -> FloatArray:
    """Return the target's coordinates for source weights, beyond their limits too.

    Parameters
    ----------
    source : (frames, source shapes) float array
        In the order of ``trained.source_shapes``.
    alpha : (frames,) float array, optional
        Share of the multiquadric at each frame [0-1]; for a hybrid only.
    """
    arrays = trained.arrays
    try:
        inputs = (source - arrays["source_rest"]) * (1 - arrays["unused"])
        moved = _predict(trained.method, arrays, trained.settings, inputs, alpha)
        return np.asarray(moved * arrays["target_units"] + trained.rest)
    except (KeyError, ValueError, IndexError, TypeError) as error:
        raise InputError(
            f"the retargeting's arrays do not fit its method, {trained.method}, or the source: "
            f"{type(error).__name__}: {error}; train it again"
        ) from error


def retarget(
    trained: Retargeting, source: FloatArray, *, alpha: FloatArray | None = None
) -> Controls:
    """Return the target's controls for source weights; see `predict_coordinates`."""
    return limited_controls(trained, predict_coordinates(trained, source, alpha=alpha))


def unspanned_shares(trained: Retargeting, source: FloatArray) -> FloatArray:
    """Return the share of the source's motion that is no sum of the pairs' expressions.

    Of the summed squares of all weights, by shape: (source shapes,). Shapes that are the same in
    all pairs do not count. `source`: (frames, source shapes).
    """
    arrays = trained.arrays
    inputs = (source - arrays["source_rest"]) * (1 - arrays["unused"])
    beyond = inputs - inputs @ arrays["pair_span"].T @ arrays["pair_span"]
    return np.asarray((beyond**2).sum(axis=0) / max(float((inputs**2).sum()), 1e-12))


def limited_controls(trained: Retargeting, coordinates: FloatArray) -> Controls:
    """Return the controls at coordinates, within their limits."""
    return trained.decode(np.clip(coordinates, *trained.ranges.T))


def describe_retargeting_figures(trained: Retargeting) -> dict[str, object]:
    """Return a retargeting's properties for JSON."""
    return {
        "method": trained.method,
        "source_shapes": len(trained.source_shapes),
        "shapes": len(trained.shapes),
        "joints": len(trained.joints),
        "attributes": len(trained.attributes),
        "settings": dict(trained.settings),
        "scores": [vars(score) for score in trained.scores],
        "pairs": trained.pairs,
    }


def retargeting_table(trained: Retargeting) -> tuple[str, ...]:
    """Return a line on the best candidate of each method."""
    seen: dict[str, str] = {}
    for score in trained.scores:
        settings = f" ({score.settings})" if score.settings else ""
        seen.setdefault(
            score.method,
            f"{score.method}{settings}: round trip {score.cyclic_mm:.4f}, error at the pairs "
            f"{score.pair_error:.4f} of their range, overshoot {score.overshoot:.0%}",
        )
    return tuple(seen.values())


def make_examples(pairs: ExpressionPairs, *, shape_ranges: FloatArray | None = None) -> Examples:
    """Return pairs as differences from the pair nearest to the source's rest."""
    space = control_space(pairs.target)
    coordinates = space.encode(pairs.target)
    rest = int(np.linalg.norm(pairs.source, axis=1).argmin())
    spans = np.ptp(coordinates, axis=0)
    low, high = (
        coordinates.min(axis=0) - _RANGE_MARGIN * spans,
        coordinates.max(axis=0) + _RANGE_MARGIN * spans,
    )
    count = len(space.shapes)
    if shape_ranges is None:
        low[:count] = np.minimum(coordinates[:, :count].min(axis=0), 0.0)
        high[:count] = np.maximum(coordinates[:, :count].max(axis=0), 1.0)
    else:
        low[:count], high[:count] = shape_ranges.T
    spans = np.where(spans > _LEAST_SPAN, spans, 1.0)
    source_low = np.minimum(pairs.source.min(axis=0), 0.0)
    source_high = np.maximum(pairs.source.max(axis=0), 1.0)
    return Examples(
        space=space,
        source=pairs.source - pairs.source[rest],
        target=coordinates - coordinates[rest],
        used=moving_shapes(pairs).astype(np.float64),
        source_rest=pairs.source[rest],
        target_rest=coordinates[rest],
        source_ranges=np.stack([source_low, source_high], axis=1),
        target_ranges=np.stack([low, high], axis=1),
        spans=spans,
        units=np.concatenate([np.ones(count), spans[count:]]),
    )


def make_probes(examples: Examples, performance: FloatArray | None) -> FloatArray:
    """Return source expressions for round trips: frames of a performance, else mixtures of pairs.

    A mixture is the sum of one to four pairs with random weights of 0.2 to 1.
    """
    if performance is not None and len(performance):
        picks = sample_frames(len(performance), _MOST_FRAMES)
        return np.asarray(performance[picks], np.float64)
    rng = np.random.default_rng(0)
    count = len(examples.source)
    shares = np.zeros((PROBE_COUNT, count))
    for row in shares:
        chosen = rng.choice(count, min(int(rng.integers(1, 5)), count), replace=False)
        row[chosen] = rng.uniform(0.2, 1.0, len(chosen))
    mixed = shares @ examples.source + examples.source_rest
    return np.asarray(np.clip(mixed, *examples.source_ranges.T))


def round_trip(
    examples: Examples,
    method: str,
    settings: Settings,
    source: FloatArray,
    *,
    alpha: FloatArray | None = None,
) -> FloatArray:
    """Return source weights after a round trip by one method: (frames, source shapes).

    `alpha`: (frames,), share of the multiquadric in both directions [0-1]; for a hybrid only.
    """
    return _cycle(_fit(method, settings, examples), examples, source, alpha)


def _candidates(method: str, alpha: float | None, *, published: bool) -> list[tuple[str, Settings]]:
    names = tuple(RETARGET_METHODS) if method == "auto" else (method,)
    candidates: list[tuple[str, Settings]] = []
    for name in names:
        choices = find_retarget_method(name).retarget_candidates
        if name == "hybrid" and alpha is not None:
            kernels = {(s["width"], s["kappa"]) for s in choices}
            choices = tuple({"width": w, "kappa": k, "alpha": alpha} for w, k in sorted(kernels))
        if name in ("kernel_cca", "hybrid") and published:
            choices = tuple(each | lines for each in choices for lines in PUBLISHED_LINES)
        candidates += [(name, settings) for settings in choices]
    return candidates


def _fit(name: str, settings: Settings, examples: Examples) -> _Fit:
    method = find_retarget_method(name)
    forward = Pairs(examples.source, examples.target / examples.units)
    backward = Pairs(examples.target / examples.spans, examples.source)
    both = (method.fit(pairs, settings).arrays for pairs in (forward, backward))
    return _Fit(name, settings, *both)


def _predict(
    method: str, arrays: Arrays, settings: Settings, inputs: FloatArray, alpha: FloatArray | None
) -> FloatArray:
    if alpha is None:
        return find_retarget_method(method).predict(arrays, settings, inputs)
    return predict_blended(arrays, settings, inputs, alpha)


def _forward(
    fitted: _Fit, examples: Examples, source: FloatArray, alpha: FloatArray | None = None
) -> FloatArray:
    inputs = (source - examples.source_rest) * examples.used
    moved = _predict(fitted.method, fitted.forward, fitted.settings, inputs, alpha)
    target = moved * examples.units + examples.target_rest
    return np.asarray(np.clip(target, *examples.target_ranges.T))


def _cycle(
    fitted: _Fit, examples: Examples, source: FloatArray, alpha: FloatArray | None = None
) -> FloatArray:
    target = (_forward(fitted, examples, source, alpha) - examples.target_rest) / examples.spans
    back = _predict(fitted.method, fitted.backward, fitted.settings, target, alpha)
    return np.asarray(np.clip(back + examples.source_rest, *examples.source_ranges.T))


def _span(source: FloatArray) -> FloatArray:
    """Return an orthonormal basis of the pairs' expressions: (dimensions, source shapes)."""
    _, singular, directions = np.linalg.svd(source, full_matrices=False)
    return np.asarray(directions[singular > _LEAST_SINGULAR * singular[0]])


def _score(
    fitted: _Fit, examples: Examples, probes: FloatArray, surface: FloatArray | None
) -> RetargetScore:
    error = _cycle(fitted, examples, probes) - probes
    at_pairs = _forward(fitted, examples, examples.source + examples.source_rest)
    residual = (at_pairs - examples.target_rest - examples.target) / examples.spans
    settings = ", ".join(f"{name} {value}" for name, value in fitted.settings.items())
    return RetargetScore(
        method=fitted.method,
        settings=settings,
        cyclic_mm=_mean_distance(error, surface),
        pair_error=round(float(np.sqrt((residual**2).mean())), PAIR_ERROR_DIGITS),
        overshoot=_overshoot(fitted, examples),
    )


def _overshoot(fitted: _Fit, examples: Examples) -> float:
    """Return `RetargetScore.overshoot`, of parts of about half of the shapes."""
    rng = np.random.default_rng(0)
    rows = rng.integers(len(examples.source), size=PROBE_COUNT)
    parts = examples.source[rows] * (rng.random((PROBE_COUNT, len(examples.used))) < 0.5)
    whole = examples.target[rows] / examples.spans
    moved = _forward(fitted, examples, parts + examples.source_rest) - examples.target_rest
    moved /= examples.spans
    beyond = moved - np.clip(moved, np.minimum(whole, 0), np.maximum(whole, 0))
    share = np.sqrt((beyond**2).sum() / max(float((whole**2).sum()), 1e-12))
    return round(float(share), PAIR_ERROR_DIGITS)


def _mean_distance(error: FloatArray, surface: FloatArray | None) -> float:
    """Return the mean displacement by errors of weights; without a surface, their mean RMS."""
    if surface is None:
        return float(np.sqrt((error**2).mean(axis=1)).mean())
    moved = (error @ surface.reshape(len(surface), -1)).reshape(len(error), -1, 3)
    return float(np.sqrt(np.einsum("fpc,fpc->fp", moved, moved)).mean())
