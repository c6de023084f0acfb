"""Regional features of a Gaussian process, and its evaluation.

The jaw moves by centimetres, a lid by millimetres: distances between faces over all markers hardly
depend on the lid. Features of a region weigh markers by their relevance for its shapes, estimated
from all frames of a take and the weights of a global mapping.
"""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import FloatArray, IntArray, RealArray, frame_blocks

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


class LocalSums:
    """``sum_i dual[i, j] exp(exponent[k] |x projection[k] - centres[k, i]|^2)``, k the region of j.

    The kernels of all regions are evaluated in batches. Kernels with small duals are evaluated in
    single precision, in half the time.

    Parameters
    ----------
    projection : (k, D, d) float array
        From coordinates to the features of each region.
    centres : (k, n, d) float array
    exponent : (k,) float array
        Negative.
    dual : (n, s) float array
    region : (s,) int array
        Of each output.
    """

    def __init__(
        self,
        projection: FloatArray,
        centres: FloatArray,
        exponent: FloatArray,
        dual: FloatArray,
        region: IntArray,
    ) -> None:
        self._outputs = dual.shape[1]
        most = int(np.bincount(region).max())
        columns = np.full((len(projection), most), self._outputs)  # padded by an unused output
        duals = np.zeros((len(projection), len(dual), most))
        for k in range(len(projection)):
            outputs = np.flatnonzero(region == k)
            columns[k, : len(outputs)], duals[k, :, : len(outputs)] = outputs, dual[:, outputs]
        # maps features, their squared norm and 1 to exponents
        squares = np.einsum("knd,knd->kn", centres, centres)[:, :, None]
        operand = np.concatenate([-2.0 * centres, np.ones_like(squares), squares], axis=2)
        operand = operand.transpose(0, 2, 1) * exponent[:, None, None]
        norms = np.linalg.norm(duals, axis=1).max(axis=1)
        rounded = norms <= _SINGLE_NORM
        self._groups: list[_Kernels] = []
        for kind, chosen in ((np.float32, rounded & (norms > 0)), (np.float64, ~rounded)):
            parts: list[RealArray] = [
                array[chosen].astype(kind, order="C") for array in (projection, operand, duals)
            ]
            self._groups.append(_Kernels(columns[chosen].ravel(), *parts))

    def __call__(self, points: FloatArray) -> FloatArray:
        """Evaluate the sums: (f, D) points to (f, s) outputs."""
        out = np.zeros((len(points), self._outputs + 1))
        for group in self._groups:
            out[:, group.columns] = group.sums(points)
        return out[:, :-1]


@dataclass(frozen=True)
class _Kernels:
    """Kernels of one precision."""

    columns: IntArray
    """(k * m,): their outputs."""
    projection: RealArray
    """(k, D, d)"""
    operand: RealArray
    """(k, d + 2, n)"""
    dual: RealArray
    """(k, n, m): of the m outputs of each kernel."""

    def sums(self, points: FloatArray) -> RealArray:
        """Evaluate them: (f, D) points to (f, k * m) outputs."""
        kernels, pairs, outputs = self.dual.shape
        rows = points.astype(self.dual.dtype)
        sums = np.empty((kernels, len(rows), outputs), self.dual.dtype)
        batch = max(_BLOCK_VALUES // max(len(rows) * pairs, 1), 1)
        for some in frame_blocks(kernels, frames=batch):
            sums[some] = self._sums_of(rows, some)
        return sums.transpose(1, 0, 2).reshape(len(rows), kernels * outputs)

    def _sums_of(self, points: RealArray, some: slice) -> RealArray:
        projection = self.projection[some]
        rows = np.empty((len(projection), len(points), projection.shape[2] + 2), points.dtype)
        features = np.matmul(points, projection, out=rows[:, :, :-2])
        np.einsum("kfd,kfd->kf", features, features, out=rows[:, :, -2])
        rows[:, :, -1] = 1.0
        values: RealArray = np.matmul(rows, self.operand[some])
        np.exp(values, out=values)
        return np.asarray(np.matmul(values, self.dual[some]))
