"""How large the error of a frame is likely to be, in each region of the face [mm].

Near the solve the posterior of a frame's bent weights is normal, with covariance (Laplace)::

    C = (J' R^-1 J + P)^-1          J: slope of the forward model, R, P: of `frame_solve`

so that the surface of region g, whose displacements have the Gram matrix ``G_g`` (mean dot products
over its points), is off by ``tr(G_g D C D)`` squared on average, D being the slope of unbending.
That knows how well the markers seen determine each shape, how far the frame is from the references
(P, R), and what only the rig says. It does not know what no weights explain: markers left over at
the solve, in variances that were expected of them, averaged over the markers that the region's
shapes move, are ``chi2_g``, and ``d_g^2`` is their mean square beyond what was expected: skin that
the solve leaves behind. The standard deviation of the region's surface is

    sigma_g = c_g sqrt(tr(G_g D C D) (1 + chi2_g) + d_g^2)

``c_g`` is calibrated on errors of references predicted by folds that have not seen them, of other
times or takes: nine in ten are to be within 1.645 sigma, as of a normal distribution. So few errors
do not fix a quantile, so that their upper tolerance limit is taken (Wilks 1941). A region with few
errors has the face's constant.
"""

from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from usdface.core.arrays import BoolArray, FloatArray, RealArray
from usdface.model.regressions.base import Arrays
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

_LEAST_MM2 = 1e-12
"""Variance of a region that nothing moves."""


@dataclass(frozen=True)
class UncertaintyModel:
    """What turns a solved frame into an uncertainty."""

    grams: FloatArray
    """(regions, shapes, shapes): of normalised weights [mm^2]."""
    calibration: FloatArray
    """(regions,): ``c``."""

    @classmethod
    def from_arrays(cls, arrays: Arrays) -> "UncertaintyModel":
        """Put a mapping's model together."""
        return cls(arrays["uncertainty_grams"], arrays["uncertainty_calibration"])

    def to_arrays(self) -> Arrays:
        """Return what `from_arrays` reads."""
        return {
            "uncertainty_grams": self.grams,
            "uncertainty_calibration": self.calibration,
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
        chi2, excess2 = self._unexplained(solver, solution.left, visible)
        squared = squared * (1 + chi2) + excess2
        return np.asarray(np.sqrt(np.maximum(squared, 0.0)) * self.calibration)

    def _shared_squared(self, solver: FrameSolver, solution: FrameSolution) -> FloatArray:
        """Return ``tr(G C)`` of rigs whose frames have no Hessian: (frames, regions).

        C is known at the narrowest and the widest prior; between them it is interpolated, the prior
        variance of the region telling where: both by their logarithms.
        """
        own = np.einsum("rss->sr", self.grams)
        error2, narrow, spread2, wide = solver.usual_posteriors
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
        expected = 3 * solver.residual2
        weight = np.einsum("rss->rs", self.grams) @ solver.marker_share
        share = weight / np.maximum(visible @ weight.T, 1e-12)[:, :, None]
        chi2, excess2 = (
            np.einsum("frk,fk->fr", share, each * visible, optimize=True)
            for each in (squared / expected, squared - expected)
        )
        return chi2, np.maximum(excess2, 0.0)


def calibrate_uncertainty(
    grams: FloatArray, errors: FloatArray, deviations: FloatArray, key_variance: FloatArray
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
    key_variance : (pairs, shapes) float array
        Of what the errors are measured from; adds to them.

    Returns
    -------
    (regions,) float array
    """
    squared = np.einsum("ns,rst,nt->nr", errors, grams, errors, optimize=True)
    squared -= key_variance @ np.einsum("rss->sr", grams)
    ratios = np.sqrt(np.maximum(squared, 0.0)) / np.maximum(deviations, 1e-9)
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
