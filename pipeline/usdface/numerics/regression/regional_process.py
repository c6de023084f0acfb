"""Regional features of a Gaussian process, and its evaluation.

The jaw moves by centimetres, a lid by millimetres: distances between faces over all markers hardly
depend on the lid. Features of a region weigh markers by their relevance for its shapes, estimated
from all frames of a take and the weights of a global mapping.
"""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import FloatArray, IntArray, RealArray, frame_blocks
from usdface.numerics.regression.gaussian_process import OFFSET_VARIANCE

_RIDGE_SHARE = 0.02
"""Ridge per frame for standardised weights: correlated shapes share the motion."""

LEAST_RELEVANCE = 0.05
"""Of a marker for a shape."""

_SINGLE_NORM = 1.5
"""Norm of an output's duals up to which its kernels are evaluated in single precision: rounding
errors of sums were at most 2.6e-7 times that norm on mappings of 50 and 100 pairs, 4e-7 of a
weight."""

_BLOCK_VALUES = 1 << 17
"""Kernel values per block. Larger arrays are allocated from the system each time, which is
slower."""


@dataclass(frozen=True)
class RegionalFeatures:
    """Coordinates whose distance is that of one region."""

    projection: FloatArray
    """(D, D): ``coordinates @ projection`` are uncorrelated over the sample, the largest variance
    first."""
    variances: FloatArray
    """(D,)"""
    axes: FloatArray
    """(3 markers, D): ``displacements @ axes`` are the same for displacements that are combinations
    of the components. For others, they depend on markers by their relevance alone."""


def marker_relevance(sample: FloatArray, weights: FloatArray, components: FloatArray) -> FloatArray:
    """Return the relevance of each marker for each shape.

    The displacement of a marker by a shape in a regression of markers on weights, over the largest
    of any marker. Returns (s, markers), from `LEAST_RELEVANCE` to 1.

    Parameters
    ----------
    sample : (frames, D) float array
        Coordinates in the motion space.
    weights : (frames, s) float array
        Of the same frames, from any mapping.
    components : (D, markers * 3) float array
    """
    centred = weights - weights.mean(axis=0)
    standard = centred / (centred.std(axis=0) + 1e-4)
    normal = standard.T @ standard + _RIDGE_SHARE * len(standard) * np.eye(standard.shape[1])
    moves = np.linalg.solve(normal, standard.T @ (sample - sample.mean(axis=0))) @ components
    length = np.linalg.norm(moves.reshape(len(moves), -1, 3), axis=2)
    share = length / np.maximum(length.max(axis=1, keepdims=True), 1e-12)
    return np.asarray(np.maximum(share, LEAST_RELEVANCE))


def regional_features(
    components: FloatArray, covariance: FloatArray, relevance: FloatArray
) -> RegionalFeatures:
    """Return the principal axes of the motion, with markers weighted by relevance.

    Parameters
    ----------
    components : (D, markers * 3) float array
    covariance : (D, D) float array
        Of the coordinates over all frames [mm^2].
    relevance : (markers,) float array
    """
    seen = components * np.repeat(relevance, 3)
    metric = seen @ seen.T
    metric += 1e-9 * np.trace(metric) * np.eye(len(metric))
    factor = np.linalg.cholesky(metric)
    values, vectors = np.linalg.eigh(factor.T @ covariance @ factor)
    variances = np.maximum(values[::-1], 1e-9 * values[-1])
    orthonormal = np.linalg.solve(factor, seen)
    axes = np.repeat(relevance, 3)[:, None] * (orthonormal.T @ vectors[:, ::-1])
    return RegionalFeatures(factor @ vectors[:, ::-1], variances, axes)


class RegionalProcesses:
    """Gaussian processes of all regions: local parts and variances.

    With ``x = point @ projection[k]`` the features of region k::

        local_j    = sum_i dual[i, j] exp(exponent[k] |x - c_i|^2),    k the region of output j
        k_i        = <x, c_i> + radial exp(exponent[k] |x - c_i|^2) + OFFSET_VARIANCE
        variance_k = k(x, x) - k' (K + noise[k] I)^-1 k

    Regions are evaluated in batches. Those with small duals are evaluated in single precision, in
    half the time.

    Parameters
    ----------
    projection : (k, D, d) float array
        From coordinates to the features of each region.
    centres : (k, n, d) float array
        Features of the pairs, c.
    exponent, noise : (k,) float arrays
        Exponents are negative.
    radial : float
        Prior variance of the local part.
    dual : (n, s) float array
    region : (s,) int array
        Of each output.
    """

    def __init__(
        self,
        projection: FloatArray,
        centres: FloatArray,
        exponent: FloatArray,
        noise: FloatArray,
        radial: float,
        dual: FloatArray,
        region: IntArray,
    ) -> None:
        self._outputs, self._regions = dual.shape[1], len(projection)
        most = int(np.bincount(region).max())
        columns = np.full((self._regions, most), self._outputs)  # padded by an unused output
        duals = np.zeros((self._regions, len(dual), most))
        for k in range(self._regions):
            outputs = np.flatnonzero(region == k)
            columns[k, : len(outputs)], duals[k, :, : len(outputs)] = outputs, dual[:, outputs]
        products, size2 = centres @ centres.transpose(0, 2, 1), (centres**2).sum(axis=2)[:, None]
        curve = exponent[:, None, None]
        covariance = radial * np.exp(curve * (size2 + size2.transpose(0, 2, 1) - 2 * products))
        covariance += products + OFFSET_VARIANCE + noise[:, None, None] * np.eye(len(dual))
        root = np.linalg.cholesky(np.linalg.inv(covariance))
        offset = OFFSET_VARIANCE * root.sum(axis=1)[:, None]
        arrays = {
            "projection": projection,
            "centres": centres.transpose(0, 2, 1),
            "size2": size2,
            "exponent": curve,
            "dual": duals,
            "root": root,
            "offset": 2 * offset,
            "rest_variance": OFFSET_VARIANCE + radial - (offset**2).sum(axis=2),
        }
        norms = np.linalg.norm(duals, axis=1).max(axis=1)
        single, double = (norms > 0) & (norms <= _SINGLE_NORM), norms > _SINGLE_NORM
        self._batches: list[_Batch] = []
        for kind, chosen in ((np.float32, single), (np.float64, double)):
            own = {name: each[chosen].astype(kind, order="C") for name, each in arrays.items()}
            regions = np.flatnonzero(chosen)
            self._batches.append(_Batch(regions, columns[regions].ravel(), radial, **own))

    def __call__(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Evaluate (f, D) points: (f, s) local parts, and (f, k) variances.

        The variance of a region whose duals are 0 is 0.
        """
        local = np.zeros((len(points), self._outputs + 1))
        variance = np.zeros((len(points), self._regions))
        for batch in self._batches:
            local[:, batch.columns], variance[:, batch.regions] = batch.evaluate(points)
        return local[:, :-1], np.maximum(variance, 0.0)


@dataclass(frozen=True)
class _Batch:
    """Regions of one precision."""

    regions: IntArray
    """(k,)"""
    columns: IntArray
    """(k * m,): their outputs."""
    radial: float
    projection: RealArray
    """(k, D, d)"""
    centres: RealArray
    """(k, d, n)"""
    size2: RealArray
    """(k, 1, n): ``|c|^2``."""
    exponent: RealArray
    """(k, 1, 1)"""
    dual: RealArray
    """(k, n, m): of the m outputs of each region."""
    root: RealArray
    """(k, n, n): R, of which ``R R' = (K + noise I)^-1``."""
    offset: RealArray
    """(k, 1, n): ``2 OFFSET_VARIANCE R' 1``."""
    rest_variance: RealArray
    """(k, 1): the terms of the variance that do not depend on the point."""

    def evaluate(self, points: FloatArray) -> tuple[RealArray, RealArray]:
        """Evaluate (f, D) points: (f, k * m) local parts and (f, k) variances."""
        count, pairs, outputs = self.dual.shape
        rows = points.astype(self.dual.dtype)
        local = np.empty((count, len(rows), outputs), self.dual.dtype)
        variance = np.empty((count, len(rows)), self.dual.dtype)
        most = max(_BLOCK_VALUES // max(len(rows) * pairs, 1), 1)
        for some in frame_blocks(count, frames=most):
            local[some], variance[some] = self._evaluate_some(rows, some)
        return local.transpose(1, 0, 2).reshape(len(rows), count * outputs), variance.T

    def _evaluate_some(self, points: RealArray, some: slice) -> tuple[RealArray, RealArray]:
        features = np.matmul(points, self.projection[some])
        size2 = np.einsum("kfd,kfd->kf", features, features)
        products = np.matmul(features, self.centres[some])
        values: RealArray = -2 * products
        values += self.size2[some]
        values += size2[:, :, None]
        values *= self.exponent[some]
        np.exp(values, out=values)
        local = np.matmul(values, self.dual[some])
        values *= self.radial
        values += products  # of the constant part, `offset` and `rest_variance`
        explained = np.matmul(values, self.root[some])
        variance = size2 + self.rest_variance[some]
        variance -= np.einsum("kfn,kfn->kf", explained, explained + self.offset[some])
        return local, variance
