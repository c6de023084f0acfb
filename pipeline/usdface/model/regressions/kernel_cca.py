"""Kernel canonical correlation: Song, Choi, Seol and Noh (2011), section 4.2, on markers.

With the lines of eq. 6 and 7 penalised as eq. 5 is; as published they are part of `hybrid`.
"""

import numpy as np

from usdface.core.arrays import FloatArray
from usdface.model.regressions.base import Fitted, Method, Pairs, Settings, dimension_choices
from usdface.model.regressions.scaling import POWERS, coordinate_scale, scaled
from usdface.numerics.regression.kernel_cca import (
    KernelCCA,
    fit_kernel_cca,
    median_width,
    predict_expansion,
)

WIDTHS = (4.0, 8.0)
"""Multiples of the median distance between pairs. Narrower kernels forget between the pairs."""


def _candidates(pairs: Pairs, dimensions: int | None) -> tuple[Settings, ...]:
    return tuple(
        space | {"lines": "penalised", "kappa": kappa}
        for space in spaces(pairs, dimensions)
        for kappa in (1e-7, 1e-6, 1e-5)
    )


def spaces(pairs: Pairs, dimensions: int | None) -> tuple[Settings, ...]:
    """Return the coordinates and kernels worth trying."""
    return tuple(
        {"dimensions": d, "whitening": power, "width": width}
        for d in dimension_choices(pairs, dimensions, (24, 40))
        for power in POWERS
        for width in WIDTHS
    )


def _fit(pairs: Pairs, settings: Settings) -> Fitted:
    scale = coordinate_scale(pairs, settings)
    model = fit_pairs(pairs, scale, settings)
    return Fitted(kernel_cca_arrays(model) | {"scale": scale}, settings)


def _predict(
    arrays: dict[str, FloatArray], settings: Settings, coordinates: FloatArray
) -> FloatArray:
    return predict_from_arrays(arrays, scaled(coordinates, arrays["scale"]))


def fit_pairs(pairs: Pairs, scale: FloatArray, settings: Settings) -> KernelCCA:
    """Fit to pairs with a candidate's ``width``, ``kappa``, ``lines`` and ``components`` if any."""
    features = scaled(pairs.coordinates, scale)
    wide = float(settings["width"])
    alike = bool((pairs.weights == pairs.weights[0]).all())  # nothing to tell apart: any width
    return fit_kernel_cca(
        features,
        pairs.weights,
        source_width=median_width(features, multiple=wide),
        target_width=1.0 if alike else median_width(pairs.weights, multiple=wide),
        kappa=float(settings["kappa"]),
        components=int(settings["components"]) if "components" in settings else None,
        lines="published" if settings["lines"] == "published" else "penalised",
    )


def kernel_cca_arrays(model: KernelCCA) -> dict[str, FloatArray]:
    """Name a regression's parts for a mapping: what predicts, and how much correlates."""
    return {
        "sources": model.centres,
        "source_width": np.array([model.width]),
        "operator": model.operator,
        "intercept": model.intercept,
        "correlations": model.correlations,
    }


def predict_from_arrays(arrays: dict[str, FloatArray], features: FloatArray) -> FloatArray:
    """Evaluate a regression from a mapping's arrays."""
    return predict_expansion(
        features,
        arrays["sources"],
        float(arrays["source_width"][0]),
        arrays["operator"],
        arrays["intercept"],
    )


METHOD = Method(
    name="kernel_cca",
    summary="kernel canonical correlation, penalty and width by cross-validation",
    candidates=_candidates,
    fit=_fit,
    predict=_predict,
)
