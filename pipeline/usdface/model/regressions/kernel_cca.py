"""Kernel canonical correlation analysis: Song et al. (2011), section 4.2.

The lines of eq. 6 and 7 carry the same penalty as eq. 5. They are unpenalised, as published, in
`hybrid` for mappings, and with `train-retarget --published`.
"""

import numpy as np

from usdface.core.arrays import Arrays
from usdface.model.regressions.base import (
    WHITENING_POWERS,
    Fitted,
    Pairs,
    Predictor,
    Regression,
    Settings,
    dimension_choices,
    scale_arrays,
    scaled_inputs,
)
from usdface.numerics.regression.kernel_cca import fit_kernel_cca, median_width, predict_expansion

_MAPPING_WIDTHS = (4.0, 8.0)
"""Candidates, as multiples of the median distance between pairs. Narrower kernels return to the
mean between pairs."""

RETARGET_KERNELS: tuple[Settings, ...] = tuple(
    {"width": width, "kappa": kappa}
    for width in (1.0, 2.0, 4.0, 8.0)
    for kappa in (1e-6, 1e-4, 1e-2)
)
"""Candidate widths, in the same unit, and penalties."""

PUBLISHED_LINES: tuple[Settings, ...] = tuple(
    {"lines": "published", "components": components} for components in (8, 16, 32)
)
"""Candidate numbers of components, which the paper does not state. With all components, plain least
squares interpolates every pair whatever the penalty; the paper has 34 pairs."""


def _candidates(pairs: Pairs, dimensions: tuple[int, ...]) -> tuple[Settings, ...]:
    return tuple(
        space | {"lines": "penalised", "kappa": kappa}
        for space in mapping_spaces(pairs, dimensions)
        for kappa in (1e-7, 1e-6, 1e-5)
    )


def mapping_spaces(pairs: Pairs, dimensions: tuple[int, ...]) -> tuple[Settings, ...]:
    """Return candidate coordinates and kernel widths for mappings."""
    return tuple(
        {"dimensions": d, "whitening": power, "width": width}
        for d in dimension_choices(pairs, dimensions, (24, 40))
        for power in WHITENING_POWERS
        for width in _MAPPING_WIDTHS
    )


def fit_expansion(pairs: Pairs, settings: Settings) -> Fitted:
    """Fit to pairs; the arrays hold the prediction's operator and the canonical correlations."""
    scale = scale_arrays(pairs, settings)
    features = scaled_inputs(scale, settings, pairs.inputs)
    multiple = float(settings["width"])
    constant = bool((pairs.outputs == pairs.outputs[0]).all())  # any width fits a constant
    model = fit_kernel_cca(
        features,
        pairs.outputs,
        source_width=median_width(features, multiple=multiple),
        target_width=1.0 if constant else median_width(pairs.outputs, multiple=multiple),
        kappa=float(settings["kappa"]),
        components=int(settings["components"]) if "components" in settings else None,
        lines="published" if settings.get("lines") == "published" else "penalised",
    )
    arrays = {
        "sources": model.centres,
        "source_width": np.array([model.width]),
        "operator": model.operator,
        "intercept": model.intercept,
        "correlations": model.correlations,
    }
    return Fitted(arrays | scale, settings)


def prepare_expansion(arrays: Arrays, settings: Settings) -> Predictor:
    """Return the predictor of fitted arrays."""
    sources, width = arrays["sources"], float(arrays["source_width"][0])
    fitted = sources, width, arrays["operator"], arrays["intercept"]
    return lambda inputs: predict_expansion(scaled_inputs(arrays, settings, inputs), *fitted)


METHOD = Regression(
    name="kernel_cca",
    fit=fit_expansion,
    prepare=prepare_expansion,
    mapping_candidates=_candidates,
    retarget_candidates=RETARGET_KERNELS,
)
