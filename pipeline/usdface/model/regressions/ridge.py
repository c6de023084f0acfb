"""Linear ridge regression, with the ridge chosen by leave-one-out error."""

from usdface.core.arrays import Arrays
from usdface.model.regressions.base import (
    Fitted,
    Pairs,
    Predictor,
    Regression,
    Settings,
    dimension_choices,
    leading_inputs,
)
from usdface.numerics.regression.linear_ridge import LinearRidge, fit_linear_ridge


def _candidates(pairs: Pairs, dimensions: tuple[int, ...]) -> tuple[Settings, ...]:
    return tuple(
        {"dimensions": d} for d in dimension_choices(pairs, dimensions, (8, 16, 24, 32, 40))
    )


def _fit(pairs: Pairs, settings: Settings) -> Fitted:
    line = fit_linear_ridge(leading_inputs(pairs.inputs, settings), pairs.outputs)
    return Fitted(line_arrays(line) | {"ridge": line.ridge}, settings)


def line_arrays(line: LinearRidge) -> Arrays:
    """Return a linear model as arrays of a mapping."""
    return {"mean": line.mean, "slope": line.coefficients, "intercept": line.intercept}


def prepare_line(arrays: Arrays, settings: Settings) -> Predictor:
    """Return the predictor of a linear model's arrays."""
    slope = arrays["slope"]
    offset = arrays["intercept"] - arrays["mean"] @ slope
    return lambda inputs: leading_inputs(inputs, settings) @ slope + offset


METHOD = Regression(
    name="ridge",
    fit=_fit,
    prepare=prepare_line,
    mapping_candidates=_candidates,
    retarget_candidates=({},),
)
