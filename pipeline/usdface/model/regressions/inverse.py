"""Weights by solving, as the equation does, on a basis learned from the pairs alone."""

from collections.abc import Callable
from typing import cast

from usdface.core.arrays import FloatArray
from usdface.model.regressions.base import Fitted, Method, Pairs, Settings, dimension_choices
from usdface.numerics.solve.forward_model import (
    ForwardModel,
    Solve,
    fit_forward_model,
    solve_forward_model,
)

SOLVES: tuple[Solve, ...] = ("bounded", "nnls", "lstsq")


def _candidates(pairs: Pairs, dimensions: int | None) -> tuple[Settings, ...]:
    return tuple(
        settings for solve in SOLVES for settings in _only(solve, (0.0,))(pairs, dimensions)
    )


def _only(
    solve: Solve, penalties: tuple[float, ...]
) -> Callable[[Pairs, int | None], tuple[Settings, ...]]:
    def candidates(pairs: Pairs, dimensions: int | None) -> tuple[Settings, ...]:
        return tuple(
            {"dimensions": d, "solve": solve, "l1": l1}
            for d in dimension_choices(pairs, dimensions, (16, 24, 40))
            for l1 in penalties
        )

    return candidates


def _fit(pairs: Pairs, settings: Settings) -> Fitted:
    model = fit_forward_model(pairs.weights, pairs.coordinates[:, : int(settings["dimensions"])])
    arrays = {
        "basis": model.basis,
        "offset": model.offset,
        "noise": model.noise,
        "weight_mean": model.weight_mean,
        "weight_precision": model.weight_precision,
        "solve_ranges": pairs.ranges,
    }
    return Fitted(arrays, settings)


def _predict(
    arrays: dict[str, FloatArray], settings: Settings, coordinates: FloatArray
) -> FloatArray:
    model = ForwardModel(
        arrays["basis"],
        arrays["offset"],
        arrays["noise"],
        arrays["weight_mean"],
        arrays["weight_precision"],
    )
    return solve_forward_model(
        model,
        coordinates[:, : int(settings["dimensions"])],
        solve=cast(Solve, settings["solve"]),
        ranges=arrays["solve_ranges"],
        l1=float(settings.get("l1", 0.0)),
    )


METHOD = Method(
    name="inverse",
    summary="least squares, non-negative or bounded, on a basis learned from the pairs",
    candidates=_candidates,
    fit=_fit,
    predict=_predict,
)

_SINGLE: tuple[tuple[str, Solve, tuple[float, ...], str], ...] = (
    ("least_squares", "lstsq", (0.0,), "least squares on a basis learned from the pairs"),
    ("nnls", "nnls", (0.0,), "the same, no weight negative"),
    ("bounded", "bounded", (0.0,), "the same within the ranges: the most probable weights"),
    ("sparse", "bounded", (1.0, 4.0, 16.0), "the same with few shapes at a time (L1)"),
)

SINGLE = tuple(
    Method(name, summary, _only(solve, penalties), _fit, _predict)
    for name, solve, penalties, summary in _SINGLE
)
"""Each way of solving as a method by itself."""
