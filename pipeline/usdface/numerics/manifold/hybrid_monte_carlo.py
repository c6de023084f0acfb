"""Hybrid Monte Carlo (Duane et al., 1987) on many chains in lockstep: W06, section 4.1.

Every chain moves in coordinates whitened by its Laplace fit, in which its energy is nearly that of
the standard Gaussian. The Hamiltonian is split (Shahbaba, Lan, Johnson and Neal, 2014): the
Gaussian part is integrated exactly, as a rotation of position and momentum, and the gradient of the
remaining energy changes the momentum before and after. A trajectory of optimal length then takes
one gradient, and only deviations from the Gaussian lead to rejections. Each chain tunes its angle
by dual averaging in the burn-in.

Mixing is measured by split R-hat and effective sample size (Gelman et al., *Bayesian Data
Analysis*, 3rd ed., 2013, section 11.4-11.5).
"""

import math
from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import FloatArray, IntArray, RealArray
from usdface.numerics.manifold.laplace import Energy, LaplaceFit

TARGET_ACCEPTANCE = 0.7
"""Target of the mean probability of acceptance [0-1]."""

FIRST_ANGLE = 1.9
"""Initial rotation of a step [radians]: a little beyond pi / 2, at which successive positions are
independent; beyond it they are anticorrelated, which reduces the error of means."""

_LARGEST_ANGLE, _SMALLEST_ANGLE = 2.2, 0.05
_PROPOSAL_WIDTH = 1.5
"""Standard deviations of a jump's proposal over those of the Laplace fits."""


@dataclass(frozen=True)
class ChainState:
    """The state of every chain."""

    white: RealArray
    """(4, chains): position in whitened coordinates."""
    energy: RealArray
    """(chains,): at that position."""
    residual: RealArray
    """(4, chains): gradient of the energy minus that of the Gaussian."""


class CommonRandomNumbers:
    """A generator whose numbers are the same for all chains, which are the last axis."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng

    def standard_normal(self, shape: tuple[int, ...], dtype: type = np.float64) -> RealArray:
        """Return standard normal numbers (..., chains)."""
        drawn: RealArray = self._rng.standard_normal((*shape[:-1], 1), dtype=dtype)
        return np.broadcast_to(drawn, shape)

    def random(self, shape: tuple[int, ...], dtype: type = np.float64) -> RealArray:
        """Return numbers (..., chains) in [0-1)."""
        drawn: RealArray = self._rng.random((*shape[:-1], 1), dtype=dtype)
        return np.broadcast_to(drawn, shape)


RandomSource = np.random.Generator | CommonRandomNumbers


@dataclass(frozen=True)
class ModeJumps:
    """The chains whose posterior has two separate modes."""

    chains: IntArray
    """(n,): their indices."""
    energy: Energy
    """Of these chains alone."""
    modes: tuple[LaplaceFit, LaplaceFit]
    """Of these chains alone."""


def chain_states(energy: Energy, fit: LaplaceFit, white: RealArray) -> ChainState:
    """Evaluate the energy at whitened positions (4, chains) of `fit`."""
    value, gradient = energy(fit.theta(white))
    return ChainState(white, value, np.sum(fit.root * gradient[:, None], axis=0) - white)


def take_hmc_step(
    rng: RandomSource, state: ChainState, energy: Energy, fit: LaplaceFit, *, angle: RealArray
) -> tuple[ChainState, RealArray]:
    """Take one step of split Hamiltonian Monte Carlo in every chain.

    Parameters
    ----------
    fit : LaplaceFit
        The mass matrix is the inverse of ``root @ root'``.
    angle : (chains,) array
        Rotation of position and momentum [radians]; multiplied by a random factor of 0.9 to 1.1,
        against periodic orbits.

    Returns
    -------
    state : ChainState
    acceptance : (chains,) array
        Probability of acceptance.
    """
    dtype = np.float32 if angle.dtype == np.float32 else np.float64
    momentum = rng.standard_normal((4, len(angle)), dtype=dtype)
    uniform = rng.random((2, len(angle)), dtype=dtype)
    turn = angle * (0.9 + 0.2 * uniform[0])
    cosine, sine = np.cos(turn), np.sin(turn)
    kinetic = 0.5 * np.sum(momentum * momentum, axis=0)
    pushed = momentum - 0.5 * turn * state.residual
    proposed = chain_states(energy, fit, cosine * state.white + sine * pushed)
    pushed = cosine * pushed - sine * state.white - 0.5 * turn * proposed.residual
    gained = state.energy + kinetic - proposed.energy - 0.5 * np.sum(pushed * pushed, axis=0)
    return _accept(state, proposed, gained, uniform[1])


def sample_chains(
    rng: RandomSource,
    energy: Energy,
    laplace: LaplaceFit,
    *,
    burn: int = 40,
    keep: int = 200,
    jumps: ModeJumps | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Run chains from a draw of their Laplace fit.

    Returns (samples, 4, chains) samples after the burn-in, in the coordinates that the energy
    takes, and their (chains,) mean probability of acceptance.

    Parameters
    ----------
    burn, keep : int
        Steps in which the angle is tuned, and steps that are returned.
    jumps : ModeJumps, optional
        In these chains every other step is followed by a Metropolis-Hastings step with proposals
        from the Gaussians around both modes.
    """
    drawn = rng.standard_normal(laplace.mode.shape)
    state = chain_states(energy, laplace, drawn.astype(laplace.mode.dtype))
    angle = np.full_like(state.energy, FIRST_ANGLE)
    bias, averaged, accepted = np.zeros_like(angle), np.zeros_like(angle), np.zeros_like(angle)
    samples = []
    for index in range(burn + keep):
        state, acceptance = take_hmc_step(rng, state, energy, laplace, angle=angle)
        if jumps is not None and index % 2:
            state = _jump_between_modes(rng, state, laplace, jumps)
        if index >= burn:
            accepted = accepted + acceptance
            samples.append(laplace.theta(state.white))
            continue
        # Hoffman and Gelman (2014), eq. 6, around the first angle
        m = index + 1.0
        bias = bias + (TARGET_ACCEPTANCE - acceptance - bias) / (m + 10.0)
        log_angle = math.log(1.2 * FIRST_ANGLE) - math.sqrt(m) / 0.5 * bias
        log_angle = np.clip(log_angle, math.log(_SMALLEST_ANGLE), math.log(_LARGEST_ANGLE))
        weight = m**-0.75
        averaged = weight * log_angle + (1.0 - weight) * averaged
        angle = np.exp(averaged if index == burn - 1 else log_angle)
    return np.stack(samples, dtype=np.float64), accepted.astype(np.float64) / keep


def split_rhat(samples: FloatArray) -> FloatArray:
    """Return split R-hat, from variances between and within halves of chains: 1 if mixed.

    Parameters
    ----------
    samples : (draws, chains, ...) float array
        Chains of the same posterior.
    """
    half = len(samples) // 2
    halves = np.concatenate([samples[:half], samples[half : 2 * half]], axis=1)
    within = halves.var(axis=0, ddof=1).mean(axis=0)
    between = halves.mean(axis=0).var(axis=0, ddof=1)
    return np.asarray(np.sqrt((half - 1) / half + between / np.maximum(within, 1e-300)))


def effective_sample_size(samples: FloatArray) -> FloatArray:
    """Return the number of independent draws with the same variance of the mean, at most all.

    By the initial positive sequence estimator of Geyer (1992).

    Parameters
    ----------
    samples : (draws, chains, ...) float array
        Chains of the same posterior.
    """
    draws, chains = samples.shape[:2]
    centred = samples - samples.mean(axis=0)
    spectrum = np.fft.rfft(centred, 2 * draws, axis=0)
    products = np.fft.irfft(spectrum * spectrum.conj(), axis=0)[:draws].mean(axis=1) / draws
    within = samples.var(axis=0, ddof=1).mean(axis=0)
    total = (draws - 1) / draws * within
    if chains > 1:
        total = total + samples.mean(axis=0).var(axis=0, ddof=1)
    total = np.maximum(total, 1e-300)
    correlation = 1.0 - (within - products) / total
    pairs = correlation[0:-1:2] + correlation[1::2]
    positive = np.logical_and.accumulate(pairs > 0, axis=0)
    time = 2.0 * np.where(positive, pairs, 0.0).sum(axis=0) - 1.0
    return np.asarray(draws * chains / np.maximum(time, 1.0), np.float64)


def _accept(
    before: ChainState, after: ChainState, gained: RealArray, uniform: RealArray
) -> tuple[ChainState, RealArray]:
    """Accept with probability ``min(1, exp(gained))``."""
    gained = np.where(np.isfinite(gained), gained, np.full_like(gained, -50.0))
    acceptance: RealArray = np.exp(np.clip(gained, -50.0, 0.0))
    accepted = uniform < acceptance
    return ChainState(
        np.where(accepted, after.white, before.white),
        np.where(accepted, after.energy, before.energy),
        np.where(accepted, after.residual, before.residual),
    ), acceptance


def _jump_between_modes(
    rng: RandomSource, state: ChainState, laplace: LaplaceFit, jumps: ModeJumps
) -> ChainState:
    """Propose a jump in the chains of `jumps`."""
    some = jumps.chains
    before = ChainState(state.white[:, some], np.take(state.energy, some), state.residual[:, some])
    # Proposals are draws of the equal mixture of two Gaussians, independent of the state.
    fit = laplace.take(some)
    chains = len(before.energy)
    first = rng.random((chains,)) < 0.5
    drawn = _PROPOSAL_WIDTH * rng.standard_normal((4, chains)).astype(before.energy.dtype)
    one, other = jumps.modes
    theta = fit.theta(before.white)
    target = np.where(first, one.theta(drawn), other.theta(drawn))
    proposed = chain_states(jumps.energy, fit, fit.whiten(target))
    gained = before.energy - proposed.energy
    gained = gained + _log_mixture(theta, jumps.modes) - _log_mixture(target, jumps.modes)
    after = _accept(before, proposed, gained, rng.random((chains,)).astype(before.energy.dtype))[0]
    white, energy, residual = state.white.copy(), state.energy.copy(), state.residual.copy()
    white[:, some], energy[some], residual[:, some] = after.white, after.energy, after.residual
    return ChainState(white, energy, residual)


def _log_mixture(theta: RealArray, modes: tuple[LaplaceFit, LaplaceFit]) -> RealArray:
    """Return the log density of the proposals of `_jump_between_modes`, up to a constant."""
    logs = []
    for mode in modes:
        white = mode.whiten(theta) / _PROPOSAL_WIDTH
        log_determinant = mode.log_evidence + mode.energy  # of the root
        logs.append(-0.5 * np.sum(white * white, axis=0) - log_determinant)
    return np.asarray(np.logaddexp(logs[0], logs[1]))
