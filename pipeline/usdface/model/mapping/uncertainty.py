"""How large the error of a frame is likely to be, in each region of the face [mm].

Near the solve the posterior of a frame's bent weights is normal, with covariance (Laplace)::

    C = (J' R^-1 J + P)^-1          J: slope of the forward model, R, P: of `frame_solve`

so that the surface of region g, whose displacements have the Gram matrix ``G_g`` (mean dot products
over its points), is off by ``tr(G_g D C D)`` squared on average, D being the slope of unbending.
Shapes of gaze and tongue have no share in G: no marker shows them, and they would hide the skin.
That knows how well the markers seen determine each shape, how far the frame is from the references
(P, R), and what only the rig says. It does not know what no weights explain: markers left over at
the solve, in variances that were expected of them, averaged over the markers that the region's
shapes move, are ``chi2_g``, and ``d_g^2`` is their mean square beyond what was expected: skin that
the solve leaves behind. The standard deviation of the region's surface is

    sigma_g = c_g sqrt(tr(G_g D C D) (1 + chi2_g) + d_g^2)

``c_g`` is calibrated on errors of references predicted by folds that have not seen them, of other
times or takes: nine in ten are to be within 1.645 sigma, as of a normal distribution. So few errors
do not fix a quantile, so that their upper tolerance limit is taken (Wilks 1941). A region with few
errors has the face's constant. Errors of the keys are in them, and stay: what keys err by and what
the forward model errs by are not told apart, and a solve that follows keys errs with them.

All this is measured against the references, and proposals that nobody tuned are wrong as a take is
wrong that is solved by the rig's geometry: together, so that no fold shows it. Their error grows
with motion (`poe bench untuned`), and a still face is not spared::

    sigma_g^2 + u^2 rho^2 (w' G_g w + M^2)

``u``: share of the references that are proposals; ``w``: the frame's weights; ``M^2``: mean square
motion of the face over the references. ``rho`` is `_PROPOSAL_ERROR` where nothing is tuned; with
tuned pairs it is learnt from what tuning changed.
"""

from dataclasses import dataclass, field
from statistics import NormalDist

import numpy as np

from usdface.core.arrays import BoolArray, FloatArray, RealArray
from usdface.model.regressions.base import Arrays, unbend
from usdface.model.regressions.frame_solve import FrameSolution, FrameSolver

ERROR_PROBABILITY = 0.9
"""That the error of a frame stays below `LIMIT_DEVIATIONS` of its uncertainty."""

LIMIT_DEVIATIONS = NormalDist().inv_cdf((1 + ERROR_PROBABILITY) / 2)

_TOLERANCE_CONFIDENCE = 0.75
"""That no less than `ERROR_PROBABILITY` of all errors are below the limit taken from a sample. With
0.9 it would be the largest error of 25 references, and verdicts would be of that one."""

_REGION_PRIOR_ERRORS = 20.0
"""Errors that the face's constant counts for beside a region's: of 20 errors, the quantile at .9 is
as uncertain as constants of regions differ."""

_CALIBRATION_RANGE = (0.5, 4.0)
"""Of ``c``: folds of few references say no more."""

_PROPOSAL_ERROR = 0.25
"""Of the motion: what proposals are off. Chosen on the performers of `poe bench real_captures`,
crosstake and the take with one side late; `poe bench untuned` judges it on others."""

_PROPOSAL_PRIOR_PAIRS = 5.0
"""Tuned pairs that `_PROPOSAL_ERROR` counts for beside what tuning changed."""

_LEAST_MM2 = 1e-12
"""Variance of a region that nothing moves."""


@dataclass(frozen=True)
class UncertaintyModel:
    """What turns a solved frame into an uncertainty."""

    grams: FloatArray
    """(regions, shapes, shapes): of normalised weights [mm^2]."""
    calibration: FloatArray
    """(regions,): ``c``."""
    proposals: FloatArray = field(default_factory=lambda: np.zeros(2))
    """``(u rho)^2``, ``M^2``; zeros of mappings of earlier versions."""

    @classmethod
    def from_arrays(cls, arrays: Arrays) -> "UncertaintyModel":
        """Put a mapping's model together."""
        return cls(
            arrays["uncertainty_grams"],
            arrays["uncertainty_calibration"],
            arrays.get("uncertainty_proposals", np.zeros(2)),
        )

    def to_arrays(self) -> Arrays:
        """Return what `from_arrays` reads."""
        return {
            "uncertainty_grams": self.grams,
            "uncertainty_calibration": self.calibration,
            "uncertainty_proposals": self.proposals,
        }

    def deviations(
        self, solver: FrameSolver, solution: FrameSolution, visible: BoolArray
    ) -> FloatArray:
        """Return the standard deviation of each region's surface: (frames, regions) [mm].

        Parameters
        ----------
        visible : (frames, markers) bool array
        """
        if solution.hessian is None:
            squared = self._shared_squared(solver, solution)
        else:
            covariance = solution.covariance(solver.forward.scales.curve)
            packed = self.grams.reshape(len(self.grams), -1).astype(np.float32)
            squared = covariance.reshape(len(visible), -1) @ packed.T
        chi2, excess2 = self._unexplained(solver, solution.residual, visible)
        squared = np.maximum(squared * (1 + chi2) + excess2, 0.0) * self.calibration**2
        share2, usual2 = self.proposals
        if share2:
            weights = unbend(solution.targets, solver.forward.scales.curve)
            squared = squared + share2 * (squared_motion(self.grams, weights) + usual2)
        return np.asarray(np.sqrt(squared))

    def _shared_squared(self, solver: FrameSolver, solution: FrameSolution) -> FloatArray:
        """Return ``tr(G C)`` of rigs whose frames have no Hessian: (frames, regions).

        C is known at the narrowest and the widest prior; between them it is interpolated, the prior
        variance of the region telling where: both by their logarithms.
        """
        own = np.einsum("rss->sr", self.grams)
        error2, narrow, spread2, wide = solver.limiting_posteriors
        priors = [np.log(each @ own + _LEAST_MM2) for each in (error2, spread2)]
        posteriors = [
            np.log(np.einsum("rst,st->r", self.grams, each) + _LEAST_MM2) for each in (narrow, wide)
        ]
        now = np.log((1 / solution.precision) @ own + _LEAST_MM2)
        share = (now - priors[0]) / np.maximum(priors[1] - priors[0], _LEAST_MM2)
        return np.asarray(np.exp(posteriors[0] + share * (posteriors[1] - posteriors[0])))

    def _unexplained(
        self, solver: FrameSolver, left: RealArray, visible: BoolArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return ``chi2_g`` and ``d_g^2`` [mm^2]: (frames, regions) each."""
        squared = (left.reshape(len(left), -1, 3) ** 2).sum(axis=2)
        expected = 3 * solver.residual_variance
        weight = np.einsum("rss->rs", self.grams) @ solver.marker_share
        share = weight / np.maximum(visible @ weight.T, 1e-12)[:, :, None]
        chi2, excess2 = (
            np.einsum("frk,fk->fr", share, each * visible, optimize=True)
            for each in (squared / expected, squared - expected)
        )
        return chi2, np.maximum(excess2, 0.0)


def squared_motion(grams: FloatArray, weights: FloatArray) -> FloatArray:
    """Return the mean square displacement of each region: (frames, regions) [mm^2].

    Parameters
    ----------
    grams : (regions, shapes, shapes) float array
        [mm^2]
    weights : (frames, shapes) float array
        Normalised.
    """
    moved = np.matmul(weights[None], grams)
    return np.asarray(np.maximum(np.einsum("rfs,fs->fr", moved, weights), 0.0))


def proposal_error(
    grams: FloatArray, weights: FloatArray, tuned: BoolArray, proposals: FloatArray | None
) -> FloatArray:
    """Return ``(u rho)^2`` and ``M^2`` [mm^2] of references of which some are proposals.

    Parameters
    ----------
    grams : (regions, shapes, shapes) float array
        The whole face first [mm^2].
    weights : (pairs, shapes) float array
        Normalised.
    tuned : (pairs,) bool array
    proposals : (pairs, shapes) float array or None
        What was proposed for every pair, normalised; None where that is not known.
    """
    motion2 = squared_motion(grams[:1], weights)[:, 0]
    prior, share2 = _PROPOSAL_PRIOR_PAIRS, _PROPOSAL_ERROR**2
    if proposals is not None and motion2[tuned].any():
        changed2 = squared_motion(grams[:1], (weights - proposals)[tuned])[:, 0]
        shown2, count = changed2.sum() / motion2[tuned].sum(), int(tuned.sum())
        share2 = (prior * share2 + count * shown2) / (prior + count)
    return np.array([share2 * (1 - tuned.mean()) ** 2, motion2.mean()])


def calibrate_uncertainty(
    grams: FloatArray, errors: FloatArray, deviations: FloatArray
) -> FloatArray:
    """Return the constant of each region under which nine of ten errors are within the limit.

    Parameters
    ----------
    grams : (regions, shapes, shapes) float array
        [mm^2]
    errors : (pairs, shapes) float array
        Normalised, of pairs that the prediction had not seen.
    deviations : (pairs, regions) float array
        Uncalibrated, of the same [mm].

    Returns
    -------
    (regions,) float array
    """
    squared = np.einsum("ns,rst,nt->nr", errors, grams, errors, optimize=True)
    ratios = np.sqrt(squared) / np.maximum(deviations, 1e-9)
    limits = _tolerance_limits(ratios)
    needed = np.log(np.maximum(limits, 1e-6) / LIMIT_DEVIATIONS)
    share = len(errors) / (len(errors) + _REGION_PRIOR_ERRORS)
    return np.asarray(
        np.clip(np.exp(share * needed + (1 - share) * needed[0]), *_CALIBRATION_RANGE)
    )


def _tolerance_limits(sample: FloatArray) -> FloatArray:
    """Return the upper tolerance limit of each column: an order statistic, of any distribution.

    Of n values the k-th smallest exceeds the quantile p with the probability that at most k - 1
    of them are below it, binomial in n and p; between two of them it is interpolated.

    References
    ----------
    Wilks (1941), Annals of Mathematical Statistics 12(1), 91-96.
    """
    from scipy.special import bdtr  # only training calibrates: a chunk of mapping starts without

    count = len(sample)
    below = bdtr(np.arange(count), count, ERROR_PROBABILITY)
    rank = np.interp(_TOLERANCE_CONFIDENCE, below, np.arange(count))
    return np.asarray(np.quantile(sample, rank / max(count - 1, 1), axis=0))
