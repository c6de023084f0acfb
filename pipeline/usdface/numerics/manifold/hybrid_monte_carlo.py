"""Hybrid Monte Carlo (Duane et al., 1987) on many chains in lockstep: W06, section 4.1.

Every chain moves in coordinates whitened by its own Laplace fit, where its energy is nearly that of
the standard Gaussian. So a trajectory is split (Shahbaba, Lan, Johnson and Neal, 2014): the
Gaussian's part is followed exactly, which is a rotation of place and momentum into each other; what
the energy is beyond it kicks before and after. One gradient then makes a trajectory as long as is
best, where leapfrog steps need several; only how far the posterior is from Gaussian is ever
refused. Each chain finds its angle by dual averaging in the burn-in.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from usdface.numerics.array_namespace import CPU, ArrayDevice, namespace_of
from usdface.numerics.manifold.laplace import Energy, LaplaceFit

ACCEPTANCE = 0.7
"""Mean acceptance the angle is tuned to."""

FIRST_ANGLE = 1.9
"""A quarter of an orbit forgets where it began; a little more lands on the other side, and the
means of samples are better for it."""

_LONGEST, _SHORTEST = 2.2, 0.05
_DIFFUSE = 1.5  # standard deviations of the jumps' proposal over those of the Laplace fit


@dataclass(frozen=True)
class ChainState:
    """Where the chains are.

    Attributes
    ----------
    white : (4, chains) array
        In whitened coordinates.
    energy : (chains,) array
    residual : (4, chains) array
        Gradient of the energy beyond the Gaussian's.
    """

    white: Any
    energy: Any
    residual: Any


@dataclass(frozen=True)
class ChainSamples:
    """What was kept.

    Attributes
    ----------
    places : (kept, 4, chains) array
        In the coordinates that the energy takes.
    acceptance : (chains,) array
        Mean probability of acceptance of the steps kept.
    angle : (chains,) array
        The angle found.
    """

    places: Any
    acceptance: Any
    angle: Any


@dataclass(frozen=True)
class Jumps:
    """Chains whose posterior has two modes, which walking does not join.

    Attributes
    ----------
    chains : (n,) int array
        numpy's.
    energy : callable
        Of these chains alone.
    modes : (LaplaceFit, LaplaceFit)
        Of these chains alone.
    """

    chains: Any
    energy: Energy
    modes: tuple[LaplaceFit, LaplaceFit]


def start_chains(energy: Energy, fit: LaplaceFit, white: Any) -> ChainState:
    """Evaluate where chains are, or begin.

    Parameters
    ----------
    energy : callable
    fit : LaplaceFit
        Whitens; the mass matrix is the inverse of ``root @ root'``.
    white : (4, chains) array
    """
    xp = namespace_of(white)
    value, gradient = energy(fit.theta(white))
    return ChainState(white, value, xp.sum(fit.root * gradient[:, None, :], axis=0) - white)


def take_hmc_step(
    rng: np.random.Generator,
    state: ChainState,
    energy: Energy,
    fit: LaplaceFit,
    *,
    angle: Any,
    device: ArrayDevice = CPU,
) -> tuple[ChainState, Any]:
    """Throw every chain with a new momentum, follow it, accept or refuse.

    Parameters
    ----------
    rng : numpy.random.Generator
    state : ChainState
    energy : callable
    fit : LaplaceFit
    angle : (chains,) array
        By which place and momentum turn into each other [radians]; shaken by a tenth, against
        orbits that close.
    device : ArrayDevice
        Where the arrays are.

    Returns
    -------
    state : ChainState
    acceptance : (chains,) array
        Probability of acceptance.
    """
    xp = namespace_of(angle)
    chains = angle.shape[0]
    dtype = np.float32 if angle.dtype == xp.float32 else np.float64
    momentum = device.put(rng.standard_normal((4, chains), dtype=dtype))
    uniform = device.put(rng.random((2, chains), dtype=dtype))
    turn = angle * (0.9 + 0.2 * uniform[0, :])
    cosine, sine = xp.cos(turn), xp.sin(turn)
    kinetic = 0.5 * xp.sum(momentum * momentum, axis=0)
    pushed = momentum - 0.5 * turn * state.residual
    there = start_chains(energy, fit, cosine * state.white + sine * pushed)
    pushed = cosine * pushed - sine * state.white - 0.5 * turn * there.residual
    gained = state.energy + kinetic - there.energy - 0.5 * xp.sum(pushed * pushed, axis=0)
    return _accept(state, there, gained, uniform[1, :])


def sample_chains(
    rng: np.random.Generator,
    energy: Energy,
    laplace: LaplaceFit,
    *,
    burn: int = 40,
    keep: int = 200,
    jumps: Jumps | None = None,
    device: ArrayDevice = CPU,
) -> ChainSamples:
    """Run chains from a draw of their Laplace fit, tune in the burn-in, keep what follows.

    Parameters
    ----------
    rng : numpy.random.Generator
    energy : callable
    laplace : LaplaceFit
    burn, keep : int
    jumps : Jumps, optional
        In these chains every other step is followed by a proposal drawn from the Gaussians around
        both modes, accepted by Metropolis and Hastings' rule.
    device : ArrayDevice
        Where the arrays are.
    """
    xp = namespace_of(laplace.mode)
    drawn = rng.standard_normal(laplace.mode.shape)
    kind = "float32" if laplace.mode.dtype == xp.float32 else "float64"
    state = start_chains(energy, laplace, device.put(drawn, dtype=kind))
    angle = xp.full_like(state.energy, FIRST_ANGLE)
    bias, averaged = xp.zeros_like(angle), xp.zeros_like(angle)
    accepted, kept = xp.zeros_like(angle), []
    for index in range(burn + keep):
        state, acceptance = take_hmc_step(rng, state, energy, laplace, angle=angle, device=device)
        if jumps is not None and index % 2:
            state = _jump_some(rng, state, laplace, jumps, device)
        if index >= burn:
            accepted = accepted + acceptance
            kept.append(state.white)
            continue
        # Hoffman and Gelman (2014), eq. 6, around the first angle
        m = index + 1.0
        bias = bias + (ACCEPTANCE - acceptance - bias) / (m + 10.0)
        log_angle = math.log(1.2 * FIRST_ANGLE) - math.sqrt(m) / 0.5 * bias
        log_angle = xp.clip(log_angle, math.log(_SHORTEST), math.log(_LONGEST))
        weight = m**-0.75
        averaged = weight * log_angle + (1.0 - weight) * averaged
        angle = xp.exp(averaged if index == burn - 1 else log_angle)
    white = xp.stack(kept)
    rows = [laplace.mode[a, :] + xp.sum(laplace.root[a, :, :] * white, axis=1) for a in range(4)]
    return ChainSamples(xp.stack(rows, axis=1), accepted / keep, angle)


def _accept(
    before: ChainState, after: ChainState, gained: Any, uniform: Any
) -> tuple[ChainState, Any]:
    xp = namespace_of(gained)
    gained = xp.where(xp.isfinite(gained), gained, xp.full_like(gained, -50.0))
    acceptance = xp.exp(xp.clip(gained, -50.0, 0.0))
    taken = uniform < acceptance
    return ChainState(
        xp.where(taken, after.white, before.white),
        xp.where(taken, after.energy, before.energy),
        xp.where(taken, after.residual, before.residual),
    ), acceptance


def _jump_some(
    rng: np.random.Generator,
    state: ChainState,
    laplace: LaplaceFit,
    jumps: Jumps,
    device: ArrayDevice,
) -> ChainState:
    xp = namespace_of(state.white)
    some = device.put(jumps.chains)
    fit = take_chains(laplace, some)
    part = ChainState(
        xp.take(state.white, some, axis=1),
        xp.take(state.energy, some),
        xp.take(state.residual, some, axis=1),
    )
    moved = _jump(rng, part, fit, jumps, device)
    place = np.arange(state.energy.shape[0])
    place[jumps.chains] = len(place) + np.arange(len(jumps.chains))
    after = device.put(place)

    def merge(whole: Any, changed: Any) -> Any:
        return xp.take(xp.concat([whole, changed], axis=-1), after, axis=whole.ndim - 1)

    return ChainState(
        merge(state.white, moved.white),
        merge(state.energy, moved.energy),
        merge(state.residual, moved.residual),
    )


def _jump(
    rng: np.random.Generator,
    state: ChainState,
    fit: LaplaceFit,
    jumps: Jumps,
    device: ArrayDevice,
) -> ChainState:
    """Propose a draw of the mixture of two Gaussians, each as likely, whatever the state."""
    xp = namespace_of(state.white)
    chains = state.energy.shape[0]
    kind = "float32" if state.energy.dtype == xp.float32 else "float64"
    first = device.put(rng.random(chains) < 0.5)
    drawn = _DIFFUSE * device.put(rng.standard_normal((4, chains)), dtype=kind)
    one, other = jumps.modes
    theta = fit.theta(state.white)
    proposed = xp.where(first, one.theta(drawn), other.theta(drawn))
    there = start_chains(jumps.energy, fit, fit.whiten(proposed))
    gained = state.energy - there.energy
    gained = gained + _log_mixture(theta, jumps.modes) - _log_mixture(proposed, jumps.modes)
    return _accept(state, there, gained, device.put(rng.random(chains), dtype=kind))[0]


def _log_mixture(theta: Any, modes: tuple[LaplaceFit, LaplaceFit]) -> Any:
    xp = namespace_of(theta)
    logs = []
    for mode in modes:
        white = mode.whiten(theta) / _DIFFUSE
        log_spread = mode.log_evidence + mode.energy  # of the root's determinant
        logs.append(-0.5 * xp.sum(white * white, axis=0) - log_spread)
    return xp.logaddexp(logs[0], logs[1])


def take_chains(fit: LaplaceFit, chains: Any) -> LaplaceFit:
    """Return the fit of some chains, by their indices."""
    xp = namespace_of(fit.mode)
    return LaplaceFit(
        xp.take(fit.mode, chains, axis=1),
        xp.take(fit.energy, chains),
        xp.take(fit.root, chains, axis=2),
        xp.take(fit.inverse, chains, axis=2),
        xp.take(fit.log_evidence, chains),
    )
