"""Optimal designs: the frames of a recording to tune by hand, and the covariance between frames.

All designs are greedy and deterministic, with ties to the earlier frame. Frames already tuned are
part of the design. Memory is linear in the number of frames.
"""

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import FloatArray, IntArray, first_largest, sample_frames

KEY_VARIANCE = 1e-2
"""Variance of a tuned weight around the true one; the kernel's is of the order of 10."""

_LINEAR_VARIANCE, _RADIAL_VARIANCE = 10.0, 3.0
"""Mean variance of the kernel's two parts."""

MEDIAN_ROWS = 512
"""Evenly spaced rows for the median distance."""


@dataclass(frozen=True)
class DesignKernel:
    """``linear * <x, y> + radial * exp(exponent * |x - y|^2)``.

    The linear part models proportional motion, the radial part combinations, which only similar
    faces share.
    """

    linear: float
    radial: float
    exponent: float

    @classmethod
    def for_rows(cls, rows: FloatArray) -> "DesignKernel":
        """Scale the kernel to some frames, (frames, d).

        The squared width of the radial part is the frames' median squared distance.
        """
        mean_square = float(np.einsum("ij,ij->", rows, rows)) / len(rows)
        some = rows[sample_frames(len(rows), MEDIAN_ROWS)]
        squared = np.einsum("ij,ij->i", some, some)
        away = squared[:, None] + squared - 2 * some @ some.T
        median = float(np.median(away[np.triu_indices(len(some), 1)])) if len(some) > 1 else 1.0
        median = max(median, 1e-12 * mean_square, 1e-300)
        return cls(_LINEAR_VARIANCE / max(mean_square, 1e-300), _RADIAL_VARIANCE, -0.5 / median)

    @classmethod
    def for_size(cls, square: float) -> "DesignKernel":
        """Scale the kernel to rows whose mean squared length and squared distance is `square`."""
        return cls(_LINEAR_VARIANCE / square, _RADIAL_VARIANCE, -0.5 / square)

    def __call__(self, left: FloatArray, right: FloatArray) -> FloatArray:
        """Return the covariances between the rows of two arrays."""
        product = left @ right.T
        away = (left**2).sum(1)[:, None] + (right**2).sum(1) - 2 * product
        out: FloatArray = self.linear * product
        out += self.radial * np.exp(self.exponent * np.maximum(away, 0.0))
        return out

    def diagonal(self, rows: FloatArray) -> FloatArray:
        """Return the prior variance of every row."""
        return np.asarray(self.linear * np.einsum("ij,ij->i", rows, rows) + self.radial)


def cholesky_factor(kernel: DesignKernel, known: FloatArray) -> FloatArray:
    """Return the lower Cholesky factor of the covariance of tuned frames, with their errors."""
    covariance = kernel(known, known) + KEY_VARIANCE * np.eye(len(known))
    return np.asarray(np.linalg.cholesky(covariance))


def posterior_shares(kernel: DesignKernel, known: FloatArray, rows: FloatArray) -> FloatArray:
    """Return the posterior over the prior variance of every row, given tuned frames.

    Returns (n + 1, frames) [0-1], given the first 0, 1, ... n of them.

    Parameters
    ----------
    known : (n, d) float array
        Features of the tuned frames.
    rows : (frames, d) float array
    """
    # Row i is what frame i explains given those before it.
    explained = np.linalg.solve(cholesky_factor(kernel, known), kernel(known, rows)) ** 2
    shares = np.ones((len(known) + 1, len(rows)))
    shares[1:] -= np.cumsum(explained, axis=0) / kernel.diagonal(rows)
    return np.clip(shares, 0.0, 1.0)


def predict_from(
    kernel: DesignKernel, known: FloatArray, values: FloatArray, rows: FloatArray
) -> FloatArray:
    """Return the Gaussian process's posterior mean at other frames, (frames, s).

    Parameters
    ----------
    kernel, known, rows
        As for `posterior_shares`.
    values : (n, s) float array
        Of the tuned frames.
    """
    mean = values.mean(axis=0)
    precise = kernel(known, known) + KEY_VARIANCE * np.eye(len(known))
    return np.asarray(mean + kernel(rows, known) @ np.linalg.solve(precise, values - mean))


_FIRST_INFORMATION = 1e-3
"""Prior information, which only breaks ties among the first frames."""

_LEAST_LENGTH_SHARE = 1e-3
"""[of the longest row] Shorter residuals of rows are linearly dependent."""


@dataclass(frozen=True)
class Design:
    """Chosen frames and their gains."""

    chosen: IntArray
    """(count,): row indices in the order of choice, without frames already tuned."""
    gain: FloatArray
    """(count,): leverage, squared distance or variance of each frame when it was chosen; not
    increasing."""


def whiten(coordinates: FloatArray, variances: FloatArray, *, power: float = 0.5) -> FloatArray:
    """Scale coordinates by ``variance ** (-power / 2)``."""
    floor = 1e-9 * float(variances.max(initial=0.0)) + 1e-300
    return np.asarray(coordinates * np.maximum(variances, floor) ** (-power / 2))


def design_d_optimal(
    features: FloatArray, count: int, *, already: IntArray | None = None
) -> Design:
    """Choose frames by greedy D-optimality, the largest leverage.

    A frame multiplies the determinant of the information matrix by one plus its leverage.

    Parameters
    ----------
    features : (frames, d) float array
        Whitened; a constant column is added for the intercept.
    count : int
        Number of frames to choose.
    already : (n,) int array, optional
        Rows that are part of the design.
    """
    start = _known_rows(features, count, already)
    rows = np.column_stack([features, np.ones(len(features))])
    inverse = np.eye(rows.shape[1]) / _FIRST_INFORMATION
    leverage = np.einsum("ij,ij->i", rows, rows) / _FIRST_INFORMATION

    def add(pick: int) -> None:
        direction = inverse @ rows[pick]
        spread = 1.0 + float(rows[pick] @ direction)
        inverse[:] -= np.outer(direction, direction) / spread
        leverage[:] -= (rows @ direction) ** 2 / spread

    return _choose_greedily(leverage, count, start, add)


def design_k_centre(features: FloatArray, count: int, *, already: IntArray | None = None) -> Design:
    """Choose frames by farthest-point sampling, starting with the one farthest from the mean.

    The largest distance to a chosen frame is at most twice that of the optimal set.

    Parameters
    ----------
    features, count, already
        As for `design_d_optimal`.

    References
    ----------
    Gonzalez (1985), Theoretical Computer Science 38, 293-306.
    """
    start = _known_rows(features, count, already)
    squared = np.einsum("ij,ij->i", features, features)

    def distance_to(point: FloatArray) -> FloatArray:
        away = squared - 2.0 * (features @ point) + float(point @ point)
        return np.asarray(np.maximum(away, 0.0))

    if count and not len(start):
        first = first_largest(distance_to(features.mean(axis=0)))
        rest = design_k_centre(features, count - 1, already=np.array([first], np.int64))
        return Design(np.append(first, rest.chosen), np.append(np.inf, rest.gain))
    nearest = np.full(len(features), np.inf)

    def add(pick: int) -> None:
        np.minimum(nearest, distance_to(features[pick]), out=nearest)

    return _choose_greedily(nearest, count, start, add)


def design_gp_variance(
    features: FloatArray, count: int, *, already: IntArray | None = None, noise: float = 1e-3
) -> Design:
    """Choose frames by the largest posterior variance of a Gaussian process.

    The covariance is `DesignKernel.for_rows`; rows of its pivoted Cholesky factor are the variance
    that each chosen frame explains.

    Parameters
    ----------
    features, count, already
        As for `design_d_optimal`.
    noise : float
        Variance of a tuned weight around the truth.

    References
    ----------
    Krause, Singh and Guestrin (2008), JMLR 9, 235-284.
    """
    start = _known_rows(features, count, already)
    kernel = DesignKernel.for_rows(features)
    variance = kernel.diagonal(features)
    factor = np.empty((len(start) + count, len(features)))
    turns = itertools.count()

    def add(pick: int) -> None:
        turn = next(turns)
        row = kernel(features[pick : pick + 1], features)[0] - factor[:turn, pick] @ factor[:turn]
        factor[turn] = row / np.sqrt(max(float(variance[pick]), 0.0) + noise)
        variance[:] -= factor[turn] ** 2

    return _choose_greedily(variance, count, start, add)


def pivoted_selection(rows: FloatArray, count: int) -> IntArray:
    """Choose rows by pivoted orthogonalisation: the farthest from the span of those chosen.

    So a half smile is not chosen in addition to the full one. Returns (m,), in the order chosen;
    fewer than `count` if their span has fewer dimensions.

    Parameters
    ----------
    rows : (n, k) float array
        Differences from the origin.
    count : int
        Most rows to choose.
    """
    residual = np.array(rows, dtype=np.float64)
    energy = np.einsum("nk,nk->n", residual, residual)
    least = _LEAST_LENGTH_SHARE**2 * float(energy.max(initial=0.0))
    chosen: list[int] = []
    for _ in range(min(count, len(residual))):
        best = first_largest(energy)
        if not energy[best] > least:
            break
        direction = residual[best] / np.sqrt(energy[best])
        residual -= np.outer(residual @ direction, direction)
        energy = np.einsum("nk,nk->n", residual, residual)
        energy[chosen] = 0.0
        energy[best] = 0.0
        chosen.append(best)
    return np.array(chosen, np.int64)


def _choose_greedily(
    score: FloatArray, count: int, start: IntArray, add: Callable[[int], None]
) -> Design:
    """Choose the rows of the largest score one by one; `add` updates the score after each.

    The rows of `start` are part of the design.
    """
    free, chosen, gain = np.ones(len(score), np.bool_), list[int](), list[float]()
    for turn in range(-len(start), count):
        pick = int(start[turn]) if turn < 0 else first_largest(np.where(free, score, -np.inf))
        if turn >= 0:
            chosen.append(pick)
            gain.append(float(score[pick]))
        free[pick] = False
        add(pick)
    return Design(np.array(chosen, np.int64), np.array(gain, np.float64))


def _known_rows(features: FloatArray, count: int, already: IntArray | None) -> IntArray:
    """Return the rows that are part of the design, of checked arguments."""
    if not np.isfinite(features).all():
        bad = int(np.flatnonzero(~np.isfinite(features).all(axis=1))[0])
        raise ValueError(f"features of row {bad} are not finite")
    start = np.zeros(0, dtype=np.int64) if already is None else np.unique(already)
    free = len(features) - len(start)
    if not 0 <= count <= free:
        raise ValueError(f"cannot choose {count} of {free} frames that are free")
    return start
