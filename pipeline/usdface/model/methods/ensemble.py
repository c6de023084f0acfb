"""The default: what examples say and what the rig's geometry says, heard together.

Examples speak through three voices (a process over the whole face, and two over the region of each
shape), weighed shape by shape by their leave-one-out errors. Geometry speaks through a
linear face calibrated on the pairs, with local corrections. Both get half of the say: leave-one-out
on chosen references flatters the examples, which know nothing of combinations that no reference
shows. What comes out is brought within the shapes' ranges at the least cost to the face.
"""

import numpy as np

from usdface.assets import FloatArray
from usdface.model.methods.contract import Fitted, Method, Pairs, Settings
from usdface.model.methods.target_curve import CURVES, bend, unbend
from usdface.model.methods.voices import (
    CORRECTIONS,
    GLOBAL_LINES,
    GLOBAL_LOCALS,
    REGION_TIGHT,
    REGION_WIDE,
    Voice,
    global_voice,
    predict_locals,
    regional_voice,
)
from usdface.numerics.regression.linear_posterior import LinearPosterior, fit_linear_posterior
from usdface.numerics.regression.marker_regions import marker_relevance, regional_features
from usdface.numerics.regression.skin_prior import expect_marker_motion
from usdface.numerics.solve.box_projection import project_to_box

MOST_DIMENSIONS = 50
LEAST_VARIANCE_MM2 = 1e-4
"""Variance of a component below which there is no motion, only rounding."""

GEOMETRY_SHARE = 0.5
BLOCK_FRAMES = 1024

SEEN_SHARE = 0.3
"""How far markers, against the examples, say where weights go that a limit pushes aside: with
more, noise of the markers shows as jitter."""

REACH = 1.2
MOST_DOUBT = 0.1
"""How far, in usual errors, weights near the upper limit are drawn to it; and the largest error
that counts as usual."""

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
    say = _say(np.stack([(voice.residuals**2).mean(axis=0) for voice in examples]))
    share = np.zeros(len(span)) if geometry is None else np.full(len(span), GEOMETRY_SHARE)
    voices = [(voice, part * (1 - share)) for voice, part in zip(examples, say, strict=True)]
    metric = gram + 1e-3 * float(np.diag(gram).mean()) * np.eye(len(gram))
    if geometry is not None:
        metric = _metric(geometry, _together(voices, weights.shape) / (1 - GEOMETRY_SHARE))
        voices += _geometry_voices(pairs, z, geometry, importance, share)
    usual = np.sqrt((_together(voices, weights.shape) ** 2).mean(axis=0))
    arrays = {
        "slope": sum((part * voice.slope for voice, part in voices), np.zeros((kept, len(span)))),
        "intercept": sum((part * voice.intercept for voice, part in voices), np.zeros(len(span))),
        "metric": metric,
        "doubt": np.clip(usual, 1e-6, MOST_DOUBT),
        "low": low,
        "span": span,
    }
    for k, (voice, part) in enumerate(voices):
        if voice.locals and (voice.locals["dual"] * part).any():
            arrays |= {f"local{k}_{name}": value for name, value in voice.locals.items()}
            arrays[f"local{k}_dual"] = voice.locals["dual"] * part
    chosen: Settings = {"curve": curve, "geometry": geometry is not None}
    return Fitted(arrays, settings | chosen)


def _predict(
    arrays: dict[str, FloatArray], settings: Settings, coordinates: FloatArray
) -> FloatArray:
    kept = int(settings["dimensions"])
    names = sorted(name.partition("_")[0] for name in arrays if name.endswith("_projection"))
    fields = ("projection", "centres", "exponent", "dual")
    locals_ = [{field: arrays[f"{name}_{field}"] for field in fields} for name in names]
    out = np.empty((len(coordinates), len(arrays["span"])))
    ones = np.ones(len(arrays["span"]))
    for start in range(0, len(coordinates), BLOCK_FRAMES):
        part = slice(start, start + BLOCK_FRAMES)
        z = coordinates[part, :kept]
        bent = z @ arrays["slope"] + arrays["intercept"]
        for parts in locals_:
            bent += predict_locals(parts, z)
        free = _reach_limit(unbend(bent, float(settings["curve"])), arrays["doubt"])
        within = project_to_box(free, arrays["metric"], lower=0 * ones, upper=ones)
        out[part] = arrays["low"] + arrays["span"] * within
    return out


def _calibrated(
    pairs: Pairs, z: FloatArray, weights: FloatArray, gram: FloatArray, span: FloatArray
) -> tuple[LinearPosterior | None, float]:
    """Fit the linear face under every curve; keep the one that predicts unseen pairs best."""
    if pairs.skin is None or len(weights) < 3:
        return None, 0.0
    kept = z.shape[1]
    motion = pairs.motion
    markers = (pairs.coordinates @ motion.components).reshape(len(z), -1, 3)
    best: tuple[float, float, LinearPosterior] | None = None
    for curve in CURVES:
        targets = bend(weights, curve)
        prior = expect_marker_motion(pairs.skin * span[:, None, None], targets, markers)
        basis = prior.basis.reshape(len(span), -1) @ motion.components[:kept].T
        posterior = fit_linear_posterior(
            z,
            targets,
            expected=basis,
            components=motion.components[:kept],
            variances=motion.variances[:kept],
            gram=gram,
        )
        predicted = unbend(targets - posterior.residuals, curve)
        error = np.clip(predicted, -0.1, 1.1) - weights
        score = float(np.einsum("ns,st,nt->", error, gram, error))
        if best is None or score < best[0]:
            best = score, curve, posterior
    if best is None:
        return None, 0.0
    return best[2], best[1]


def _example_voices(
    pairs: Pairs, z: FloatArray, targets: FloatArray, importance: FloatArray
) -> tuple[list[Voice], FloatArray]:
    variances = pairs.motion.variances[: z.shape[1]]
    tuned = targets
    for _ in range(3):
        line = global_voice(
            z, targets, variances=variances, choices=GLOBAL_LINES, importance=importance
        )
        targets = _uncensor(tuned, z @ line.slope + line.intercept)
    line = global_voice(
        z, targets, variances=variances, choices=GLOBAL_LINES, importance=importance
    )
    sample = pairs.motion.sample[:, : z.shape[1]]
    components = pairs.motion.components[: z.shape[1]]
    guessed = np.clip(sample @ line.slope + line.intercept, 0.0, 1.0)
    covariance = np.cov(sample.T).reshape(z.shape[1], -1)
    voices = [
        line,
        global_voice(z, targets, variances=variances, choices=GLOBAL_LOCALS, importance=importance),
    ]
    for choices, sharpness, floor, shared in (
        (REGION_WIDE, 1.5, 0.01, True),
        (REGION_TIGHT, 2.0, 0.01, False),
    ):
        relevance = marker_relevance(sample, guessed, components, sharpness=sharpness, floor=floor)
        regions = tuple(regional_features(components, covariance, row) for row in relevance)
        voices.append(regional_voice(z, targets, regions=regions, choices=choices, shared=shared))
    return voices, targets


def _geometry_voices(
    pairs: Pairs,
    z: FloatArray,
    geometry: LinearPosterior,
    importance: FloatArray,
    share: FloatArray,
) -> list[tuple[Voice, FloatArray]]:
    correction = global_voice(
        z,
        geometry.residuals,
        variances=pairs.motion.variances[: z.shape[1]],
        choices=CORRECTIONS,
        importance=importance,
        noises=10.0 ** np.arange(-3.0, 1.6, 0.5),
    )
    line = Voice(geometry.slope, geometry.intercept, {}, geometry.residuals)
    alone = (geometry.residuals**2).mean(axis=0)
    helped = (correction.residuals**2).mean(axis=0)
    part = _say(np.stack([alone, helped]))[1]
    return [(line, share), (correction, share * part)]


def _uncensor(tuned: FloatArray, predicted: FloatArray) -> FloatArray:
    """Let weights at a limit follow a prediction beyond it: the limit cut them off."""
    above = np.where(tuned >= 1 - _AT_LIMIT, np.clip(predicted, 1.0, 1.0 + _BEYOND), tuned)
    below: FloatArray = np.where(tuned <= _AT_LIMIT, np.clip(predicted, -_BEYOND, 0.0), above)
    return below


def _say(errors: FloatArray) -> FloatArray:
    """Share of each voice for each shape, by the squared inverse of its squared error."""
    weight = (errors + 1e-7) ** -2.0
    share: FloatArray = weight / weight.sum(axis=0)
    return share


def _together(voices: list[tuple[Voice, FloatArray]], shape: tuple[int, ...]) -> FloatArray:
    """Leave-one-out residuals of the voices' weighted sum."""
    return sum((part * voice.residuals for voice, part in voices), np.zeros(shape))


def _reach_limit(weights: FloatArray, doubt: FloatArray) -> FloatArray:
    """Let full weights be full: lids close, though errors beyond the limit are cut off.

    A shape tuned to its limit is predicted around it, and cutting off what lies beyond leaves it
    short on average. Within two of its usual errors of the limit a weight is drawn towards it.
    """
    near = np.clip((weights - 1) / doubt + 2, 0.0, 1.0)
    reached: FloatArray = weights + REACH * doubt * near
    return reached


def _metric(geometry: LinearPosterior, residuals: FloatArray) -> FloatArray:
    """How strongly each frame determines its weights: markers, and the examples beside them."""
    seen = geometry.forward @ np.linalg.solve(geometry.noise, geometry.forward.T)
    heard = 1 / np.maximum((residuals**2).mean(axis=0), 1e-3)
    metric: FloatArray = SEEN_SHARE / 2 * (seen + seen.T) + np.diag(heard)
    return metric


METHOD = Method(
    name="ensemble",
    summary="examples and the rig's geometry together: processes over face and regions",
    candidates=_candidates,
    fit=_fit,
    predict=_predict,
)
