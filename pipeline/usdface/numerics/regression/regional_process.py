"""Processes over the part of the face that each shape moves: their features, and their sums.

The jaw moves centimetres and a lid millimetres. Seen over all markers, the lid drowns; seen over
the markers that its shapes move, it does not. Which markers those are is learned from all frames
of a take through weights that a first, plain mapping gives them.
"""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import FloatArray, IntArray, RealArray

_RIDGE_SHARE = 0.02
"""Ridge per frame on standardised weights: shapes that act together share the motion."""

LEAST_RELEVANCE = 0.05
"""Of a marker for a shape: none is ignored wholly."""

_SINGLE_NORM = 1.5
"""Norm of an output's duals up to which its kernels are evaluated in single precision: rounding
moved sums by at most 2.6e-7 times that norm on mappings of 50 and 100 pairs, 4e-7 of a weight."""

_BLOCK_VALUES = 1 << 17
"""Kernel values at once: enough that calls are cheap. Larger, arrays come fresh from the system
each time, which costs more than it saves."""


@dataclass(frozen=True)
class RegionalFeatures:
    """Coordinates that measure distance over one region."""

    projection: FloatArray
    """(D, D): ``coordinates @ projection`` are uncorrelated over the sample, the largest variance
    first."""
    variances: FloatArray
    """(D,)"""


def marker_relevance(sample: FloatArray, weights: FloatArray, components: FloatArray) -> FloatArray:
    """How much each marker has to do with each shape.

    Markers are regressed on weights; a marker's relevance is how far it moves with the shape,
    against the marker that moves most.

    Parameters
    ----------
    sample : (frames, D) float array
        Coordinates in the motion space.
    weights : (frames, s) float array
        Of the same frames, from any mapping.
    components : (D, markers * 3) float array

    Returns
    -------
    (s, markers) float array
        From `LEAST_RELEVANCE` to 1.
    """
    centred = weights - weights.mean(axis=0)
    standard = centred / (centred.std(axis=0) + 1e-4)
    normal = standard.T @ standard + _RIDGE_SHARE * len(standard) * np.eye(standard.shape[1])
    moves = np.linalg.solve(normal, standard.T @ (sample - sample.mean(axis=0))) @ components
    length = np.linalg.norm(moves.reshape(len(moves), -1, 3), axis=2)
    share = length / np.maximum(length.max(axis=1, keepdims=True), 1e-12)
    relevance: FloatArray = np.maximum(share, LEAST_RELEVANCE)
    return relevance


def regional_features(
    components: FloatArray, covariance: FloatArray, relevance: FloatArray
) -> RegionalFeatures:
    """Principal axes of the motion under a metric that weighs markers by relevance.

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
    return RegionalFeatures(factor @ vectors[:, ::-1], variances)


class LocalSums:
    """``sum_i dual[i, j] exp(exponent[k] |x projection[k] - centres[k, i]|^2)``, k the region of j.

    Where regions have their own features, nothing of one kernel serves another; they are laid side
    by side, so that a block of points takes few calls and not some per region. Kernels whose duals
    are small are evaluated in single precision, at half the time.

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
        columns = np.full((len(projection), most), self._outputs)  # the one beyond the last: none
        duals = np.zeros((len(projection), len(dual), most))
        for k in range(len(projection)):
            its = np.flatnonzero(region == k)
            columns[k, : len(its)], duals[k, :, : len(its)] = its, dual[:, its]
        # of features, their squared norm and 1, makes exponents
        squares = np.einsum("knd,knd->kn", centres, centres)[:, :, None]
        operand = np.concatenate([-2.0 * centres, np.ones_like(squares), squares], axis=2)
        operand = operand.transpose(0, 2, 1) * exponent[:, None, None]
        norms = np.linalg.norm(duals, axis=1).max(axis=1)
        rounded = norms <= _SINGLE_NORM
        self._groups: list[_Kernels] = []
        for kind, chosen in ((np.float32, rounded & (norms > 0)), (np.float64, ~rounded)):
            parts: list[RealArray] = [
                each[chosen].astype(kind, order="C") for each in (projection, operand, duals)
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
    """(k * m,): which outputs they make."""
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
        found = np.empty((kernels, len(rows), outputs), self.dual.dtype)
        together = max(_BLOCK_VALUES // max(len(rows) * pairs, 1), 1)
        for start in range(0, kernels, together):
            some = slice(start, start + together)
            found[some] = self._sums_of(rows, some)
        return found.transpose(1, 0, 2).reshape(len(rows), kernels * outputs)

    def _sums_of(self, points: RealArray, some: slice) -> RealArray:
        projection = self.projection[some]
        rows = np.empty((len(projection), len(points), projection.shape[2] + 2), points.dtype)
        features = np.matmul(points, projection, out=rows[:, :, :-2])
        np.einsum("kfd,kfd->kf", features, features, out=rows[:, :, -2])
        rows[:, :, -1] = 1.0
        values: RealArray = np.matmul(rows, self.operand[some])
        np.exp(values, out=values)
        sums: RealArray = np.matmul(values, self.dual[some])
        return sums
