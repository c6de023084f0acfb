"""Weights by solving, as the equation does, on a basis learned from the pairs alone."""

from typing import cast

from usdface.assets import FloatArray
from usdface.model.methods.contract import Fitted, Method, Pairs, Settings, dimension_choices
from usdface.numerics.solve.forward_model import (
    ForwardModel,
    Solve,
    fit_forward_model,
    solve_forward_model,
)

SOLVES: tuple[Solve, ...] = ("bounded", "nnls", "lstsq")


def _candidates(pairs: Pairs, dimensions: int | None) -> tuple[Settings, ...]:
    return tuple(
        {"dimensions": d, "solve": solve}
        for solve in SOLVES
        for d in dimension_choices(pairs, dimensions, (16, 24, 40))
    )


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
    )


METHOD = Method(
    name="inverse",
    summary="least squares, non-negative or bounded, on a basis learned from the pairs",
    candidates=_candidates,
    fit=_fit,
    predict=_predict,
)
