"""Fields over the surface from samples of the hyper-parameters: W06, eq. 3.

The prediction at a point is linear in ``h(x) = [Q' k(x); 1; s(x)]``, which the mesh alone decides.
So what is averaged over the samples are its weights (*dual weights*), never fields::

    gamma = [rho R (z - P w); w]        rho = v0 / v1, in the terms of `hyper_posterior`
    mean(x) = h' mean(gamma)
    var(x)  = mean(v0) + h' Sigma h
    Sigma   = mean(Y'Y) + cov(gamma) - diag(mean(v0 rho R), 0)
    Y       = sqrt(v1) chol(G)^-1 [-rho P'R | I]

The variance is that of the surface, not of a marker measured there: v1 is left out.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from usdface.numerics.manifold.hyper_posterior import PAIRS, MarkerSpectrum

Array = NDArray[np.float64]
Float32Array = NDArray[np.float32]

_FARTHEST = 30.0
"""Of theta: a take that stands still drives scales to 0, which single precision cannot divide."""


@dataclass(frozen=True)
class DualMoments:
    """Mean and covariance of the weights on h.

    Attributes
    ----------
    mean : (chains, N + 4) float32 array
    covariance : (chains, N + 4, N + 4) float32 array
    constant : (chains,) float32 array
        v0, averaged over samples.
    """

    mean: Float32Array
    covariance: Float32Array
    constant: Float32Array


def average_dual_weights(
    spectrum: MarkerSpectrum, displacements: Array, theta: Array
) -> DualMoments:
    """Average over samples.

    Parameters
    ----------
    spectrum : MarkerSpectrum
    displacements : (chains, N) float array
        [mm]
    theta : (samples, 4, chains) float array
    """
    rotated = (displacements @ spectrum.vectors).astype(np.float32)
    P = spectrum.trend.astype(np.float32)
    count, chains, samples = len(P), len(rotated), len(theta)
    products = np.stack([P[:, i] * P[:, j] for i, j in PAIRS], axis=1)
    within = np.clip(np.moveaxis(theta, 2, 0), -_FARTHEST, _FARTHEST)  # chains, samples, 4
    scales = np.exp(within).astype(np.float32)
    v0, v1 = scales[..., 0], scales[..., 1]
    ratio = (v0 / v1)[..., None]
    R = 1.0 / (1.0 + ratio * spectrum.values.astype(np.float32))
    M = (R.reshape(-1, count) @ products).reshape(chains, samples, 10)
    b = ((R * rotated[:, None]).reshape(-1, count) @ P).reshape(chains, samples, 4)
    M[..., 0] += v1 / scales[..., 2]
    for k in (4, 7, 9):
        M[..., k] += v1 / scales[..., 3]
    inverse_root = _inverse_roots(M)
    w = np.einsum("bsji,bsjk,bsk->bsi", inverse_root, inverse_root, b, optimize=True)
    R *= ratio  # rho R from here on
    weights = np.empty((chains, samples, count + 4), np.float32)
    np.matmul(
        w.reshape(-1, 4), P.T, out=(fitted := np.empty((chains * samples, count), np.float32))
    )
    weights[..., :count] = R * (rotated[:, None] - fitted.reshape(chains, samples, count))
    weights[..., count:] = w
    mean = weights.mean(axis=1)
    weights -= mean[:, None]
    scaled = np.sqrt(v1)[..., None, None] * inverse_root
    spread = np.empty((chains, samples, 4, count + 4), np.float32)
    np.matmul(scaled, P.T, out=spread[..., :count])
    spread[..., :count] *= -R[:, :, None]
    spread[..., count:] = scaled
    rows = spread.reshape(chains, samples * 4, count + 4)
    covariance = np.matmul(rows.transpose(0, 2, 1), rows)
    covariance += np.matmul(weights.transpose(0, 2, 1), weights)
    diagonal = np.arange(count)
    covariance[:, diagonal, diagonal] -= (v0[..., None] * R).sum(axis=1)
    covariance /= samples
    return DualMoments(mean, covariance, v0.mean(axis=1))


def _inverse_roots(G: Float32Array) -> Float32Array:
    """Invert the Cholesky factors of symmetric matrices of four, all at once.

    Parameters
    ----------
    G : (..., 10) float32 array
        Entries in the order of `PAIRS`.

    Returns
    -------
    (..., 4, 4) float32 array
        Lower triangular; its transpose times it is the inverse of G.
    """
    entry = {pair: np.float64(G[..., k]) for k, pair in enumerate(PAIRS)}
    root: dict[tuple[int, int], Array] = {}
    for j in range(4):
        for i in range(j, 4):
            left = entry[j, i] - sum(root[i, k] * root[j, k] for k in range(j))
            root[i, j] = np.sqrt(left) if i == j else left / root[j, j]
    out = np.zeros((*G.shape[:-1], 4, 4), np.float32)
    inverse: dict[tuple[int, int], Array] = {}
    for j in range(4):
        for i in range(j, 4):
            rest = sum(root[i, k] * inverse[k, j] for k in range(j, i))
            inverse[i, j] = (float(i == j) - rest) / root[i, i]
            out[..., i, j] = inverse[i, j]
    return out


def join_moments(parts: list[DualMoments]) -> DualMoments:
    """Put the chains of several batches after each other."""
    return DualMoments(
        np.concatenate([part.mean for part in parts]),
        np.concatenate([part.covariance for part in parts]),
        np.concatenate([part.constant for part in parts]),
    )


@dataclass(frozen=True)
class SurfaceFields:
    """h over a mesh, and its products compressed so that variances are one small product.

    Attributes
    ----------
    basis : (points, N + 4) float32 array
        h
    squares : (points, rank) float32 array
    reading : (rank, (N + 4)(N + 5) / 2) float32 array
        ``squares @ reading`` are, nearly, the products ``h_i h_j`` of `numpy.triu_indices`'s
        order, those with i < j twice.
    """

    basis: Float32Array
    squares: Float32Array
    reading: Float32Array


def make_fields(
    spectrum: MarkerSpectrum,
    cross: Float32Array,
    places: Float32Array,
    *,
    rank: int = 128,
    rng: np.random.Generator,
) -> SurfaceFields:
    """Prepare a mesh.

    Parameters
    ----------
    spectrum : MarkerSpectrum
    cross : (points, N) float32 array
        Covariance of the points with the markers.
    places : (points, 3) float32 array
        Where points are, centred and scaled as the markers' places are.
    rank : int
        Of the variances; the mean is exact. The basis comes from a sample of points.
    rng : numpy.random.Generator
        Chooses the sample.
    """
    ones = np.ones((len(cross), 1), np.float32)
    rotated = cross @ spectrum.vectors.astype(np.float32)
    basis = np.concatenate([rotated, ones, places.astype(np.float32)], axis=1)
    sample = basis[rng.choice(len(basis), min(len(basis), 8 * rank), replace=False)]
    _, _, right = np.linalg.svd(_products(sample), full_matrices=False)
    directions = np.ascontiguousarray(right[:rank])
    squares = np.empty((len(basis), len(directions)), np.float32)
    block = max(1, (1 << 22) // directions.shape[1])
    for start in range(0, len(basis), block):
        part = slice(start, start + block)
        np.matmul(_products(basis[part]), directions.T, out=squares[part])
    return SurfaceFields(basis, squares, directions)


def predict_mean(fields: SurfaceFields, moments: DualMoments, *, group: int = 3) -> Float32Array:
    """Return displacements: (groups, points, group) float32 array [mm]."""
    flat = fields.basis @ moments.mean.T
    out = flat.reshape(len(flat), -1, group).transpose(1, 0, 2)
    return np.ascontiguousarray(out)


def predict_variance(fields: SurfaceFields, moments: DualMoments) -> Float32Array:
    """Return variances: (chains, points) float32 array [mm^2]."""
    upper = np.triu_indices(moments.covariance.shape[1])
    entries = moments.covariance[:, upper[0], upper[1]]
    read = entries @ fields.reading.T
    out = (read @ fields.squares.T).astype(np.float32, copy=False)
    np.add(out, moments.constant[:, None], out=out)
    return np.maximum(out, 0.0, out=out)


def mix_variances(moments: DualMoments, shares: Array) -> DualMoments:
    """Add up the variances of consecutive chains before they become fields, which are dear.

    Parameters
    ----------
    moments : DualMoments
    shares : (group,) float array
        Of each of the chains that are added up: the axes of a frame.
    """
    parts = np.float32(shares)
    size = moments.covariance.shape[1]
    covariance = moments.covariance.reshape(-1, len(shares), size * size)
    return DualMoments(
        moments.mean,
        np.tensordot(covariance, parts, axes=(1, 0)).reshape(-1, size, size),
        moments.constant.reshape(-1, len(shares)) @ parts,
    )


def _products(basis: Float32Array) -> Float32Array:
    i, j = np.triu_indices(basis.shape[1])
    out: Float32Array = basis[:, i] * basis[:, j]
    out *= np.where(i == j, 1.0, 2.0).astype(np.float32)
    return out
