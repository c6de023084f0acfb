"""Posterior samples of the hyper-parameters, per frame and axis or for a whole take."""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import BoolArray, FloatArray, RealArray
from usdface.numerics.manifold.hybrid_monte_carlo import (
    ModeJumps,
    RandomSource,
    effective_sample_size,
    sample_chains,
    split_rhat,
)
from usdface.numerics.manifold.hyper_posterior import (
    PhiEnergy,
    SharedTable,
    TabulatedEnergy,
    noise_gain,
    to_phi,
    to_theta,
)
from usdface.numerics.manifold.laplace import LaplaceFit, fit_laplace, select_fits

_LEAST_DISTANCE = 2.5
"""Between two distinct modes, in standard deviations of the Gaussian around either."""

_LARGEST_LOG_RATIO = 7.0
"""Of the evidence of two modes; beyond it the less probable one is ignored."""


@dataclass(frozen=True)
class Modes:
    """The modes of every chain."""

    best: LaplaceFit
    """The one with the larger evidence, in the coordinates phi of `hyper_posterior`."""
    second: LaplaceFit
    """That of the other start; a distinct mode in the chains of `double` alone."""
    double: BoolArray
    """(chains,): chains with two modes, in which motion is signal or noise."""


def find_modes(
    table: SharedTable, displacements: FloatArray, *, energy: TabulatedEnergy | None = None
) -> Modes:
    """Find modes from two starts: all motion is signal, all motion is noise.

    Parameters
    ----------
    displacements : (chains, N) float array
        [mm]
    energy : TabulatedEnergy, optional
        Of these displacements; in double precision by default.
    """
    centre = table.spectrum.prior.centre
    power = np.maximum(displacements.var(axis=1), 1e-3)
    signal = np.repeat(centre[:, None], len(displacements), axis=1)
    noise = signal.copy()
    signal[0] = 0.5 * (centre[0] + np.log(power))
    noise[0], noise[1] = centre[0] - 3.0, np.log(power)
    gain = noise_gain(table.spectrum)
    tabulated = energy or TabulatedEnergy(table, displacements)
    of_phi = PhiEnergy(tabulated, gain)
    with np.errstate(all="ignore"):  # steps that overflow are rejected
        first, second = (
            fit_laplace(of_phi, to_phi(start, gain).astype(tabulated.dtype))
            for start in (signal, noise)
        )
        swap = second.log_evidence > first.log_evidence
        best, other = select_fits(swap, second, first), select_fits(swap, first, second)
        distance = np.minimum(_distance(best, other), _distance(other, best))
        likely = best.log_evidence - other.log_evidence < _LARGEST_LOG_RATIO
    return Modes(best, other, (distance > _LEAST_DISTANCE) & likely)


def sample_hyperparameters(
    rng: RandomSource,
    table: SharedTable,
    displacements: FloatArray,
    *,
    burn: int = 40,
    keep: int = 200,
    modes: Modes | None = None,
) -> tuple[FloatArray, FloatArray, Modes]:
    """Sample every chain's posterior in single precision: W06, eq. 3 and "200 sampled values".

    Returns samples of ``log(v0, v1, a0, a1)`` and acceptance, see `sample_chains`, and the modes.

    Parameters
    ----------
    rng : Generator or CommonRandomNumbers
        With `CommonRandomNumbers`, chains of similar posteriors have similar errors, so that a
        mesh does not jitter from frame to frame.
    displacements : (chains, N) float array
        [mm]
    modes : Modes, optional
        In single precision, if known.
    """
    energy = TabulatedEnergy(table, displacements, dtype=np.float32)
    found = modes or find_modes(table, displacements, energy=energy)
    gain = noise_gain(table.spectrum)
    double = np.flatnonzero(found.double)
    jumps = None
    if len(double):
        of_double = TabulatedEnergy(table, displacements[double], dtype=np.float32)
        jumps = ModeJumps(
            double, PhiEnergy(of_double, gain), (found.best.take(double), found.second.take(double))
        )
    with np.errstate(all="ignore"):  # a proposal that overflows is rejected
        phi, acceptance = sample_chains(
            rng, PhiEnergy(energy, gain), found.best, burn=burn, keep=keep, jumps=jumps
        )
    theta = np.asarray(to_theta(np.moveaxis(phi, 1, 0), gain), np.float64)
    return np.moveaxis(theta, 0, 1), acceptance, found


def _distance(of: LaplaceFit, to: LaplaceFit) -> RealArray:
    white = of.whiten(to.mode)
    return np.asarray(np.sqrt(np.sum(white * white, axis=0)))


@dataclass(frozen=True)
class SharedSamples:
    """Samples of hyper-parameters that are common to all frames and axes of a take."""

    theta: FloatArray
    """(samples, 4)"""
    acceptance: float
    """Mean probability of acceptance after the burn-in."""
    effective_samples: float
    rhat: float
    """`effective_samples`, `rhat`: of all chains: medians over the hyper-parameters."""


_PRIOR_COUNTS = (1, 225, 1, 1)
"""Times that the priors of theta count in a take. The cameras' noise v1 is known to a fifteenth of
the spread for one frame: free, a jaw that opens between few markers is taken for their noise."""


class PooledEnergy:
    """The energy of one theta under many rows of displacements, with the prior `_PRIOR_COUNTS`.

    Parameters
    ----------
    displacements : (rows, N) float array
        [mm]
    chains : int
        Values of theta evaluated together.
    """

    def __init__(self, table: SharedTable, displacements: FloatArray, *, chains: int) -> None:
        self._rows = len(displacements)
        self._energy = TabulatedEnergy(table, np.tile(displacements, (chains, 1)))
        self._centre = table.spectrum.prior.centre[:, None]
        surplus = self._rows - np.array(_PRIOR_COUNTS)
        self._surplus = (surplus / np.square(table.spectrum.prior.spread))[:, None]

    def __call__(self, theta: RealArray) -> tuple[RealArray, RealArray]:
        """Return the energies (chains,) and gradients (4, chains)."""
        value, gradient = self._energy(np.repeat(theta, self._rows, axis=1))
        offset = theta - self._centre
        surplus = offset * self._surplus  # gradients of the prior that are too many
        total = gradient.reshape(4, -1, self._rows).sum(axis=2) - surplus
        energy = value.reshape(-1, self._rows).sum(axis=1) - 0.5 * (offset * surplus).sum(axis=0)
        return energy, total


def fit_shared_mode(table: SharedTable, displacements: FloatArray) -> LaplaceFit:
    """Find the most probable theta of all rows (rows, N) [mm] together."""
    start = table.spectrum.prior.centre[:, None].copy()
    energy = PooledEnergy(table, displacements, chains=1)
    with np.errstate(all="ignore"):
        return fit_laplace(energy, start, iterations=30)


_SHARED_CHAINS = 4
"""Run in lockstep from the same Laplace fit."""


def sample_shared(
    rng: np.random.Generator,
    table: SharedTable,
    displacements: FloatArray,
    *,
    burn: int = 40,
    keep: int = 200,
) -> SharedSamples:
    """Sample the posterior of all rows together.

    Parameters
    ----------
    displacements : (rows, N) float array
        [mm]
    burn, keep : int
        Burn-in of each chain; samples of all chains together.
    """
    fit = fit_shared_mode(table, displacements)
    energy = PooledEnergy(table, displacements, chains=_SHARED_CHAINS)
    start = fit.take(np.zeros(_SHARED_CHAINS, np.int64))
    with np.errstate(all="ignore"):
        theta, acceptance = sample_chains(
            rng, energy, start, burn=burn, keep=-(-keep // _SHARED_CHAINS)
        )
    each = np.moveaxis(theta, 1, 2)
    return SharedSamples(
        each.reshape(-1, 4)[:keep],
        float(acceptance.mean()),
        float(np.median(effective_sample_size(each))),
        float(np.median(split_rhat(each))),
    )
