"""By which factor the keys of a pair are larger than those of the others.

Animators who key the same expressions differ in gain: one sets every weight a tenth larger than the
other. If the keys of pair i are ``g_i`` times the weights that the other pairs imply, its markers
move by ``1 / g_i`` of what a forward model of the other pairs predicts. From the leave-one-out
residuals ``r`` and the predicted motion ``m``, each with variance v, part p of the face gives::

    c_ip = sum_k r_ik . m_ik / v_ik / sum_k |m_ik|^2 / v_ik    (about 1 / g_i - 1)

A single wrong key has the same effect in its own part of the face. Upper and lower face have no
shapes in common, so the covariance of their ``c`` over pairs is the variance of the gain alone.
Where it is significant, each pair's gain is its best linear unbiased prediction (Robinson 1991,
Statistical Science 6(1), 15-32), and keys are divided by it. The mean gain of all pairs stays 1.
"""

from dataclasses import replace

import numpy as np

from usdface.core.arrays import FloatArray
from usdface.model.mapping.regions import membership, region_points
from usdface.model.regressions import Pairs
from usdface.model.regressions.forward_model import ForwardModel
from usdface.model.regressions.frame_solve import FrameSolver

_PARTS = (("brows", "lids"), ("mouth", "jaw"))
"""Regions of the face that share no shape."""

_NONE = np.zeros(0, np.int64)

_LEAST_GAIN_DEVIATION = 0.03
"""Standard deviation of the gains below which keys stay as they are."""

_LEAST_T = 2.5
"""Gain variance over its standard error above which it is significant: one in a hundred."""

_LARGEST_FACTOR = 0.4
"""Limit of ``c``: pairs that differ by more hold wrong keys."""

_LEAST_PAIRS = 12
"""Below, a covariance over pairs is not estimated."""


def gain_variance(forward: ForwardModel, parts: tuple[str, ...], common: float) -> float:
    """Return the variance of the gains of pairs; 0 where it is not significant.

    Parameters
    ----------
    forward : ForwardModel
        Conditioned on the pairs.
    parts : tuple of str
        Of the face, of each shape; see `region_points`.
    common : float
        As of `FrameSolver`.
    """
    factor, precision = _part_factors(forward, parts, common)
    if len(factor) < _LEAST_PAIRS or not precision.any(axis=0).all():
        return 0.0
    # A pair counts as far as its markers tell a gain of a tenth in both parts.
    weight = (precision / (precision + 1 / 0.1**2)).prod(axis=1)
    products, total = factor.prod(axis=1), max(float(weight.sum()), 1e-9)
    variance = float(weight @ products) / total
    error = float(np.sqrt(weight**2 @ (products - variance) ** 2)) / total
    significant = variance > max(_LEAST_T * error, _LEAST_GAIN_DEVIATION**2)
    return variance if significant else 0.0


def predict_log_factors(
    forward: ForwardModel,
    parts: tuple[str, ...],
    common: float,
    *,
    variance: float,
    applied: FloatArray,
) -> FloatArray:
    """Return the logarithm of what brings each pair's keys to the mean gain: (pairs,).

    Parameters
    ----------
    forward, parts, common
        As of `gain_variance`.
    variance : float
        Of the gains.
    applied : (pairs,) float array
        Logarithm of the factors that the keys of `forward` are multiplied by already.
    """
    factor, precision = _part_factors(forward, parts, common)
    own = (factor**2).mean(axis=0)  # of a part's keys alone
    weight = 1 / (own + 1 / np.maximum(precision, 1e-9))
    total = (weight * (np.log1p(factor) + applied[:, None])).sum(axis=1)
    predicted = total / (1 / variance + weight.sum(axis=1))
    return np.asarray(predicted - predicted.mean())


def scale_keys(pairs: Pairs, log_factor: FloatArray) -> Pairs:
    """Return pairs whose keys are multiplied, within their ranges."""
    low, high = pairs.face.ranges.T
    keys = low + (pairs.outputs - low) * np.exp(log_factor)[:, None]
    return replace(pairs, outputs=np.clip(keys, low, high), forward=None)


def mean_gains(log_factor: FloatArray, authors: tuple[str, ...]) -> dict[str, float]:
    """Return the mean gain of each author's keys, over that of all; the largest first.

    Empty where gains do not differ significantly, or fewer than two authors are known.
    """
    names = sorted(set(filter(None, authors)))
    if len(names) < 2 or not log_factor.any():
        return {}
    gain = -log_factor
    found = {
        name: float(np.exp(gain[[author == name for author in authors]].mean())) for name in names
    }
    return dict(sorted(found.items(), key=lambda each: -each[1]))


def _part_factors(
    forward: ForwardModel, parts: tuple[str, ...], common: float
) -> tuple[FloatArray, FloatArray]:
    """Return ``c`` and its precision, from the markers' variance: (pairs, parts) arrays."""
    regions = region_points(parts, forward.basis)
    members = membership(
        {str(part): np.concatenate([regions.get(n, _NONE) for n in part]) for part in _PARTS},
        len(forward.noise),
    )
    keys = forward.targets
    predicted, _ = FrameSolver(forward, np.ones(keys.shape[1])).linearise(keys)
    motion = predicted.reshape(len(keys), -1, 3) - forward.offset
    weight = 1 / (common * forward.leave_one_out_variance)
    precision = (weight * (motion**2).sum(axis=2)) @ members.T
    factor = (weight * (motion * forward.residuals).sum(axis=2)) @ members.T
    factor /= np.maximum(precision, 1e-9)
    return np.clip(factor, -_LARGEST_FACTOR, _LARGEST_FACTOR), precision
