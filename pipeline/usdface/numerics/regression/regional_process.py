"""Regional features of a Gaussian process, and its evaluation.

The jaw moves by centimetres, a lid by millimetres: distances between faces over all markers hardly
depend on the lid. Features of a region weigh markers by their relevance for its shapes, from the
rig (`face_map`) or from frames with weights (`marker_relevance`).
"""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import Float32Array, FloatArray, IntArray, frame_blocks, single_precision
from usdface.numerics.regression.gaussian_process import OFFSET_VARIANCE

_RIDGE_SHARE = 0.02
"""Ridge per frame for standardised weights: correlated shapes share the motion."""

LEAST_RELEVANCE = 0.05
"""Smallest relevance of a marker for a shape: all markers distinguish faces."""

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
    """Gaussian processes of all regions, evaluated in batches: local parts and variances.

    With ``x = point @ projection[k]`` the features of region k::

        local_j    = sum_i dual[i, j] exp(exponent[k] |x - c_i|^2),    k the region of output j
        k_i        = <x, c_i> + radial exp(exponent[k] |x - c_i|^2) + OFFSET_VARIANCE
        variance_k = k(x, x) - k' (K + noise[k] I)^-1 k

    In single precision, in half the time: on mappings of 25 and 50 pairs, sums differ from those in
    double precision by less than 1e-4 of a weight, deviations by less than 1 %.

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
        count, most = len(projection), int(np.bincount(region).max())
        self._outputs = dual.shape[1]
        self._columns = np.full((count, most), self._outputs)  # padded by an unused output
        duals = np.zeros((count, len(dual), most))
        for k in range(count):
            outputs = np.flatnonzero(region == k)
            self._columns[k, : len(outputs)] = outputs
            duals[k, :, : len(outputs)] = dual[:, outputs]
        products, size2 = centres @ centres.transpose(0, 2, 1), (centres**2).sum(axis=2)[:, None]
        exponents = exponent[:, None, None]
        covariance = radial * np.exp(exponents * (size2 + size2.transpose(0, 2, 1) - 2 * products))
        covariance += products + OFFSET_VARIANCE + noise[:, None, None] * np.eye(len(dual))
        root = np.linalg.cholesky(np.linalg.inv(covariance))
        # The terms of OFFSET_VARIANCE, which would take the digits of single precision in k.
        offset = OFFSET_VARIANCE * root.sum(axis=1)[:, None]
        constant = OFFSET_VARIANCE + radial - (offset**2).sum(axis=2)
        self._radial = radial
        self._projection, self._exponent = single_precision(projection), single_precision(exponents)
        self._centres = single_precision(centres.transpose(0, 2, 1))
        self._size2, self._dual = single_precision(size2), single_precision(duals)
        self._root, self._offset = single_precision(root), single_precision(2 * offset)
        self._constant = single_precision(constant)

    def __call__(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Evaluate (f, D) points: (f, s) local parts, and (f, k) variances."""
        count, pairs, outputs = self._dual.shape
        rows = single_precision(points)
        sums = np.empty((count, len(rows), outputs), np.float32)
        variance = np.empty((count, len(rows)))
        most = max(_BLOCK_VALUES // max(len(rows) * pairs, 1), 1)
        for some in frame_blocks(count, frames=most):
            sums[some], variance[some] = self._evaluate(rows, some)
        local = np.empty((len(rows), self._outputs + 1))
        local[:, self._columns.ravel()] = sums.transpose(1, 0, 2).reshape(
            len(rows), count * outputs
        )
        return local[:, : self._outputs], np.maximum(variance.T, 0.0)

    def _evaluate(self, points: Float32Array, some: slice) -> tuple[Float32Array, Float32Array]:
        """Return local parts (regions, f, outputs) and variances (regions, f) of some regions."""
        features = np.matmul(points, self._projection[some])
        size2 = np.einsum("kfd,kfd->kf", features, features)
        products = np.matmul(features, self._centres[some])
        values = np.asarray(-2 * products)
        values += self._size2[some]
        values += size2[:, :, None]
        values *= self._exponent[some]
        np.exp(values, out=values)
        local = np.matmul(values, self._dual[some])
        values *= self._radial
        values += products
        explained = np.matmul(values, self._root[some])
        variance = size2 + self._constant[some]
        variance -= np.einsum("kfn,kfn->kf", explained, explained + self._offset[some])
        return local, variance
