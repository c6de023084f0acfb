"""Weights brought within their limits at the least cost to the face.

Cutting a weight off at its limit leaves the others as they were, though they were chosen to go
with it. The nearest point of the box under the metric in which weights are determined moves them
along: what a shape may not do, its neighbours take over.
"""

import math
from typing import Any

import numpy as np

from usdface.core.arrays import FloatArray
from usdface.numerics.array_namespace import CPU, ArrayDevice, namespace_of

_MOST_STEPS = 10
SETTLED = 1e-3
"""Steps of accelerated projected gradient: as many as a metric needs for that share of the way to
be left, at most those."""


class BoxProjection:
    """Approaches the points of a box that are nearest under a quadratic metric.

    Minimises ``(x - w)' M (x - w)`` with ``lower <= x <= upper`` for every row, from the row cut
    off at its limits, by accelerated projected gradient; rows already within their limits stay as
    they are. The metric is scaled to a unit diagonal first. The number of steps depends on it
    alone: the square root of its condition times a logarithm. Steps
    are taken in ``x - w``, which is small: single precision then rounds ``x`` by less than 1e-6.

    Parameters
    ----------
    metric : (s, s) float array
        Symmetric, positive definite; with `factor` (s,), the diagonal to which it adds.
    lower, upper : (s,) float arrays
    factor : (s, r) float array, optional
        The metric is then ``diag(metric) + factor @ factor.T``, which is quicker where r is small.
    steps : int, optional
        By default as many as the metric needs, at most `_MOST_STEPS`.
    single : bool
        Take the steps in single precision.
    device : ArrayDevice
        Where weights will be.

    References
    ----------
    Beck and Teboulle (2009), SIAM J. Imaging Sciences 2(1), 183-202.
    """

    def __init__(
        self,
        metric: FloatArray,
        *,
        lower: FloatArray,
        upper: FloatArray,
        factor: FloatArray | None = None,
        steps: int | None = None,
        single: bool = False,
        device: ArrayDevice = CPU,
    ) -> None:
        whole = metric if factor is None else np.diag(metric) + factor @ factor.T
        squared = 1 / np.diag(whole)
        curvature = np.linalg.eigvalsh(whole * np.sqrt(np.outer(squared, squared)))
        least, largest = float(curvature[0]), float(curvature[-1])
        step = 1 / largest
        needed = -math.log(SETTLED) * math.sqrt(largest / max(least, 1e-12 * largest))
        # in the weights' own units, a step is one product: x - step M diag(squared) x
        parts = (
            (np.eye(len(whole)) - step * whole * squared,)
            if factor is None
            else (1 - step * metric * squared, -step * factor, (factor * squared[:, None]).T)
        )
        kind = "float32" if single else "float64"
        self._descent = tuple(device.put(np.ascontiguousarray(each), dtype=kind) for each in parts)
        self._lower, self._upper = device.put(lower), device.put(upper)
        self._steps = min(_MOST_STEPS, math.ceil(needed)) if steps is None else steps

    def __call__(self, weights: Any) -> Any:
        """Project rows.

        Parameters
        ----------
        weights : (f, s) float array
            On the device, in double precision.
        """
        xp = namespace_of(weights)
        kind = self._descent[0].dtype
        low = xp.astype(self._lower - weights, kind)
        high = xp.astype(self._upper - weights, kind)
        moved = xp.clip(xp.zeros_like(low), low, high)
        ahead, momentum = moved, 1.0
        for _ in range(self._steps):
            # clip would be one call, and a slow one where its bounds are arrays
            following = xp.minimum(xp.maximum(self._descend(ahead), low), high)
            gained = (1 + math.sqrt(1 + 4 * momentum**2)) / 2
            ahead = following - moved
            ahead *= (momentum - 1) / gained
            ahead += following
            moved, momentum = following, gained
        return xp.clip(weights + xp.astype(moved, weights.dtype), self._lower, self._upper)

    def _descend(self, ahead: Any) -> Any:
        """Take one step of the gradient."""
        xp = namespace_of(ahead)
        if len(self._descent) == 1:
            return xp.matmul(ahead, self._descent[0])
        kept, left, right = self._descent
        return ahead * kept + xp.matmul(xp.matmul(ahead, left), right)


def project_to_box(
    weights: FloatArray,
    metric: FloatArray,
    *,
    lower: FloatArray,
    upper: FloatArray,
    steps: int | None = None,
) -> FloatArray:
    """Project rows once; see `BoxProjection`.

    Parameters
    ----------
    weights : (f, s) float array
    metric, lower, upper, steps
        Those of `BoxProjection`.
    """
    projected: FloatArray = BoxProjection(metric, lower=lower, upper=upper, steps=steps)(weights)
    return projected
