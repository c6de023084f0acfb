"""Hardy's multiquadric: Song, Choi, Seol and Noh (2011), *Characteristic Facial Retargeting*, 4.1.

Published for retargeting, where it is named `rbf`; in mappings it is `multiquadric`.
"""

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
from usdface.numerics.regression.multiquadric_rbf import fit_multiquadric, predict_multiquadric


def _candidates(pairs: Pairs, dimensions: tuple[int, ...]) -> tuple[Settings, ...]:
    return tuple(
        {"dimensions": d, "whitening": power, "smooth": smooth}
        for smooth in (False, True)
        for d in dimension_choices(pairs, dimensions, (16, 24, 40))
        for power in WHITENING_POWERS
    )


def fit_network(pairs: Pairs, settings: Settings) -> Fitted:
    """Interpolate the pairs; smooth them if equal inputs with different outputs prevent it.

    The setting ``smooth`` requests smoothing; in the result it states whether it was applied.
    """
    scale = scale_arrays(pairs, settings)
    features = scaled_inputs(scale, settings, pairs.inputs)
    smooth = bool(settings.get("smooth", False))
    try:
        model = fit_multiquadric(features, pairs.outputs, smooth=smooth)
    except ValueError:
        smooth = True
        model = fit_multiquadric(features, pairs.outputs, smooth=True)
    arrays = {
        "centres": model.centres,
        "softness": model.softness,
        "coefficients": model.coefficients,
        "ridge": model.ridge,
    }
    return Fitted(arrays | scale, settings | {"smooth": smooth})


def prepare_network(arrays: Arrays, settings: Settings) -> Predictor:
    """Return the predictor of fitted arrays."""
    fitted = [arrays[name] for name in ("centres", "softness", "coefficients")]
    return lambda inputs: predict_multiquadric(scaled_inputs(arrays, settings, inputs), *fitted)


METHOD = Regression(
    name="multiquadric",
    fit=fit_network,
    prepare=prepare_network,
    mapping_candidates=_candidates,
    retarget_candidates=({},),
    retarget_name="rbf",
)
