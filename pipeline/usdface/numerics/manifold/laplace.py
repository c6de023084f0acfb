"""The most probable hyper-parameters of many chains at once, and the Gaussian around each."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from usdface.numerics.array_namespace import namespace_of

Energy = Callable[..., tuple[Any, Any]]
"""``energy(theta, with_energy=True)`` of theta (4, chains): energies (chains,), gradients."""

_DIFFERENCE = {"single": 1e-2, "double": 1e-4}
"""Step in theta of the Hessian's finite differences of the analytic gradient: where rounding and
curvature err alike."""

_FLATTEST = 0.05
"""Least curvature, per unit of theta squared: priors have 0.44."""

_FARTHEST = 2.0
"""Longest Newton step in theta."""

_SETTLED = 1e-3
"""Energy that the next step would gain: nothing samples could tell."""


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
    inverse : (4, 4, chains) array
        Of `root`: turns theta into coordinates in which the Gaussian is the standard one.
    log_evidence : (chains,) array
        Of the posterior's mass around the mode, up to a constant.
    """

    mode: Any
    energy: Any
    root: Any
    inverse: Any
    log_evidence: Any

    def whiten(self, theta: Any) -> Any:
        """Turn theta (4, chains) into whitened coordinates."""
        xp = namespace_of(theta)
        return xp.sum(self.inverse * (theta - self.mode)[None, :, :], axis=1)

    def theta(self, white: Any) -> Any:
        """Turn whitened coordinates (4, chains) into theta."""
        xp = namespace_of(white)
        return self.mode + xp.sum(self.root * white[None, :, :], axis=1)


def fit_laplace(energy: Energy, start: Any, *, iterations: int = 10) -> LaplaceFit:
    """Go downhill from `start` by Newton steps within a trust region.

    Parameters
    ----------
    energy : callable
    start : (4, chains) array
    iterations : int
        At most.
    """
    xp = namespace_of(start)
    theta = start
    value, gradient = energy(theta)
    radius = xp.full_like(value, _FARTHEST)
    left = iterations
    while True:
        root, inverse, log_curvature = _factorise(_hessian(energy, theta, gradient))
        along = xp.sum(root * gradient[:, None, :], axis=0)
        gain = 0.5 * xp.sum(along * along, axis=0)
        gain = xp.where(xp.isfinite(gain), gain, xp.zeros_like(gain))
        if left == 0 or float(xp.max(gain)) < _SETTLED:
            break
        left -= 1
        step = -xp.sum(root * along[None, :, :], axis=1)
        length = xp.sqrt(xp.sum(step * step, axis=0))
        step = step * xp.clip(radius / xp.clip(length, 1e-9, None), None, 1.0)
        new_value, new_gradient = energy(theta + step)
        better = new_value <= value
        theta = xp.where(better, theta + step, theta)
        gradient = xp.where(better, new_gradient, gradient)
        value = xp.where(better, new_value, value)
        radius = xp.clip(xp.where(better, 2.0 * radius, 0.25 * radius), None, _FARTHEST)
    return LaplaceFit(theta, value, root, inverse, -value - 0.5 * log_curvature)


def _hessian(energy: Energy, theta: Any, gradient: Any) -> list[list[Any]]:
    """Take finite differences: rows of four entries, (chains,) each."""
    xp = namespace_of(theta)
    by = _DIFFERENCE["single" if theta.dtype == xp.float32 else "double"]
    rows = []
    for parameter in range(4):
        moved = [theta[k, :] + by if k == parameter else theta[k, :] for k in range(4)]
        nearby = energy(xp.stack(moved), with_energy=False)[1]
        row = (nearby - gradient) / by
        rows.append(xp.where(xp.isfinite(row), row, xp.zeros_like(row)))
    return [[0.5 * (rows[i][j, :] + rows[j][i, :]) for j in range(4)] for i in range(4)]


def _factorise(hessian: list[list[Any]]) -> tuple[Any, Any, Any]:
    """Factorise ``L D L'`` of each chain, pivots made positive.

    Returns
    -------
    root : (4, 4, chains) array
        ``inv(L)' D^(-1/2)``
    inverse : (4, 4, chains) array
        ``D^(1/2) L'``
    log_determinant : (chains,) array
    """
    xp = namespace_of(hessian[0][0])
    zero = xp.zeros_like(hessian[0][0])
    L = [[zero] * 4 for _ in range(4)]
    K = [[zero] * 4 for _ in range(4)]  # the inverse of L
    pivots: list[Any] = []
    for j in range(4):
        pivot = hessian[j][j]
        for k in range(j):
            pivot = pivot - L[j][k] * L[j][k] * pivots[k]
        pivots.append(xp.clip(xp.abs(pivot), _FLATTEST, None))
        L[j][j] = K[j][j] = zero + 1.0
        for i in range(j + 1, 4):
            entry = hessian[i][j]
            for k in range(j):
                entry = entry - L[i][k] * L[j][k] * pivots[k]
            L[i][j] = entry / pivots[j]
    for j in range(4):
        for i in range(j + 1, 4):
            entry = zero
            for k in range(j, i):
                entry = entry - L[i][k] * K[k][j]
            K[i][j] = entry
    scales = [xp.sqrt(pivot) for pivot in pivots]
    root = xp.stack([xp.stack([K[b][a] / scales[b] for b in range(4)]) for a in range(4)])
    inverse = xp.stack([xp.stack([L[a][b] * scales[b] for a in range(4)]) for b in range(4)])
    return root, inverse, 2.0 * xp.sum(xp.log(xp.stack(scales)), axis=0)
