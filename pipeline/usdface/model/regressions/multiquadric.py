"""Hardy's multiquadric: Song, Choi, Seol and Noh (2011), section 4.1, on markers."""

from usdface.core.arrays import FloatArray
from usdface.model.regressions.base import Fitted, Method, Pairs, Settings, dimension_choices
from usdface.model.regressions.scaling import POWERS, coordinate_scale, scaled
from usdface.numerics.regression.multiquadric_rbf import (
    Multiquadric,
    fit_multiquadric,
    predict_multiquadric,
)


def _candidates(pairs: Pairs, dimensions: int | None) -> tuple[Settings, ...]:
    return tuple(
        {"dimensions": d, "whitening": power, "smooth": smooth}
        for smooth in (False, True)
        for d in dimension_choices(pairs, dimensions, (16, 24, 40))
        for power in POWERS
    )


def _fit(pairs: Pairs, settings: Settings) -> Fitted:
    scale = coordinate_scale(pairs, settings)
    model, smooth = fit_pairs(pairs, scale, smooth=bool(settings["smooth"]))
    return Fitted(multiquadric_arrays(model) | {"scale": scale}, settings | {"smooth": smooth})


def _predict(
    arrays: dict[str, FloatArray], settings: Settings, coordinates: FloatArray
) -> FloatArray:
    features = scaled(coordinates, arrays["scale"])
    return predict_multiquadric(multiquadric_from_arrays(arrays), features)


def fit_pairs(pairs: Pairs, scale: FloatArray, *, smooth: bool) -> tuple[Multiquadric, bool]:
    """Fit to pairs, smoothly where they cannot all be met: two faces alike, keyed differently."""
    features = scaled(pairs.coordinates, scale)
    if not smooth:
        try:
            return fit_multiquadric(features, pairs.weights), False
        except ValueError:
            pass
    return fit_multiquadric(features, pairs.weights, smooth=True), True


def multiquadric_arrays(model: Multiquadric) -> dict[str, FloatArray]:
    """Name a network's parts for a mapping."""
    return {
        "centres": model.centres,
        "softness": model.softness,
        "coefficients": model.coefficients,
        "ridge": model.ridge,
    }


def multiquadric_from_arrays(arrays: dict[str, FloatArray]) -> Multiquadric:
    """Put a network together again."""
    return Multiquadric(
        arrays["centres"], arrays["softness"], arrays["coefficients"], arrays["ridge"]
    )


METHOD = Method(
    name="multiquadric",
    summary="Hardy multiquadric through every pair, each centre as soft as its neighbour is far",
    candidates=_candidates,
    fit=_fit,
    predict=_predict,
)
