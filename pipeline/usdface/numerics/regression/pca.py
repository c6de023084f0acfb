"""Principal components of long recordings, from moments summed in blocks.

Deng et al. (2006), section 5 and eq. 3: the motion space of a face, from vectors of its markers.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from usdface.core.arrays import FloatArray, frame_blocks

_BLOCK_ROWS = 8192
"""Rows converted to float64 at a time: a block fits in the cache."""


@dataclass(frozen=True)
class PCA:
    """Principal components."""

    mean: FloatArray
    """(d,)"""
    components: FloatArray
    """(k, d): orthonormal rows, the largest variance first; the largest entry of each row is
    positive, so that the same data give the same signs everywhere."""
    variances: FloatArray
    """(k,): of the data along each row (divisor n - 1)."""
    total_variance: float
    """Along all d directions."""


@dataclass(frozen=True)
class Moments:
    """Count, mean and scatter matrix of vectors."""

    count: int
    mean: FloatArray
    scatter: FloatArray


def sum_moments(blocks: Iterable[ArrayLike]) -> Moments:
    """Return the moments of the rows of many arrays, in float64 and bounded memory.

    Parameters
    ----------
    blocks : iterable of (n, d) arrays
        Any float type; each is read in slices of `_BLOCK_ROWS` rows.
    """
    origin = total = scatter = None
    count = 0
    for block in blocks:
        rows = np.asarray(block)
        for piece in frame_blocks(len(rows), frames=_BLOCK_ROWS):
            part = rows[piece].astype(np.float64)
            if origin is None or total is None or scatter is None:
                origin = part[0].copy()  # sums about a data point cancel less than about 0
                total = np.zeros_like(origin)
                scatter = np.zeros((len(origin), len(origin)))
            if part.shape[1] != len(origin):
                raise ValueError(f"blocks of {len(origin)} and of {part.shape[1]} columns")
            part -= origin
            if not np.isfinite(part).all():
                bad = piece.start + int(np.flatnonzero(~np.isfinite(part).all(axis=1))[0])
                raise ValueError(f"row {bad} holds a value that is not finite")
            total += part.sum(axis=0)
            scatter += part.T @ part
            count += len(part)
    if origin is None or total is None or scatter is None:
        raise ValueError("no rows to take moments of")
    offset = total / count
    return Moments(count, origin + offset, scatter - count * np.outer(offset, offset))


def fit_pca(data: ArrayLike, *, dimensions: int | None = None) -> PCA:
    """Fit principal components to the rows of one array.

    Parameters
    ----------
    data : (n, d) float array
    dimensions : int, optional
        Number of components; by default as many as the data have.
    """
    rows = np.asarray(data)
    if rows.ndim != 2 or len(rows) < 2:
        raise ValueError(f"principal components need at least 2 rows, got shape {rows.shape}")
    if len(rows) > rows.shape[1]:
        return pca_from_moments(sum_moments([rows]), dimensions=dimensions)
    # Few rows: the covariance matrix would square the condition number.
    points = rows.astype(np.float64)
    if not np.isfinite(points).all():
        raise ValueError("the data hold values that are not finite")
    mean = points.mean(axis=0)
    _, singular, components = np.linalg.svd(points - mean, full_matrices=False)
    variances = singular**2 / (len(points) - 1)
    return _keep(mean, components[:-1], variances[:-1], float(variances.sum()), dimensions)


def pca_from_moments(moments: Moments, *, dimensions: int | None = None) -> PCA:
    """Fit principal components from summed moments; see `fit_pca`."""
    if moments.count < 2:
        raise ValueError(f"principal components need at least 2 rows, got {moments.count}")
    values, vectors = np.linalg.eigh(moments.scatter / (moments.count - 1))
    rank = min(moments.count - 1, len(values))
    values = np.maximum(values[::-1], 0.0)
    components = vectors.T[::-1][:rank]
    return _keep(moments.mean, components, values[:rank], float(values.sum()), dimensions)


def project(pca: PCA, data: ArrayLike) -> FloatArray:
    """Return coordinates of rows along the components (Deng et al. 2006, eq. 3): (n, k).

    Parameters
    ----------
    data : (n, d) float array
        Any float type; converted in slices.
    """
    rows = np.asarray(data)
    out = np.empty((len(rows), len(pca.components)))
    offset = pca.components @ pca.mean
    for part in frame_blocks(len(rows), frames=_BLOCK_ROWS):
        np.matmul(rows[part].astype(np.float64), pca.components.T, out=out[part])
    out -= offset
    return out


def _keep(
    mean: FloatArray,
    components: FloatArray,
    variances: FloatArray,
    total: float,
    dimensions: int | None,
) -> PCA:
    count = len(variances)
    if dimensions is not None:
        if not 1 <= dimensions <= count:
            raise ValueError(
                f"dimensions must be from 1 to {count} for these data, got {dimensions}"
            )
        count = dimensions
    rows = components[:count].copy()
    peak = rows[np.arange(count), np.abs(rows).argmax(axis=1)]
    rows *= np.where(peak < 0, -1.0, 1.0)[:, None]
    return PCA(mean, rows, variances[:count].copy(), total)
