"""Keys that are 0 as small weights were not set.

Some animators key the ten largest shapes of a face and leave the others at 0. If these zeros count
as exact, the keyed shapes take over the motion of the others.
"""

from collections.abc import Callable

import numpy as np

from usdface.core.arrays import FloatArray
from usdface.model.regressions.forward_model import ForwardModel
from usdface.model.regressions.frame_solve import FrameSolver

_UNSET_WEIGHT = 0.08
"""Root mean square of the bent weights that were not set, if of 51 shapes 8 to 12 are keyed."""

_CRITICAL_T, _LEAST_GAIN = 4.0, 12.0
"""Student's t over pairs of the difference of log likelihood, and its smallest mean: errors that
markers have in common, which it takes for independent, make 10 (decision 69)."""

_LEAST_ZEROS, _MIN_PAIRS = 0.75, 8
"""Smallest share of keys that are 0, and fewest pairs: of 51 shapes, complete keys with 15 % error
have up to 60 %, rounded ones 66 %, the 12 largest leave 76 %."""


def with_unset_keys(forward: ForwardModel, fit: Callable[[float], ForwardModel]) -> ForwardModel:
    """Return the model for which keys of 0 were not set, if pairs are more probable by it.

    The evidence of the scales takes markers one by one, where weights that were not set look like
    noise. Here the leave-one-out residuals ``r`` of each pair are compared jointly::

        log p(r) = log N(r; 0, diag(s^2) + J' diag(v) J)

    ``s^2``: their variance without the error of the pair's own keys. ``v``: variance of the keys,
    `ForwardScales.key_variance`. ``J``: Jacobian of the markers.

    Parameters
    ----------
    forward : ForwardModel
        Posterior given the original keys.
    fit : callable
        Fit of the same, given the scale `ForwardScales.unset`.
    """
    if (forward.targets == 0).mean() < _LEAST_ZEROS or len(forward.targets) < _MIN_PAIRS:
        return forward
    before = _log_likelihood(forward)
    if before is None:
        return forward
    unset = fit(_UNSET_WEIGHT)
    after = _log_likelihood(unset)
    if after is None:
        return forward
    gain = after - before
    least = max(_LEAST_GAIN, _CRITICAL_T * gain.std(ddof=1) / len(gain) ** 0.5)
    return unset if gain.mean() > least else forward


def _log_likelihood(forward: ForwardModel) -> FloatArray | None:
    """Return ``log p(r)`` up to a constant, (pairs,); None for rigs of many shapes."""
    keys = forward.targets
    _, slope = FrameSolver(forward, np.ones(keys.shape[1])).linearise(keys)
    if slope is None:
        return None
    deviation = np.sqrt(np.repeat(forward.leave_one_out_variance, 3, axis=1))
    residuals = forward.residuals.reshape(len(keys), -1) / deviation
    scaled = slope * np.sqrt(forward.scales.key_variance(keys))[:, :, None] / deviation[:, None]
    # By Sylvester's and Woodbury's identities, in the space of the shapes.
    inner = np.eye(keys.shape[1]) + scaled @ scaled.transpose(0, 2, 1)
    root = np.linalg.cholesky(inner)
    explained = np.linalg.solve(root, scaled @ residuals[:, :, None])[:, :, 0]
    fit = (residuals**2).sum(axis=1) - (explained**2).sum(axis=1)
    log_determinant = np.log(deviation).sum(axis=1) + np.log(np.einsum("nss->ns", root)).sum(axis=1)
    return np.asarray(-0.5 * fit - log_determinant)
