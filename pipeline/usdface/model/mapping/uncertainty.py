"""Uncertainty of a frame: standard deviation of the error of each region's surface [mm].

The posterior of a frame's bent weights is approximated by a normal distribution at the solution
(Laplace's method), with covariance ::

    C = (J W J' + P)^-1

``J``: Jacobian of the forward model, a row per shape. ``W``, ``P``: inverse covariance of the
markers' errors and prior precision, of `frame_solve`. With ``D`` the derivative of unbending and
``G_g`` the Gram matrix of the displacements of region g (mean dot products over its points), the
expected squared error of the surface is ``tr(G_g D C D)``. G excludes the shapes of gaze and
tongue, which no marker shows.

The posterior covers visibility, distance from the references, and the error of the rig as a prior,
but not motion that no weights explain. ``chi2_g`` is the squared residual at the solution relative
to its expected value, averaged over the markers that the region's shapes move; expected are the
residuals of the references, `FrameSolution.unknown2`, as in ``W``, and half of the predictive
variance of the forward model (decision 60). ``d_g^2`` is the mean squared residual in excess of the
first two. With ``a`` the motion of the rig over that of the performer, the standard deviation
is ::

    sigma_g = c_g sqrt(min(v_g (1 + chi2_g), max(v_g, tr(G_g V))) + (a d_g)^2 / 2)

``v_g``: tr(G_g D C D). ``V``: prior variance of bent weights far from the references, which bounds
the effect of chi2. The excess counts half, since markers that lie elsewhere on the skin than those
of the references have one without an error of the surface.

``c_g`` is calibrated on out-of-fold errors of the references, in folds blocked by take and time,
such that 90 % are within 1.645 sigma, as for a normal distribution. As few errors determine a
quantile poorly, its upper tolerance limit is used (Wilks 1941), and regions are shrunk towards the
constant of the face.

The errors are relative to the keys, to the corrected ones if keys have random errors or were not
set, plus the variance of the solve by the jackknife (`PairFolds.squared_errors`, decision 37).

Errors of the keys of one shape average out over the pairs that show it, to a factor g_s on its
motion that cross-validation shows only where these pairs are many::

    sigma_g^2 + sum_s var(g_s) w_s^2 G_gss,    var(g_s) = (tau^2 + tau_0^2) / n_s

``w``: weights of the frame. ``tau``: relative error of the keys, `ForwardScales.tau`. ``tau_0``:
`_LEAST_KEY_ERROR`. ``n_s = sum_n t_ns^2 / max_n t_ns^2``: effective number of pairs that show the
shape, with bent weights t.

Proposals that were not tuned have errors in common with takes solved by the rig's geometry, which
cross-validation does not show. These grow with motion (`poe bench untuned`), and are present in a
still face as well::

    sigma_g^2 + u^2 rho^2 (w' G_g w + M^2)

``u``: share of proposals among the references. ``M^2``: mean squared motion of the face over the
references. ``rho``: relative error of proposals, `_PROPOSAL_ERROR` a priori, updated by the changes
that tuning made.

The same holds for shapes that were left at 0 in most pairs (`unset_keys`). Their weights are
learned with the error that their correction leaves, of deviation v, `ForwardScales.unset`::

    sigma_g^2 + v^2 (sum_s G_gss) (w' G w / M^2 + 1) / 2
"""

from dataclasses import dataclass, field
from statistics import NormalDist

import numpy as np

from usdface.core.arrays import Arrays, BoolArray, FloatArray
from usdface.core.errors import InputError
from usdface.model.regressions.bent_weights import unbend
from usdface.model.regressions.forward_model import ForwardModel
from usdface.model.regressions.frame_solve import FrameSolution, FrameSolver

ERROR_PROBABILITY = 0.9
"""Probability of an error below `LIMIT_DEVIATIONS` times the uncertainty."""

LIMIT_DEVIATIONS = NormalDist().inv_cdf((1 + ERROR_PROBABILITY) / 2)
"""Standard deviations of the two-sided normal interval, 1.645."""

TOLERANCE_CONFIDENCE = 0.75
"""Confidence of upper limits in the calibration, as that at least `ERROR_PROBABILITY` of all errors
are below the tolerance limit. At .9, the limit of 25 references would be their largest error."""

_REGION_PRIOR_ERRORS = 20.0
"""Weight of the face's constant in a region's, as a number of errors: the .9 quantile of 20 errors
is as uncertain as the constants of regions differ."""

_CALIBRATION_RANGE = (1.0, 4.0)
"""Limits of ``c``. It never narrows the posterior: folds lack references that the mapping has, so
that their posteriors are wider than those of takes (decision 43)."""

_PREDICTED_SHARE = 0.5
"""Share of the forward model's predictive variance that residuals are expected to have: weights
follow the rest. Chosen among 0, 1/4, 1/2 and 1 (decision 60)."""

_UNEXPLAINED_SHARE = 0.5
"""Share of the excess ``(a d)^2`` that is an error of the surface. Chosen among 0, .3, .5 and 1
(decision 61)."""

_LEAST_KEY_ERROR = 0.06
"""Smallest relative error of the keys of one shape: animators set weights in such steps. Residuals
hardly show it where few pairs have the shape. Chosen on set-ups 0 to 39 of `poe bench
random_setups` (decision 51) and on the performers of `poe bench confidence` (decision 61)."""

_PROPOSAL_ERROR = 0.25
"""Prior of rho, error of proposals relative to the motion. Chosen on the performers of `poe bench
real_captures`, crosstake and the take with one side late; `poe bench untuned` validates it on
others."""

_LANDMARK_PROPOSAL_ERROR = 0.6
"""The same of landmarks detected in images, which show an expression differently from the skin: .69
and .6 of two rendered actors; .25 put 12 to 35 % of their frames within the limit for 90 %."""

_PROPOSAL_PRIOR_PAIRS = 5.0
"""Weight of the prior of rho, as a number of tuned pairs."""

_MIN_VARIANCE_MM2 = 1e-12
"""Keeps logarithms finite in regions without motion."""


@dataclass(frozen=True)
class UncertaintyModel:
    """Calibrated model of the uncertainty of solved frames."""

    grams: FloatArray
    """(regions, shapes, shapes): ``G`` for normalised weights [mm^2]."""
    calibration: FloatArray
    """(regions,): ``c``."""
    motion_scale: float = 1.0
    """``a``: residuals are as large as the performer's face, errors of the surface as the rig's. 1
    if unknown, and in mappings of earlier versions."""
    proposals: FloatArray = field(default_factory=lambda: np.zeros(2))
    """``(u rho)^2`` and ``M^2`` [mm^2]; zero in mappings of earlier versions."""

    @classmethod
    def from_arrays(cls, arrays: Arrays) -> "UncertaintyModel":
        """Rebuild the model from the arrays of a mapping.

        Raises
        ------
        InputError
            If an array is missing, or the motion scale is not a positive number.
        """
        scale = arrays.get("uncertainty_motion_scale", np.ones(1))
        missing = {"uncertainty_grams", "uncertainty_calibration"} - arrays.keys()
        if missing or scale.size != 1 or not 0 < scale.item() < np.inf:
            wrong = ", ".join(sorted(missing)) or "uncertainty_motion_scale"
            raise InputError(f"the mapping's array {wrong} is missing or wrong; train it again")
        return cls(
            arrays["uncertainty_grams"],
            arrays["uncertainty_calibration"],
            scale.item(),
            arrays.get("uncertainty_proposals", np.zeros(2)),
        )

    def to_arrays(self) -> Arrays:
        """Return the model as arrays of a mapping, the input of `from_arrays`."""
        return {
            "uncertainty_grams": self.grams,
            "uncertainty_calibration": self.calibration,
            "uncertainty_motion_scale": np.array([self.motion_scale]),
            "uncertainty_proposals": self.proposals,
        }

    def deviations(
        self, solver: FrameSolver, solution: FrameSolution, visible: BoolArray
    ) -> FloatArray:
        """Return ``sigma_g``: (frames, regions) [mm]; `visible` is (frames, markers)."""
        squared = (self.calibration * self.uncalibrated(solver, solution, visible)) ** 2
        weights = unbend(solution.targets, solver.forward.scales.curve)
        diagonals = np.einsum("rss->sr", self.grams)
        squared += weights**2 @ (_gain_variance(solver.forward)[:, None] * diagonals)
        if solver.forward.scales.unset:
            squared += _unset_variance(solver.forward, self.grams, weights)
        share2, mean_motion2 = self.proposals
        if share2:
            squared += share2 * (squared_motion(self.grams, weights) + mean_motion2)
        return np.asarray(np.sqrt(squared))

    def uncalibrated(
        self, solver: FrameSolver, solution: FrameSolution, visible: BoolArray
    ) -> FloatArray:
        """Return ``sigma_g / c_g`` of the solve: (frames, regions) [mm]."""
        if solution.hessian is None:
            squared = self._interpolated_variance(solver, solution)
        else:
            covariance = solution.covariance(solver.forward.scales.curve)
            packed = self.grams.reshape(len(self.grams), -1).astype(np.float32)
            squared = covariance.reshape(len(visible), -1) @ packed.T
        chi2, excess2 = self._residual_terms(solver, solution, visible)
        _, _, spread2, _ = solver.limiting_posteriors
        unknown = np.einsum("rss->rs", self.grams) @ spread2
        squared = np.minimum(squared * (1 + chi2), np.maximum(squared, unknown))
        squared += _UNEXPLAINED_SHARE * self.motion_scale**2 * excess2
        return np.asarray(np.sqrt(np.maximum(squared, 0.0)))

    def _interpolated_variance(self, solver: FrameSolver, solution: FrameSolution) -> FloatArray:
        """Return ``tr(G C)``, without D, for solutions without a Hessian: (frames, regions) [mm^2].

        Interpolated between the posteriors at the narrowest and the widest prior, linearly in the
        logarithm of the region's prior variance.
        """
        diagonals = np.einsum("rss->sr", self.grams)
        error2, narrow, spread2, wide = solver.limiting_posteriors
        priors = [np.log(each @ diagonals + _MIN_VARIANCE_MM2) for each in (error2, spread2)]
        posteriors = [
            np.log(np.einsum("rst,st->r", self.grams, each) + _MIN_VARIANCE_MM2)
            for each in (narrow, wide)
        ]
        prior = np.log((1 / solution.precision) @ diagonals + _MIN_VARIANCE_MM2)
        share = (prior - priors[0]) / np.maximum(priors[1] - priors[0], _MIN_VARIANCE_MM2)
        return np.asarray(np.exp(posteriors[0] + share * (posteriors[1] - posteriors[0])))

    def _residual_terms(
        self, solver: FrameSolver, solution: FrameSolution, visible: BoolArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return ``chi2_g`` and ``d_g^2`` [mm^2]: (frames, regions) each."""
        squared = (solution.residual.reshape(len(visible), -1, 3) ** 2).sum(axis=2)
        squared = np.maximum(squared, solution.unknown2)  # filled markers have the others' residual
        expected = 3 * solver.residual_variance + solution.unknown2
        predicted = expected + 3 * _PREDICTED_SHARE * solution.predictive
        weight = np.einsum("rss->rs", self.grams) @ solver.marker_share
        share = weight / np.maximum(visible @ weight.T, 1e-12)[:, :, None]
        chi2, excess2 = (
            np.einsum("frk,fk->fr", share, each * visible, optimize=True)
            for each in (squared / predicted, squared - expected)
        )
        return chi2, np.maximum(excess2, 0.0)


def _gain_variance(forward: ForwardModel) -> FloatArray:
    """Return ``var(g_s)`` of each shape: (shapes,)."""
    squared = forward.targets**2
    pairs = squared.sum(axis=0) / np.maximum(squared.max(axis=0), 1e-12)
    return np.asarray((forward.scales.tau**2 + _LEAST_KEY_ERROR**2) / np.maximum(pairs, 1.0))


def _unset_variance(forward: ForwardModel, grams: FloatArray, weights: FloatArray) -> FloatArray:
    """Return the variance by keys that were not set: (frames, regions) [mm^2]."""
    keys = unbend(forward.targets, forward.scales.curve)
    motion2, of_pairs2 = (squared_motion(grams[:1], each) for each in (weights, keys))
    growth = (motion2 / of_pairs2.mean() + 1) / 2
    return np.asarray(growth * forward.scales.unset**2 * np.einsum("rss->r", grams))


def squared_motion(grams: FloatArray, weights: FloatArray) -> FloatArray:
    """Return the mean squared displacement ``w' G w``: (frames, regions) [mm^2].

    Parameters
    ----------
    grams : (regions, shapes, shapes) float array
        [mm^2]
    weights : (frames, shapes) float array
        Normalised.
    """
    product = np.matmul(weights[None], grams)
    return np.asarray(np.maximum(np.einsum("rfs,fs->fr", product, weights), 0.0))


def proposal_error(
    grams: FloatArray,
    weights: FloatArray,
    tuned: BoolArray,
    proposals: FloatArray | None,
    *,
    landmarks: bool = False,
) -> FloatArray:
    """Return ``(u rho)^2`` and ``M^2`` [mm^2] of references that may include proposals.

    Parameters
    ----------
    grams : (regions, shapes, shapes) float array
        The whole face first [mm^2].
    weights : (pairs, shapes) float array
        Normalised.
    tuned : (pairs,) bool array
    proposals : (pairs, shapes) float array or None
        Proposed weights of every pair, normalised; None if unknown.
    landmarks : bool
        Whether the markers are landmarks detected in images.
    """
    motion2 = squared_motion(grams[:1], weights)[:, 0]
    prior = _PROPOSAL_PRIOR_PAIRS
    share2 = (_LANDMARK_PROPOSAL_ERROR if landmarks else _PROPOSAL_ERROR) ** 2
    if proposals is not None and motion2[tuned].any():
        changed2 = squared_motion(grams[:1], (weights - proposals)[tuned])[:, 0]
        measured2, count = changed2.sum() / motion2[tuned].sum(), int(tuned.sum())
        share2 = (prior * share2 + count * measured2) / (prior + count)
    return np.array([share2 * (1 - tuned.mean()) ** 2, motion2.mean()])


def calibrate_uncertainty(squared_errors: FloatArray, deviations: FloatArray) -> FloatArray:
    """Return ``c`` of each region, for which 90 % of the errors are within the limit: (regions,).

    Parameters
    ----------
    squared_errors : (pairs, regions) float array
        Out of fold [mm^2].
    deviations : (pairs, regions) float array
        Uncalibrated standard deviations of the same [mm].
    """
    ratios = np.sqrt(squared_errors) / np.maximum(deviations, 1e-9)
    limits = _tolerance_limits(ratios)
    needed = np.log(np.maximum(limits, 1e-6) / LIMIT_DEVIATIONS)
    share = len(ratios) / (len(ratios) + _REGION_PRIOR_ERRORS)
    return np.asarray(
        np.clip(np.exp(share * needed + (1 - share) * needed[0]), *_CALIBRATION_RANGE)
    )


def _tolerance_limits(sample: FloatArray) -> FloatArray:
    """Return the distribution-free upper tolerance limit of each column, an order statistic.

    The k-th smallest of n values exceeds the p-quantile with the probability that at most k - 1
    values are below it, which is binomial in n and p; k is interpolated.

    References
    ----------
    Wilks (1941), Annals of Mathematical Statistics 12(1), 91-96.
    """
    from scipy.special import bdtr  # only training needs SciPy: mapping starts faster without

    count = len(sample)
    below = bdtr(np.arange(count), count, ERROR_PROBABILITY)
    rank = np.interp(TOLERANCE_CONFIDENCE, below, np.arange(count))
    return np.asarray(np.quantile(sample, rank / max(count - 1, 1), axis=0))
