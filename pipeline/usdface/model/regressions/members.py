"""The members of the ensemble: processes over the region of each shape, and kernel CCA.

A member is a straight line plus local corrections. Lines of several members add up to one line;
local corrections keep their own centres.
"""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import FloatArray, IntArray
from usdface.model.regressions.base import (
    Arrays,
    Pairs,
    Predictor,
    Settings,
    scale_arrays,
    scaled_inputs,
)
from usdface.model.regressions.kernel_cca import fit_model
from usdface.numerics.regression.gaussian_process import (
    NOISES,
    GaussianProcess,
    ProcessSettings,
    fit_best_gaussian_process,
    fit_gaussian_process,
    leave_one_out_errors,
    smoothest_near_best,
    usable_choices,
)
from usdface.numerics.regression.kernel_cca import predict_kernel_cca
from usdface.numerics.regression.regional_process import LocalSums, RegionalFeatures

GLOBAL_LINE_CHOICES = tuple(
    ProcessSettings(d, p) for d in (16, 24, 32, 40) for p in (0.0, 0.25, 0.5)
)
_LOCAL_SIZES = ((0.0, 1.0), (1.0, 1.0), (1.0, 3.0), (3.0, 3.0))
WIDE_REGION_CHOICES = tuple(
    ProcessSettings(d, p, r, c) for d in (12, 24) for p in (0.25, 0.5) for r, c in _LOCAL_SIZES
)
TIGHT_REGION_CHOICES = tuple(
    ProcessSettings(d, 0.5, r, c) for d in (4, 8, 12) for r, c in _LOCAL_SIZES
)

_CORRELATION_CHOICES = tuple(
    (power, width, kappa)
    for kappa in (1e-6, 1e-7, 1e-5)
    for power in (0.0, 0.125, 0.25)
    for width in (8.0, 4.0)
)
"""Whitening, width and penalty of kernel CCA; the first are tried first where pairs are many."""

FEWEST_CORRELATED_PAIRS = 4
"""Pairs below which nothing can be said to correlate."""

_CORRELATION_FOLDS = 25
_MANY_PAIRS = 100
_MANY_FOLDS = 10
"""Parts in which pairs are left out: the first up to this many pairs, beyond the last."""

_CORRELATION_COST = 5e8
"""Fits times cubed pairs: all choices up to 100 pairs."""

REGIONAL_COST = 200 * 200.0**3
"""Shapes times cubed pairs up to which every shape has a process of its own."""

GLOBAL_LOCAL_CHOICES = tuple(
    ProcessSettings(d, p, 1.0, c) for d in (24, 40) for p in (0.25, 0.5) for c in (1.0, 4.0)
)
"""Of one process for all shapes, where they are too many."""

REGIONAL_CHOICES_COST = 16 * 60 * 200.0**3
"""Choices times shapes times cubed pairs: all of them up to 200 pairs of 60 shapes."""


@dataclass(frozen=True)
class Member:
    """One member of the ensemble.

    Attributes
    ----------
    slope : (D, s) float array
    intercept : (s,) float array
    locals : dict of str to float array
        Local corrections: `projection`, `centres`, `exponent` and `dual` of `LocalSums`.
    residuals : (n, s) float array
        Leave-one-out.
    """

    slope: FloatArray
    intercept: FloatArray
    locals: Arrays
    residuals: FloatArray


def fit_global_member(
    coordinates: FloatArray,
    outputs: FloatArray,
    *,
    variances: FloatArray,
    choices: tuple[ProcessSettings, ...],
    importance: FloatArray,
    noises: FloatArray = NOISES,
) -> Member:
    """Fit one process over the whole face."""
    process = fit_best_gaussian_process(
        coordinates,
        outputs,
        variances=variances,
        choices=usable_choices(choices, most=len(variances)),
        importance=importance,
        noises=noises,
    )
    slope = np.zeros((coordinates.shape[1], outputs.shape[1]))
    slope[: len(process.scale)] = process.scale[:, None] * process.slope
    projection = np.zeros((coordinates.shape[1], len(process.scale)))
    np.fill_diagonal(projection, process.scale)
    parts = {
        "projection": projection,
        "centres": process.centres,
        "exponent": np.array([process.exponent]),
        "dual": process.dual,
    }
    return Member(slope, process.intercept, parts, process.residuals)


def fit_correlation_member(pairs: Pairs, *, importance: FloatArray, dimensions: int) -> Member:
    """Fit kernel CCA, with the kernel and penalty whose errors on unseen pairs weigh least.

    Its wide kernels are nearly quadratic functions of the whole face: they see what happens
    together.

    Parameters
    ----------
    importance : (s,) float array
        Weight of each output's squared error.
    """
    count = len(pairs.outputs)
    folds = np.arange(count) % min(
        count, _CORRELATION_FOLDS if count <= _MANY_PAIRS else _MANY_FOLDS
    )
    affordable = int(_CORRELATION_COST / (int(folds.max()) + 1) / count**3)
    tried = []
    for power, width, kappa in _CORRELATION_CHOICES[: max(affordable, 1)]:
        settings: Settings = {
            "dimensions": dimensions,
            "whitening": power,
            "width": width,
            "kappa": kappa,
        }
        scale = scale_arrays(pairs, settings)
        residuals = np.empty_like(pairs.outputs)
        for fold in range(int(folds.max()) + 1):
            test = folds == fold
            model = fit_model(pairs.rows(np.flatnonzero(~test)), scale, settings)
            unseen = scaled_inputs(scale, settings, pairs.inputs[test])
            residuals[test] = pairs.outputs[test] - predict_kernel_cca(model, unseen)
        tried.append((float((residuals**2).sum(axis=0) @ importance), settings, residuals))
    _, settings, residuals = min(tried, key=lambda entry: entry[0])
    scale = scale_arrays(pairs, settings)
    model = fit_model(pairs, scale, settings)
    parts = {
        "projection": np.diag(scale["scale"]),
        "centres": model.centres,
        "exponent": np.array([-0.5 / model.width**2]),
        "dual": model.operator,
    }
    return Member(np.zeros((dimensions, pairs.outputs.shape[1])), model.intercept, parts, residuals)


def fit_regional_member(
    coordinates: FloatArray,
    outputs: FloatArray,
    *,
    regions: tuple[RegionalFeatures, ...],
    choices: tuple[ProcessSettings, ...],
    shared: bool,
) -> Member:
    """Fit a process for each shape over its own region.

    With `shared` one choice serves all shapes: the one whose errors, each shape's against its
    own best, are least on average.
    """
    choices = usable_choices(choices, most=coordinates.shape[1])
    choices = affordable_choices(choices, pairs=len(coordinates), shapes=len(regions))
    rows = [coordinates @ region.projection for region in regions]
    errors = np.stack(
        [
            leave_one_out_errors(
                rows[j], outputs[:, [j]], variances=region.variances, choices=choices
            )[:, :, 0]
            for j, region in enumerate(regions)
        ]
    )
    least = errors.min(axis=2)
    relative = least / np.maximum(least.min(axis=1, keepdims=True), 1e-12)
    best: IntArray = (
        np.full(len(regions), relative.mean(axis=0).argmin()) if shared else least.argmin(axis=1)
    )
    fits = [
        fit_gaussian_process(
            rows[j],
            outputs[:, [j]],
            variances=region.variances,
            choice=choices[best[j]],
            noise=NOISES[smoothest_near_best(errors[j, best[j]][:, None])],
        )
        for j, region in enumerate(regions)
    ]
    return _stack(fits, regions)


def affordable_choices(
    choices: tuple[ProcessSettings, ...], *, pairs: int, shapes: int
) -> tuple[ProcessSettings, ...]:
    """Thin choices out where many pairs and shapes would take minutes to compare them all."""
    allowed = max(1, min(len(choices), int(REGIONAL_CHOICES_COST / (shapes * pairs**3))))
    places = np.linspace(0, len(choices) - 1, allowed + 2).round().astype(int)[1:-1]
    return choices if allowed == len(choices) else tuple(choices[i] for i in places)


def _stack(fits: list[GaussianProcess], regions: tuple[RegionalFeatures, ...]) -> Member:
    s, n = len(fits), len(fits[0].centres)
    full = len(regions[0].projection)
    kept = max(len(fit.scale) for fit in fits)
    projection, centres = np.zeros((s, full, kept)), np.zeros((s, n, kept))
    slope = np.zeros((full, s))
    for j, (fit, region) in enumerate(zip(fits, regions, strict=True)):
        d = len(fit.scale)
        projection[j, :, :d] = region.projection[:, :d] * fit.scale
        centres[j, :, :d] = fit.centres
        slope[:, j] = projection[j, :, :d] @ fit.slope[:, 0]
    parts = {
        "projection": projection,
        "centres": centres,
        "exponent": np.array([fit.exponent for fit in fits]),
        "dual": np.stack([fit.dual[:, 0] for fit in fits], axis=1),
    }
    return Member(
        slope,
        np.array([fit.intercept[0] for fit in fits]),
        parts,
        np.concatenate([fit.residuals for fit in fits], axis=1),
    )


def stack_corrections(members: list[tuple[Member, FloatArray]]) -> Arrays:
    """Gather what the members correct, as `prepare_corrections` reads it.

    Parameters
    ----------
    members : list of (Member, (s,) float array)
        With the share of each for each shape.
    """
    arrays: Arrays = {}
    for k, (member, share) in enumerate(members):
        if member.locals and (member.locals["dual"] * share).any():
            arrays |= {f"local{k}_{name}": value for name, value in member.locals.items()}
            arrays[f"local{k}_dual"] = member.locals["dual"] * share
    return arrays


def prepare_corrections(arrays: Arrays) -> Predictor:
    """Make the corrections ready that a mapping's arrays hold; other arrays are not read."""
    prefixes = sorted(
        name.removesuffix("projection") for name in arrays if name.endswith("_projection")
    )
    sums = [
        LocalSums(
            **{
                name: arrays[prefix + name]
                for name in ("projection", "centres", "exponent", "dual")
            }
        )
        for prefix in prefixes
    ]

    def predict(points: FloatArray) -> FloatArray:
        return sum((each(points) for each in sums[1:]), sums[0](points)) if sums else np.zeros(1)

    return predict
