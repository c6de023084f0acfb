"""Gains of the keys of pairs, or of their authors, relative to their mean.

Animators who key the same expressions differ in gain: one may set all weights 10 % larger than
another. If the keys of pair i are ``g_i`` times the weights that the other pairs imply, its markers
move by ``1 / g_i`` of the motion predicted by a forward model of the other pairs. With the
leave-one-out residuals ``r``, the predicted motion ``m`` and their variance v, part p of the face
estimates the relative excess of motion::

    c_ip = sum_k r_ik . m_ik / v_ik / sum_k |m_ik|^2 / v_ik    (about 1 / g_i - 1)

A single wrong key has the same effect, but in one part only. Upper and lower face share no
shape, so the covariance of their ``c`` over pairs estimates the variance of the gain. If it is
significant, the gain of each pair is its best linear unbiased prediction (Robinson 1991,
Statistical Science 6(1), 15-32), and its keys are divided by it. The mean gain of all pairs is 1.

If the pairs' authors are known, all pairs of an author have one gain. Its variance is the
covariance over authors of the parts' means of ``log(1 + c)``, if a one-way analysis of variance (F
test) finds differences between authors in both parts. Otherwise each pair has its own gain, as
above.
"""

from dataclasses import replace

import numpy as np

from usdface.core.arrays import FloatArray, IntArray
from usdface.model.mapping.regions import membership, region_points
from usdface.model.regressions.base import Pairs
from usdface.model.regressions.forward_model import ForwardModel
from usdface.model.regressions.frame_solve import FrameSolver

_PARTS = (("brows", "lids"), ("mouth", "jaw"))
"""Regions of the two parts of the face, which share no shape."""

_NO_MARKERS = np.zeros(0, np.int64)

_MIN_GAIN_DEVIATION = 0.03
"""Standard deviation of the gains below which keys are not scaled."""

_CRITICAL_T = 2.5
"""Ratio of the gain variance to its standard error from which it is significant, p = .01."""

_MAX_P_VALUE = 0.05
"""Largest probability, if authors do not differ, of the F statistics of both parts of the face."""

_MAX_EXCESS = 0.4
"""Limit of ``c``: larger values are due to wrong keys, not to gain."""

_MIN_PAIRS = 12
"""Fewest pairs for an estimate of the covariance."""

_DETECTED_GAIN = 0.1
"""Relative gain that a pair's markers must be able to resolve for full weight in the estimate."""


def gain_groups(
    forward: ForwardModel, parts: tuple[str, ...], inflation: float, authors: tuple[str, ...]
) -> tuple[IntArray, float]:
    """Return the group of pairs of equal gain of each pair, and the variance of the gains.

    Parameters
    ----------
    forward : ForwardModel
        Posterior given the pairs.
    parts : tuple of str
        Part of the face of each shape; see `region_points`.
    inflation : float
        As of `correct_keys`.
    authors : tuple of str
        Author of each pair, ``''`` if unknown; empty if all are. Pairs of unknown authors count as
        those of one more.

    Returns
    -------
    groups : (pairs,) int array
        Authors if their gains differ significantly, else the pairs.
    variance : float
        0 if it is not significant.
    """
    excess, precision = _motion_excess(forward, parts, inflation)
    each = np.arange(len(excess))
    if len(excess) < _MIN_PAIRS or not precision.any(axis=0).all():
        return each, 0.0
    if 1 < len(set(authors)) < len(excess):
        groups = np.unique(authors, return_inverse=True)[1]
        variance = _author_variance(excess, precision, groups)
        if variance:
            return groups, variance
    return each, _pair_variance(excess, precision)


def _author_variance(excess: FloatArray, precision: FloatArray, groups: IntArray) -> float:
    """Return the variance of the gains of groups of pairs, or 0 if it is not significant."""
    from scipy.special import fdtrc

    weights, values = _excess_weights(excess, precision), np.log1p(excess)
    size = np.bincount(groups, weights.sum(axis=1))
    between, within = len(size) - 1, len(values) - len(size)  # degrees of freedom
    deviations = []
    for weight, value in zip(weights.T, values.T, strict=True):
        count = np.bincount(groups, weight)
        mean = np.bincount(groups, weight * value) / count
        error = max(float(weight @ (value - mean[groups]) ** 2) / within, 1e-12)
        spread = float(count @ (mean - np.average(mean, weights=count)) ** 2) / between
        if fdtrc(between, within, spread / error) > _MAX_P_VALUE:
            return 0.0
        deviations.append(mean - np.average(mean, weights=size))
    covariance = float(size @ np.prod(deviations, axis=0))
    variance = covariance / float(size.sum() - (size**2).sum() / size.sum())
    return variance if variance > _MIN_GAIN_DEVIATION**2 else 0.0


def _pair_variance(excess: FloatArray, precision: FloatArray) -> float:
    """Return the variance of the gains of pairs, or 0 if it is not significant."""
    weight = (precision / (precision + 1 / _DETECTED_GAIN**2)).prod(axis=1)
    products, total = excess.prod(axis=1), max(float(weight.sum()), 1e-9)
    variance = float(weight @ products) / total
    error = float(np.sqrt(weight**2 @ (products - variance) ** 2)) / total
    significant = variance > max(_CRITICAL_T * error, _MIN_GAIN_DEVIATION**2)
    return variance if significant else 0.0


def predict_log_factors(
    forward: ForwardModel,
    parts: tuple[str, ...],
    inflation: float,
    *,
    groups: IntArray,
    variance: float,
    applied: FloatArray,
) -> FloatArray:
    """Return the logarithm of the factor that scales each pair's keys to the mean gain: (pairs,).

    Parameters
    ----------
    forward, parts, inflation
        As of `gain_groups`.
    groups, variance
        From `gain_groups`.
    applied : (pairs,) float array
        Logarithm of the factors already applied to the keys of `forward`.
    """
    excess, precision = _motion_excess(forward, parts, inflation)
    weight = _excess_weights(excess, precision)
    total = (weight * (np.log1p(excess) + applied[:, None])).sum(axis=1)
    weight_of_group = np.bincount(groups, weight.sum(axis=1))
    predicted = (np.bincount(groups, total) / (1 / variance + weight_of_group))[groups]
    return np.asarray(predicted - predicted.mean())


def _excess_weights(excess: FloatArray, precision: FloatArray) -> FloatArray:
    """Return the inverse variance of ``c``: that of the errors of one part's keys, and noise."""
    return np.asarray(1 / ((excess**2).mean(axis=0) + 1 / np.maximum(precision, 1e-9)))


def scale_keys(pairs: Pairs, log_factor: FloatArray) -> Pairs:
    """Return pairs with scaled keys, limited to their ranges."""
    low, high = pairs.face.ranges.T
    keys = low + (pairs.outputs - low) * np.exp(log_factor)[:, None]
    return replace(pairs, outputs=np.clip(keys, low, high), forward=None)


def mean_gains(log_factor: FloatArray, authors: tuple[str, ...]) -> dict[str, float]:
    """Return the geometric mean gain of each author's keys, in descending order.

    Empty if gains do not differ significantly, or with fewer than two named authors.
    """
    names = sorted(set(filter(None, authors)))
    if len(names) < 2 or not log_factor.any():
        return {}
    log_gain = -log_factor
    gains = {
        name: float(np.exp(log_gain[[author == name for author in authors]].mean()))
        for name in names
    }
    return dict(sorted(gains.items(), key=lambda item: -item[1]))


def _motion_excess(
    forward: ForwardModel, parts: tuple[str, ...], inflation: float
) -> tuple[FloatArray, FloatArray]:
    """Return ``c`` and its precision given the markers' variance: (pairs, parts) arrays."""
    regions = region_points(parts, forward.basis)
    members = membership(
        {str(part): np.concatenate([regions.get(n, _NO_MARKERS) for n in part]) for part in _PARTS},
        len(forward.noise),
    )
    keys = forward.targets
    predicted, _ = FrameSolver(forward, np.ones(keys.shape[1])).linearise(keys)
    motion = predicted.reshape(len(keys), -1, 3) - forward.offset
    weight = 1 / (inflation * forward.leave_one_out_variance)
    precision = (weight * (motion**2).sum(axis=2)) @ members.T
    excess = (weight * (motion * forward.residuals).sum(axis=2)) @ members.T
    excess /= np.maximum(precision, 1e-9)
    return np.clip(excess, -_MAX_EXCESS, _MAX_EXCESS), precision
