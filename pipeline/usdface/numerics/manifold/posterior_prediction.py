"""Fields over the surface from samples of the hyper-parameters: W06, eq. 3.

The prediction at a point is linear in ``h(x) = [Q' k(x); 1; s(x)]``, which the mesh alone decides.
So what is averaged over the samples are its weights (*dual weights*), never fields::

    gamma = [rho R (z - P w); w]        rho = v0 / v1, in the terms of `hyper_posterior`
    mean(x) = h' mean(gamma)
    var(x)  = mean(v0) + h' Sigma h
    Sigma   = mean(Y'Y) + cov(gamma) - diag(mean(v0 rho R), 0)
    Y       = sqrt(v1) chol(G)^-1 [-rho P'R | I]

The variance is that of the surface, not of a marker measured there: v1 is left out. What is done
for every frame follows the array API, on the device that the fields are put on.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from usdface.core.arrays import Float32Array, FloatArray
from usdface.numerics.array_namespace import CPU, ArrayDevice, namespace_of
from usdface.numerics.manifold.hyper_posterior import PAIRS, MarkerSpectrum
from usdface.numerics.manifold.tabulated_energy import Precision

_FARTHEST = 30.0
"""Of theta: a take that stands still drives scales to 0, which single precision cannot divide."""


@dataclass(frozen=True)
class DualMoments:
    """Mean and covariance of the weights on h.

    Attributes
    ----------
    mean : (chains, N + 4) array
    covariance : (chains, N + 4, N + 4) array
    constant : (chains,) array
        v0, averaged over samples.
    """

    mean: Any
    covariance: Any
    constant: Any


def average_dual_weights(
    spectrum: MarkerSpectrum,
    displacements: FloatArray,
    theta: FloatArray,
    *,
    device: ArrayDevice = CPU,
    dtype: Precision = "float32",
) -> DualMoments:
    """Average over samples.

    Parameters
    ----------
    spectrum : MarkerSpectrum
    displacements : (chains, N) float array
        [mm]
    theta : (samples, 4, chains) float array
    device : ArrayDevice
        Where the moments are wanted.
    dtype : {'float32', 'float64'}
    """
    xp = device.namespace
    rotated = device.put(displacements @ spectrum.vectors, dtype=dtype)
    P = device.put(spectrum.trend, dtype=dtype)
    values = device.put(spectrum.values, dtype=dtype)
    count, chains, samples = P.shape[0], rotated.shape[0], len(theta)
    products = xp.stack([P[:, i] * P[:, j] for i, j in PAIRS], axis=1)
    within = np.clip(np.moveaxis(theta, 2, 0), -_FARTHEST, _FARTHEST)  # chains, samples, 4
    scales = xp.exp(device.put(np.ascontiguousarray(within), dtype=dtype))
    v0, v1, a0, a1 = (scales[:, :, k] for k in range(4))
    ratio = (v0 / v1)[:, :, None]
    R = 1.0 / (1.0 + ratio * values)
    M = xp.reshape(xp.reshape(R, (-1, count)) @ products, (chains, samples, 10))
    weighted = xp.reshape(R * rotated[:, None, :], (-1, count)) @ P
    b = xp.reshape(weighted, (chains, samples, 4))
    M[:, :, 0] += v1 / a0
    for k in (4, 7, 9):
        M[:, :, k] += v1 / a1
    inverse_root = _inverse_roots(M)
    w = (xp.matrix_transpose(inverse_root) @ (inverse_root @ b[:, :, :, None]))[:, :, :, 0]
    R *= ratio  # rho R from here on
    fitted = xp.reshape(xp.reshape(w, (-1, 4)) @ P.T, (chains, samples, count))
    weights = device.empty((chains, samples, count + 4), dtype=dtype)
    weights[:, :, :count] = R * (rotated[:, None, :] - fitted)
    weights[:, :, count:] = w
    mean = xp.mean(weights, axis=1)
    weights -= mean[:, None, :]
    scaled = xp.sqrt(v1)[:, :, None, None] * inverse_root
    spread = device.empty((chains, samples, 4, count + 4), dtype=dtype)
    spread[:, :, :, :count] = scaled @ P.T
    spread[:, :, :, :count] *= -R[:, :, None, :]
    spread[:, :, :, count:] = scaled
    rows = xp.reshape(spread, (chains, samples * 4, count + 4))
    covariance = xp.matrix_transpose(rows) @ rows
    covariance += xp.matrix_transpose(weights) @ weights
    prior = xp.sum(v0[:, :, None] * R, axis=1)
    covariance[:, :count, :count] -= prior[:, :, None] * device.put(np.eye(count), dtype=dtype)
    covariance /= samples
    return DualMoments(mean, covariance, xp.mean(v0, axis=1))


def _inverse_roots(G: Any) -> Any:
    """Invert the Cholesky factors of symmetric matrices of four, all at once.

    Parameters
    ----------
    G : (..., 10) array
        Entries in the order of `PAIRS`.

    Returns
    -------
    (..., 4, 4) array
        Lower triangular; its transpose times it is the inverse of G.
    """
    xp = namespace_of(G)
    exact = xp.astype(G, xp.float64)
    entry = {pair: exact[..., k] for k, pair in enumerate(PAIRS)}
    root: dict[tuple[int, int], Any] = {}
    for j in range(4):
        for i in range(j, 4):
            left = entry[j, i]
            for k in range(j):
                left = left - root[i, k] * root[j, k]
            root[i, j] = xp.sqrt(left) if i == j else left / root[j, j]
    zero = xp.zeros_like(root[0, 0])
    inverse = {(i, j): zero for i in range(4) for j in range(4)}
    for j in range(4):
        for i in range(j, 4):
            rest = zero + float(i == j)
            for k in range(j, i):
                rest = rest - root[i, k] * inverse[k, j]
            inverse[i, j] = rest / root[i, i]
    out = xp.stack(
        [xp.stack([inverse[i, j] for j in range(4)], axis=-1) for i in range(4)], axis=-2
    )
    return xp.astype(out, G.dtype)


def join_moments(parts: list[DualMoments]) -> DualMoments:
    """Put the chains of several batches after each other."""
    xp = namespace_of(parts[0].mean)
    return DualMoments(
        xp.concat([part.mean for part in parts]),
        xp.concat([part.covariance for part in parts]),
        xp.concat([part.constant for part in parts]),
    )


@dataclass(frozen=True)
class SurfaceFields:
    """h over a mesh, and its products compressed so that variances are one small product.

    Attributes
    ----------
    basis : (points, N + 4) array
        h
    squares : (points, rank) array
    reading : (rank, (N + 4)(N + 5) / 2) array
        ``squares @ reading`` are, nearly, the products ``h_i h_j`` of `numpy.triu_indices`'s
        order, those with i < j twice.
    device : ArrayDevice
        Where they are.
    """

    basis: Any
    squares: Any
    reading: Any
    device: ArrayDevice = CPU


def make_fields(
    spectrum: MarkerSpectrum,
    cross: Float32Array,
    places: Float32Array,
    *,
    rank: int = 128,
    rng: np.random.Generator,
    device: ArrayDevice = CPU,
    dtype: Precision = "float32",
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
    device : ArrayDevice
        Where fields will be predicted.
    dtype : {'float32', 'float64'}
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
    return SurfaceFields(
        device.put(basis, dtype=dtype),
        device.put(squares, dtype=dtype),
        device.put(directions, dtype=dtype),
        device,
    )


def predict_mean(fields: SurfaceFields, moments: DualMoments, *, group: int = 3) -> Float32Array:
    """Return displacements: (groups, points, group) float32 array [mm]."""
    flat = fields.device.fetch(fields.basis @ moments.mean.T)
    out = flat.reshape(len(flat), -1, group).transpose(1, 0, 2)
    return np.ascontiguousarray(out, np.float32)


def predict_variance(fields: SurfaceFields, moments: DualMoments) -> Float32Array:
    """Return variances: (chains, points) float32 array [mm^2]."""
    xp = namespace_of(moments.covariance)
    chains, size = moments.covariance.shape[:2]
    upper = np.triu_indices(size)
    places = fields.device.put(upper[0] * size + upper[1])
    entries = xp.take(xp.reshape(moments.covariance, (chains, size * size)), places, axis=1)
    out = (entries @ fields.reading.T) @ fields.squares.T
    out += moments.constant[:, None]
    found = fields.device.fetch(out).astype(np.float32, copy=False)
    return np.maximum(found, 0.0, out=found if found.flags.writeable else None)


def mix_variances(moments: DualMoments, shares: FloatArray) -> DualMoments:
    """Add up the variances of consecutive chains before they become fields, which are dear.

    Parameters
    ----------
    moments : DualMoments
    shares : (group,) float array
        Of each of the chains that are added up: the axes of a frame.
    """
    xp = namespace_of(moments.mean)
    size, count = moments.covariance.shape[1], len(shares)
    covariance = xp.reshape(moments.covariance, (-1, count, size, size))
    constant = xp.reshape(moments.constant, (-1, count))
    return DualMoments(
        moments.mean,
        sum(covariance[:, k, :, :] * float(share) for k, share in enumerate(shares)),
        sum(constant[:, k] * float(share) for k, share in enumerate(shares)),
    )


def _products(basis: Float32Array) -> Float32Array:
    i, j = np.triu_indices(basis.shape[1])
    out: Float32Array = basis[:, i] * basis[:, j]
    out *= np.where(i == j, 1.0, 2.0).astype(np.float32)
    return out
