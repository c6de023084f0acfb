"""Gaussian RBF on as many components as the pairs carry, one wide width, a straight tail."""

from typing import Any

import numpy as np

from usdface.core.arrays import FloatArray
from usdface.model.regressions import d06
from usdface.model.regressions import ridge as linear
from usdface.model.regressions.base import (
    Fitted,
    Method,
    Pairs,
    Predictor,
    Settings,
    dimension_choices,
)
from usdface.model.regressions.d06 import rbf_arrays, rbf_from_arrays
from usdface.numerics.array_namespace import ArrayDevice
from usdface.numerics.regression.linear_ridge import (
    LinearRidge,
    fit_linear_ridge,
    predict_linear_ridge,
)
from usdface.numerics.regression.rbf_ridge import (
    centre_widths,
    fit_rbf_ridge,
    predict_rbf_ridge,
    shared_widths,
)


def _candidates(pairs: Pairs, dimensions: int | None) -> tuple[Settings, ...]:
    choices = dimension_choices(pairs, dimensions, (8, 16, 24, 32))
    shared = [(width, "shared") for width in (4.0, 8.0, 16.0)]
    return tuple(
        {"dimensions": d, "width": width, "widths": widths}
        for d in choices
        for width, widths in (*shared, (8.0, "per centre"))
    )


def _fit(pairs: Pairs, settings: Settings) -> Fitted:
    features = pairs.coordinates[:, : int(settings["dimensions"])]
    line = fit_linear_ridge(features, pairs.weights)
    # The network learns what the line leaves over, so far from all pairs the line goes on. It
    # learns from leave-one-out residuals: the fitted ones are small where the line overfits.
    of = centre_widths if settings.get("widths") == "per centre" else shared_widths
    widths = of(features, multiple=float(settings["width"]))
    network = fit_rbf_ridge(features, line.loo_residuals, widths=widths)
    arrays = {"mean": line.mean, "slope": line.coefficients, "intercept": line.intercept}
    return Fitted(rbf_arrays(network) | arrays, settings)


def _predict(
    arrays: dict[str, FloatArray], settings: Settings, coordinates: FloatArray
) -> FloatArray:
    features = coordinates[:, : int(settings["dimensions"])]
    nothing = np.zeros(0)
    line = LinearRidge(arrays["mean"], arrays["slope"], arrays["intercept"], nothing, nothing)
    return predict_linear_ridge(line, features) + predict_rbf_ridge(
        rbf_from_arrays(arrays), features
    )


def _prepare(arrays: dict[str, FloatArray], settings: Settings, device: ArrayDevice) -> Predictor:
    line = linear.prepare(arrays, settings, device)
    network = d06.prepare(arrays, settings, device)

    def predict(coordinates: Any) -> Any:
        return line(coordinates) + network(coordinates)

    return predict


METHOD = Method(
    name="rbf",
    summary="Gaussian RBF over a straight line, components and width by cross-validation",
    candidates=_candidates,
    fit=_fit,
    predict=_predict,
    prepare=_prepare,
)
