"""Samples of the hyper-parameters of every chain: start, modes, chains."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from usdface.numerics.manifold.hybrid_monte_carlo import ChainSamples, Jumps, sample_chains
from usdface.numerics.manifold.laplace import Energy, LaplaceFit, fit_laplace
from usdface.numerics.manifold.tabulated_energy import SharedTable, TabulatedEnergy

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_APART = 2.5
"""In standard deviations of the nearer mode: closer modes are one."""

_RARE = 7.0
"""A mode e^7 times less likely than the other is left out."""


@dataclass(frozen=True)
class Modes:
    """The modes of every chain.

    Attributes
    ----------
    best : LaplaceFit
        The one with the more mass.
    second : LaplaceFit
        The other start's; only that of chains in `double` is a mode of its own.
    double : (chains,) bool array
        Chains with two: what moves may be signal or noise.
    """

    best: LaplaceFit
    second: LaplaceFit
    double: BoolArray


def find_modes(table: SharedTable, energy: Energy, displacements: Array) -> Modes:
    """Look for modes from two starts: all is signal, all is noise.

    Parameters
    ----------
    table : SharedTable
    energy : callable
        The energy of these displacements.
    displacements : (chains, N) float array
    """
    centre = table.spectrum.prior.centre
    power = np.maximum(displacements.var(axis=1), 1e-3)
    signal = np.repeat(centre[:, None], len(displacements), axis=1)
    noise = signal.copy()
    signal[0] = 0.5 * (centre[0] + np.log(power))
    noise[0], noise[1] = centre[0] - 3.0, np.log(power)
    with np.errstate(all="ignore"):  # a step too far overflows, and is not taken
        first, second = fit_laplace(energy, signal), fit_laplace(energy, noise)
    swap = second.log_evidence > first.log_evidence
    best, other = _choose(swap, second, first), _choose(swap, first, second)
    distance = np.stack([_distance(best, other), _distance(other, best)]).min(axis=0)
    likely = best.log_evidence - other.log_evidence < _RARE
    return Modes(best, other, (distance > _APART) & likely)


def sample_hyperparameters(
    rng: np.random.Generator,
    table: SharedTable,
    displacements: Array,
    *,
    burn: int = 40,
    keep: int = 200,
    modes: Modes | None = None,
) -> tuple[ChainSamples, Modes]:
    """Sample every chain's posterior: W06, eq. 3 and "200 sampled values".

    Parameters
    ----------
    rng : numpy.random.Generator
    table : SharedTable
    displacements : (chains, N) float array
        [mm]
    burn, keep : int
    modes : Modes, optional
        Known already.
    """
    energy = TabulatedEnergy(table, displacements)
    found = modes or find_modes(table, energy, displacements)
    # single precision errs by about 1e-4 of an energy, which acceptance does not notice
    single = np.zeros(1, np.float32)
    double = np.flatnonzero(found.double)
    jumps = None
    if len(double):
        jumps = Jumps(
            double,
            TabulatedEnergy(table, displacements[double], like=single),
            (_cast(_take(found.best, double)), _cast(_take(found.second, double))),
        )
    quick = TabulatedEnergy(table, displacements, like=single)
    with np.errstate(all="ignore"):  # a proposal that overflows is rejected
        samples = sample_chains(rng, quick, _cast(found.best), burn=burn, keep=keep, jumps=jumps)
    theta = samples.theta.astype(np.float64)
    return ChainSamples(theta, samples.acceptance, samples.step), found


def draw_laplace(rng: np.random.Generator, modes: Modes, *, keep: int) -> Array:
    """Draw from the Gaussian around the best mode instead of walking: (keep, 4, chains)."""
    drawn = rng.standard_normal((keep, *modes.best.mode.shape))
    out: Array = modes.best.mode + np.einsum("abc,kbc->kac", modes.best.root, drawn)
    return out


def _choose(which: BoolArray, yes: LaplaceFit, no: LaplaceFit) -> LaplaceFit:
    return LaplaceFit(
        np.where(which, yes.mode, no.mode),
        np.where(which, yes.energy, no.energy),
        np.where(which, yes.root, no.root),
        np.where(which, yes.log_evidence, no.log_evidence),
    )


def _cast(fit: LaplaceFit) -> LaplaceFit:
    """Single precision, and chains next to each other in memory: the inner loop reads them so."""
    return LaplaceFit(
        *(
            np.ascontiguousarray(part, np.float32)
            for part in (fit.mode, fit.energy, fit.root, fit.log_evidence)
        )
    )


def _take(fit: LaplaceFit, chains: NDArray[np.int64]) -> LaplaceFit:
    return LaplaceFit(
        fit.mode[:, chains],
        fit.energy[chains],
        fit.root[:, :, chains],
        fit.log_evidence[chains],
    )


def _distance(of: LaplaceFit, to: LaplaceFit) -> Array:
    root = np.moveaxis(of.root, 2, 0)
    white = np.linalg.solve(root, (to.mode - of.mode).T[:, :, None])[:, :, 0]
    out: Array = np.linalg.norm(white, axis=1)
    return out
