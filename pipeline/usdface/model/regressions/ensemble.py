"""The default: a blend of regressions on the examples and a linear face from the rig's geometry.

Examples enter through three members (processes over the region of each shape, near and wide, and
kernel CCA over the whole face), weighed shape by shape by their leave-one-out errors. Geometry
enters through a linear face calibrated on the pairs. Its share depends on the errors of both and on
how far the members disagree: leave-one-out on chosen references flatters the examples, which know
nothing of combinations that no reference shows. What comes out is brought within the shapes' ranges
at the least cost to the face.
"""

import math
from dataclasses import replace
from functools import partial

import numpy as np

from usdface.core.arrays import FloatArray
from usdface.model.regressions.base import Arrays, Fitted, Pairs, Predictor, Regression, Settings
from usdface.model.regressions.members import (
    FEWEST_CORRELATED_PAIRS,
    GLOBAL_LINE_CHOICES,
    GLOBAL_LOCAL_CHOICES,
    REGIONAL_COST,
    TIGHT_REGION_CHOICES,
    WIDE_REGION_CHOICES,
    Member,
    fit_correlation_member,
    fit_global_member,
    fit_regional_member,
    prepare_corrections,
    stack_corrections,
)
from usdface.model.regressions.target_curve import CURVES, bend, choose_curves, unbend
from usdface.numerics.regression.cross_validation import blend_shares
from usdface.numerics.regression.linear_posterior import LinearPosterior, fit_linear_posterior
from usdface.numerics.regression.marker_prior import expect_marker_motion
from usdface.numerics.regression.regional_process import marker_relevance, regional_features
from usdface.numerics.solve.bounded_least_squares import BoxProjection

_MAX_DIMENSIONS = 50
_LEAST_VARIANCE_MM2 = 1e-4
"""Variance of a component below which there is no motion, only rounding."""

_VARIANCE_FLOOR_MM2 = 1e-9  # of components asked for that do not move at all

_COVARIANCE_SHARE = 0.75
_COVARIANCE_PAIRS = 25
"""Residuals' covariances between members are multiplied by ``0.75 max(0, 1 - 25 / pairs)``: of few
pairs they are chance, and members then count as independent."""

_DISAGREEMENT_FACTOR = 1.5
_SHAPE_DISAGREEMENT_SHARE = 0.25
"""The examples' expected squared error is ``residual^2 + 1.5 disagreement^2``; of the disagreement
over a shape, this share is that shape's and the rest the whole face's. Noise leads all members
astray alike, geometry too; where no reference shows the way, they differ."""

_MARKER_METRIC_SHARE = 0.3
"""Share of the markers' information, beside the examples', in the metric that says where weights go
that a limit pushes aside: with more, noise of the markers shows as jitter."""

_SATURATION_ERRORS = 1.4
"""How far weights near 1 are drawn towards it, in expected errors."""

_TAKE_ERROR_RATIO = 2.0
"""Expected error on a take over the leave-one-out error on the chosen pairs."""

_MAX_EXPECTED_ERROR = 0.15
"""Of a weight."""

_ZERO_SLACK_ERRORS = 0.25
"""How far below 0, in leave-one-out errors, a weight may be without others moving for it."""

_AT_LIMIT = 0.005
"""Weights this near to 0 or 1 may have been cut off there when they were tuned."""

_MAX_OVERSHOOT = 0.25
"""How far beyond the limit such a weight may be taken to be."""


def _candidates(pairs: Pairs, dimensions: int | None) -> tuple[Settings, ...]:
    return ({"dimensions": dimensions or _signal_dimensions(pairs)},)


def _signal_dimensions(pairs: Pairs) -> int:
    """How many components move at all, at most `_MAX_DIMENSIONS`."""
    moving = int((pairs.face.motion.variances > _LEAST_VARIANCE_MM2).sum())
    return int(max(1, min(moving, _MAX_DIMENSIONS, pairs.inputs.shape[1])))


def _fit(pairs: Pairs, settings: Settings) -> Fitted:
    kept = int(settings["dimensions"])
    z = pairs.inputs[:, :kept]
    low, span = pairs.face.ranges[:, 0], np.ptp(pairs.face.ranges, axis=1)
    weights = (pairs.outputs - low) / span
    gram = pairs.face.gram * np.outer(span, span)
    importance = np.diag(gram) + 1e-3 * float(np.diag(gram).mean())
    geometry, curve = _calibrate(pairs, z, weights, gram, span)
    examples = _fit_members(pairs, z, bend(weights, curve), importance)
    residuals = np.stack([member.residuals for member in examples])
    members = list(zip(examples, blend_weights(residuals), strict=True))
    metric: Arrays = {"metric": gram + 1e-3 * float(np.diag(gram).mean()) * np.eye(len(gram))}
    if geometry is not None:
        blended = _blended_residuals(members, weights.shape)
        metric = _metric(geometry, blended)
        disagreement = _disagreement(residuals, blended, importance)
        share = _geometry_share(geometry.residuals, blended, disagreement)
        line = Member(geometry.slope, geometry.intercept, {}, geometry.residuals)
        members = [(member, part * (1 - share)) for member, part in members] + [(line, share)]
    unseen = np.sqrt((_blended_residuals(members, weights.shape) ** 2).mean(axis=0))
    arrays = {
        "slope": sum((part * each.slope for each, part in members), np.zeros((kept, len(span)))),
        "intercept": sum((part * each.intercept for each, part in members), np.zeros(len(span))),
        "expected_error": np.clip(_TAKE_ERROR_RATIO * unseen, 1e-6, _MAX_EXPECTED_ERROR),
        "start_error": unseen,
        "curve": curve,
        "low": low,
        "span": span,
    }
    arrays |= metric | stack_corrections(members)
    chosen: Settings = {"curve": float(curve.mean()), "geometry": geometry is not None}
    return Fitted(arrays, settings | chosen)


def _prepare(arrays: Arrays, settings: Settings) -> Predictor:
    kept = int(settings["dimensions"])
    slope, intercept, curve, low, span = (
        arrays[name] for name in ("slope", "intercept", "curve", "low", "span")
    )
    expected_error = arrays["expected_error"]
    corrections = prepare_corrections(arrays)
    project = BoxProjection(
        arrays["metric"],
        factor=arrays.get("metric_factor"),
        lower=np.zeros(len(span)),
        upper=np.ones(len(span)),
    )

    def predict(coordinates: FloatArray) -> FloatArray:
        z = coordinates[:, :kept]
        free = unbend(z @ slope + intercept + corrections(z), curve)
        free = _saturate_near_one(free, expected_error)
        free = _drop_noise_outside_limits(free, expected_error)
        predicted: FloatArray = low + span * project(free)
        return predicted

    return predict


def _calibrate(
    pairs: Pairs, z: FloatArray, weights: FloatArray, gram: FloatArray, span: FloatArray
) -> tuple[LinearPosterior | None, FloatArray]:
    """Fit the linear face under every curve; keep for each shape the curve that predicts best."""
    if pairs.face.skin is None or len(weights) < 3:
        return None, np.zeros(len(span))
    skin = pairs.face.skin * span[:, None, None]
    markers = (pairs.inputs @ pairs.face.motion.components).reshape(len(z), -1, 3)
    errors = []
    for curve in CURVES:
        posterior = _posterior(pairs, z, bend(weights, curve), gram, skin, markers)
        predicted = unbend(bend(weights, curve) - posterior.residuals, curve)
        errors.append(np.clip(predicted, -0.1, 1.1) - weights)
    curves = choose_curves(np.stack(errors), weights, gram)
    return _posterior(pairs, z, bend(weights, curves), gram, skin, markers), curves


def _posterior(
    pairs: Pairs,
    z: FloatArray,
    targets: FloatArray,
    gram: FloatArray,
    skin: FloatArray,
    markers: FloatArray,
) -> LinearPosterior:
    kept = z.shape[1]
    components = pairs.face.motion.components[:kept]
    prior = expect_marker_motion(skin, targets, markers)
    return fit_linear_posterior(
        z,
        targets,
        expected=prior.basis.reshape(len(skin), -1) @ components.T,
        components=components,
        variances=_floored_variances(pairs, kept),
        gram=gram,
    )


def _floored_variances(pairs: Pairs, kept: int) -> FloatArray:
    """Variances of the first components, positive: a take may have fewer than are asked for."""
    return np.maximum(pairs.face.motion.variances[:kept], _VARIANCE_FLOOR_MM2)


def _fit_members(
    pairs: Pairs, z: FloatArray, tuned: FloatArray, importance: FloatArray
) -> list[Member]:
    """Fit what learns from examples alone."""
    motion, kept = pairs.face.motion, z.shape[1]
    fit_global = partial(
        fit_global_member, z, variances=_floored_variances(pairs, kept), importance=importance
    )
    targets = tuned
    for _ in range(3):
        line = fit_global(targets, choices=GLOBAL_LINE_CHOICES)
        targets = _uncensor(tuned, z @ line.slope + line.intercept)
    line = fit_global(targets, choices=GLOBAL_LINE_CHOICES)
    members = []
    if len(targets) >= FEWEST_CORRELATED_PAIRS:
        taught = replace(pairs, outputs=targets)
        members = [fit_correlation_member(taught, importance=importance, dimensions=kept)]
    if len(targets) ** 3 * targets.shape[1] > REGIONAL_COST:
        return [*members, fit_global(targets, choices=GLOBAL_LOCAL_CHOICES)]
    sample, components = motion.sample[:, :kept], motion.components[:kept]
    guessed = np.clip(sample @ line.slope + line.intercept, 0.0, 1.0)
    covariance = np.cov(sample.T).reshape(kept, -1)
    for choices, sharpness, shared in (
        (WIDE_REGION_CHOICES, 1.5, True),
        (TIGHT_REGION_CHOICES, 2.0, False),
    ):
        relevance = marker_relevance(sample, guessed, components, sharpness=sharpness, floor=0.01)
        regions = tuple(regional_features(components, covariance, row) for row in relevance)
        members.append(
            fit_regional_member(z, targets, regions=regions, choices=choices, shared=shared)
        )
    return members


def _geometry_share(
    geometry: FloatArray, examples: FloatArray, disagreement: FloatArray
) -> FloatArray:
    """Share of geometry in each shape, by leave-one-out residuals of both."""
    likely = np.maximum((examples**2).mean(axis=0) + _DISAGREEMENT_FACTOR * disagreement, 1e-7)
    share: FloatArray = 1 / (1 + (geometry**2).mean(axis=0) / likely)
    return share


def _disagreement(residuals: FloatArray, blended: FloatArray, importance: FloatArray) -> FloatArray:
    """Mean squared difference of the members from their blend, for each shape.

    Few pairs determine it badly for a shape alone: most of it is what it is, as a share of the
    squared error, over the whole face.
    """
    by_shape = ((residuals - blended) ** 2).mean(axis=(0, 1))
    squared = (blended**2).mean(axis=0)
    whole = float(importance @ by_shape) / max(float(importance @ squared), 1e-12)
    share = _SHAPE_DISAGREEMENT_SHARE
    found: FloatArray = share * by_shape + (1 - share) * whole * squared
    return found


def _uncensor(tuned: FloatArray, predicted: FloatArray) -> FloatArray:
    """Let weights at a limit follow a prediction beyond it: the limit cut them off."""
    above = np.where(tuned >= 1 - _AT_LIMIT, np.clip(predicted, 1.0, 1.0 + _MAX_OVERSHOOT), tuned)
    below: FloatArray = np.where(
        tuned <= _AT_LIMIT, np.clip(predicted, -_MAX_OVERSHOOT, 0.0), above
    )
    return below


def blend_weights(residuals: FloatArray) -> FloatArray:
    """Share of each member for each shape, by the covariance of their errors.

    Parameters
    ----------
    residuals : (members, n, s) float array
        Leave-one-out.

    Returns
    -------
    (members, s) float array
    """
    covariance = np.einsum("vns,wns->svw", residuals, residuals) / residuals.shape[1]
    variances = np.einsum("svv->sv", covariance) + 1e-7
    covariance *= _COVARIANCE_SHARE * max(0.0, 1 - _COVARIANCE_PAIRS / residuals.shape[1])
    np.einsum("svv->sv", covariance)[:] = variances
    return blend_shares(covariance)


def _blended_residuals(
    members: list[tuple[Member, FloatArray]], shape: tuple[int, ...]
) -> FloatArray:
    """Leave-one-out residuals of the members' weighted sum."""
    return sum((part * member.residuals for member, part in members), np.zeros(shape))


def _saturate_near_one(weights: FloatArray, expected_error: FloatArray) -> FloatArray:
    """Let full weights be full: lids close, though errors beyond the limit are cut off.

    A shape tuned to its limit is predicted around it, and cutting off what lies beyond leaves it
    short on average. Within two expected errors of the limit a weight is drawn towards it.
    """
    near = np.clip((weights - 1) / expected_error + 2, 0.0, 1.0)
    return weights + _SATURATION_ERRORS * expected_error * near


def _drop_noise_outside_limits(weights: FloatArray, expected_error: FloatArray) -> FloatArray:
    """Leave beyond the limits only what says that other weights are to move.

    Above the upper limit is what was drawn there, and what the limit cut off when it was tuned;
    just below the lower one is noise, which would become noise of the others.
    """
    slack = _ZERO_SLACK_ERRORS / _TAKE_ERROR_RATIO * expected_error
    below: FloatArray = np.minimum(np.maximum(weights, -slack), 0.0)
    return np.minimum(weights, 1.0) - below


def _metric(geometry: LinearPosterior, residuals: FloatArray) -> Arrays:
    """How strongly each frame determines its weights: by its markers, and by the examples."""
    root = np.linalg.cholesky(geometry.noise)
    by_markers = np.linalg.solve(root, geometry.forward.T).T
    by_markers *= math.sqrt(_MARKER_METRIC_SHARE)
    by_examples = 1 / np.maximum((residuals**2).mean(axis=0), 1e-3)
    if 2 * by_markers.shape[1] < len(by_examples):  # two thin products take less than a square one
        return {"metric": by_examples, "metric_factor": by_markers}
    return {"metric": np.diag(by_examples) + by_markers @ by_markers.T}


METHOD = Regression(
    name="ensemble",
    summary="examples and the rig's geometry together: processes over face and regions",
    fit=_fit,
    prepare=_prepare,
    mapping_candidates=_candidates,
)

FACE_MAP = replace(
    METHOD,
    name="face_map",
    summary="the ensemble near the references, and where the markers leave them the rig's geometry",
    solves_frames=True,
)
