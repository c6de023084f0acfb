"""Expected weights, given weights that err and how each of them is used.

A shape is at rest in most frames. What a solve leaves on it there is small, but a combination that
begins at 0 and counts in full early (an in-between at .25) makes four times as much of it. The
prior of a weight is a mixture over the n rows in which its use is known::

    (n + 1) p(w) = sum over rows at rest of delta(w) + sum over others of N(w; row, spread^2) + 1

the last 1 being one row of any weight in [0, 1]. Given a value x that errs by N(0, d^2), each part
of the mixture has its likelihood and its mean in closed form, so that ``x`` stays as it is where
``d`` is 0. The uniform part is not cut at 0 and 1, nor are the normal ones: x lies between them.
"""

import numpy as np

from usdface.core.arrays import FloatArray, RealArray

_REST_WEIGHT = 0.01
"""Weight below which a row counts as rest: no animator keys finer."""

_SPREAD_WEIGHT = 0.1
"""How far a weight may be from what a row shows: rows are a sample of a continuous motion."""


def expected_weights(seen: RealArray, deviation: RealArray, rows: RealArray) -> FloatArray:
    """Return the posterior mean of weights: (frames, shapes).

    Parameters
    ----------
    seen : (frames, shapes) float array
        Weights that err, as shares of their ranges [0-1].
    deviation : (frames, shapes) float array
        Standard deviation of the error; 0 where a weight is exact.
    rows : (rows, shapes) float array
        Weights that show how each shape is used [0-1].
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
