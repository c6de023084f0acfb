"""The posterior's energy from tables: no sum over markers is left in the sampler's inner loop.

All sums of `hyper_posterior` are functions of one variable x for each chain. They and their
slopes are tabulated on nodes once (one matrix product for all chains) and read by cubic Hermite
interpolation, whose own derivative is the gradient: leapfrog steps conserve what is tabulated.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usdface.numerics.manifold.hyper_posterior import (
    PAIRS,
    MarkerSpectrum,
    Moments,
    energy_of_moments,
)

Array = NDArray[np.float64]

SPACING = 0.125
"""Of the nodes in x. Cubic interpolation errs by about 1e-7 of a sum's size."""

REACH = 6.0
"""Prior standard deviations of x on either side of its centre that the table covers."""


class SharedTable:
    """What all chains of a mesh share, tabulated once.

    Parameters
    ----------
    spectrum : MarkerSpectrum
    spacing : float
    """

    def __init__(self, spectrum: MarkerSpectrum, *, spacing: float = SPACING) -> None:
        self.spectrum = spectrum
        self.spacing = spacing
        centre, spread = spectrum.prior.centre, spectrum.prior.spread
        half = REACH * math.hypot(spread[0], spread[1])
        self.start = float(centre[0] - centre[1]) - half
        self.nodes = int(2 * half / spacing) + 2
        x = self.start + spacing * np.arange(self.nodes)
        P = spectrum.trend
        R = 1.0 / (1.0 + np.exp(x)[:, None] * spectrum.values)
        steep = spacing * R * (R - 1.0)
        products = np.stack([P[:, i] * P[:, j] for i, j in PAIRS], axis=1)
        logs = -np.log(R).sum(axis=1, keepdims=True)
        slopes = spacing * (1.0 - R).sum(axis=1, keepdims=True)
        self.table: Array = np.concatenate([R @ products, logs, steep @ products, slopes], axis=1)
        linear = np.stack([R.T[:, :, None] * P[:, None], steep.T[:, :, None] * P[:, None]], axis=2)
        self._linear: Array = linear.reshape(len(P), -1)
        self._square: Array = np.stack([R.T, steep.T], axis=2).reshape(len(P), -1)

    def own_table(self, rotated: Array) -> Array:
        """Tabulate the chains' own sums: (chains, nodes, 10), values then slopes times spacing."""
        chains = len(rotated)
        linear = (rotated @ self._linear).reshape(chains, self.nodes, 2, 4)
        square = (rotated**2 @ self._square).reshape(chains, self.nodes, 2, 1)
        return np.concatenate([linear, square], axis=3).reshape(chains, self.nodes, 10)


class TabulatedEnergy:
    """U and its gradient for a batch of chains: call it with theta of shape (4, chains).

    Parameters
    ----------
    shared : SharedTable
    displacements : (chains, N) float array
        t [mm], one channel of one frame in each row.
    like : array, optional
        The result's kind and place: tables are converted to its namespace and data type.
    """

    def __init__(self, shared: SharedTable, displacements: Array, *, like: Any = None) -> None:
        anchor = np.zeros(1) if like is None else like
        self.namespace = xp = anchor.__array_namespace__()
        self.chains = len(displacements)
        self.count = len(shared.spectrum.values)
        self._start, self._spacing, self._nodes = shared.start, shared.spacing, shared.nodes
        own = shared.own_table(displacements @ shared.spectrum.vectors)

        def convert(values: Any) -> Any:
            return xp.asarray(values, dtype=anchor.dtype)

        self._own = convert(own.reshape(-1, 10))
        self._shared = convert(shared.table)
        self._row = xp.arange(self.chains) * self._nodes
        self._centre = convert(shared.spectrum.prior.centre[:, None])
        self._precision = convert(np.array(shared.spectrum.prior.spread)[:, None] ** -2.0)

    def __call__(self, theta: Any, with_energy: bool = True) -> tuple[Any, Any]:
        """Return the energies (chains,), or None, and gradients (4, chains)."""
        moments = self._moments(theta[0, :] - theta[1, :])
        return energy_of_moments(
            theta,
            moments,
            count=self.count,
            centre=self._centre,
            precision=self._precision,
            with_energy=with_energy,
        )

    def _moments(self, x: Any) -> Moments:
        xp = self.namespace
        place = (x - self._start) / self._spacing
        outside = ~((place > 0) & (place < self._nodes - 1.001))
        place = xp.where(outside, xp.zeros_like(place), place)
        node = xp.astype(place, xp.int64)
        t = place - xp.astype(node, place.dtype)
        square = t * t
        cube = square * t
        h01 = 3.0 * square - 2.0 * cube
        h11 = cube - square
        h10 = h11 - square + t
        k = 1.0 / self._spacing
        k01 = (6.0 * k) * (t - square)
        k11 = k * (3.0 * square - 2.0 * t)
        k10 = k11 - k * (2.0 * t - 1.0)

        def read(table: Any, row: Any, columns: int) -> tuple[Any, Any]:
            # copied into rows of chains: what follows then reads memory in order
            size = (2 * columns, -1)
            near = xp.reshape(xp.take(table, row, axis=0).T, size, copy=True)
            far = xp.reshape(xp.take(table, row + 1, axis=0).T, size, copy=True)
            first, step = near[:columns, :], far[:columns, :] - near[:columns, :]
            leave, arrive = near[columns:, :], far[columns:, :]
            values = first + h01 * step + h10 * leave + h11 * arrive
            return values, k01 * step + k10 * leave + k11 * arrive

        own, own_slope = read(self._own, self._row + node, 5)
        shared, shared_slope = read(self._shared, node, 11)
        return Moments(shared, own, shared_slope, own_slope, outside)
