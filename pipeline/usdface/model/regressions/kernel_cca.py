"""Kernel canonical correlation: Song et al. (2011), section 4.2, for markers and for retargeting.

With the lines of eq. 6 and 7 penalised as eq. 5 is; on markers, `hybrid` takes them as published,
and in retargeting `train-retarget --published` does.
"""

import numpy as np

from usdface.core.arrays import FloatArray
from usdface.model.regressions.base import (
    WHITENING_POWERS,
    Arrays,
    Fitted,
    Pairs,
    Predictor,
    Regression,
    Settings,
    dimension_choices,
    scale_arrays,
    scaled_inputs,
)
from usdface.numerics.regression.kernel_cca import (
    KernelCCA,
    fit_kernel_cca,
    median_width,
    predict_expansion,
)

_MAPPING_WIDTHS = (4.0, 8.0)
"""Multiples of the median distance between pairs. Narrower kernels forget between the pairs."""

RETARGET_KERNELS: tuple[Settings, ...] = tuple(
    {"width": width, "kappa": kappa}
    for width in (1.0, 2.0, 4.0, 8.0)
    for kappa in (1e-6, 1e-4, 1e-2)
)
"""Widths, in the same unit, and penalties that are tried."""

PUBLISHED_LINES: tuple[Settings, ...] = tuple(
    {"lines": "published", "components": components} for components in (8, 16, 32)
)
"""The paper prints no number of components. Over all of them plain least squares meets every pair
exactly, whatever the penalty; 32 is nearly all of its 34 pairs."""


def _candidates(pairs: Pairs, dimensions: tuple[int, ...]) -> tuple[Settings, ...]:
    return tuple(
        space | {"lines": "penalised", "kappa": kappa}
        for space in mapping_spaces(pairs, dimensions)
        for kappa in (1e-7, 1e-6, 1e-5)
    )


def mapping_spaces(pairs: Pairs, dimensions: tuple[int, ...]) -> tuple[Settings, ...]:
    """Return the coordinates and kernels worth trying on markers."""
    return tuple(
        {"dimensions": d, "whitening": power, "width": width}
        for d in dimension_choices(pairs, dimensions, (24, 40))
        for power in WHITENING_POWERS
        for width in _MAPPING_WIDTHS
    )


def fit_expansion(pairs: Pairs, settings: Settings) -> Fitted:
    """Fit to pairs; what is kept is what predicts, and how much correlates."""
    scale = scale_arrays(pairs, settings)
    model = fit_model(pairs, scale, settings)
    arrays = {
        "sources": model.centres,
        "source_width": np.array([model.width]),
        "operator": model.operator,
        "intercept": model.intercept,
        "correlations": model.correlations,
    }
    return Fitted(arrays | scale, settings)


def fit_model(pairs: Pairs, scale: Arrays, settings: Settings) -> KernelCCA:
    """Fit with a candidate's ``width`` and ``kappa``, its ``lines`` and ``components`` if any."""
    features = scaled_inputs(scale, settings, pairs.inputs)
    multiple = float(settings["width"])
    constant = bool((pairs.outputs == pairs.outputs[0]).all())  # then any width will do
    return fit_kernel_cca(
        features,
        pairs.outputs,
        source_width=median_width(features, multiple=multiple),
        target_width=1.0 if constant else median_width(pairs.outputs, multiple=multiple),
        kappa=float(settings["kappa"]),
        components=int(settings["components"]) if "components" in settings else None,
        lines="published" if settings.get("lines") == "published" else "penalised",
    )


def prepare_expansion(arrays: Arrays, settings: Settings) -> Predictor:
    """Make the regression ready that a mapping's or a retargeting's arrays hold."""
    sources, width = arrays["sources"], float(arrays["source_width"][0])
    operator, intercept = arrays["operator"], arrays["intercept"]

    def predict(inputs: FloatArray) -> FloatArray:
        features = scaled_inputs(arrays, settings, inputs)
        return predict_expansion(features, sources, width, operator, intercept)

    return predict


METHOD = Regression(
    name="kernel_cca",
    summary="kernel canonical correlation, penalty and width by cross-validation",
    fit=fit_expansion,
    prepare=prepare_expansion,
    mapping_candidates=_candidates,
    retarget_candidates=RETARGET_KERNELS,
)
