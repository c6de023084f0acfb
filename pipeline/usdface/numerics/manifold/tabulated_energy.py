"""The posterior's energy from tables: no sum over markers is left in the sampler's inner loop.

All sums of `hyper_posterior` are functions of one variable x for each chain. They and their
slopes are tabulated on nodes once (one matrix product for all chains) and read by cubic Hermite
interpolation, whose own derivative is the gradient: trajectories conserve what is tabulated.
"""

import math
from typing import Any, Literal

import numpy as np

from usdface.core.arrays import RealArray
from usdface.numerics.array_namespace import CPU, ArrayDevice
from usdface.numerics.manifold.hyper_posterior import (
    PAIRS,
    MarkerSpectrum,
    PosteriorMoments,
    energy_of_moments,
)

Precision = Literal["float32", "float64"]

SPACING = 0.125
"""Of the nodes in x. Cubic interpolation errs by about 1e-7 of a sum's size."""

_REACH = 6.0
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
        half = _REACH * math.hypot(spread[0], spread[1])
        self.start = float(centre[0] - centre[1]) - half
        self.nodes = int(2 * half / spacing) + 2
        x = self.start + spacing * np.arange(self.nodes)
        P = spectrum.trend
        R = 1.0 / (1.0 + np.exp(x)[:, None] * spectrum.values)
        steep = spacing * R * (R - 1.0)
        products = np.stack([P[:, i] * P[:, j] for i, j in PAIRS], axis=1)
        logs = -np.log(R).sum(axis=1, keepdims=True)
        slopes = spacing * (1.0 - R).sum(axis=1, keepdims=True)
        whole = np.concatenate([R @ products, logs, steep @ products, slopes], axis=1)
        self.table: RealArray = _cubics(whole[None])[0]
        linear = np.concatenate([R.T[:, :, None] * P[:, None], steep.T[:, :, None] * P[:, None]], 2)
        self.linear: RealArray = _cubics(linear).reshape(len(P), -1)
        self.square: RealArray = _cubics(np.stack([R.T, steep.T], axis=2)).reshape(len(P), -1)


def _cubics(nodes: RealArray) -> RealArray:
    """Turn values and slopes at nodes into each interval's cubic.

    Parameters
    ----------
    nodes : (chains, nodes, 2 k) float array
        Values, then slopes times the spacing.

    Returns
    -------
    (chains, nodes, 4 k) float array
        Coefficients of 1, t, t^2, t^3 with t from 0 to 1 on the way to the next node; those of
        the last node are of no use.
    """
    half = nodes.shape[2] // 2
    out = np.zeros((*nodes.shape[:2], 4, half))
    value, slope = nodes[..., :half], nodes[..., half:]
    rise = value[:, 1:] - value[:, :-1]
    out[:, :, 0], out[:, :, 1] = value, slope
    out[:, :-1, 2] = 3.0 * rise - 2.0 * slope[:, :-1] - slope[:, 1:]
    out[:, :-1, 3] = slope[:, :-1] + slope[:, 1:] - 2.0 * rise
    return out.reshape(*nodes.shape[:2], 4 * half)


class TabulatedEnergy:
    """U and its gradient for a batch of chains: call it with theta of shape (4, chains).

    Parameters
    ----------
    shared : SharedTable
    displacements : (chains, N) float array
        t [mm], one channel of one frame in each row.
    device : ArrayDevice
        Where tables are kept and theta comes from.
    dtype : {'float64', 'float32'}
        Of tables and theta. Single precision errs by about 1e-4 of an energy, which acceptance does
        not notice.
    """

    def __init__(
        self,
        shared: SharedTable,
        displacements: RealArray,
        *,
        device: ArrayDevice = CPU,
        dtype: Precision = "float64",
    ) -> None:
        def put(values: RealArray) -> Any:
            return device.put(values, dtype=dtype)

        self.namespace = xp = device.namespace
        self.chains = len(displacements)
        self.count = len(shared.spectrum.values)
        self._start, self._spacing, self._nodes = shared.start, shared.spacing, shared.nodes
        rotated = put(displacements @ shared.spectrum.vectors)
        # the cubics' coefficients for b and for c, a row for each node of each chain
        self._linear = xp.reshape(rotated @ put(shared.linear), (-1, 16))
        self._square = xp.reshape((rotated * rotated) @ put(shared.square), (-1, 4))
        self._shared = put(shared.table)
        self._row = device.put(np.arange(self.chains) * self._nodes)
        self._centre = put(shared.spectrum.prior.centre[:, None])
        self._precision = put(np.array(shared.spectrum.prior.spread)[:, None] ** -2.0)

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

    def _moments(self, x: Any) -> PosteriorMoments:
        xp = self.namespace
        place = (x - self._start) / self._spacing
        outside = ~((place > 0) & (place < self._nodes - 1.001))
        place = xp.where(outside, xp.zeros_like(place), place)
        node = xp.astype(place, xp.int64)
        t = place - xp.astype(node, place.dtype)
        row = self._row + node
        linear = xp.reshape(xp.take(self._linear, row, axis=0).T, (4, 4, -1))
        square = xp.reshape(xp.take(self._square, row, axis=0).T, (4, 1, -1))
        shared = xp.reshape(xp.take(self._shared, node, axis=0).T, (4, 11, -1))
        # put together into rows of chains: what follows then reads memory in order
        cubics = xp.concat([linear, square, shared], axis=1)
        first, second, third, fourth = (cubics[k, :, :] for k in range(4))
        # Horner's rule, and its derivative beside it
        values = fourth * t
        slopes = values + values
        values += third
        slopes += third
        values *= t
        slopes *= t
        values += second
        slopes += values
        values *= t
        values += first
        slopes *= 1.0 / self._spacing
        return PosteriorMoments(values[5:, :], values[:5, :], slopes[5:, :], slopes[:5, :], outside)
