"""The posterior's energy from tables: the sampler's inner loop has no sum over markers.

The sums of `hyper_posterior` are functions of one variable x for each chain. They and their slopes
are tabulated on nodes once, by one matrix product for all chains, and read by cubic Hermite
interpolation. The gradient is the derivative of the interpolant, so that trajectories conserve the
tabulated energy.
"""

import math

import numpy as np
from numpy.typing import DTypeLike

from usdface.core.arrays import FloatArray, RealArray
from usdface.numerics.manifold.hyper_posterior import (
    PAIRS,
    MarkerSpectrum,
    PosteriorMoments,
    energy_of_moments,
)

_NODE_SPACING = 0.125
"""Of the nodes in x. Cubic interpolation errs by about 1e-7 of a sum's size."""

_RANGE_DEVIATIONS = 6.0
"""Prior standard deviations of x on either side of its centre that the table covers."""


class SharedTable:
    """The tables that all chains of a mesh have in common."""

    def __init__(self, spectrum: MarkerSpectrum) -> None:
        self.spectrum = spectrum
        centre, spread = spectrum.prior.centre, spectrum.prior.spread
        half = _RANGE_DEVIATIONS * math.hypot(spread[0], spread[1])
        self.start = float(centre[0] - centre[1]) - half
        self.nodes = int(2 * half / _NODE_SPACING) + 2
        x = self.start + _NODE_SPACING * np.arange(self.nodes)
        P = spectrum.trend
        R = 1.0 / (1.0 + np.exp(x)[:, None] * spectrum.values)
        steep = _NODE_SPACING * R * (R - 1.0)
        products = np.stack([P[:, i] * P[:, j] for i, j in PAIRS], axis=1)
        logs = -np.log(R).sum(axis=1, keepdims=True)
        slopes = _NODE_SPACING * (1.0 - R).sum(axis=1, keepdims=True)
        whole = np.concatenate([R @ products, logs, steep @ products, slopes], axis=1)
        self.table: FloatArray = _cubics(whole[None])[0]
        linear = np.concatenate([R.T[:, :, None] * P[:, None], steep.T[:, :, None] * P[:, None]], 2)
        self.linear: FloatArray = _cubics(linear).reshape(len(P), -1)
        self.square: FloatArray = _cubics(np.stack([R.T, steep.T], axis=2)).reshape(len(P), -1)


def _cubics(nodes: FloatArray) -> FloatArray:
    """Turn values and slopes at nodes into each interval's cubic.

    Parameters
    ----------
    nodes : (chains, nodes, 2 k) float array
        Values, then slopes times the spacing.

    Returns
    -------
    (chains, nodes, 4 k) float array
        Coefficients of 1, t, t^2, t^3 with t from 0 to 1 on the way to the next node; those of
        the last node are not used.
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
    displacements : (chains, N) float array
        t [mm], one channel of one frame in each row.
    dtype : dtype
        Of tables and theta. Single precision errs by about 1e-4 of an energy, which does not change
        the acceptance of proposals noticeably.
    """

    def __init__(
        self, shared: SharedTable, displacements: FloatArray, *, dtype: DTypeLike = np.float64
    ) -> None:
        def cast(values: FloatArray) -> RealArray:
            return np.asarray(values, dtype=dtype)

        self.dtype = np.dtype(dtype)
        self._count = len(shared.spectrum.values)
        self._start, self._nodes = shared.start, shared.nodes
        rotated = cast(displacements @ shared.spectrum.vectors)
        # the cubics' coefficients for b and for c, a row for each node of each chain
        self._linear = (rotated @ cast(shared.linear)).reshape(-1, 16)
        self._square = ((rotated * rotated) @ cast(shared.square)).reshape(-1, 4)
        self._shared = cast(shared.table)
        self._first_row = np.arange(len(displacements)) * self._nodes
        self._centre = cast(shared.spectrum.prior.centre[:, None])
        self._precision = cast(np.array(shared.spectrum.prior.spread)[:, None] ** -2.0)

    def __call__(self, theta: RealArray) -> tuple[RealArray, RealArray]:
        """Return the energies (chains,) and gradients (4, chains)."""
        return energy_of_moments(
            theta,
            self._moments(theta[0] - theta[1]),
            count=self._count,
            centre=self._centre,
            precision=self._precision,
        )

    def _moments(self, x: RealArray) -> PosteriorMoments:
        place = (x - self._start) / _NODE_SPACING
        outside = ~((place > 0) & (place < self._nodes - 1.001))
        place = np.where(outside, np.zeros_like(place), place)
        node = place.astype(np.int64)
        t = place - node.astype(place.dtype)
        row = self._first_row + node
        linear = self._linear[row].T.reshape(4, 4, -1)
        square = self._square[row].T.reshape(4, 1, -1)
        shared = self._shared[node].T.reshape(4, 11, -1)
        # copied into rows of chains: what follows then reads memory in order
        first, second, third, fourth = np.concatenate([linear, square, shared], axis=1)
        # Horner's rule for the cubic and for its derivative
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
        slopes *= 1.0 / _NODE_SPACING
        return PosteriorMoments(values[5:], values[:5], slopes[5:], slopes[:5], outside)
