"""Weights brought within their limits at the least cost to the face.

Cutting a weight off at its limit leaves the others as they were, though they were chosen to go
with it. The nearest point of the box under the metric in which weights are determined moves them
along: what a shape may not do, its neighbours take over.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

STEPS = 30
"""Of accelerated projected gradient: weights have settled to a thousandth."""


def project_to_box(
    weights: Array, metric: Array, *, lower: Array, upper: Array, steps: int = STEPS
) -> Array:
    """Approach the point of a box that is nearest under a quadratic metric.

    Minimises ``(x - w)' M (x - w)`` with ``lower <= x <= upper`` for every row, from the row cut
    off at its limits, by a fixed number of accelerated projected gradient steps; rows already
    within their limits are returned as they are. The metric is scaled to a unit diagonal first.

    Parameters
    ----------
    weights : (f, s) float array
    metric : (s, s) float array
        Symmetric, positive definite.
    lower, upper : (s,) float arrays

    References
    ----------
    Beck and Teboulle (2009), SIAM J. Imaging Sciences 2(1), 183-202.
    """
    out: Array = np.clip(weights, lower, upper)
    moved = np.flatnonzero((out != weights).any(axis=1))
    if not len(moved):
        return out
    unit = 1 / np.sqrt(np.diag(metric))
    scaled = metric * unit[:, None] * unit
    step = 1 / float(np.linalg.eigvalsh(scaled)[-1])
    low, high, wanted = lower / unit, upper / unit, weights[moved] / unit
    pull = wanted @ scaled
    x = out[moved] / unit
    ahead, momentum = x, 1.0
    for _ in range(steps):
        following = np.clip(ahead - step * (ahead @ scaled - pull), low, high)
        gained = (1 + np.sqrt(1 + 4 * momentum**2)) / 2
        ahead = following + (momentum - 1) / gained * (following - x)
        x, momentum = following, gained
    out[moved] = np.clip(x * unit, lower, upper)
    return out
