"""Covariance between frames for the selection of references."""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import FloatArray

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
        some = rows[np.linspace(0, len(rows) - 1, min(len(rows), MEDIAN_ROWS)).astype(int)]
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


def posterior_share(kernel: DesignKernel, known: FloatArray, rows: FloatArray) -> FloatArray:
    """Return the posterior over the prior variance of every row, given tuned frames.

    Parameters
    ----------
    known : (n, d) float array
        Features of the tuned frames.
    rows : (frames, d) float array

    Returns
    -------
    (frames,) float array
        [0-1]
    """
    prior = kernel.diagonal(rows)
    if not len(known):
        return np.ones(len(rows))
    factor = np.linalg.cholesky(kernel(known, known) + KEY_VARIANCE * np.eye(len(known)))
    shared = np.linalg.solve(factor, kernel(known, rows))
    explained = np.einsum("ij,ij->j", shared, shared)
    return np.asarray(np.clip(1.0 - explained / prior, 0.0, 1.0))


def predict_from(
    kernel: DesignKernel, known: FloatArray, values: FloatArray, rows: FloatArray
) -> FloatArray:
    """Return the Gaussian process's posterior mean at other frames, (frames, s).

    Parameters
    ----------
    kernel, known, rows
        As for `posterior_share`.
    values : (n, s) float array
        Of the tuned frames.
    """
    mean = values.mean(axis=0)
    precise = kernel(known, known) + KEY_VARIANCE * np.eye(len(known))
    return np.asarray(mean + kernel(rows, known) @ np.linalg.solve(precise, values - mean))
