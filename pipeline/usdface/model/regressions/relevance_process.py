"""A Gaussian process with a length for each component, learned by its evidence (ARD)."""

import numpy as np

from usdface.core.arrays import FloatArray
from usdface.model.regressions.base import Fitted, Method, Pairs, Settings, dimension_choices
from usdface.numerics.regression.ard_process import (
    ARDProcess,
    fit_ard_process,
    predict_ard_process,
)

LEAST_DEVIATION_MM = 0.25
"""Of a component: a head placed by a hundredth of a millimetre otherwise moves components by a
tenth, and one that hardly moved among the references must not become another face by it."""


def _candidates(pairs: Pairs, dimensions: int | None) -> tuple[Settings, ...]:
    return tuple({"dimensions": d} for d in dimension_choices(pairs, dimensions, (8, 16, 24)))


def _fit(pairs: Pairs, settings: Settings) -> Fitted:
    model = fit_ard_process(
        pairs.coordinates[:, : int(settings["dimensions"])],
        pairs.weights,
        least_deviation=LEAST_DEVIATION_MM,
    )
    arrays = {
        "centres": model.centres,
        "lengths": model.lengths,
        "dual": model.dual,
        "mean": model.mean,
    }
    learned: Settings = {
        "amplitude": model.amplitude,
        "noise": model.noise,
        "evidence": model.evidence,
    }
    return Fitted(arrays, settings | learned)


def _predict(
    arrays: dict[str, FloatArray], settings: Settings, coordinates: FloatArray
) -> FloatArray:
    model = ARDProcess(
        arrays["centres"],
        arrays["lengths"],
        float(settings["amplitude"]),
        float(settings["noise"]),
        arrays["dual"],
        arrays["mean"],
        float("nan"),
    )
    return predict_ard_process(model, np.ascontiguousarray(coordinates[:, : len(model.lengths)]))


METHOD = Method(
    name="gaussian_process",
    summary="Gaussian process, a length for each component by maximum evidence (ARD)",
    candidates=_candidates,
    fit=_fit,
    predict=_predict,
)
