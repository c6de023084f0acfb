"""A straight line with a ridge chosen by leave-one-out: the baseline that others must beat."""

from typing import Any

import numpy as np

from usdface.core.arrays import FloatArray
from usdface.model.regressions.base import (
    Fitted,
    Method,
    Pairs,
    Predictor,
    Settings,
    dimension_choices,
)
from usdface.numerics.array_namespace import ArrayDevice
from usdface.numerics.regression.linear_ridge import (
    LinearRidge,
    fit_linear_ridge,
    predict_linear_ridge,
)


def _candidates(pairs: Pairs, dimensions: int | None) -> tuple[Settings, ...]:
    return tuple(
        {"dimensions": d} for d in dimension_choices(pairs, dimensions, (8, 16, 24, 32, 40))
    )


def _fit(pairs: Pairs, settings: Settings) -> Fitted:
    features = pairs.coordinates[:, : int(settings["dimensions"])]
    model = fit_linear_ridge(features, pairs.weights)
    arrays = {
        "mean": model.mean,
        "slope": model.coefficients,
        "intercept": model.intercept,
        "ridge": model.ridge,
    }
    return Fitted(arrays, settings)


def _predict(
    arrays: dict[str, FloatArray], settings: Settings, coordinates: FloatArray
) -> FloatArray:
    line = LinearRidge(
        arrays["mean"], arrays["slope"], arrays["intercept"], arrays["ridge"], np.zeros((0, 0))
    )
    return predict_linear_ridge(line, coordinates[:, : int(settings["dimensions"])])


def prepare(arrays: dict[str, FloatArray], settings: Settings, device: ArrayDevice) -> Predictor:
    """Put the line on a device."""
    kept = int(settings["dimensions"])
    slope = device.put(arrays["slope"])
    offset = device.put(arrays["intercept"] - arrays["mean"] @ arrays["slope"])

    def predict(coordinates: Any) -> Any:
        return coordinates[:, :kept] @ slope + offset

    return predict


METHOD = Method(
    name="ridge",
    summary="linear ridge regression, a ridge per shape by leave-one-out",
    candidates=_candidates,
    fit=_fit,
    predict=_predict,
    prepare=prepare,
)
