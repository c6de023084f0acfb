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

from usdface.core.arrays import FloatArray, IntArray, sample_frames
from usdface.model.regressions.base import (
    Arrays,
    Fitted,
    Pairs,
    Predictor,
    Regression,
    Settings,
    unbend,
)
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

_MOST_REGIONS = 64
"""Of the face: with so many, neighbouring ones see nearly the same markers."""

_COMPARED_SHAPES = 40
"""Shapes, those that matter most on the surface, by which the covariance is chosen."""


def _candidates(pairs: Pairs, dimensions: tuple[int, ...]) -> tuple[Settings, ...]:
    moving = int((pairs.face.motion.variances > _LEAST_VARIANCE_MM2).sum())
    most = max(1, min(moving, _MAX_DIMENSIONS, pairs.inputs.shape[1]))
    return tuple({"dimensions": kept} for kept in dimensions or (most,))


def _fit(pairs: Pairs, settings: Settings) -> Fitted:
    forward, kept = pairs.forward, int(settings["dimensions"])
    if forward is None:
        raise ValueError("the face map needs the pairs' forward model")
    z, targets = pairs.inputs[:, :kept], forward.targets
    length = np.sqrt((forward.basis**2).sum(axis=2))
    share = length / np.maximum(length.max(axis=1, keepdims=True), 1e-9)
    region, relevance = _gather_regions(np.maximum(share, _LEAST_RELEVANCE))
    sample, axes = pairs.face.motion.sample[:, :kept], pairs.face.motion.components[:kept]
    covariance = np.cov(sample.T).reshape(kept, -1)
    features = [regional_features(axes, covariance, row) for row in relevance]
    chosen = _choose_covariance(z, targets, [features[k] for k in region], pairs.face.gram)
    arrays = _fit_regions(z, targets, features, region, chosen)
    low, span = pairs.face.ranges[:, 0], np.ptp(pairs.face.ranges, axis=1)
    curve = forward.scales.curve
    return Fitted(
        arrays | {"curve": np.array([curve]), "low": low, "span": span},
        settings | {"curve": curve, "features": chosen.dimensions},
    )


def _gather_regions(relevance: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return the region of each shape, and what of the markers each region sees.

    Few shapes have a region each. Many share those of shapes that move nearly the same markers.
    """
    if len(relevance) <= _MOST_REGIONS:
        return np.arange(len(relevance)), relevance
    from scipy.cluster.hierarchy import fcluster, linkage  # mapping starts without SciPy

    region = np.asarray(
        fcluster(linkage(relevance, "ward"), _MOST_REGIONS, "maxclust") - 1, np.int64
    )
    return region, np.stack([relevance[region == k].mean(axis=0) for k in range(region.max() + 1)])


def _choose_covariance(
    z: FloatArray, targets: FloatArray, features: list[RegionalFeatures], gram: FloatArray
) -> ProcessSettings:
    """Return the covariance whose errors, each shape's against its own least, are least."""
    choices = usable_choices(_COVARIANCES, most=z.shape[1])
    by_size = np.argsort(-np.diag(gram), kind="stable")
    errors = np.stack(
        [
            leave_one_out_errors(
                z @ features[s].projection,
                targets[:, [s]],
                variances=features[s].variances,
                choices=choices,
            ).min(axis=1)[:, 0]
            for s in by_size[sample_frames(len(by_size), _COMPARED_SHAPES)]
        ]
    )
    relative = errors / np.maximum(errors.min(axis=1, keepdims=True), 1e-12)
    return choices[int(relative.mean(axis=0).argmin())]


def _fit_regions(
    z: FloatArray,
    targets: FloatArray,
    features: list[RegionalFeatures],
    region: IntArray,
    choice: ProcessSettings,
) -> Arrays:
    """Fit the processes of each region's shapes, and lay regions side by side."""
    slope, intercept = np.empty((z.shape[1], len(region))), np.empty(len(region))
    dual, residuals = np.empty_like(targets), np.empty_like(targets)
    projection, centres, exponent = [], [], []
    for k, each in enumerate(features):
        shapes = np.flatnonzero(region == k)
        given = {"features": z @ each.projection, "outputs": targets[:, shapes]}
        errors = leave_one_out_errors(**given, variances=each.variances, choices=(choice,))[0]
        noise = NOISES[smoothest_near_best(errors)]
        fit = fit_gaussian_process(**given, variances=each.variances, choice=choice, noise=noise)
        projection.append(each.projection[:, : len(fit.scale)] * fit.scale)
        centres.append(fit.centres)
        exponent.append(fit.exponent)
        slope[:, shapes] = projection[-1] @ fit.slope
        intercept[shapes], dual[:, shapes] = fit.intercept, fit.dual
        residuals[:, shapes] = fit.residuals
    return {
        "slope": slope,
        "intercept": intercept,
        "projection": np.stack(projection),
        "centres": np.stack(centres),
        "exponent": np.array(exponent),
        "dual": dual,
        "region": region.astype(np.float64),
        "start_error": np.sqrt((residuals**2).mean(axis=0)),
    }


def _prepare(arrays: Arrays, settings: Settings) -> Predictor:
    kept, curve = int(settings["dimensions"]), float(arrays["curve"][0])
    local = LocalSums(
        **{name: arrays[name] for name in ("projection", "centres", "exponent", "dual")},
        region=arrays["region"].astype(np.int64),
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
