"""Training pairs with a forward model, and with keys corrected by it."""

from dataclasses import dataclass, replace

import numpy as np

from usdface.core.arrays import FloatArray, IntArray
from usdface.model.mapping.pair_gains import gain_groups, predict_log_factors, scale_keys
from usdface.model.mapping.regions import FACE, marker_motion, region_points
from usdface.model.mapping.unset_keys import with_unset_keys
from usdface.model.regressions.base import Pairs, Regression
from usdface.model.regressions.bent_weights import bend, unbend
from usdface.model.regressions.driven_motion import DrivenMotion, driven_weights
from usdface.model.regressions.forward_model import ForwardModel, ForwardScales, fit_forward_model
from usdface.model.regressions.frame_solve import LANDMARK_INFLATION, MARKER_INFLATION, FrameSolver
from usdface.numerics.measure.face_regions import shapes_by_region
from usdface.numerics.regression.marker_prior import fit_marker_basis
from usdface.numerics.rigid.skin_rotation import rotate_deltas, skin_rotations
from usdface.numerics.solve.bounded_least_squares import minimise_within_bounds

_KEY_ROUNDS, _UNSET_ROUNDS = 2, 8
"""Alternations of correcting the keys and fitting the forward model: more do not improve it, except
where the keyed shapes have to give back the motion of those that were not set."""

_GAIN_ROUNDS = 4
"""Alternations of estimating the gains and fitting the forward model; the last changes no gain by
more than 2 %."""

_CONTRADICTION_CHI2 = 9.0
"""Threshold for a pair's mean chi2 (squared leave-one-out residual over its variance), relative to
the median over pairs."""

_REGION_CONTRADICTION_CHI2 = 30.0
"""The same for a region: with fewer markers, chi2 has a wider distribution. A forgotten blink
reaches 35, correct keys of a rig of 137 shapes up to 25."""

_CONTRADICTION_MM = 0.5
"""Root mean square residual up to which a contradiction is not reported: keys are not set more
precisely than this."""

_CRITICAL_RANK_SUM = 2.58
"""Standard deviations of a rank sum (Mann and Whitney 1947), p = .005; two pairs reach 2.45."""

_ROUNDING_ERROR = 0.03
"""Largest tau that rounding of keys and leaving out small weights can cause. Up to it, corrections
are of errors that all pairs have in common."""

_KEY_GRADIENT_STEPS = 200
"""Accelerated gradient steps of the correction, whose prior is ill-conditioned."""

_LEAST_KEY_VARIANCE = 1e-8
"""Smallest variance of a key in a pair of which others were not set."""

KEY_INFLATION, _LANDMARK_KEY_INFLATION = 3.0, 243.0
"""Number of markers, and of landmarks, whose errors count as one independent error where keys are
corrected: common errors would otherwise be taken for errors of the keys."""

_PRIOR_CURVE = 0.3
"""Parameter of `bend` for locating markers on the rig, which is insensitive to it."""


@dataclass(frozen=True)
class RigPrior:
    """Motion of the markers by the rig: prior of the forward model."""

    basis: FloatArray
    """(shapes, markers, 3): displacement by each bent weight at 1 [mm]."""
    driven: DrivenMotion | None
    """Of shapes that others drive."""


@dataclass(frozen=True)
class CorrectedPairs:
    """Pairs with the posterior mode of their keys, and the forward model given these."""

    pairs: Pairs
    """Pairs with corrected keys."""
    forward: ForwardModel
    """Posterior given the corrected keys."""
    original_keys: FloatArray
    """(pairs, shapes): keys of the references."""
    scales: ForwardScales
    """Of the forward model, with the errors of the original keys."""
    uncorrected: ForwardModel
    """Posterior given the original keys."""
    inflation: float
    """Of takes, as of `FrameSolver`; keys are corrected with `KEY_INFLATION`."""
    log_factor: FloatArray
    """(pairs,): logarithm of the factor that scaled each pair's keys to the mean gain."""

    def training_pairs(self, method: Regression) -> Pairs:
        """Return the training pairs of a method.

        Published methods are fitted to original keys, with one output for both sides of a shape.
        """
        if method.solves_frames:
            return self.pairs
        return replace(self.pairs, outputs=self.pairs.face.sides.join(self.original_keys))

    @property
    def has_random_errors(self) -> bool:
        """Whether the keys have more errors than those that all pairs have in common."""
        largest = max(self.scales.tau, self.scales.unset)
        return largest > _ROUNDING_ERROR or bool(self.log_factor.any())


def correct_pairs(
    pairs: Pairs,
    parts: tuple[str, ...],
    *,
    landmarks: bool = False,
    scales: ForwardScales | None = None,
) -> CorrectedPairs:
    """Fit the forward model, and correct the keys if they have errors.

    First gains (`pair_gains`), then each key.

    Parameters
    ----------
    parts : tuple of str
        Part of the face of each shape; see `region_points`.
    landmarks : bool
        Whether the markers are landmarks detected in images, whose errors are correlated.
    scales : ForwardScales, optional
        Fixed scales, with the errors of the original keys; by default they are estimated.
    """
    original_keys, face = pairs.outputs, pairs.face
    key_inflation = _LANDMARK_KEY_INFLATION if landmarks else KEY_INFLATION
    prior = fit_rig_prior(pairs)
    uncorrected = fit_pairs_forward(pairs, scales, prior)
    if scales is None and not landmarks:
        uncorrected = with_unset_keys(
            uncorrected, lambda unset: fit_pairs_forward(pairs, None, prior, unset=unset)
        )
    pairs, forward, log_factor = _equalise_gains(
        pairs, uncorrected, parts, key_inflation, scales, prior
    )
    scales, keys = forward.scales, forward.targets
    low, span = face.ranges[:, 0], np.ptp(face.ranges, axis=1)
    rounds = _UNSET_ROUNDS if scales.unset else _KEY_ROUNDS if scales.tau else 0
    for _ in range(rounds):
        mode, variance = correct_keys(forward, keys, scales, inflation=key_inflation)
        if mode is forward.targets:  # not corrected: too many shapes
            break
        corrected = low + span * unbend(mode, scales.curve)
        pairs = replace(pairs, outputs=corrected)
        # The errors of corrected keys are those of the posterior. Keys that left 0 count as set.
        left = float(np.sqrt(variance.sum() / scales.key_variance(keys).sum()))
        forward = fit_pairs_forward(
            pairs, replace(scales, tau=scales.tau * left, unset=scales.unset * left), prior
        )
    return CorrectedPairs(
        replace(pairs, forward=forward),
        forward,
        original_keys,
        scales,
        uncorrected,
        inflation=LANDMARK_INFLATION if landmarks else MARKER_INFLATION,
        log_factor=log_factor,
    )


def _equalise_gains(
    pairs: Pairs,
    forward: ForwardModel,
    parts: tuple[str, ...],
    key_inflation: float,
    scales: ForwardScales | None,
    prior: RigPrior,
) -> tuple[Pairs, ForwardModel, FloatArray]:
    """Scale the keys to the mean gain, if gains of authors or of pairs differ significantly."""
    log_factor = np.zeros(len(pairs.outputs))
    groups, variance = gain_groups(forward, parts, key_inflation, pairs.authors)
    if variance == 0:
        return pairs, forward, log_factor
    for _ in range(_GAIN_ROUNDS):
        log_factor = predict_log_factors(
            forward, parts, key_inflation, groups=groups, variance=variance, applied=log_factor
        )
        scaled = scale_keys(pairs, log_factor)
        forward = fit_pairs_forward(scaled, forward.scales, prior)
    unset = forward.scales.unset
    return scaled, fit_pairs_forward(scaled, scales, prior, unset=unset), log_factor


def correct_keys(
    forward: ForwardModel,
    keys: FloatArray,
    scales: ForwardScales,
    *,
    inflation: float = KEY_INFLATION,
) -> tuple[FloatArray, FloatArray]:
    """Return the posterior mode and variance of the bent keys, (pairs, shapes), given the markers.

    The prior is centred on the keys. Half of its variance is a gain common to all shapes of the
    pair, half is independent per shape::

        cov(t) = tau^2 (diag(t^2 + 1/25) + t t') / 2 + unset^2 diag[t = 0]

    The likelihood is that of the leave-one-out residuals, linearised at the current keys.

    Parameters
    ----------
    forward : ForwardModel
        Posterior given these pairs at their current keys.
    keys : (pairs, shapes) float array
        Original keys, bent.
    inflation : float
        Number of markers whose errors count as one.
    """
    solver, current = FrameSolver(forward, np.full(keys.shape[1], scales.tau)), forward.targets
    _, slope = solver.linearise(current)
    if slope is None:  # too many shapes for a Jacobian per pair: keys stay
        return current, scales.key_variance(keys)
    if not scales.has_key_errors:
        return current, np.zeros_like(current)
    weighted = slope / np.repeat(inflation * forward.leave_one_out_variance, 3, axis=1)[:, None]
    half = replace(scales, tau=scales.tau / 2**0.5)
    diagonal = (half.key_variance(keys) + _LEAST_KEY_VARIANCE)[:, None] * np.eye(keys.shape[1])
    precision = np.linalg.inv(diagonal + half.tau**2 * keys[:, :, None] * keys[:, None])
    hessian = weighted @ slope.transpose(0, 2, 1) + precision
    gradient = (weighted @ forward.residuals.reshape(len(keys), -1, 1))[:, :, 0]
    gradient += (precision @ (keys - current)[:, :, None])[:, :, 0]
    step = minimise_within_bounds(
        lambda rows: (hessian @ rows[:, :, None])[:, :, 0],
        np.einsum("nss->ns", hessian),
        gradient,
        lower=-current,
        upper=1 - current,
        start=np.zeros_like(current),
        steps=_KEY_GRADIENT_STEPS,
    )
    variance = np.einsum("nss->ns", np.linalg.inv(hessian))
    return np.clip(current + step, 0.0, 1.0), variance


def find_contradicted(
    forward: ForwardModel, parts: tuple[str, ...]
) -> dict[int, tuple[str, float]]:
    """Find pairs whose leave-one-out residuals contradict their keys.

    Each region is tested as well as the face, in whose mean two markers of a lid have no weight.
    Returns, by pair, the region with the largest ratio of chi2 to its threshold, and the root mean
    square residual there [mm], the largest residual first.

    `parts`: part of the face of each shape.
    """
    squared = (forward.residuals**2).sum(axis=2)
    chi2 = squared * np.einsum("knn->nk", forward.inverse)
    worst: dict[int, tuple[float, str, float]] = {}
    for region, markers in region_points(parts, forward.basis).items():
        mean = chi2[:, markers].mean(axis=1)
        limit = _CONTRADICTION_CHI2 if region == FACE else _REGION_CONTRADICTION_CHI2
        excess = mean / np.maximum(limit * np.median(mean), 1e-12)
        rms_mm = np.sqrt(squared[:, markers].mean(axis=1))
        for pair in np.flatnonzero((excess > 1) & (rms_mm > _CONTRADICTION_MM)):
            entry = (float(excess[pair]), region, float(rms_mm[pair]))
            worst[int(pair)] = max(worst.get(int(pair), entry), entry)
    ordered = sorted(worst.items(), key=lambda item: -item[1][2])
    return {pair: (region, residual_mm) for pair, (_, region, residual_mm) in ordered}


def find_forgotten(forward: ForwardModel, parts: tuple[str, ...]) -> dict[str, IntArray]:
    """Find regions that are 0 in some pairs though their markers move, as if they were forgotten.

    `find_contradicted` compares with the median pair, and does not find what half of them have.
    Here the residuals of the pairs at 0 are compared with those of the others: they are smaller if
    the region rests there. Returns, by region, the pairs at 0 beyond the median of the others, the
    largest residual first.

    `parts`: part of the face of each shape.
    """
    found, shapes = {}, shapes_by_region(parts)
    squared = (forward.residuals**2).sum(axis=2)
    for region, markers in region_points(parts, forward.basis).items():
        zero = np.asarray((forward.targets[:, shapes.get(region, [])] == 0).all(axis=1))
        if zero.all():  # the face, and regions at rest
            continue
        rms_mm = np.sqrt(squared[:, markers].mean(axis=1))
        products, larger = zero.sum() * (~zero).sum(), rms_mm[zero][:, None] > rms_mm[~zero]
        deviation = np.sqrt(products * (len(squared) + 1) / 12)
        moved = zero & (rms_mm > max(np.median(rms_mm[~zero]), _CONTRADICTION_MM))
        if larger.sum() - products / 2 > _CRITICAL_RANK_SUM * deviation and moved.any():
            order = np.argsort(-rms_mm, kind="stable")
            found[region] = order[moved[order]]
    return found


def fit_rig_prior(pairs: Pairs) -> RigPrior:
    """Locate the markers on the rig; without a rig, the prior is a regression's basis."""
    face = pairs.face
    weights, displaced = face.normalise(pairs.outputs), pairs.displacements
    if face.skin is None:
        return RigPrior(marker_motion(weights, displaced), None)
    skin, bent = face.skin * np.ptp(face.ranges, axis=1)[:, None, None], bend(weights, _PRIOR_CURVE)
    if face.driven is not None:
        skin = np.concatenate([skin, face.driven.skin])
    rest, inputs = face.rest, np.concatenate([bent, _driven_weights(pairs)], axis=1)
    basis = fit_marker_basis(
        skin,
        inputs,
        displaced,
        rest=None if rest is None else rest.points,
        neutral=face.neutral,
        places=None if rest is None else rest.markers,
        motion_scale=None if rest is None else rest.motion_scale,
    )
    if face.neutral is not None:
        predicted = np.einsum("ns,smc->nmc", inputs, basis, optimize=True)
        seen = np.ones(predicted.shape[:2], np.bool_)
        basis = rotate_deltas(
            basis, skin_rotations(face.neutral, predicted, displaced, visible=seen)
        )
    count = weights.shape[1]
    if face.driven is None:
        return RigPrior(basis, None)
    motion = basis[count:].reshape(len(basis) - count, displaced[0].size)
    return RigPrior(basis[:count], DrivenMotion(face.driven.logic, face.sides, motion))


def fit_pairs_forward(
    pairs: Pairs,
    scales: ForwardScales | None = None,
    prior: RigPrior | None = None,
    *,
    unset: float = 0.0,
) -> ForwardModel:
    """Fit the forward model; by default its scales and the prior are estimated."""
    face, displaced, prior = pairs.face, pairs.displacements, prior or fit_rig_prior(pairs)
    if prior.driven is not None:
        displaced = displaced - (_driven_weights(pairs) @ prior.driven.motion).reshape(
            displaced.shape
        )
    forward = fit_forward_model(
        face.normalise(pairs.outputs),
        displaced,
        expected=prior.basis,
        neutral=np.zeros(displaced.shape[1:]) if face.neutral is None else face.neutral,
        scales=scales,
        unset=unset,
        lids=face.lids,
    )
    return replace(forward, driven=prior.driven)


def _driven_weights(pairs: Pairs) -> FloatArray:
    """Return the weights of the shapes that others drive: (pairs, driven shapes)."""
    face = pairs.face
    if face.driven is None:
        return np.zeros((len(pairs.outputs), 0))
    weights = face.sides.join(np.clip(pairs.outputs, *face.ranges.T))
    return driven_weights(face.driven.logic, weights)
