"""Predictions over the surface from samples of the hyper-parameters (W06, eq. 3), calibrated.

The prediction at a point is linear in ``h(x) = [Q' k(x); 1; s(x)]``, which depends on the mesh
alone. So the average over samples is taken of the weights of h (*dual weights*)::

    gamma = [rho R (z - P w); w]        rho = v0 / v1, in the terms of `hyper_posterior`
    mean(x) = h' mean(gamma)
    var(x)  = mean(v0) + h' Sigma h
    Sigma   = mean(Y'Y) + cov(gamma) - diag(mean(v0 rho R), 0)
    Y       = sqrt(v1) chol(G)^-1 [-rho P'R | I]

The variance is that of the surface, without the noise v1 of a measurement.

A Gaussian process is overconfident where a face is rougher than on average and underconfident where
it is smoother. Calibration is by errors at left-out markers over their expected deviations. Along
lids and lips markers form rows, whose neighbours predict a left-out marker better than points off
the row: its nearest neighbour is left out as well.

With one set of hyper-parameters for all frames C, the variance is the same in all frames. A frame
with larger motion t, of n measured coordinates, has larger errors. In a Student-t process (Shah,
Wilson and Ghahramani, 2014) with nu = n degrees of freedom, deviations have the factor s::

    s^2 = (nu + t' C^-1 t) / (nu + n)

Markers tell how much they move themselves, in all frames alike, and hardly how much the skin far
from them does. There, v0 is averaged with its prior median m, weighted by their numbers of markers
(`HyperPrior.markers`), n and N. The variance grows by the share of v0 that no marker explains, with
the shortest length scale l that markers can tell, their median distance from each other::

    added(x) = (1 - max_i c(d_i(x) / l)^2) max(n (m - v0) / (N + n), 0)
"""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import BoolArray, Float32Array, FloatArray, RealArray
from usdface.numerics.manifold.hyper_posterior import SYMMETRIC_ENTRIES, HyperPrior, MarkerSpectrum

_LARGEST_LOG = 30.0
"""Bound of |theta|: in a take without motion scales tend to 0, and overflow in single precision."""

_NORMAL_95 = 1.959963984540054
"""Half width of a 95 % interval in standard deviations."""

_JITTER_SHARE = 1e-10
"""[of the trace] Added to the diagonal, so that a covariance without noise is invertible."""

_LEAST_FACTOR = 1e-3
"""Of a standard deviation; errors at left-out markers are 0 in a take without motion."""

_LEAST_VARIANCE = 1e-12
"""[mm^2] Of v0, in a take without motion."""

_PRIOR_MARKERS = 0.3
"""Weight, in markers, of the overall mean squared error in the local one."""


@dataclass(frozen=True)
class DualMoments:
    """Mean and covariance of the weights of h."""

    mean: Float32Array
    """(chains, N + 4)"""
    covariance: Float32Array
    """(chains, N + 4, N + 4)"""
    constant: Float32Array
    """(chains,): v0, averaged over samples."""


def average_dual_weights(
    spectrum: MarkerSpectrum, displacements: FloatArray, theta: FloatArray
) -> DualMoments:
    """Average the weights over samples, in single precision.

    Parameters
    ----------
    displacements : (chains, N) float array
        [mm]
    theta : (samples, 4, chains) float array
    """
    rotated = (displacements @ spectrum.vectors).astype(np.float32)
    P, values = spectrum.trend.astype(np.float32), spectrum.values.astype(np.float32)
    count, chains, samples = len(P), len(rotated), len(theta)
    products = np.stack([P[:, i] * P[:, j] for i, j in SYMMETRIC_ENTRIES], axis=1)
    bounded = np.clip(np.moveaxis(theta, 2, 0), -_LARGEST_LOG, _LARGEST_LOG)
    scales = np.exp(np.ascontiguousarray(bounded, np.float32))  # (chains, samples, 4)
    v0, v1, a0, a1 = (scales[:, :, k] for k in range(4))
    ratio = (v0 / v1)[:, :, None]
    R = 1.0 / (1.0 + ratio * values)
    M = (R.reshape(-1, count) @ products).reshape(chains, samples, 10)
    b = ((R * rotated[:, None]).reshape(-1, count) @ P).reshape(chains, samples, 4)
    M[:, :, 0] += v1 / a0
    for k in (4, 7, 9):
        M[:, :, k] += v1 / a1
    inverse_root = _inverse_roots(M)
    w = (np.matrix_transpose(inverse_root) @ (inverse_root @ b[..., None]))[..., 0]
    R *= ratio  # rho R from here on
    fitted = (w.reshape(-1, 4) @ P.T).reshape(chains, samples, count)
    weights = np.empty((chains, samples, count + 4), np.float32)
    weights[:, :, :count] = R * (rotated[:, None] - fitted)
    weights[:, :, count:] = w
    mean = np.mean(weights, axis=1)
    weights -= mean[:, None]
    scaled = np.sqrt(v1)[:, :, None, None] * inverse_root
    spread = np.empty((chains, samples, 4, count + 4), np.float32)
    spread[..., :count] = scaled @ P.T
    spread[..., :count] *= -R[:, :, None]
    spread[..., count:] = scaled
    rows = spread.reshape(chains, samples * 4, count + 4)
    covariance = np.matrix_transpose(rows) @ rows
    covariance += np.matrix_transpose(weights) @ weights
    prior = np.sum(v0[:, :, None] * R, axis=1)
    covariance[:, :count, :count] -= prior[:, :, None] * np.eye(count, dtype=np.float32)
    covariance /= samples
    return DualMoments(mean, covariance, np.mean(v0, axis=1))


def _inverse_roots(G: RealArray) -> Float32Array:
    """Return inverse Cholesky factors of symmetric (4, 4) matrices.

    Returns (..., 4, 4), lower triangular; its transpose times it is the inverse of G.

    Parameters
    ----------
    G : (..., 10) float32 array
        Entries in the order of `SYMMETRIC_ENTRIES`.
    """
    whole = np.empty((*G.shape[:-1], 4, 4))
    for k, (i, j) in enumerate(SYMMETRIC_ENTRIES):
        whole[..., i, j] = whole[..., j, i] = G[..., k]
    return np.linalg.inv(np.linalg.cholesky(whole)).astype(np.float32)


def join_moments(parts: list[DualMoments]) -> DualMoments:
    """Concatenate the chains of several batches."""
    return DualMoments(
        np.concatenate([part.mean for part in parts]),
        np.concatenate([part.covariance for part in parts]),
        np.concatenate([part.constant for part in parts]),
    )


def mix_variances(moments: DualMoments, shares: FloatArray) -> DualMoments:
    """Sum the variances of consecutive chains, which is cheaper than summing their fields.

    Parameters
    ----------
    shares : (group,) float array
        Factor of each chain of a group, such as the axes of a frame.
    """
    size, count = moments.covariance.shape[1], len(shares)
    covariance = moments.covariance.reshape(-1, count, size, size)
    constant = moments.constant.reshape(-1, count)
    mixed, level = np.zeros_like(covariance[:, 0]), np.zeros_like(constant[:, 0])
    for k, share in enumerate(shares.tolist()):
        mixed += covariance[:, k] * share
        level += constant[:, k] * share
    return DualMoments(moments.mean, mixed, level)


def surface_basis(spectrum: MarkerSpectrum, cross: Float32Array, places: RealArray) -> Float32Array:
    """Return h at the points of a mesh: (points, N + 4).

    Parameters
    ----------
    cross : (points, N) float32 array
        Covariance of the points with the markers.
    places : (points, 3) float array
        Of points, centred and scaled as the markers' places.
    """
    rotated = cross @ spectrum.vectors.astype(np.float32)
    ones = np.ones((len(cross), 1), np.float32)
    return np.concatenate([rotated, ones, places.astype(np.float32)], axis=1)


def predict_mean(basis: Float32Array, moments: DualMoments) -> Float32Array:
    """Return displacements, three chains to a frame: (frames, points, 3) float32 array [mm]."""
    flat = basis @ moments.mean.T
    return np.ascontiguousarray(flat.reshape(len(flat), -1, 3).transpose(1, 0, 2), np.float32)


def predict_variance(basis: Float32Array, moments: DualMoments) -> Float32Array:
    """Return variances: (chains, points) float32 array [mm^2]."""
    out = np.empty((len(moments.constant), len(basis)), np.float32)
    for chain, covariance in enumerate(moments.covariance):
        # The products of h are not approximated by few: deviations at markers would be wrong by
        # factors, although those of most points are not.
        np.einsum("pi,pi->p", basis @ covariance, basis, out=out[chain])
    out += moments.constant[:, None]
    return np.asarray(np.maximum(out, 0.0, out=out))


@dataclass(frozen=True)
class SpreadFactors:
    """Factors of standard deviations, by which 95 % intervals contain 95 %."""

    of_axes: FloatArray
    """(3,)"""
    of_points: Float32Array
    """(points,)"""


def leave_markers_out(
    spectrum: MarkerSpectrum,
    displacements: FloatArray,
    theta: FloatArray,
    *,
    with_nearest: bool = False,
) -> tuple[FloatArray, FloatArray]:
    """Predict every marker from the others, in closed form (Rasmussen and Williams, eq. 5.12).

    Returns (chains, N) errors, measured minus predicted, and standard deviations of the prediction,
    the marker's noise included [mm].

    Parameters
    ----------
    displacements : (chains, N) float array
        [mm]
    theta : (samples, 4, chains or 1) float array
        Predictions are averaged over the samples; one theta may serve all chains.
    with_nearest : bool
        Whether the marker with the largest covariance is left out too.
    """
    Q = spectrum.vectors
    covariance = (Q * spectrum.values) @ Q.T
    errors, squares = np.empty_like(displacements), np.empty_like(displacements)
    others = covariance - 2.0 * np.diag(np.diagonal(covariance))
    markers, nearest = np.arange(len(Q)), others.argmax(axis=1)
    for chain in range(theta.shape[2]):
        rows = slice(None) if theta.shape[2] == 1 else slice(chain, chain + 1)
        inverse = marker_precisions(spectrum, theta[:, :, chain])
        diagonal = np.diagonal(inverse, axis1=1, axis2=2)[:, None]
        solved = displacements[rows] @ inverse
        error, variance = solved / diagonal, 1.0 / diagonal
        if with_nearest:
            across = inverse[:, None, markers, nearest]
            of_nearest = diagonal[..., nearest]
            determinant = diagonal * of_nearest - across**2
            error = (of_nearest * solved - across * solved[..., nearest]) / determinant
            variance = of_nearest / determinant
        errors[rows] = error.mean(axis=0)
        squares[rows] = variance.mean(axis=0) + error.var(axis=0)
    return errors, np.sqrt(squares)


def marker_precisions(spectrum: MarkerSpectrum, theta: FloatArray) -> FloatArray:
    """Return inverse covariances of the displacements of markers, noise included.

    Returns (samples, N, N).

    Parameters
    ----------
    theta : (samples, 4) float array
    """
    Q = spectrum.vectors
    trend = Q @ spectrum.trend
    scales = np.exp(np.clip(theta, -_LARGEST_LOG, _LARGEST_LOG))
    v0, v1, a0, a1 = (scales[:, k][:, None, None] for k in range(4))
    C = v0 * ((Q * spectrum.values) @ Q.T) + a0 + a1 * (trend[:, 1:] @ trend[:, 1:].T)
    noise = v1 + _JITTER_SHARE * np.trace(C + v1 * np.eye(len(Q)), axis1=1, axis2=2)[:, None, None]
    return np.asarray(np.linalg.inv(C + noise * np.eye(len(Q))))


def frame_factors(
    displacements: FloatArray, precision: FloatArray, measured: BoolArray
) -> FloatArray:
    """Return the factor s of the standard deviations of each frame: (frames,).

    Parameters
    ----------
    displacements : (frames, N, 3) float array
        [mm]
    precision : (N, N) float array
        C^-1 [mm^-2].
    measured : (frames, N) bool array
        False where other markers predict one.
    """
    power = np.einsum("fmc,mn,fnc->f", displacements, precision, displacements, optimize=True)
    count = 3.0 * np.maximum(measured.sum(axis=1), 1)
    return np.asarray(np.sqrt((1.0 + power / count) / 2.0))


def calibrate_spread(
    errors: FloatArray, expected: FloatArray, covariance: FloatArray, cross: Float32Array
) -> SpreadFactors:
    """Return factors of standard deviations for points and axes.

    With ``z = errors / expected`` of left-out markers, a point's factor is the root of the mean z^2
    of the markers weighted by their squared covariance with it. One more factor for each axis
    calibrates the 95 % interval of the left-out values.

    Parameters
    ----------
    errors, expected : (chains, N) float arrays
        See `leave_markers_out`; chains go x, y, z, frame by frame.
    covariance : (N, N) float array
        Between markers, 1 on its diagonal.
    cross : (points, N) float32 array
        Covariance of points with markers.
    """
    z = (errors / expected).reshape(-1, 3, errors.shape[1])
    size = np.sqrt((z**2).mean(axis=(0, 2), keepdims=True))
    squares = ((z / np.maximum(size, _LEAST_FACTOR)) ** 2).mean(axis=(0, 1))
    weights = np.maximum(covariance, 0.0) ** 2
    np.fill_diagonal(weights, 0.0)  # a marker's factor is estimated from the others
    scaled = np.abs(z) / np.sqrt(_average_nearby(weights, squares))
    factors = np.quantile(np.moveaxis(scaled, 1, 0).reshape(3, -1), 0.95, axis=1) / _NORMAL_95
    of_points = np.sqrt(_average_nearby(np.maximum(cross, 0.0) ** 2, squares))
    return SpreadFactors(np.maximum(factors, _LEAST_FACTOR), of_points.astype(np.float32))


def prior_shares(
    similar: RealArray, level: RealArray, prior: HyperPrior, *, markers: int
) -> Float32Array:
    """Return what the prior adds to the variance of points, as shares of v0: (points,).

    Parameters
    ----------
    similar : (points,) float array
        Correlation with the most similar marker, at the shortest length scale.
    level : (points,) float array
        Calibrated v0 [mm^2].
    markers : int
        N
    """
    weight = prior.markers / (markers + prior.markers)
    excess = np.maximum(prior.medians[0] / np.maximum(level, _LEAST_VARIANCE) - 1.0, 0.0)
    return ((1.0 - similar**2) * weight * excess).astype(np.float32)


def _average_nearby(weights: RealArray, squares: FloatArray) -> FloatArray:
    """Return averages of the markers' squares by weights (places, N), with a prior: (places,)."""
    total = weights.sum(axis=1) + _PRIOR_MARKERS
    average: FloatArray = (weights @ squares + _PRIOR_MARKERS * squares.mean()) / total
    return np.maximum(average, _LEAST_FACTOR)
