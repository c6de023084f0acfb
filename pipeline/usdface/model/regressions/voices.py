"""The members of the ensemble: processes over the region of each shape, and kernel CCA.

A voice is a straight line plus local corrections. Lines of several voices add up to one line;
local corrections keep their own centres.
"""

from dataclasses import dataclass, replace

import numpy as np

from usdface.core.arrays import FloatArray, IntArray
from usdface.model.regressions import kernel_cca
from usdface.model.regressions.base import Pairs, Settings
from usdface.model.regressions.scaling import coordinate_scale, scaled
from usdface.numerics.array_namespace import CPU, ArrayDevice
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
from usdface.numerics.regression.local_sums import LocalSums
from usdface.numerics.regression.marker_regions import RegionalFeatures

GLOBAL_LINES = tuple(ProcessSettings(d, p) for d in (16, 24, 32, 40) for p in (0.0, 0.25, 0.5))
_LOCAL_SIZES = ((0.0, 1.0), (1.0, 1.0), (1.0, 3.0), (3.0, 3.0))
REGION_WIDE = tuple(
    ProcessSettings(d, p, r, c) for d in (12, 24) for p in (0.25, 0.5) for r, c in _LOCAL_SIZES
)
REGION_TIGHT = tuple(ProcessSettings(d, 0.5, r, c) for d in (4, 8, 12) for r, c in _LOCAL_SIZES)

CORRELATIONS = tuple(
    (power, width, kappa)
    for kappa in (1e-6, 1e-7, 1e-5)
    for power in (0.0, 0.125, 0.25)
    for width in (8.0, 4.0)
)
"""Whitening, width and penalty of kernel CCA; the first are tried first where pairs are many."""

FEWEST_CORRELATED = 4
"""Pairs below which nothing can be said to correlate."""

CORRELATION_FOLDS = 25
MANY_PAIRS = 100
MANY_FOLDS = 10
"""Parts in which pairs are left out: the first up to this many pairs, beyond the last."""

CORRELATION_COST = 5e8
"""Fits times cubed pairs: all choices up to 100 pairs."""

REGIONAL_COST = 200 * 200.0**3
"""Shapes times cubed pairs up to which every shape has a process of its own."""

GLOBAL_LOCALS = tuple(
    ProcessSettings(d, p, 1.0, c) for d in (24, 40) for p in (0.25, 0.5) for c in (1.0, 4.0)
)
"""Of one process for all shapes, where they are too many."""

AFFORDABLE = 16 * 60 * 200.0**3
"""Choices times shapes times cubed pairs: all of them up to 200 pairs of 60 shapes."""


@dataclass(frozen=True)
class Voice:
    """One member of the ensemble.

    Attributes
    ----------
    slope : (D, s) float array
    intercept : (s,) float array
    locals : dict of str to float array
        Local corrections, as `local_sums` reads them.
    residuals : (n, s) float array
        Leave-one-out.
    """

    slope: FloatArray
    intercept: FloatArray
    locals: dict[str, FloatArray]
    residuals: FloatArray


def global_voice(
    coordinates: FloatArray,
    outputs: FloatArray,
    *,
    variances: FloatArray,
    choices: tuple[ProcessSettings, ...],
    importance: FloatArray,
    noises: FloatArray = NOISES,
) -> Voice:
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
    return Voice(slope, process.intercept, parts, process.residuals)


def correlation_voice(pairs: Pairs, targets: FloatArray, *, dimensions: int) -> Voice:
    """Fit kernel CCA, its kernel and penalty those that move the surface least away.

    Its wide kernels are nearly quadratic functions of the whole face: what happens together is
    heard together.
    """
    count = len(targets)
    parts_out = CORRELATION_FOLDS if count <= MANY_PAIRS else MANY_FOLDS
    folds = np.arange(count) % min(count, parts_out)
    allowed = int(CORRELATION_COST / (int(folds.max()) + 1) / count**3)
    best: tuple[float, Settings, FloatArray] | None = None
    taught = replace(pairs, weights=targets)
    for power, width, kappa in CORRELATIONS[: max(allowed, 1)]:
        settings: Settings = {
            "dimensions": dimensions,
            "whitening": power,
            "width": width,
            "kappa": kappa,
            "lines": "penalised",
        }
        scale = coordinate_scale(pairs, settings)
        residuals = np.empty_like(targets)
        for fold in range(int(folds.max()) + 1):
            test = folds == fold
            model = kernel_cca.fit_pairs(taught.rows(np.flatnonzero(~test)), scale, settings)
            unseen = scaled(pairs.coordinates[test], scale)
            residuals[test] = targets[test] - predict_kernel_cca(model, unseen)
        error = float(np.einsum("ns,st,nt->", residuals, pairs.gram, residuals, optimize=True))
        if best is None or error < best[0]:
            best = error, settings, residuals
    if best is None:
        raise ValueError("no choice to try")
    _, settings, residuals = best
    scale = coordinate_scale(pairs, settings)
    model = kernel_cca.fit_pairs(taught, scale, settings)
    parts = {
        "projection": np.diag(scale),
        "centres": model.centres,
        "exponent": np.array([-0.5 / model.width**2]),
        "dual": model.operator,
    }
    return Voice(np.zeros((dimensions, targets.shape[1])), model.intercept, parts, residuals)


def regional_voice(
    coordinates: FloatArray,
    outputs: FloatArray,
    *,
    regions: tuple[RegionalFeatures, ...],
    choices: tuple[ProcessSettings, ...],
    shared: bool,
) -> Voice:
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
    allowed = max(1, min(len(choices), int(AFFORDABLE / (shapes * pairs**3))))
    places = np.linspace(0, len(choices) - 1, allowed + 2).round().astype(int)[1:-1]
    return choices if allowed == len(choices) else tuple(choices[i] for i in places)


def _stack(fits: list[GaussianProcess], regions: tuple[RegionalFeatures, ...]) -> Voice:
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
    return Voice(
        slope,
        np.array([fit.intercept[0] for fit in fits]),
        parts,
        np.concatenate([fit.residuals for fit in fits], axis=1),
    )


def local_sums(
    arrays: dict[str, FloatArray],
    *,
    prefix: str = "",
    single: bool = False,
    device: ArrayDevice = CPU,
) -> LocalSums:
    """Make the local corrections ready that a mapping's arrays hold under a prefix."""
    return LocalSums(
        arrays[f"{prefix}projection"],
        arrays[f"{prefix}centres"],
        arrays[f"{prefix}exponent"][:, None],
        arrays[f"{prefix}dual"],
        single=single,
        device=device,
    )
