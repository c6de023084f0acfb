"""Laplace approximation of the posteriors of many chains: modes and Gaussians around them."""

from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np

from usdface.core.arrays import BoolArray, IntArray, RealArray

Energy = Callable[[RealArray], tuple[RealArray, RealArray]]
"""``energy(theta)`` of theta (4, chains): energies (chains,) and gradients (4, chains)."""

_HESSIAN_STEPS = {"float32": 1e-2, "float64": 1e-4}
"""Step in theta of finite differences of the gradient: about the cube root of the rounding of the
precision, at which rounding and truncation errors are equal."""

_LEAST_CURVATURE = 0.05
"""Least pivot of the Hessian [per unit of theta squared]; the prior alone has 1 / 1.5^2 = 0.44."""

_LONGEST_STEP = 2.0
"""Of Newton's method, in theta."""

_LEAST_GAIN = 1e-3
"""Decrease of the energy by the next Newton step at convergence; samples have a standard deviation
of about 1.4 in energy."""


@dataclass(frozen=True)
class LaplaceFit:
    """A mode of each chain's posterior and the Gaussian with the same curvature there."""

    mode: RealArray
    """(4, chains)"""
    energy: RealArray
    """(chains,): at the mode."""
    root: RealArray
    """(4, 4, chains): ``root @ root'`` is the inverse of the Hessian at the mode."""
    inverse: RealArray
    """(4, 4, chains): of `root`; maps theta to whitened coordinates."""
    log_evidence: RealArray
    """(chains,): logarithm of the posterior's mass around the mode, up to a constant."""

    def whiten(self, theta: RealArray) -> RealArray:
        """Return whitened coordinates of theta (4, chains)."""
        return np.asarray(np.sum(self.inverse * (theta - self.mode)[None], axis=1))

    def theta(self, white: RealArray) -> RealArray:
        """Return theta of whitened coordinates (4, chains)."""
        return np.asarray(self.mode + np.sum(self.root * white[None], axis=1))

    def take(self, chains: IntArray) -> "LaplaceFit":
        """Return the fits of some chains, by their indices."""
        return LaplaceFit(
            *(np.take(getattr(self, field.name), chains, axis=-1) for field in fields(self))
        )


def select_fits(mask: BoolArray, first: LaplaceFit, second: LaplaceFit) -> LaplaceFit:
    """Return the first fit where `mask` is true, else the second, chain by chain."""
    return LaplaceFit(
        *(
            np.where(mask, getattr(first, field.name), getattr(second, field.name))
            for field in fields(LaplaceFit)
        )
    )


def fit_laplace(energy: Energy, start: RealArray, *, iterations: int = 10) -> LaplaceFit:
    """Minimise the energy from `start` by Newton's method within a trust region.

    Parameters
    ----------
    start : (4, chains) array
    iterations : int
        At most.
    """
    theta = start
    value, gradient = energy(theta)
    radius = np.full_like(value, _LONGEST_STEP)
    remaining = iterations
    while True:
        root, inverse, log_curvature = _factorise(_hessian(energy, theta, gradient))
        white_slope = np.sum(root * gradient[:, None], axis=0)
        gain = 0.5 * np.sum(white_slope * white_slope, axis=0)
        gain = np.where(np.isfinite(gain), gain, np.zeros_like(gain))
        if remaining == 0 or float(np.max(gain)) < _LEAST_GAIN:
            break
        remaining -= 1
        step = -np.sum(root * white_slope[None], axis=1)
        length = np.sqrt(np.sum(step * step, axis=0))
        step = step * np.clip(radius / np.clip(length, 1e-9, None), None, 1.0)
        new_value, new_gradient = energy(theta + step)
        better = new_value <= value
        theta = np.where(better, theta + step, theta)
        gradient = np.where(better, new_gradient, gradient)
        value = np.where(better, new_value, value)
        radius = np.clip(np.where(better, 2.0 * radius, 0.25 * radius), None, _LONGEST_STEP)
    return LaplaceFit(theta, value, root, inverse, -value - 0.5 * log_curvature)


def _hessian(energy: Energy, theta: RealArray, gradient: RealArray) -> RealArray:
    """Return the Hessian by finite differences of the gradient: (4, 4, chains)."""
    step = _HESSIAN_STEPS[theta.dtype.name]
    rows = np.empty((4, *theta.shape), theta.dtype)
    for parameter in range(4):
        moved = theta.copy()
        moved[parameter] += step
        row = (energy(moved)[1] - gradient) / step
        rows[parameter] = np.where(np.isfinite(row), row, np.zeros_like(row))
    return np.asarray(0.5 * (rows + rows.transpose(1, 0, 2)))


def _factorise(hessian: RealArray) -> tuple[RealArray, RealArray, RealArray]:
    """Factorise ``H = L D L'`` of each chain, pivots D made positive.

    Returns
    -------
    root : (4, 4, chains) array
        ``inv(L)' D^(-1/2)``
    inverse : (4, 4, chains) array
        ``D^(1/2) L'``
    log_determinant : (chains,) array
    """
    L, inverse_L = np.zeros_like(hessian), np.zeros_like(hessian)
    pivots = np.empty_like(hessian[0])
    for j in range(4):
        pivot = hessian[j, j]
        for k in range(j):
            pivot = pivot - L[j, k] * L[j, k] * pivots[k]
        pivots[j] = np.clip(np.abs(pivot), _LEAST_CURVATURE, None)
        L[j, j] = inverse_L[j, j] = 1.0
        for i in range(j + 1, 4):
            entry = hessian[i, j]
            for k in range(j):
                entry = entry - L[i, k] * L[j, k] * pivots[k]
            L[i, j] = entry / pivots[j]
    for j in range(4):
        for i in range(j + 1, 4):
            inverse_L[i, j] = -sum(L[i, k] * inverse_L[k, j] for k in range(j, i))
    scales = np.sqrt(pivots)
    root = inverse_L.transpose(1, 0, 2) / scales
    inverse = L.transpose(1, 0, 2) * scales[:, None]
    return root, inverse, 2.0 * np.sum(np.log(scales), axis=0)
