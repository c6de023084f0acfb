"""The published method: Gaussian RBF with weight decay on four principal components.

Deng, Chiang, Fox and Neumann (2006), *Animating Blendshape Faces by Cross-Mapping Motion Capture
Data*, sections 5 and 6.
"""

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
from usdface.numerics.regression.local_sums import LocalSums
from usdface.numerics.regression.rbf_ridge import (
    RBFRidge,
    centre_widths,
    fit_rbf_ridge,
    gaussian_design,
    predict_rbf_ridge,
    reestimate_ridge,
    rotate,
)

PAPER_DIMENSIONS = 4
PAPER_WIDTH = 2.0
"""Multiple of the distance to the nearest centre; the paper gives none, this is customary."""

ITERATION_START = 1e-3
"""Of the largest squared singular value; the paper gives none either."""


def _candidates(pairs: Pairs, dimensions: int | None) -> tuple[Settings, ...]:
    choices = dimension_choices(pairs, dimensions, (PAPER_DIMENSIONS,))
    return tuple(
        {"dimensions": d, "width": PAPER_WIDTH, "ridge": ridge}
        for d in choices
        for ridge in ("closed form", "iterated")
    )


def _fit(pairs: Pairs, settings: Settings) -> Fitted:
    centres = pairs.coordinates[:, : int(settings["dimensions"])]
    widths = centre_widths(centres, multiple=float(settings["width"]))
    ridge = None
    if settings.get("ridge") == "iterated":
        rotated = rotate(gaussian_design(centres, centres, widths), pairs.weights)
        ridge = reestimate_ridge(rotated, start=ITERATION_START)
    model = fit_rbf_ridge(centres, pairs.weights, widths=widths, ridge=ridge)
    return Fitted(rbf_arrays(model), settings)


def _predict(
    arrays: dict[str, FloatArray], settings: Settings, coordinates: FloatArray
) -> FloatArray:
    model = rbf_from_arrays(arrays)
    return predict_rbf_ridge(model, coordinates[:, : int(settings["dimensions"])])


def prepare(arrays: dict[str, FloatArray], settings: Settings, device: ArrayDevice) -> Predictor:
    """Put the network on a device."""
    kept = int(settings["dimensions"])
    exponent = -0.5 / arrays["widths"] ** 2
    sums = LocalSums(
        np.eye(kept), arrays["centres"], exponent[None], arrays["coefficients"], device=device
    )

    def predict(coordinates: Any) -> Any:
        return sums(coordinates[:, :kept])

    return predict


def rbf_arrays(model: RBFRidge) -> dict[str, FloatArray]:
    """Name a network's parts for a mapping."""
    return {
        "centres": model.centres,
        "widths": model.widths,
        "coefficients": model.coefficients,
        "ridge": model.ridge,
        "freedom": model.freedom,
        "gcv": model.score,
    }


def rbf_from_arrays(arrays: dict[str, FloatArray]) -> RBFRidge:
    """Put a network together again."""
    return RBFRidge(
        centres=arrays["centres"],
        widths=arrays["widths"],
        coefficients=arrays["coefficients"],
        ridge=arrays["ridge"],
        freedom=arrays["freedom"],
        score=arrays["gcv"],
    )


METHOD = Method(
    name="d06",
    summary="Gaussian RBF, 4 components, a width per centre, ridge by GCV: the paper as published",
    candidates=_candidates,
    fit=_fit,
    predict=_predict,
    prepare=prepare,
)
