"""Posterior of the hyper-parameters of W06 eq. 7, for many frames and channels at once.

One *chain* is one channel of one frame: N markers' displacements t along x, y or z. With
``theta = log(v0, v1, a0, a1)`` the covariance is ``C = v0 K + a0 1 1' + a1 S S' + v1 I``, and::

    U(theta) = 1/2 log|C| + 1/2 t' C^-1 t + sum_a (theta_a - m_a)^2 / (2 s_a^2)           (eq. 8)

K and S belong to the mesh. With ``K = Q diag(l) Q'`` and ``P = Q' [1 S]`` the two scales v0, v1
act on the spectrum and a0, a1 are a change of rank four (Woodbury). Dividing by v1, everything
enters through sums that depend on ``x = theta_0 - theta_1 = log(v0 / v1)`` alone; with
``R_i = 1/(1 + e^x l_i)`` and ``z = Q' t``::

    M(x) = sum R p p'    b(x) = sum R z p    c(x) = sum R z^2    h(x) = sum log(1 + e^x l)
    A = (a0, a1, a1, a1) / v1,   G = diag(1/A) + M,   w = G^-1 b,   q = c - b'w
    2 U = N theta_1 + h + log|G| + log A_0 + 3 log A_1 + q / v1 + prior

and with ' for d/dx::

    2 dU/dx       = h' + tr(G^-1 M') + (c' - 2 b''w + w'M'w) / v1
    2 dU/dlog A_0 = 1 - Ginv_00 / A_0 - w_0^2 / (A_0 v1)          (A_1 alike, over three)
    2 dU/dlog v1  = N - q / v1                                     (x and A held)

The displacements determine the power along each direction of the spectrum, ``v0 l + v1``, but
hardly the share of noise in it, so that the posterior is curved in theta. With ``k = 1 / median l``
it is nearly Gaussian in::

    phi = (log(v0 + k v1), log(v1 / v0), log a0, log a1)

in which chains are sampled. The Jacobian determinant is 1: densities, modes and evidence are the
same in both coordinates.

The sums and their slopes are tabulated over x, by one matrix product for all chains, and evaluated
by cubic Hermite interpolation, so that the sampler's inner loop has no sum over markers. The
gradient is the derivative of the interpolant: trajectories conserve the tabulated energy.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import DTypeLike

from usdface.core.arrays import BoolArray, FloatArray, RealArray
from usdface.numerics.manifold.laplace import Energy

SYMMETRIC_ENTRIES = ((0, 0), (0, 1), (0, 2), (0, 3), (1, 1), (1, 2), (1, 3), (2, 2), (2, 3), (3, 3))
"""Storage order of the ten entries of a symmetric (4, 4) matrix."""

REJECTED_ENERGY = 1e20
"""U of a theta outside the table or with overflow, which the sampler rejects."""


@dataclass(frozen=True)
class HyperPrior:
    """Log-normal priors of v0, v1, a0 and a1."""

    medians: tuple[float, float, float, float] = (9.0, 0.05, 4.0, 1.0)
    """[mm^2]. Of v0, the motion beyond a linear field; of v1, the markers' noise; of a0, the motion
    common to all markers; of a1, the motion that is linear in the position."""
    spread: tuple[float, float, float, float] = (1.5, 1.5, 1.5, 1.5)
    """Standard deviations of the logarithms."""

    def __post_init__(self) -> None:
        if not all(0 < value < np.inf for value in (*self.medians, *self.spread)):
            raise ValueError(f"prior medians and spreads must be positive: {self}")

    @property
    def centre(self) -> FloatArray:
        """Medians of theta: (4,) float array."""
        return np.log(self.medians)

    @property
    def markers(self) -> float:
        """Number of markers whose mean square tells v0 as well as the prior does.

        The logarithm of a mean of n squares has the variance ``psi'(n / 2)``, with the trigamma
        function ``psi'(x) = 1/x + 1/(2 x^2)``, to second order; it is that of the prior at
        ``n = (1 + sqrt(1 + 2 s^2)) / s^2``.
        """
        square = self.spread[0] ** 2
        return (1.0 + math.sqrt(1.0 + 2.0 * square)) / square


@dataclass(frozen=True)
class MarkerSpectrum:
    """Terms of U that depend on the mesh alone."""

    values: FloatArray
    """(N,): eigenvalues l of the covariance K between markers."""
    vectors: FloatArray
    """(N, N): Q"""
    trend: FloatArray
    """(N, 4): P"""
    prior: HyperPrior


def decompose(matrix: FloatArray, places: FloatArray, prior: HyperPrior) -> MarkerSpectrum:
    """Diagonalise the covariance between markers, ``K = Q diag(l) Q'``.

    Parameters
    ----------
    matrix : (N, N) float array
        K, positive semidefinite.
    places : (N, 3) float array
        S: positions of the markers, centred and scaled to about 1.
    """
    values, vectors = np.linalg.eigh(matrix)
    trend = vectors.T @ np.concatenate([np.ones((len(places), 1)), places], axis=1)
    return MarkerSpectrum(np.maximum(values, 1e-9), vectors, trend, prior)


@dataclass(frozen=True)
class PosteriorMoments:
    """The sums over markers at one x per chain, and their derivatives."""

    shared: RealArray
    """(11, chains): the entries of M in the order of `SYMMETRIC_ENTRIES`, then h."""
    per_chain: RealArray
    """(5, chains): b, then c."""
    shared_slope: RealArray
    per_chain_slope: RealArray
    """`shared_slope`, `per_chain_slope`: d/dx of both."""
    outside: BoolArray
    """(chains,): chains whose x cannot be evaluated."""


def energy_of_moments(
    theta: RealArray,
    moments: PosteriorMoments,
    *,
    count: int,
    centre: RealArray,
    precision: RealArray,
) -> tuple[RealArray, RealArray]:
    """Evaluate U and its gradient.

    Parameters
    ----------
    theta : (4, chains) array
    moments : PosteriorMoments
        At ``theta[0] - theta[1]``.
    centre, precision : (4, 1) arrays
        Of the prior of theta.

    Returns
    -------
    energy : (chains,) array
    gradient : (4, chains) array
    """
    M, D = moments.shared, moments.shared_slope
    inverse_v1 = np.exp(-theta[1])
    inverse_a0, inverse_a1 = np.exp(theta[1] - theta[2]), np.exp(theta[1] - theta[3])
    (i00, i01, i02, i03, i11, i12, i13, i22, i23, i33), determinant = _invert(
        M, inverse_a0, inverse_a1
    )
    b0, b1, b2, b3, c = moments.per_chain
    w0 = i00 * b0 + i01 * b1 + i02 * b2 + i03 * b3
    w1 = i01 * b0 + i11 * b1 + i12 * b2 + i13 * b3
    w2 = i02 * b0 + i12 * b1 + i22 * b2 + i23 * b3
    w3 = i03 * b0 + i13 * b1 + i23 * b2 + i33 * b3
    fit = (c - b0 * w0 - b1 * w1 - b2 * w2 - b3 * w3) * inverse_v1

    # d/dx of log|G| and of q: the sum of M' times (G^-1 + w w' / v1), entry by entry
    slope = moments.per_chain_slope
    k0, k1, k2, k3 = (inverse_v1 * w for w in (w0, w1, w2, w3))
    diagonal = D[0] * (i00 + k0 * w0) + D[4] * (i11 + k1 * w1)
    diagonal = diagonal + D[7] * (i22 + k2 * w2) + D[9] * (i33 + k3 * w3) + D[10]
    upper = D[1] * (i01 + k0 * w1) + D[2] * (i02 + k0 * w2) + D[3] * (i03 + k0 * w3)
    upper = upper + D[5] * (i12 + k1 * w2) + D[6] * (i13 + k1 * w3)
    upper = upper + D[8] * (i23 + k2 * w3)
    upper = upper - slope[0] * k0 - slope[1] * k1 - slope[2] * k2 - slope[3] * k3
    by_x = diagonal + 2.0 * upper + slope[4] * inverse_v1
    by_a0 = 1.0 - inverse_a0 * (i00 + k0 * w0)
    by_a1 = 3.0 - inverse_a1 * (i11 + i22 + i33 + k1 * w1 + k2 * w2 + k3 * w3)
    offset = theta - centre
    prior_slope = offset * precision
    by_v1 = count - fit - by_x - by_a0 - by_a1
    gradient = 0.5 * np.stack([by_x, by_v1, by_a0, by_a1]) + prior_slope
    energy = count * theta[1] + M[10] + np.log(determinant) + fit
    energy = energy + (theta[2] - theta[1]) + 3.0 * (theta[3] - theta[1])
    energy = 0.5 * (energy + np.sum(offset * prior_slope, axis=0))
    possible = np.isfinite(energy) & (energy < REJECTED_ENERGY) & ~moments.outside
    return np.where(possible, energy, np.full_like(energy, REJECTED_ENERGY)), gradient


def noise_gain(spectrum: MarkerSpectrum) -> float:
    """Return ``k = 1 / median l``, the ratio of the powers of units of v1 and v0."""
    return float(1.0 / np.median(spectrum.values))


def to_theta(phi: RealArray, gain: float) -> RealArray:
    """Return theta of phi (4, ...), for the `noise_gain` k."""
    log_v0 = phi[0] - _log_total(phi[1], gain)
    return np.stack([log_v0, log_v0 + phi[1], phi[2], phi[3]])


def to_phi(theta: RealArray, gain: float) -> RealArray:
    """Return phi of theta (4, ...), the inverse of `to_theta`."""
    ratio = theta[1] - theta[0]
    return np.stack([theta[0] + _log_total(ratio, gain), ratio, theta[2], theta[3]])


class PhiEnergy:
    """An energy of theta as a function of phi, (4, chains)."""

    def __init__(self, energy: Energy, gain: float) -> None:
        self._energy, self._gain = energy, gain

    def __call__(self, phi: RealArray) -> tuple[RealArray, RealArray]:
        """Return the energies (chains,) and gradients (4, chains)."""
        value, gradient = self._energy(to_theta(phi, self._gain))
        by_total = gradient[0] + gradient[1]
        noise_share = 1.0 / (1.0 + np.exp(-phi[1]) / self._gain)  # k v1 / (v0 + k v1)
        by_ratio = gradient[1] - noise_share * by_total
        return value, np.stack([by_total, by_ratio, gradient[2], gradient[3]])


def _log_total(ratio: RealArray, gain: float) -> RealArray:
    """Return ``log(1 + k exp(ratio))``, without overflow."""
    shifted = ratio + float(np.log(gain))
    return np.asarray(np.clip(shifted, 0.0, None) + np.log1p(np.exp(-np.abs(shifted))))


def _invert(
    M: RealArray, inverse_a0: RealArray, inverse_a1: RealArray
) -> tuple[tuple[RealArray, ...], RealArray]:
    """Return the inverse of G, as `SYMMETRIC_ENTRIES`, and its determinant, by (2, 2) blocks."""
    g00, g11 = M[0] + inverse_a0, M[4] + inverse_a1
    g22, g33 = M[7] + inverse_a1, M[9] + inverse_a1
    g01, g02, g03, g12, g13, g23 = (M[k] for k in (1, 2, 3, 5, 6, 8))
    upper = g00 * g11 - g01 * g01
    r = 1.0 / upper
    a00, a01, a11 = g11 * r, -g01 * r, g00 * r
    y00, y01 = a00 * g02 + a01 * g12, a00 * g03 + a01 * g13
    y10, y11 = a01 * g02 + a11 * g12, a01 * g03 + a11 * g13
    s00 = g22 - g02 * y00 - g12 * y10
    s01 = g23 - g02 * y01 - g12 * y11
    s11 = g33 - g03 * y01 - g13 * y11
    lower = s00 * s11 - s01 * s01
    r = 1.0 / lower
    i22, i23, i33 = s11 * r, -s01 * r, s00 * r
    i02, i03 = -(y00 * i22 + y01 * i23), -(y00 * i23 + y01 * i33)
    i12, i13 = -(y10 * i22 + y11 * i23), -(y10 * i23 + y11 * i33)
    i00 = a00 - i02 * y00 - i03 * y01
    i01 = a01 - i02 * y10 - i03 * y11
    i11 = a11 - i12 * y10 - i13 * y11
    return (i00, i01, i02, i03, i11, i12, i13, i22, i23, i33), upper * lower


_NODE_SPACING = 0.125
"""Of the nodes in x; the relative error of cubic interpolation is about 1e-7."""

_RANGE_DEVIATIONS = 6.0
"""Half width of the table, in prior standard deviations of x."""


class SharedTable:
    """The tables that are common to all chains of a mesh."""

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
        products = np.stack([P[:, i] * P[:, j] for i, j in SYMMETRIC_ENTRIES], axis=1)
        logs = -np.log(R).sum(axis=1, keepdims=True)
        slopes = _NODE_SPACING * (1.0 - R).sum(axis=1, keepdims=True)
        whole = np.concatenate([R @ products, logs, steep @ products, slopes], axis=1)
        self.table: FloatArray = _cubics(whole[None])[0]
        linear = np.concatenate([R.T[:, :, None] * P[:, None], steep.T[:, :, None] * P[:, None]], 2)
        self.linear: FloatArray = _cubics(linear).reshape(len(P), -1)
        self.square: FloatArray = _cubics(np.stack([R.T, steep.T], axis=2)).reshape(len(P), -1)


def _cubics(nodes: FloatArray) -> FloatArray:
    """Return the cubic Hermite polynomial of each interval between nodes.

    Returns (chains, nodes, 4 k), coefficients of 1, t, t^2, t^3 with t from 0 to 1 towards the next
    node; those of the last node are not used.

    Parameters
    ----------
    nodes : (chains, nodes, 2 k) float array
        Values, then slopes times the spacing.
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
    """U and its gradient for a batch of chains, as a function of theta (4, chains).

    Parameters
    ----------
    displacements : (chains, N) float array
        t [mm], one channel of one frame in each row.
    dtype : dtype
        Of tables and theta. Errors of the energy in single precision are about 1e-4, negligible in
        the acceptance of proposals.
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
        # Copied to rows of chains, which are contiguous.
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
