"""The posterior of the hyper-parameters of W06 eq. 7, for many frames and channels at once.

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

Arrays follow the array API, so that another namespace than numpy's may hold them.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from usdface.core.arrays import FloatArray
from usdface.numerics.array_namespace import namespace_of

PAIRS = ((0, 0), (0, 1), (0, 2), (0, 3), (1, 1), (1, 2), (1, 3), (2, 2), (2, 3), (3, 3))
"""The order in which the ten entries of a symmetric matrix of four are stored."""

IMPOSSIBLE = 1e20
"""Energy of a proposal that left the table or overflowed: it is rejected."""


@dataclass(frozen=True)
class HyperPrior:
    """Log-normal priors of v0, v1, a0 and a1.

    Attributes
    ----------
    medians : tuple of float
        [mm^2]. Of v0, what the face moves beyond a linear field; of v1, the markers' noise; of a0
        and a1, what all of it moves, and what it moves more at one end than at the other.
    spread : tuple of float
        Standard deviations of the logarithms.
    """

    medians: tuple[float, float, float, float] = (9.0, 0.05, 4.0, 1.0)
    spread: tuple[float, float, float, float] = (1.5, 1.5, 1.5, 1.5)

    def __post_init__(self) -> None:
        if not all(0 < value < np.inf for value in (*self.medians, *self.spread)):
            raise ValueError(f"prior medians and spreads must be positive: {self}")

    @property
    def centre(self) -> FloatArray:
        """Medians of theta: (4,) float array."""
        return np.log(self.medians)


@dataclass(frozen=True)
class MarkerSpectrum:
    """What depends on the mesh alone.

    Attributes
    ----------
    values : (N,) float array
        Eigenvalues l of the covariance K between markers.
    vectors : (N, N) float array
        Q
    trend : (N, 4) float array
        P
    prior : HyperPrior
    """

    values: FloatArray
    vectors: FloatArray
    trend: FloatArray
    prior: HyperPrior = field(default_factory=HyperPrior)


def decompose(
    matrix: FloatArray, places: FloatArray, *, prior: HyperPrior | None = None
) -> MarkerSpectrum:
    """Take apart the covariance between markers.

    Parameters
    ----------
    matrix : (N, N) float array
        K, positive semidefinite.
    places : (N, 3) float array
        S, where the markers are, centred and scaled to about 1.
    prior : HyperPrior, optional
    """
    values, vectors = np.linalg.eigh(matrix)
    trend = vectors.T @ np.concatenate([np.ones((len(places), 1)), places], axis=1)
    return MarkerSpectrum(np.maximum(values, 1e-9), vectors, trend, prior or HyperPrior())


@dataclass(frozen=True)
class PosteriorMoments:
    """The sums over markers at one x per chain, and their derivatives.

    Attributes
    ----------
    shared : (11, chains) array
        The entries of M in the order of `PAIRS`, then h.
    own : (5, chains) array
        b, then c.
    shared_slope, own_slope : arrays
        d/dx of both.
    outside : (chains,) bool array or None
        Chains whose x cannot be evaluated.
    """

    shared: Any
    own: Any
    shared_slope: Any
    own_slope: Any
    outside: Any = None


def direct_moments(
    spectrum: MarkerSpectrum, rotated: FloatArray, x: FloatArray
) -> PosteriorMoments:
    """Sum over the markers.

    Parameters
    ----------
    spectrum : MarkerSpectrum
    rotated : (chains, N) float array
        z
    x : (chains,) float array
        log(v0 / v1)
    """
    P = spectrum.trend
    products = np.stack([P[:, i] * P[:, j] for i, j in PAIRS], axis=1)
    R = 1.0 / (1.0 + np.exp(x)[:, None] * spectrum.values)
    slope = R * (R - 1.0)
    shared = np.concatenate([(R @ products).T, -np.log(R).sum(axis=1)[None]])
    shared_slope = np.concatenate([(slope @ products).T, (1.0 - R).sum(axis=1)[None]])
    own = np.concatenate([((R * rotated) @ P).T, (R * rotated**2).sum(axis=1)[None]])
    own_slope = np.concatenate([((slope * rotated) @ P).T, (slope * rotated**2).sum(axis=1)[None]])
    return PosteriorMoments(shared, own, shared_slope, own_slope)


def energy_of_moments(
    theta: Any,
    moments: PosteriorMoments,
    *,
    count: int,
    centre: Any,
    precision: Any,
    with_energy: bool,
) -> tuple[Any, Any]:
    """Evaluate U and its gradient.

    Parameters
    ----------
    theta : (4, chains) array
    moments : Moments
        At ``theta[0] - theta[1]``.
    count : int
        N
    centre, precision : (4, 1) arrays
        Of the prior of theta.
    with_energy : bool
        Curvature by differences needs the gradient alone.

    Returns
    -------
    energy : (chains,) array or None
    gradient : (4, chains) array
    """
    xp = namespace_of(theta)
    M, D, own, slope = moments.shared, moments.shared_slope, moments.own, moments.own_slope
    inverse_v1 = xp.exp(-theta[1, :])
    inverse_a0, inverse_a1 = xp.exp(theta[1, :] - theta[2, :]), xp.exp(theta[1, :] - theta[3, :])
    (i00, i01, i02, i03, i11, i12, i13, i22, i23, i33), determinant = _invert(
        M, inverse_a0, inverse_a1
    )
    b0, b1, b2, b3, c = (own[k, :] for k in range(5))
    w0 = i00 * b0 + i01 * b1 + i02 * b2 + i03 * b3
    w1 = i01 * b0 + i11 * b1 + i12 * b2 + i13 * b3
    w2 = i02 * b0 + i12 * b1 + i22 * b2 + i23 * b3
    w3 = i03 * b0 + i13 * b1 + i23 * b2 + i33 * b3
    fit = (c - b0 * w0 - b1 * w1 - b2 * w2 - b3 * w3) * inverse_v1

    # d/dx of log|G| and of q: each entry of M' meets that of G^-1 + w w' / v1
    k0, k1, k2, k3 = (inverse_v1 * w for w in (w0, w1, w2, w3))
    along = D[0, :] * (i00 + k0 * w0) + D[4, :] * (i11 + k1 * w1)
    along = along + D[7, :] * (i22 + k2 * w2) + D[9, :] * (i33 + k3 * w3) + D[10, :]
    aside = D[1, :] * (i01 + k0 * w1) + D[2, :] * (i02 + k0 * w2) + D[3, :] * (i03 + k0 * w3)
    aside = aside + D[5, :] * (i12 + k1 * w2) + D[6, :] * (i13 + k1 * w3)
    aside = aside + D[8, :] * (i23 + k2 * w3)
    aside = aside - slope[0, :] * k0 - slope[1, :] * k1 - slope[2, :] * k2 - slope[3, :] * k3
    by_x = along + 2.0 * aside + slope[4, :] * inverse_v1
    by_a0 = 1.0 - inverse_a0 * (i00 + k0 * w0)
    by_a1 = 3.0 - inverse_a1 * (i11 + i22 + i33 + k1 * w1 + k2 * w2 + k3 * w3)
    away = theta - centre
    pull = away * precision
    gradient = 0.5 * xp.stack([by_x, count - fit - by_x - by_a0 - by_a1, by_a0, by_a1]) + pull
    if not with_energy:
        return None, gradient
    energy = count * theta[1, :] + M[10, :] + xp.log(determinant) + fit
    energy = energy + (theta[2, :] - theta[1, :]) + 3.0 * (theta[3, :] - theta[1, :])
    energy = 0.5 * (energy + xp.sum(away * pull, axis=0))
    possible = xp.isfinite(energy) & (energy < IMPOSSIBLE)
    if moments.outside is not None:
        possible = possible & ~moments.outside
    return xp.where(possible, energy, xp.full_like(energy, IMPOSSIBLE)), gradient


def _invert(M: Any, inverse_a0: Any, inverse_a1: Any) -> tuple[tuple[Any, ...], Any]:
    """Invert G by blocks of two: its ten entries in the order of `PAIRS`, and its determinant."""
    g00, g11 = M[0, :] + inverse_a0, M[4, :] + inverse_a1
    g22, g33 = M[7, :] + inverse_a1, M[9, :] + inverse_a1
    g01, g02, g03, g12, g13, g23 = (M[k, :] for k in (1, 2, 3, 5, 6, 8))
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
