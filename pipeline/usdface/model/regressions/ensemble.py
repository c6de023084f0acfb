"""The default: what examples say and what the rig's geometry says, heard together.

Examples speak through three voices (processes over the region of each shape, near and wide, and
kernel CCA over the whole face), weighed shape by shape by their leave-one-out errors. Geometry
speaks through a linear face calibrated on the pairs. How far it is heard depends on the errors of
both and on how far the voices disagree: leave-one-out on chosen references flatters the examples,
which know nothing of combinations that no reference shows. What comes out is brought within the
shapes' ranges at the least cost to the face.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np

from usdface.core.arrays import FloatArray
from usdface.model.mapping.coordinates import noise_variance
from usdface.model.regressions.base import (
    Fitted,
    Method,
    Pairs,
    Predictor,
    Settings,
    in_double_precision,
)
from usdface.model.regressions.corrections import (
    condense_corrections,
    prepare_corrections,
    stack_corrections,
)
from usdface.model.regressions.target_curve import CURVES, bend, choose_curves, unbend
from usdface.model.regressions.voices import (
    FEWEST_CORRELATED,
    GLOBAL_LINES,
    GLOBAL_LOCALS,
    REGION_TIGHT,
    REGION_WIDE,
    REGIONAL_COST,
    Voice,
    correlation_voice,
    global_voice,
    regional_voice,
)
from usdface.numerics.array_namespace import CPU, ArrayDevice, namespace_of
from usdface.numerics.regression.convex_blend import blend_shares
from usdface.numerics.regression.linear_posterior import LinearPosterior, fit_linear_posterior
from usdface.numerics.regression.marker_regions import marker_relevance, regional_features
from usdface.numerics.regression.skin_prior import expect_marker_motion
from usdface.numerics.solve.box_projection import BoxProjection

MOST_DIMENSIONS = 50
LEAST_VARIANCE_MM2 = 1e-4
"""Variance of a component below which there is no motion, only rounding."""

_FLOOR_MM2 = 1e-9  # of components asked for that do not move at all

TRUSTED = 0.75
_FEW_PAIRS = 25
"""How far it is believed that voices err together as their residuals do: the first times the share
of the pairs beyond the second. At these and below, voices count as independent."""

DISAGREED = 1.5
OWN_DISAGREEMENT = 0.25
"""By how many times their squared disagreement the examples' squared error counts as larger; and
how far disagreement over a shape is that shape's own, the rest being the whole face's. Noise leads
all voices astray alike, geometry too; where no reference shows the way, each goes its own."""

SEEN_SHARE = 0.3
"""How far markers, against the examples, say where weights go that a limit pushes aside: with
more, noise of the markers shows as jitter."""

_REACH = 1.4
UNSEEN = 2.0
MOST_DOUBT = 0.15
"""How far, in usual errors, weights near the upper limit are drawn to it; how much larger errors
are on a take than on the chosen pairs; and the largest error that counts as usual."""

BELOW = 0.25
"""How far below the lower limit, in usual errors, a weight may be without others moving for it."""

_AT_LIMIT = 0.005  # weights this near to 0 or 1 may have wanted to go beyond
_BEYOND = 0.25  # and how far at most


def _candidates(pairs: Pairs, dimensions: int | None) -> tuple[Settings, ...]:
    return ({"dimensions": dimensions or signal_dimensions(pairs)},)


def signal_dimensions(pairs: Pairs) -> int:
    """How many components move at all, at most `MOST_DIMENSIONS`."""
    moving = int((pairs.motion.variances > LEAST_VARIANCE_MM2).sum())
    return int(max(1, min(moving, MOST_DIMENSIONS, pairs.coordinates.shape[1])))


def _fit(pairs: Pairs, settings: Settings) -> Fitted:
    kept = int(settings["dimensions"])
    z = pairs.coordinates[:, :kept]
    low, span = pairs.ranges[:, 0], np.ptp(pairs.ranges, axis=1)
    weights = (pairs.weights - low) / span
    gram = pairs.gram * np.outer(span, span)
    geometry, curve = _calibrated(pairs, z, weights, gram, span)
    targets = bend(weights, curve)
    importance = np.diag(gram) + 1e-3 * float(np.diag(gram).mean())
    examples, targets = _example_voices(pairs, z, targets, importance)
    residuals = np.stack([voice.residuals for voice in examples])
    say = blend_weights(residuals)
    voices = list(zip(examples, say, strict=True))
    metric = {"metric": gram + 1e-3 * float(np.diag(gram).mean()) * np.eye(len(gram))}
    if geometry is not None:
        together = _blended_residuals(voices, weights.shape)
        metric = _metric(geometry, together)
        disagreement = _disagreement(residuals, together, importance)
        share = _geometry_share(geometry.residuals, together, disagreement)
        line = Voice(geometry.slope, geometry.intercept, {}, geometry.residuals)
        voices = [(voice, part * (1 - share)) for voice, part in voices] + [(line, share)]
    usual = np.sqrt((_blended_residuals(voices, weights.shape) ** 2).mean(axis=0))
    arrays = {
        "slope": sum((part * voice.slope for voice, part in voices), np.zeros((kept, len(span)))),
        "intercept": sum((part * voice.intercept for voice, part in voices), np.zeros(len(span))),
        "doubt": np.clip(UNSEEN * usual, 1e-6, MOST_DOUBT),
        "curve": curve,
        "low": low,
        "span": span,
    }
    arrays |= metric | stack_corrections(voices)
    chosen: Settings = {"curve": float(curve.mean()), "geometry": geometry is not None}
    return Fitted(arrays, settings | chosen)


def _prepare(
    arrays: dict[str, FloatArray],
    settings: Settings,
    device: ArrayDevice = CPU,
    *,
    single: bool = True,
) -> Predictor:
    single &= device is CPU  # in double precision all devices agree to 1e-6 with it
    kept = int(settings["dimensions"])
    slope, intercept, curve, doubt, low, span = (
        device.put(arrays[name]) for name in ("slope", "intercept", "curve", "doubt", "low", "span")
    )
    corrections = prepare_corrections(arrays, single=single, device=device)
    within = BoxProjection(
        arrays["metric"],
        factor=arrays.get("metric_factor"),
        lower=np.zeros(len(arrays["span"])),
        upper=np.ones(len(arrays["span"])),
        single=single,
        device=device,
    )

    def predict(coordinates: Any) -> Any:
        z = coordinates[:, :kept]
        bent = z @ slope + intercept + corrections(z)
        free = _saturate_near_one(unbend(bent, curve), doubt)
        return low + span * within(_drop_noise_outside_limits(free, doubt))

    return predict


def _quicken(pairs: Pairs, fitted: Fitted) -> Fitted:
    """Condense the examples' corrections, on frames of the takes."""
    kept = int(fitted.settings["dimensions"])
    condensed = condense_corrections(
        fitted.arrays,
        pairs.motion.sample[:, :kept],
        noise=math.sqrt(noise_variance(pairs.motion)),
    )
    return replace(fitted, arrays=fitted.arrays | condensed)


def _calibrated(
    pairs: Pairs, z: FloatArray, weights: FloatArray, gram: FloatArray, span: FloatArray
) -> tuple[LinearPosterior | None, FloatArray]:
    """Fit the linear face under every curve; keep for each shape the curve that predicts best."""
    if pairs.skin is None or len(weights) < 3:
        return None, np.zeros(len(span))
    skin = pairs.skin * span[:, None, None]
    markers = (pairs.coordinates @ pairs.motion.components).reshape(len(z), -1, 3)
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
    components = pairs.motion.components[:kept]
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
    return np.maximum(pairs.motion.variances[:kept], _FLOOR_MM2)


def _example_voices(
    pairs: Pairs, z: FloatArray, targets: FloatArray, importance: FloatArray
) -> tuple[list[Voice], FloatArray]:
    variances = _floored_variances(pairs, z.shape[1])
    tuned = targets
    for _ in range(3):
        line = global_voice(
            z, targets, variances=variances, choices=GLOBAL_LINES, importance=importance
        )
        targets = _uncensor(tuned, z @ line.slope + line.intercept)
    line = global_voice(
        z, targets, variances=variances, choices=GLOBAL_LINES, importance=importance
    )
    taught = replace(pairs, weights=targets, gram=np.diag(importance))
    voices = []
    if len(targets) >= FEWEST_CORRELATED:
        voices = [correlation_voice(taught, targets, dimensions=z.shape[1])]
    if len(targets) ** 3 * targets.shape[1] > REGIONAL_COST:
        voices.append(
            global_voice(
                z, targets, variances=variances, choices=GLOBAL_LOCALS, importance=importance
            )
        )
        return voices, targets
    sample = pairs.motion.sample[:, : z.shape[1]]
    components = pairs.motion.components[: z.shape[1]]
    guessed = np.clip(sample @ line.slope + line.intercept, 0.0, 1.0)
    covariance = np.cov(sample.T).reshape(z.shape[1], -1)
    for choices, sharpness, floor, shared in (
        (REGION_WIDE, 1.5, 0.01, True),
        (REGION_TIGHT, 2.0, 0.01, False),
    ):
        relevance = marker_relevance(sample, guessed, components, sharpness=sharpness, floor=floor)
        regions = tuple(regional_features(components, covariance, row) for row in relevance)
        voices.append(regional_voice(z, targets, regions=regions, choices=choices, shared=shared))
    return voices, targets


def _geometry_share(
    geometry: FloatArray, examples: FloatArray, disagreement: FloatArray
) -> FloatArray:
    """How far geometry is heard for each shape, by leave-one-out residuals of both."""
    likely = np.maximum((examples**2).mean(axis=0) + DISAGREED * disagreement, 1e-7)
    share: FloatArray = 1 / (1 + (geometry**2).mean(axis=0) / likely)
    return share


def _disagreement(
    residuals: FloatArray, together: FloatArray, importance: FloatArray
) -> FloatArray:
    """Mean squared difference of the voices from their blend, for each shape.

    Few pairs tell it badly for a shape alone: most of it is what it is, as a share of the squared
    error, over the whole face.
    """
    own = ((residuals - together) ** 2).mean(axis=(0, 1))
    squared = (together**2).mean(axis=0)
    whole = float(importance @ own) / max(float(importance @ squared), 1e-12)
    found: FloatArray = OWN_DISAGREEMENT * own + (1 - OWN_DISAGREEMENT) * whole * squared
    return found


def _uncensor(tuned: FloatArray, predicted: FloatArray) -> FloatArray:
    """Let weights at a limit follow a prediction beyond it: the limit cut them off."""
    above = np.where(tuned >= 1 - _AT_LIMIT, np.clip(predicted, 1.0, 1.0 + _BEYOND), tuned)
    below: FloatArray = np.where(tuned <= _AT_LIMIT, np.clip(predicted, -_BEYOND, 0.0), above)
    return below


def blend_weights(residuals: FloatArray) -> FloatArray:
    """Share of each voice for each shape, by what its errors and theirs together are."""
    covariance = np.einsum("vns,wns->svw", residuals, residuals) / residuals.shape[1]
    alone = np.einsum("svv->sv", covariance) + 1e-7
    covariance *= TRUSTED * max(0.0, 1 - _FEW_PAIRS / residuals.shape[1])
    np.einsum("svv->sv", covariance)[:] = alone
    return blend_shares(covariance)


def _blended_residuals(
    voices: list[tuple[Voice, FloatArray]], shape: tuple[int, ...]
) -> FloatArray:
    """Leave-one-out residuals of the voices' weighted sum."""
    return sum((part * voice.residuals for voice, part in voices), np.zeros(shape))


def _saturate_near_one(weights: Any, doubt: Any) -> Any:
    """Let full weights be full: lids close, though errors beyond the limit are cut off.

    A shape tuned to its limit is predicted around it, and cutting off what lies beyond leaves it
    short on average. Within two of its usual errors of the limit a weight is drawn towards it.
    """
    near = namespace_of(weights).clip((weights - 1) / doubt + 2, 0.0, 1.0)
    return weights + _REACH * doubt * near


def _drop_noise_outside_limits(weights: Any, doubt: Any) -> Any:
    """Leave beyond the limits only what says that other weights are to move.

    Above the upper limit is what was drawn there, and what the limit cut off when it was tuned;
    just below the lower one is noise, which would become noise of the others.
    """
    xp = namespace_of(weights)
    slack = BELOW / UNSEEN * doubt
    return xp.clip(weights, max=1.0) - xp.clip(xp.maximum(weights, -slack), max=0.0)


def _metric(geometry: LinearPosterior, residuals: FloatArray) -> dict[str, FloatArray]:
    """How strongly each frame determines its weights: markers, and the examples beside them."""
    root = np.linalg.cholesky(geometry.noise)
    seen = math.sqrt(SEEN_SHARE) * np.linalg.solve(root, geometry.forward.T).T
    heard = 1 / np.maximum((residuals**2).mean(axis=0), 1e-3)
    if 2 * seen.shape[1] < len(heard):  # two thin products take less than a square one
        return {"metric": heard, "metric_factor": seen}
    return {"metric": np.diag(heard) + seen @ seen.T}


METHOD = Method(
    name="ensemble",
    summary="examples and the rig's geometry together: processes over face and regions",
    candidates=_candidates,
    fit=_fit,
    predict=in_double_precision(_prepare),
    prepare=_prepare,
    quicken=_quicken,
)
