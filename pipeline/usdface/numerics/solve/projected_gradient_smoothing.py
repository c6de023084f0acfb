"""Smooth tracks within bounds on any device: steps of whole arrays instead of a banded solve.

A banded solve goes from one frame to the next, which is nothing for a graphics card. Accelerated
projected gradient minimises the same sum by stencils over all frames and tracks at once, and the
number of steps is known beforehand: it grows with the square root of the condition, which for the
cut-offs that faces are smoothed at is small.

References
----------
Nesterov (2004), Introductory Lectures on Convex Optimization, section 2.2: the constant step
scheme and its rate.
"""

import math
from typing import Any

from usdface.core.arrays import FloatArray
from usdface.numerics.array_namespace import ArrayDevice, namespace_of
from usdface.numerics.solve.banded_smoothing import check_smoothing

_LEFT = 1e-10
"""Share of the way that is left, so that the processor's answer is met within rounding."""

MOST_STEPS = 20_000
"""Slower motion than these steps can tell apart is smoothed on the processor."""

_STENCIL = 16.0  # largest eigenvalue of squared second differences


def steps_needed(penalty: float, trust: FloatArray) -> int:
    """Return how many steps smoothing takes: some hundred at 20 Hz of 120.

    Parameters
    ----------
    penalty : float
    trust : (frames,) float array
        Positive.
    """
    condition = (float(trust.max()) + _STENCIL * penalty) / float(trust.min())
    return math.ceil(-math.log(_LEFT) * math.sqrt(condition))


def smooth_on_device(
    tracks: FloatArray,
    *,
    penalty: float,
    trust: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    device: ArrayDevice,
) -> FloatArray:
    """Smooth every column under its bounds; see `smooth_within_bounds`, whose answer this is.

    Parameters
    ----------
    tracks : (frames, n) float array
    penalty : float
    trust : (frames,) float array
    lower, upper : (n,) float arrays
        All numpy's.
    device : ArrayDevice
        Where the steps are taken, in double precision.

    Returns
    -------
    (frames, n) float array
        numpy's.

    Raises
    ------
    ValueError
        If a value is not finite, a trust not positive or the penalty negative.
    """
    check_smoothing(tracks, penalty=penalty, trust=trust)
    wanted, low, high = (device.put(each) for each in (tracks, lower, upper))
    weight = device.put(trust[:, None])
    xp = namespace_of(wanted)
    now = _within(wanted, low, high)
    if len(tracks) < 3 or penalty == 0:
        return device.fetch(now)
    curvature = float(trust.max()) + _STENCIL * penalty
    root = math.sqrt(curvature / float(trust.min()))
    ahead, momentum = now, (root - 1) / (root + 1)
    edge = xp.zeros((2, wanted.shape[1]), dtype=wanted.dtype, device=device.device)
    for _ in range(steps_needed(penalty, trust)):
        pull = weight * (ahead - wanted)
        bend = xp.concat([edge, _second_differences(ahead), edge], axis=0)
        pull = pull + penalty * _second_differences(bend)
        following = _within(ahead - pull / curvature, low, high)
        ahead = following + momentum * (following - now)
        now = following
    return device.fetch(now)


def _second_differences(rows: Any) -> Any:
    return rows[2:, :] - 2.0 * rows[1:-1, :] + rows[:-2, :]


def _within(rows: Any, low: Any, high: Any) -> Any:
    xp = namespace_of(rows)
    return xp.minimum(xp.maximum(rows, low), high)
