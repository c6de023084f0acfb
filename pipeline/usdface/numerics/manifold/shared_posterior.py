"""One posterior for many frames: what a whole take says of the hyper-parameters."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from usdface.core.arrays import FloatArray
from usdface.numerics.manifold.hybrid_monte_carlo import sample_chains
from usdface.numerics.manifold.laplace import LaplaceFit, fit_laplace
from usdface.numerics.manifold.tabulated_energy import SharedTable, TabulatedEnergy


@dataclass(frozen=True)
class SharedSamples:
    """Hyper-parameters of a take.

    Attributes
    ----------
    mode : (4,) float array
        The most probable theta.
    theta : (samples, 4) float array
    acceptance : float
    """

    mode: FloatArray
    theta: FloatArray
    acceptance: float


class PooledEnergy:
    """Energy of one theta under many rows of displacements at once; the prior counts once.

    Parameters
    ----------
    table : SharedTable
    displacements : (rows, N) float array
    chains : int
        Values of theta evaluated together.
    """

    def __init__(self, table: SharedTable, displacements: FloatArray, *, chains: int) -> None:
        self._rows = len(displacements)
        self._energy = TabulatedEnergy(table, np.tile(displacements, (chains, 1)))
        self._centre = table.spectrum.prior.centre[:, None]
        self._precision = np.array(table.spectrum.prior.spread)[:, None] ** -2.0

    def __call__(self, theta: Any, with_energy: bool = True) -> tuple[Any, Any]:
        """Return energies (chains,), or None, and gradients (4, chains)."""
        value, gradient = self._energy(np.repeat(theta, self._rows, axis=1), with_energy)
        away = theta - self._centre
        pull = away * self._precision * (self._rows - 1)
        total = gradient.reshape(4, -1, self._rows).sum(axis=2) - pull
        if value is None:
            return None, total
        return value.reshape(-1, self._rows).sum(axis=1) - 0.5 * (away * pull).sum(axis=0), total


def fit_shared_mode(table: SharedTable, displacements: FloatArray) -> LaplaceFit:
    """Find the most probable theta of all rows together."""
    start = table.spectrum.prior.centre[:, None].copy()
    energy = PooledEnergy(table, displacements, chains=1)
    with np.errstate(all="ignore"):
        return fit_laplace(energy, start, iterations=30)


def sample_shared(
    rng: np.random.Generator,
    table: SharedTable,
    displacements: FloatArray,
    *,
    burn: int = 40,
    keep: int = 200,
    chains: int = 4,
) -> SharedSamples:
    """Sample the posterior of all rows together.

    Parameters
    ----------
    rng : numpy.random.Generator
    table : SharedTable
    displacements : (rows, N) float array
        [mm]
    burn, keep : int
        `keep` over all chains.
    chains : int
    """
    fit = fit_shared_mode(table, displacements)
    spread = LaplaceFit(
        np.repeat(fit.mode, chains, axis=1),
        np.repeat(fit.energy, chains),
        np.repeat(fit.root, chains, axis=2),
        np.repeat(fit.inverse, chains, axis=2),
        np.repeat(fit.log_evidence, chains),
    )
    energy = PooledEnergy(table, displacements, chains=chains)
    with np.errstate(all="ignore"):
        samples = sample_chains(rng, energy, spread, burn=burn, keep=-(-keep // chains))
    theta = np.moveaxis(samples.places, 1, 2).reshape(-1, 4)[:keep]
    return SharedSamples(fit.mode[:, 0], theta, float(samples.acceptance.mean()))
