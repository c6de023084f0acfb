"""The most probable hyper-parameters of many chains at once, and the Gaussian around each."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

Energy = Callable[..., tuple[Any, Any]]
"""``energy(theta, with_energy=True)`` of theta (4, chains): energies (chains,), gradients."""

_DIFFERENCE = 1e-4
"""Step in theta of the Hessian's finite differences of the analytic gradient."""

_FLATTEST = 0.05
"""Least curvature, per unit of theta squared: priors have 0.44."""

_FARTHEST = 2.0
"""Longest Newton step in theta."""


@dataclass(frozen=True)
class LaplaceFit:
    """A mode of each chain's posterior and the Gaussian that touches it there.

    Attributes
    ----------
    mode : (4, chains) array
    energy : (chains,) array
        At the mode.
    root : (4, 4, chains) array
        ``root @ root'`` is the inverse of the Hessian at the mode.
    log_evidence : (chains,) array
        Of the posterior's mass around the mode, up to a constant.
    """

    mode: Any
    energy: Any
    root: Any
    log_evidence: Any


def fit_laplace(energy: Energy, start: Any, *, iterations: int = 10) -> LaplaceFit:
    """Go downhill from `start` by Newton steps within a trust region.

    Parameters
    ----------
    energy : callable
    start : (4, chains) array
    iterations : int
        At most.
    """
    xp = start.__array_namespace__()
    theta = start
    value, gradient = energy(theta)
    radius = xp.full_like(value, _FARTHEST)
    for _ in range(iterations):
        curvature, axes = _hessian(energy, theta, gradient)
        along = xp.sum(axes * gradient.T[:, :, None], axis=1) / curvature
        step = -xp.sum(axes * along[:, None, :], axis=2).T
        length = xp.sqrt(xp.sum(step * step, axis=0))
        step = step * xp.minimum(radius / xp.maximum(length, xp.full_like(length, 1e-9)), 1.0)
        new_value, new_gradient = energy(theta + step)
        better = new_value <= value
        gain = float(xp.max(xp.where(better, value - new_value, xp.zeros_like(value))))
        theta = xp.where(better, theta + step, theta)
        gradient = xp.where(better, new_gradient, gradient)
        value = xp.where(better, new_value, value)
        radius = xp.minimum(xp.where(better, 2.0 * radius, 0.25 * radius), _FARTHEST)
        if bool(xp.all(better)) and gain < 1e-3:
            break
    curvature, axes = _hessian(energy, theta, gradient)
    root = xp.permute_dims(axes / xp.sqrt(curvature)[:, None, :], (1, 2, 0))
    log_evidence = -value - 0.5 * xp.sum(xp.log(curvature), axis=1)
    return LaplaceFit(theta, value, xp.asarray(root, copy=True), log_evidence)


def _hessian(energy: Energy, theta: Any, gradient: Any) -> tuple[Any, Any]:
    """Eigenvalues (chains, 4), floored, and eigenvectors (chains, 4, 4) of each Hessian."""
    xp = theta.__array_namespace__()
    rows = []
    for parameter in range(4):
        unit = xp.asarray([[float(k == parameter)] for k in range(4)], dtype=theta.dtype)
        nearby = energy(theta + _DIFFERENCE * unit, with_energy=False)[1]
        rows.append((nearby - gradient) / _DIFFERENCE)
    hessian = xp.permute_dims(xp.stack(rows), (2, 0, 1))
    hessian = 0.5 * (hessian + xp.permute_dims(hessian, (0, 2, 1)))
    hessian = xp.where(xp.isfinite(hessian), hessian, xp.zeros_like(hessian))
    values, vectors = xp.linalg.eigh(hessian)
    return xp.maximum(xp.abs(values), _FLATTEST), vectors
