"""A model of its own for each shape, over the markers that it moves."""

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
    in_double_precision,
)
from usdface.model.regressions.voices import (
    GLOBAL_LINES,
    REGION_TIGHT,
    REGION_WIDE,
    global_voice,
    local_sums,
    regional_voice,
)
from usdface.numerics.array_namespace import CPU, ArrayDevice
from usdface.numerics.regression.marker_regions import marker_relevance, regional_features

_FLOOR = 0.01
SHARPNESS = {"wide": 1.5, "tight": 2.0}


def _candidates(pairs: Pairs, dimensions: int | None) -> tuple[Settings, ...]:
    most = dimension_choices(pairs, dimensions, (40,))
    return tuple({"dimensions": d, "region": region} for d in most for region in SHARPNESS)


def _fit(pairs: Pairs, settings: Settings) -> Fitted:
    kept = int(settings["dimensions"])
    z, components = pairs.coordinates[:, :kept], pairs.motion.components[:kept]
    variances = np.maximum(pairs.motion.variances[:kept], 1e-9)
    importance = np.diag(pairs.gram) + 1e-3 * float(np.diag(pairs.gram).mean())
    line = global_voice(
        z, pairs.weights, variances=variances, choices=GLOBAL_LINES, importance=importance
    )
    sample = pairs.motion.sample[:, :kept]
    guessed = np.clip(sample @ line.slope + line.intercept, pairs.ranges[:, 0], pairs.ranges[:, 1])
    relevance = marker_relevance(
        sample, guessed, components, sharpness=SHARPNESS[str(settings["region"])], floor=_FLOOR
    )
    covariance = np.cov(sample.T).reshape(kept, -1)
    voice = regional_voice(
        z,
        pairs.weights,
        regions=tuple(regional_features(components, covariance, row) for row in relevance),
        choices=REGION_WIDE if settings["region"] == "wide" else REGION_TIGHT,
        shared=settings["region"] == "wide",
    )
    arrays = {"slope": voice.slope, "intercept": voice.intercept, "relevance": relevance}
    return Fitted(arrays | voice.locals, settings)


def _prepare(
    arrays: dict[str, FloatArray],
    settings: Settings,
    device: ArrayDevice = CPU,
    *,
    single: bool = True,
) -> Predictor:
    single &= device is CPU  # in double precision all devices agree to 1e-6 with it
    kept = int(settings["dimensions"])
    slope, intercept = device.put(arrays["slope"]), device.put(arrays["intercept"])
    sums = local_sums(arrays, single=single, device=device)

    def predict(coordinates: Any) -> Any:
        z = coordinates[:, :kept]
        return z @ slope + intercept + sums(z)

    return predict


METHOD = Method(
    name="regional",
    summary="a Gaussian process for each shape over the markers it moves",
    candidates=_candidates,
    fit=_fit,
    predict=in_double_precision(_prepare),
    prepare=_prepare,
)
