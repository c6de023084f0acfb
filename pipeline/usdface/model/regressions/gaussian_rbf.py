"""Gaussian radial basis functions: with a linear part (`rbf`), and as published (`d06`).

Deng, Chiang, Fox and Neumann (2006), *Animating Blendshape Faces by Cross-Mapping Motion Capture
Data*, sections 5 and 6.
"""

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
from usdface.model.regressions.ridge import line_arrays, prepare_line
from usdface.numerics.regression.linear_ridge import fit_linear_ridge
from usdface.numerics.regression.rbf_ridge import (
    RBFRidge,
    centre_widths,
    fit_rbf_ridge,
    gaussian_design,
    predict_rbf_ridge,
    reestimate_ridge,
    rotate,
    shared_widths,
)

PAPER_DIMENSIONS = 4
"""The paper's number of components, which explain 90.21 % of its variance."""

PAPER_WIDTH = 2.0
"""Width as a multiple of the distance to the nearest centre. The paper states no width; basis
functions that overlap with their nearest neighbours only are a usual default. Larger widths have
lower errors: `train --method d06 --widths 2,4,8,16` compares."""

ITERATION_START = 1e-3
"""Initial ridge relative to the largest squared singular value, which the paper does not state."""


def _candidates(pairs: Pairs, dimensions: tuple[int, ...]) -> tuple[Settings, ...]:
    choices = dimension_choices(pairs, dimensions, (8, 16, 24, 32))
    shared = [(width, "shared") for width in (4.0, 8.0, 16.0)]
    return tuple(
        {"dimensions": d, "width": width, "widths": widths}
        for d in choices
        for width, widths in (*shared, (8.0, "per centre"))
    )


def _fit(pairs: Pairs, settings: Settings) -> Fitted:
    features = leading_inputs(pairs.inputs, settings)
    line = fit_linear_ridge(features, pairs.outputs)
    # Far from all pairs the network vanishes, and the line extrapolates. The network is fitted to
    # leave-one-out residuals, since fitted ones are too small where the line overfits.
    widths_of = centre_widths if settings.get("widths") == "per centre" else shared_widths
    widths = widths_of(features, multiple=float(settings["width"]))
    network = fit_rbf_ridge(features, line.loo_residuals, widths=widths)
    return Fitted(_network_arrays(network) | line_arrays(line), settings)


def _prepare(arrays: Arrays, settings: Settings) -> Predictor:
    line, network = prepare_line(arrays, settings), _prepare_network(arrays, settings)
    return lambda inputs: line(inputs) + network(inputs)


def _published_candidates(pairs: Pairs, dimensions: tuple[int, ...]) -> tuple[Settings, ...]:
    choices = dimension_choices(pairs, dimensions, (PAPER_DIMENSIONS,))
    return tuple(
        {"dimensions": d, "width": PAPER_WIDTH, "ridge": ridge}
        for d in choices
        for ridge in ("closed form", "iterated")
    )


def _fit_published(pairs: Pairs, settings: Settings) -> Fitted:
    centres = leading_inputs(pairs.inputs, settings)
    widths = centre_widths(centres, multiple=float(settings["width"]))
    ridge = None
    if settings.get("ridge") == "iterated":
        rotated = rotate(gaussian_design(centres, centres, widths), pairs.outputs)
        ridge = reestimate_ridge(rotated, start=ITERATION_START)
    model = fit_rbf_ridge(centres, pairs.outputs, widths=widths, ridge=ridge)
    return Fitted(_network_arrays(model), settings)


def _network_arrays(model: RBFRidge) -> Arrays:
    return {
        "centres": model.centres,
        "widths": model.widths,
        "coefficients": model.coefficients,
        "ridge": model.ridge,
        "freedom": model.freedom,
        "gcv": model.score,
    }


def _prepare_network(arrays: Arrays, settings: Settings) -> Predictor:
    fitted = [arrays[name] for name in ("centres", "widths", "coefficients")]
    return lambda inputs: predict_rbf_ridge(leading_inputs(inputs, settings), *fitted)


METHOD = Regression(
    name="rbf",
    fit=_fit,
    prepare=_prepare,
    mapping_candidates=_candidates,
)

PUBLISHED = Regression(
    name="d06",
    fit=_fit_published,
    prepare=_prepare_network,
    mapping_candidates=_published_candidates,
)
