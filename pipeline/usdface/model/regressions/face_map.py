"""The face map's inverse regression: what the references say of a frame that looks like them.

Each shape has a Gaussian process from markers to its bent weight. Two faces are compared by the
markers that the shape moves: marker k counts by ``h_sk = max(|B_sk| / max_j |B_sj|, floor)``, where
``B`` is what the forward model says the shape does. So a lid does not drown in the jaw, and what is
local on the rig stays local: references that close both eyes do not make one lid ask the other.
Features are the principal axes of the weighed markers over all frames of the takes, and the
covariance a line and a local part (`gaussian_process`). One covariance serves all shapes, the one
with the least leave-one-out error; noise is each shape's own.

The answer is where `frame_solve` starts from; the leave-one-out error is how far it believes it.
"""

import numpy as np

from usdface.core.arrays import FloatArray, sample_frames
from usdface.model.regressions.base import Arrays, Fitted, Pairs, Predictor, Regression, Settings
from usdface.model.regressions.target_curve import unbend
from usdface.numerics.regression.gaussian_process import (
    NOISES,
    ProcessSettings,
    fit_gaussian_process,
    leave_one_out_errors,
    smoothest_near_best,
    usable_choices,
)
from usdface.numerics.regression.regional_process import (
    LocalSums,
    RegionalFeatures,
    regional_features,
)

_MAX_DIMENSIONS = 50
_LEAST_VARIANCE_MM2 = 1e-4
"""Variance of a component below which there is no motion, only rounding."""

_LEAST_RELEVANCE = 0.01
"""``floor``: faces that differ only where the shape moves nothing are still two faces."""

_COVARIANCES = tuple(
    ProcessSettings(dimensions, 0.25, radial, width)
    for dimensions in (12, 24)
    for radial, width in ((1.0, 1.0), (1.0, 3.0), (3.0, 3.0))
)
"""Tried: features, and size and width of the local part. They differ by a few hundredths."""

_COMPARED_SHAPES = 40
"""Shapes, those that matter most on the surface, by which the covariance is chosen."""


def _candidates(pairs: Pairs, dimensions: int | None) -> tuple[Settings, ...]:
    moving = int((pairs.face.motion.variances > _LEAST_VARIANCE_MM2).sum())
    most = max(1, min(moving, _MAX_DIMENSIONS, pairs.inputs.shape[1]))
    return ({"dimensions": dimensions or most},)


def _fit(pairs: Pairs, settings: Settings) -> Fitted:
    forward, kept = pairs.forward, int(settings["dimensions"])
    if forward is None:
        raise ValueError("the face map needs the pairs' forward model")
    z, targets = pairs.inputs[:, :kept], forward.targets
    length = np.sqrt((forward.basis**2).sum(axis=2))
    share = length / np.maximum(length.max(axis=1, keepdims=True), 1e-9)
    relevance = np.maximum(share, _LEAST_RELEVANCE)
    sample, axes = pairs.face.motion.sample[:, :kept], pairs.face.motion.components[:kept]
    covariance = np.cov(sample.T).reshape(kept, -1)
    regions = [regional_features(axes, covariance, row) for row in relevance]
    chosen = _choose_covariance(z, targets, regions, np.diag(pairs.face.gram))
    arrays = _fit_shapes(z, targets, regions, chosen)
    low, span = pairs.face.ranges[:, 0], np.ptp(pairs.face.ranges, axis=1)
    curve = forward.scales.curve
    return Fitted(
        arrays | {"curve": np.array([curve]), "low": low, "span": span},
        settings | {"curve": curve, "features": chosen.dimensions},
    )


def _choose_covariance(
    z: FloatArray, targets: FloatArray, regions: list[RegionalFeatures], importance: FloatArray
) -> ProcessSettings:
    """Return the covariance whose errors, each shape's against its own least, are least."""
    choices = usable_choices(_COVARIANCES, most=z.shape[1])
    by_size = np.argsort(-importance, kind="stable")
    errors = np.stack(
        [
            leave_one_out_errors(
                z @ regions[s].projection,
                targets[:, [s]],
                variances=regions[s].variances,
                choices=choices,
            ).min(axis=1)[:, 0]
            for s in by_size[sample_frames(len(by_size), _COMPARED_SHAPES)]
        ]
    )
    relative = errors / np.maximum(errors.min(axis=1, keepdims=True), 1e-12)
    return choices[int(relative.mean(axis=0).argmin())]


def _fit_shapes(
    z: FloatArray, targets: FloatArray, regions: list[RegionalFeatures], choice: ProcessSettings
) -> Arrays:
    """Fit every shape's process, and lay them side by side."""
    slopes, intercepts, residuals = [], [], []
    projections, centres, exponents, duals = [], [], [], []
    for s, region in enumerate(regions):
        given = {"features": z @ region.projection, "outputs": targets[:, [s]]}
        errors = leave_one_out_errors(**given, variances=region.variances, choices=(choice,))[0]
        noise = NOISES[smoothest_near_best(errors)]
        fit = fit_gaussian_process(**given, variances=region.variances, choice=choice, noise=noise)
        projection = region.projection[:, : len(fit.scale)] * fit.scale
        projections.append(projection)
        slopes.append(projection @ fit.slope[:, 0])
        intercepts.append(fit.intercept[0])
        residuals.append(fit.residuals[:, 0])
        centres.append(fit.centres)
        exponents.append(fit.exponent)
        duals.append(fit.dual[:, 0])
    return {
        "slope": np.stack(slopes, axis=1),
        "intercept": np.array(intercepts),
        "projection": np.stack(projections),
        "centres": np.stack(centres),
        "exponent": np.array(exponents),
        "dual": np.stack(duals, axis=1),
        "start_error": np.sqrt((np.stack(residuals) ** 2).mean(axis=1)),
    }


def _prepare(arrays: Arrays, settings: Settings) -> Predictor:
    kept, curve = int(settings["dimensions"]), float(arrays["curve"][0])
    local = LocalSums(
        **{name: arrays[name] for name in ("projection", "centres", "exponent", "dual")}
    )

    def predict(coordinates: FloatArray) -> FloatArray:
        z = coordinates[:, :kept]
        targets = np.clip(z @ arrays["slope"] + arrays["intercept"] + local(z), 0.0, 1.0)
        return np.asarray(arrays["low"] + arrays["span"] * unbend(targets, curve))

    return predict


METHOD = Regression(
    name="face_map",
    summary="Gaussian processes near the references, and beyond them the rig's geometry",
    fit=_fit,
    prepare=_prepare,
    mapping_candidates=_candidates,
    solves_frames=True,
)
