"""Hybrid Monte Carlo (Duane et al., 1987) on many chains in lockstep: W06, section 4.1.

Every chain moves in coordinates whitened by its own Laplace fit, so that one number of leapfrog
steps suits all; each finds its step length by dual averaging in the burn-in.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from usdface.numerics.manifold.laplace import Energy, LaplaceFit

ACCEPTANCE = 0.8
"""Mean acceptance the step length is tuned to."""

FIRST_STEP = 0.85
"""In whitened coordinates: two or three make about a quarter of an orbit."""

_LONGEST, _SHORTEST = 1.4, 0.01
_DIFFUSE = 1.5  # standard deviations of the jumps' proposal over those of the Laplace fit


@dataclass(frozen=True)
class ChainState:
    """Where the chains are: theta (4, chains), their energies and gradients."""

    theta: Any
    energy: Any
    gradient: Any


@dataclass(frozen=True)
class ChainSamples:
    """What was kept.

    Attributes
    ----------
    theta : (kept, 4, chains) array
    acceptance : (chains,) array
        Mean probability of acceptance of the steps kept.
    step : (chains,) array
        The step length found.
    """

    theta: Any
    acceptance: Any
    step: Any


@dataclass(frozen=True)
class Jumps:
    """Chains whose posterior has two modes, which walking does not join.

    Attributes
    ----------
    chains : (n,) int array
    energy : callable
        Of these chains alone.
    modes : (LaplaceFit, LaplaceFit)
        Of these chains alone.
    """

    chains: Any
    energy: Energy
    modes: tuple[LaplaceFit, LaplaceFit]


def start_chains(energy: Energy, theta: Any) -> ChainState:
    """Evaluate where chains begin."""
    value, gradient = energy(theta)
    return ChainState(theta, value, gradient)


def take_hmc_step(
    rng: np.random.Generator,
    state: ChainState,
    energy: Energy,
    *,
    root: Any,
    step: Any,
    leapfrogs: int,
) -> tuple[ChainState, Any]:
    """Throw every chain with a new momentum, follow it, accept or refuse.

    Parameters
    ----------
    rng : numpy.random.Generator
    state : ChainState
    energy : callable
    root : (4, 4, chains) array
        Whitening; the mass matrix is the inverse of ``root @ root'``.
    step : (chains,) array
        In whitened coordinates; shaken by a fifth, against orbits that close.
    leapfrogs : int

    Returns
    -------
    state : ChainState
    acceptance : (chains,) array
        Probability of acceptance.
    """
    xp = root.__array_namespace__()
    chains = root.shape[2]
    dtype = np.float32 if root.dtype == xp.float32 else np.float64
    drawn = rng.standard_normal((4, chains), dtype=dtype)
    uniform = xp.asarray(rng.random((2, chains), dtype=dtype))
    momentum = xp.asarray(drawn)
    length = step * (0.8 + 0.4 * uniform[0, :])

    def push(by: Any, gradient: Any) -> Any:
        return by * xp.sum(root * gradient[:, None, :], axis=0)

    kinetic = 0.5 * xp.sum(momentum * momentum, axis=0)
    theta, gradient, value = state.theta, state.gradient, state.energy
    momentum = momentum - push(0.5 * length, gradient)
    for index in range(leapfrogs):
        last = index == leapfrogs - 1
        theta = theta + length * xp.sum(root * momentum[None, :, :], axis=1)
        value, gradient = energy(theta, with_energy=last)
        momentum = momentum - push(0.5 * length if last else length, gradient)
    lost = state.energy + kinetic - value - 0.5 * xp.sum(momentum * momentum, axis=0)
    lost = xp.where(xp.isfinite(lost), lost, xp.full_like(lost, -50.0))
    acceptance = xp.exp(xp.clip(lost, -50.0, 0.0))
    taken = uniform[1, :] < acceptance
    return ChainState(
        xp.where(taken, theta, state.theta),
        xp.where(taken, value, state.energy),
        xp.where(taken, gradient, state.gradient),
    ), acceptance


def sample_chains(
    rng: np.random.Generator,
    energy: Energy,
    laplace: LaplaceFit,
    *,
    burn: int = 40,
    keep: int = 200,
    leapfrogs: tuple[int, int] = (2, 3),
    jumps: Jumps | None = None,
) -> ChainSamples:
    """Run chains from a draw of their Laplace fit, tune in the burn-in, keep what follows.

    Parameters
    ----------
    rng : numpy.random.Generator
    energy : callable
    laplace : LaplaceFit
    burn, keep : int
    leapfrogs : (int, int)
        Least and most leapfrog steps of a trajectory, drawn for each.
    jumps : Jumps, optional
        In these chains every other step is followed by a proposal drawn from the Gaussians around
        both modes, accepted by Metropolis and Hastings' rule.
    """
    xp = laplace.mode.__array_namespace__()
    root = laplace.root
    drawn = xp.asarray(rng.standard_normal(laplace.mode.shape), dtype=root.dtype)
    state = start_chains(energy, laplace.mode + xp.sum(root * drawn[None, :, :], axis=1))
    step = xp.full_like(state.energy, FIRST_STEP)
    bias, averaged = xp.zeros_like(step), xp.zeros_like(step)
    accepted, kept = xp.zeros_like(step), []
    for index in range(burn + keep):
        count = int(rng.integers(leapfrogs[0], leapfrogs[1] + 1))
        state, acceptance = take_hmc_step(rng, state, energy, root=root, step=step, leapfrogs=count)
        if jumps is not None and index % 2:
            state = _jump_some(rng, state, jumps)
        if index >= burn:
            accepted = accepted + acceptance
            kept.append(state.theta)
            continue
        # Hoffman and Gelman (2014), eq. 6, around the first step
        m = index + 1.0
        bias = bias + (ACCEPTANCE - acceptance - bias) / (m + 10.0)
        log_step = math.log(1.2 * FIRST_STEP) - math.sqrt(m) / 0.5 * bias
        log_step = xp.clip(log_step, math.log(_SHORTEST), math.log(_LONGEST))
        weight = m**-0.75
        averaged = weight * log_step + (1.0 - weight) * averaged
        step = xp.exp(averaged if index == burn - 1 else log_step)
    return ChainSamples(xp.stack(kept), accepted / keep, step)


def _jump_some(rng: np.random.Generator, state: ChainState, jumps: Jumps) -> ChainState:
    xp = state.theta.__array_namespace__()
    some = jumps.chains
    part = ChainState(state.theta[:, some], state.energy[some], state.gradient[:, some])
    moved = _jump(rng, part, jumps.energy, jumps.modes)
    # the state before is kept as a sample: change copies
    whole = ChainState(
        xp.asarray(state.theta, copy=True),
        xp.asarray(state.energy, copy=True),
        xp.asarray(state.gradient, copy=True),
    )
    whole.theta[:, some], whole.gradient[:, some] = moved.theta, moved.gradient
    whole.energy[some] = moved.energy
    return whole


def _jump(
    rng: np.random.Generator,
    state: ChainState,
    energy: Energy,
    modes: tuple[LaplaceFit, LaplaceFit],
) -> ChainState:
    """Propose a draw of the mixture of two Gaussians, each as likely, whatever the state."""
    xp = state.theta.__array_namespace__()
    chains = state.theta.shape[1]
    first = xp.asarray(rng.random(chains) < 0.5)
    drawn = xp.asarray(rng.standard_normal((4, chains)), dtype=state.theta.dtype)
    mode = xp.where(first, modes[0].mode, modes[1].mode)
    root = xp.where(first, modes[0].root, modes[1].root)
    proposed = mode + _DIFFUSE * xp.sum(root * drawn[None, :, :], axis=1)
    value, gradient = energy(proposed)
    gain = state.energy - value
    gain = gain + _log_mixture(state.theta, modes) - _log_mixture(proposed, modes)
    gain = xp.where(xp.isfinite(gain), gain, xp.full_like(gain, -50.0))
    taken = xp.asarray(rng.random(chains), dtype=gain.dtype) < xp.exp(xp.clip(gain, -50.0, 0.0))
    return ChainState(
        xp.where(taken, proposed, state.theta),
        xp.where(taken, value, state.energy),
        xp.where(taken, gradient, state.gradient),
    )


def _log_mixture(theta: Any, modes: tuple[LaplaceFit, LaplaceFit]) -> Any:
    xp = theta.__array_namespace__()
    logs = []
    for mode in modes:
        root = xp.permute_dims(mode.root, (2, 0, 1))
        away = (theta - mode.mode).T[:, :, None]
        white = xp.linalg.solve(root, away)[:, :, 0] / _DIFFUSE
        logs.append(-0.5 * xp.sum(white * white, axis=1) - xp.log(xp.abs(xp.linalg.det(root))))
    return xp.logaddexp(logs[0], logs[1])
