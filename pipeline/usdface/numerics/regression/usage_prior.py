"""Posterior means of noisy weights, under a prior of how each weight is used.

A shape is at rest in most frames. The residual weight of a solve there is small, but a combination
with an in-between at .25 amplifies it four times. The prior of a weight is a mixture over n rows of
known weights::

    (n + 1) p(w) = sum over rows at rest of delta(w) + sum over others of N(w; row, spread^2) + 1

with a uniform density on [0, 1] as the last. For a value x with an error of N(0, d^2), each
component has its likelihood and mean in closed form; ``x`` is unchanged where ``d`` is 0. The
components are not truncated at 0 and 1, as x is between them.
"""

import numpy as np

from usdface.core.arrays import FloatArray, RealArray

_REST_WEIGHT = 0.01
"""Smaller weights of rows are at rest; animators set none so small."""

_SPREAD_WEIGHT = 0.1
"""Standard deviation of a weight about that of a row: rows sample a continuous motion."""


def expected_weights(seen: RealArray, deviation: RealArray, rows: RealArray) -> FloatArray:
    """Return the posterior mean of weights: (frames, shapes).

    Parameters
    ----------
    seen : (frames, shapes) float array
        Noisy weights, as shares of their ranges [0-1].
    deviation : (frames, shapes) float array
        Standard deviation of the error; 0 where a weight is exact.
    rows : (rows, shapes) float array
        Known weights, which define the prior [0-1].
    """
    out = np.array(seen, np.float64)
    for column, used in enumerate(np.asarray(rows, np.float64).T):
        doubtful = np.asarray(deviation[:, column]) > 0
        x, error = out[doubtful, column], np.asarray(deviation[doubtful, column], np.float64)
        active = used[used > _REST_WEIGHT]
        wide = np.hypot(error, _SPREAD_WEIGHT)[:, None]
        near = np.exp(-0.5 * ((x[:, None] - active) / wide) ** 2) / wide
        rest = (len(used) - len(active)) * np.exp(-0.5 * (x / error) ** 2) / error
        anywhere = np.full_like(x, np.sqrt(2 * np.pi))  # in units of the normal densities
        toward = (x[:, None] * _SPREAD_WEIGHT**2 + active * error[:, None] ** 2) / wide**2
        mass = near.sum(axis=1) + rest + anywhere
        out[doubtful, column] = ((near * toward).sum(axis=1) + anywhere * x) / mass
    return out
