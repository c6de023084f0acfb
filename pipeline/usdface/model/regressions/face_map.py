"""Inverse regression of the face map: Gaussian processes from markers to bent weights.

Each shape s has a Gaussian process. Its inputs are the markers, marker k multiplied by ::

    h_sk = max(|E_sk| / max(max_j |E_sj|, .1 mm), floor)

with ``E`` the displacement of the rig by the shape (`forward_model`). The small motion of lids is
thus not lost in that of the jaw, and shapes that are local on the rig depend on nearby markers
only: from references that close both eyes, one lid does not learn to follow the other. Features are
the weighted markers along their principal axes over all frames of the takes. They are computed from
the markers of a frame, not from its components in the motion space, which cannot represent an
expression that no take shows, such as a wink, and would pass half of it to the other eye. The
covariance is linear plus radial (`gaussian_process`). All shapes share the covariance of least
leave-one-out error; the noise is chosen for each shape.

The prediction is the prior mean of `frame_solve`, and its standard deviation the prior's ::

    deviation_s^2 = a_s (variance_s(x) + noise_s)

with ``a_s`` such that residuals of left-out references have their expected size
(`GaussianProcess`). It increases with the distance of a frame from the references.
"""

import numpy as np

from usdface.core.arrays import Arrays, FloatArray, IntArray, sample_frames
from usdface.model.regressions.base import Fitted, Pairs, ProcessPredictor, Regression, Settings
from usdface.numerics.regression.gaussian_process import (
    NOISES,
    ProcessSettings,
    fit_gaussian_process,
    leave_one_out_errors,
    smoothest_near_best,
    usable_choices,
)
from usdface.numerics.regression.regional_process import (
    RegionalFeatures,
    RegionalProcesses,
    regional_features,
)

_MAX_DIMENSIONS = 50
"""Largest number of principal components of the motion space in use."""

_MIN_VARIANCE_MM2 = 1e-4
"""Variance of a component below which it is rounding error."""

_MIN_RELEVANCE = 0.003
"""``floor``: markers that the shape does not move still distinguish faces."""

_LEAST_MOTION_MM = 0.1
"""Least divisor: a shape that moves no marker, such as one of the tongue, depends on all alike."""

_COVARIANCES = tuple(
    ProcessSettings(dimensions, 0.25, radial, width)
    for dimensions in (12, 24)
    for radial, width in ((1.0, 1.0), (1.0, 3.0), (3.0, 3.0))
)
"""Candidates: number of features, and amplitude and width of the radial part. Their errors differ
by a few percent."""

_MAX_REGIONS = 64
"""Largest number of regions: with more, neighbouring ones weight the markers nearly alike."""

_COMPARED_SHAPES = 40
"""Largest number of shapes in the choice of the covariance, spread over their effect on the
surface."""


def _candidates(pairs: Pairs, dimensions: tuple[int, ...]) -> tuple[Settings, ...]:
    moving = int((pairs.face.motion.variances > _MIN_VARIANCE_MM2).sum())
    most = max(1, min(moving, _MAX_DIMENSIONS, pairs.inputs.shape[1]))
    return tuple({"dimensions": count} for count in dimensions or (most,))


def _fit(pairs: Pairs, settings: Settings) -> Fitted:
    forward, count = pairs.forward, int(settings["dimensions"])
    if forward is None:
        raise ValueError("the face map needs the pairs' forward model")
    moved = pairs.displacements.reshape(len(pairs.outputs), -1)
    length = np.sqrt(forward.shape_size2)
    share = length / np.maximum(length.max(axis=1, keepdims=True), _LEAST_MOTION_MM)
    region, relevance = _cluster_shapes(np.maximum(share, _MIN_RELEVANCE))
    sample, axes = pairs.face.motion.sample[:, :count], pairs.face.motion.components[:count]
    covariance = np.cov(sample.T).reshape(count, -1)
    features = [regional_features(axes, covariance, row) for row in relevance]
    chosen = _choose_covariance(
        moved, forward.targets, [features[k] for k in region], pairs.face.gram
    )
    arrays = _fit_regions(moved, forward.targets, features, region, chosen)
    return Fitted(arrays, settings | {"curve": forward.scales.curve, "features": chosen.dimensions})


def _cluster_shapes(relevance: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return the region of each shape, and the relevance of the markers to each region.

    Up to `_MAX_REGIONS` shapes have a region each; more are clustered by the markers they move.
    """
    if len(relevance) <= _MAX_REGIONS:
        return np.arange(len(relevance)), relevance
    from scipy.cluster.hierarchy import fcluster, linkage  # SciPy is only loaded for training

    region = np.asarray(
        fcluster(linkage(relevance, "ward"), _MAX_REGIONS, "maxclust") - 1, np.int64
    )
    return region, np.stack([relevance[region == k].mean(axis=0) for k in range(region.max() + 1)])


def _choose_covariance(
    moved: FloatArray, targets: FloatArray, features: list[RegionalFeatures], gram: FloatArray
) -> ProcessSettings:
    """Return the covariance of least leave-one-out error, relative to each shape's least."""
    choices = usable_choices(_COVARIANCES, most=len(features[0].variances))
    size = np.log(np.maximum(np.diag(gram), 1e-12))  # rounded: mirrored shapes are equally large
    by_size = np.argsort(-size.round(4), kind="stable")
    errors = np.stack(
        [
            leave_one_out_errors(
                moved @ features[s].axes,
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
    moved: FloatArray,
    targets: FloatArray,
    features: list[RegionalFeatures],
    region: IntArray,
    choice: ProcessSettings,
) -> Arrays:
    """Fit the processes of each region's shapes, and stack the regions' arrays."""
    slope, intercept = np.empty((moved.shape[1], len(region))), np.empty(len(region))
    dual, residuals = np.empty_like(targets), np.empty_like(targets)
    amplitude, noises = np.empty(len(region)), np.empty(len(region))
    projection, centres, exponent = [], [], []
    for k, each in enumerate(features):
        shapes = np.flatnonzero(region == k)
        data = {"features": moved @ each.axes, "outputs": targets[:, shapes]}
        errors = leave_one_out_errors(**data, variances=each.variances, choices=(choice,))[0]
        noise = NOISES[smoothest_near_best(errors)]
        fit = fit_gaussian_process(**data, variances=each.variances, choice=choice, noise=noise)
        projection.append(each.axes[:, : len(fit.scale)] * fit.scale)
        centres.append(fit.centres)
        exponent.append(fit.exponent)
        slope[:, shapes] = projection[-1] @ fit.slope
        intercept[shapes], dual[:, shapes] = fit.intercept, fit.dual
        residuals[:, shapes] = fit.residuals
        amplitude[shapes], noises[shapes] = fit.amplitude, noise
    return {
        "slope": slope,
        "intercept": intercept,
        "projection": np.stack(projection),
        "centres": np.stack(centres),
        "exponent": np.array(exponent),
        "dual": dual,
        "region": region.astype(np.float64),
        "radial": np.array([choice.radial]),
        "noise": noises,
        "amplitude": amplitude,
        "start_error": np.sqrt((residuals**2).mean(axis=0)),
    }


def _prepare_process(arrays: Arrays, _settings: Settings) -> ProcessPredictor:
    region, noise = arrays["region"].astype(np.int64), arrays["noise"]
    mean_log_noise = np.bincount(region, np.log(noise)) / np.bincount(region)
    processes = RegionalProcesses(
        **{name: arrays[name] for name in ("projection", "centres", "exponent", "dual")},
        noise=np.exp(mean_log_noise),
        radial=float(arrays["radial"][0]),
        region=region,
    )

    def predict(moved: FloatArray) -> tuple[FloatArray, FloatArray]:
        if moved.shape[1] != len(arrays["slope"]):
            raise ValueError(
                f"its regression reads {len(arrays['slope'])} values a frame, such as the "
                f"components of earlier versions, not {moved.shape[1]} coordinates of markers"
            )
        local, variance = processes(moved)
        mean = np.clip(moved @ arrays["slope"] + arrays["intercept"] + local, 0.0, 1.0)
        return mean, np.sqrt(arrays["amplitude"] * (variance[:, region] + noise))

    return predict


METHOD = Regression(
    name="face_map",
    fit=_fit,
    prepare_process=_prepare_process,
    mapping_candidates=_candidates,
)
