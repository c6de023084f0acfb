"""Pairs as training uses them: with a forward model, and with keys corrected by it."""

from dataclasses import dataclass, replace

import numpy as np

from usdface.core.arrays import FloatArray
from usdface.model.mapping.pair_gains import gain_variance, predict_log_factors, scale_keys
from usdface.model.mapping.regions import FACE, marker_motion, region_points
from usdface.model.regressions import Pairs, Regression
from usdface.model.regressions.base import bend, unbend
from usdface.model.regressions.driven_motion import DrivenMotion, driven_weights
from usdface.model.regressions.forward_model import ForwardModel, ForwardScales, fit_forward_model
from usdface.model.regressions.frame_solve import VARIANCE_INFLATIONS, FrameSolver
from usdface.numerics.regression.marker_prior import expect_marker_motion
from usdface.numerics.solve.bounded_least_squares import descend_in_boxes

_KEY_ROUNDS = 2
"""Of correcting keys and fitting the forward model again; more give the same accuracy."""

_GAIN_ROUNDS = 4
"""Of estimating the pairs' gains and fitting the forward model again. The last changes none by more
than 2 %."""

_CONTRADICTION_CHI2 = 9.0
"""Of the median over pairs: squared leave-one-out residual over the variance expected of it."""

_REGION_CONTRADICTION_CHI2 = 30.0
"""The same of one region: of few markers, and of motion that models tell less well, it is spread
wider. A blink that was forgotten comes to 35, sound keys of a rig of 137 shapes up to 25."""

_CONTRADICTION_MM = 0.5
"""Closer, keys are as good as the eye."""

_KEY_GRADIENT_STEPS = 200
"""Accelerated steps of their correction: its prior is ill-conditioned, and keys are few."""

_PRIOR_CURVE = 0.3
"""Bend of weights under which markers are looked for on the skin; it hardly matters there."""


@dataclass(frozen=True)
class CorrectedPairs:
    """Pairs whose keys are where the markers put them, as far as keys err."""

    pairs: Pairs
    """With the corrected keys."""
    forward: ForwardModel
    """Conditioned on them."""
    given: FloatArray
    """(pairs, shapes): keys as they came."""
    key_error: float
    """Of the keys as they came, as a share of them: `ForwardScales.tau`."""
    uncorrected: ForwardModel
    """Conditioned on the keys as they came."""
    common: float
    """Markers whose squared residuals count as one; see `FrameSolver`."""
    log_factor: FloatArray
    """(pairs,): logarithm of the factor that brought each pair's keys to the mean gain."""

    def as_given(self) -> Pairs:
        """Return the pairs before any was corrected."""
        return replace(self.pairs, outputs=self.given, forward=None)

    def known_to(self, method: Regression) -> Pairs:
        """Return the pairs that a method learns: methods of the literature, the keys as given."""
        return self.pairs if method.solves_frames else replace(self.pairs, outputs=self.given)


def correct_pairs(
    pairs: Pairs, parts: tuple[str, ...], *, common: float = VARIANCE_INFLATIONS[0]
) -> CorrectedPairs:
    """Fit the forward model, and correct the keys by it where its evidence says that they err.

    Gains first, one per pair (`pair_gains`); then each key by itself.

    Parameters
    ----------
    parts : tuple of str
        Of the face, of each shape; see `region_points`.
    """
    given, face = pairs.outputs, pairs.face
    uncorrected = fit_pairs_forward(pairs)
    pairs, forward, log_factor = _equalise_gains(pairs, uncorrected, parts, common)
    scales, keys = forward.scales, forward.targets
    low, span = face.ranges[:, 0], np.ptp(face.ranges, axis=1)
    for _ in range(_KEY_ROUNDS if scales.tau > 0 else 0):
        posterior = correct_keys(forward, keys, scales.tau, common=common)
        if posterior.targets is forward.targets:
            break
        moved = low + span * unbend(posterior.targets, scales.curve)
        pairs = replace(pairs, outputs=moved)
        left = posterior.variance.sum() / scales.key_variance(keys).sum()
        forward = fit_pairs_forward(pairs, replace(scales, tau=scales.tau * float(np.sqrt(left))))
    return CorrectedPairs(
        replace(pairs, forward=forward),
        forward,
        given,
        scales.tau,
        uncorrected,
        common,
        log_factor,
    )


def _equalise_gains(
    pairs: Pairs, forward: ForwardModel, parts: tuple[str, ...], common: float
) -> tuple[Pairs, ForwardModel, FloatArray]:
    """Bring the keys of all pairs to their mean gain, where gains differ significantly."""
    log_factor = np.zeros(len(pairs.outputs))
    variance = gain_variance(forward, parts, common)
    if variance == 0:
        return pairs, forward, log_factor
    for _ in range(_GAIN_ROUNDS):
        log_factor = predict_log_factors(
            forward, parts, common, variance=variance, applied=log_factor
        )
        scaled = scale_keys(pairs, log_factor)
        forward = fit_pairs_forward(scaled, forward.scales)
    return scaled, fit_pairs_forward(scaled), log_factor


@dataclass(frozen=True)
class KeyPosterior:
    """Keys of references, given their markers."""

    targets: FloatArray
    """(pairs, shapes): most probable bent weights."""
    variance: FloatArray
    """(pairs, shapes): of the error that is left."""


def correct_keys(
    forward: ForwardModel, keys: FloatArray, tau: float, *, common: float = VARIANCE_INFLATIONS[0]
) -> KeyPosterior:
    """Move keys to where their markers put them, as far as keys err.

    A key t is off by tau of itself, and by a fifth of tau where it is small (`forward_model`); half
    of the variance is the face's, one animator's gain on one day, half the shape's::

        cov(t) = tau^2 (diag(t^2 + 1/25) + t t') / 2

    The pair's markers, less what a model that has not seen the pair predicts of them, say in which
    direction.

    Parameters
    ----------
    forward : ForwardModel
        Conditioned on these pairs, at the keys found so far.
    keys : (pairs, shapes) float array
        As given, bent.
    common : float
        As of `FrameSolver`.
    """
    solver, now = FrameSolver(forward, np.full(keys.shape[1], tau)), forward.targets
    _, slope = solver.linearise(now)
    if slope is None:  # of rigs of very many shapes keys stay as they are
        return KeyPosterior(now, replace(forward.scales, tau=tau).key_variance(keys))
    if tau == 0:
        return KeyPosterior(now, np.zeros_like(now))
    weighted = slope / np.repeat(common * forward.leave_one_out_variance, 3, axis=1)[:, None]
    prior = replace(forward.scales, tau=tau).key_variance(keys)[:, None] * np.eye(keys.shape[1])
    precision = np.linalg.inv(0.5 * (prior + tau**2 * keys[:, :, None] * keys[:, None]))
    hessian = weighted @ slope.transpose(0, 2, 1) + precision
    gradient = (weighted @ forward.residuals.reshape(len(keys), -1, 1))[:, :, 0]
    gradient += (precision @ (keys - now)[:, :, None])[:, :, 0]
    moved = descend_in_boxes(
        lambda rows: (hessian @ rows[:, :, None])[:, :, 0],
        np.einsum("nss->ns", hessian),
        gradient,
        lower=-now,
        upper=1 - now,
        start=np.zeros_like(now),
        steps=_KEY_GRADIENT_STEPS,
    )
    variance = np.einsum("nss->ns", np.linalg.inv(hessian))
    return KeyPosterior(np.clip(now + moved, 0.0, 1.0), variance)


def find_contradicted(
    forward: ForwardModel, parts: tuple[str, ...]
) -> dict[int, tuple[str, float]]:
    """Find pairs whose markers are far from where a model of the others puts them under their keys.

    Region by region: two markers of a lid do not show in the mean of a hundred.

    Parameters
    ----------
    parts : tuple of str
        Of the face, of each shape.

    Returns
    -------
    dict of int to (str, float)
        Pair: the region where it is worst, and the root mean square distance there [mm]; farthest
        first.
    """
    squared = (forward.residuals**2).sum(axis=2)
    chi2 = squared * np.einsum("knn->nk", forward.inverse)
    worst: dict[int, tuple[float, str, float]] = {}
    for region, markers in region_points(parts, forward.basis).items():
        mean = chi2[:, markers].mean(axis=1)
        limit = _CONTRADICTION_CHI2 if region == FACE else _REGION_CONTRADICTION_CHI2
        excess = mean / np.maximum(limit * np.median(mean), 1e-12)
        away = np.sqrt(squared[:, markers].mean(axis=1))
        for pair in np.flatnonzero((excess > 1) & (away > _CONTRADICTION_MM)):
            found = (float(excess[pair]), region, float(away[pair]))
            worst[int(pair)] = max(worst.get(int(pair), found), found)
    far = sorted(worst.items(), key=lambda each: -each[1][2])
    return {pair: (region, away) for pair, (_, region, away) in far}


def fit_pairs_forward(pairs: Pairs, scales: ForwardScales | None = None) -> ForwardModel:
    """Fit the forward model, from what the rig's shapes do or, without a rig, the pairs' line."""
    face = pairs.face
    weights, moved = face.normalise(pairs.outputs), displacements(pairs)
    neutral = np.zeros(moved.shape[1:]) if face.neutral is None else face.neutral
    if face.skin is None:
        expected = marker_motion(weights, moved)
        return fit_forward_model(weights, moved, expected=expected, neutral=neutral, scales=scales)
    skin, bent = face.skin * np.ptp(face.ranges, axis=1)[:, None, None], bend(weights, _PRIOR_CURVE)
    driven = np.zeros((len(weights), 0))
    if face.driven is not None:
        low, high = face.ranges.T
        driven = driven_weights(face.driven.logic, np.clip(pairs.outputs, low, high))
        skin = np.concatenate([skin, face.driven.skin])
    basis = expect_marker_motion(
        skin,
        np.concatenate([bent, driven], axis=1),
        moved,
        rest=None if face.rest is None else face.rest.points,
        neutral=face.neutral,
        places=None if face.rest is None else face.rest.markers,
    ).basis
    count = weights.shape[1]
    motion = basis[count:].reshape(len(basis) - count, moved[0].size)
    forward = fit_forward_model(
        weights,
        moved - (driven @ motion).reshape(moved.shape),
        expected=basis[:count],
        neutral=neutral,
        scales=scales,
    )
    if face.driven is None:
        return forward
    return replace(forward, driven=DrivenMotion(face.driven.logic, face.ranges, motion))


def displacements(pairs: Pairs) -> FloatArray:
    """Return how far the references' markers are from the neutral: (pairs, markers, 3) [mm]."""
    if pairs.markers is None or pairs.face.neutral is None:
        raise ValueError("a mapping's pairs need markers and a neutral")
    return pairs.markers - pairs.face.neutral
