"""Delays of keys: the video from which they were set may not be in sync with the capture.

Keys that are late by d seconds describe the face of a time d before their frame. r_n(d) are the
residuals of pair n under the forward model (`forward_model`) with the markers of that time, and v_n
the velocities of these, both whitened by the covariance of the pairs, ``C = L L'``: ``L^-1 r``,
``L^-1 v``. As r changes by -v with d, the Gauss-Newton step is that of least squares ::

    step = sum_n v_n'r_n / H,  H = sum_n |v_n|^2
    error^2 = sum_n sum_m (v_n'e_m)^2 / ((N - 1) H^2),  e_m = r_m - v_m step

Errors of a pair's markers are correlated, those of different pairs are not: each v_n is projected
on the errors of all N pairs. Those of v_n alone would be few, as most keys are of frames that
hardly move.
"""

from dataclasses import replace

import numpy as np

from usdface.core.arrays import BoolArray, FloatArray, IntArray
from usdface.core.trajectories import TRAJECTORY_SECONDS, displacements_at
from usdface.model.mapping.corrected_pairs import RigPrior, fit_pairs_forward, fit_rig_prior
from usdface.model.regressions.base import Pairs
from usdface.model.regressions.forward_model import ForwardModel, ForwardScales

_SCALES = ForwardScales(tau=0.1)
"""Of the forward model: animators' keys have errors of 5 to 15 %."""

_ROUNDS, _PRECISION = 6, 1e-3
"""Largest number of steps, and length of the last one [s]."""

_LARGEST_STEP = 1 / 30
_HALF_INTERVAL = 1 / 60
"""Of a velocity [s]."""

LARGEST_DELAY = float(TRAJECTORY_SECONDS[-1]) - _HALF_INTERVAL
"""[s]"""
_LEAST_DELAY = 0.004
"""Shorter ones are not removed [s]: a quarter of a frame at 60 per second."""

_FALSE_POSITIVE_RATE = 0.01
"""Probability of a delay that is found in keys that have none."""


def find_key_delays(pairs: Pairs, trajectories: FloatArray, take: IntArray) -> FloatArray:
    """Return the delay of each pair's keys, positive if they are late, 0 if it is not significant.

    One delay for all takes is found first, then one for each. Returns (pairs,) [s].

    Parameters
    ----------
    pairs : Pairs
        With markers of the frames that were keyed.
    trajectories : (pairs, times, markers, 3) array
        Of `References` [mm].
    take : (pairs,) int array
        Index of each pair's take; -1 for proposals, which are made from the markers.
    """
    prior, delays = fit_rig_prior(pairs), np.zeros(len(take))
    takes = [take == each for each in np.unique(take[take >= 0])]
    for members in ([take >= 0], takes)[: len(takes)]:
        delays = _refine(pairs, prior, trajectories, delays, members)
    return np.where(np.abs(delays) < _LEAST_DELAY, 0.0, delays)


def _refine(
    pairs: Pairs,
    prior: RigPrior,
    trajectories: FloatArray,
    start: FloatArray,
    members: list[BoolArray],
) -> FloatArray:
    """Return the delays with those of groups of pairs changed where that is significant."""
    found, longest = start.copy(), np.inf
    for _ in range(_ROUNDS):
        if longest < _PRECISION:
            break
        velocity, residual = whiten_pairs(*_fit_at(pairs, prior, trajectories, found))
        longest = 0.0
        for group in members:
            step, critical = measure_step(velocity[group], residual[group])
            if np.abs(found[group] + step - start[group]).max() < critical:
                found[group] = start[group]  # later rounds may differ, as the other delays do
                continue
            moved = found[group] + np.clip(step, -_LARGEST_STEP, _LARGEST_STEP)
            found[group] = np.clip(moved, -LARGEST_DELAY, LARGEST_DELAY)
            longest = max(longest, abs(step))
    return found


def _fit_at(
    pairs: Pairs, prior: RigPrior, trajectories: FloatArray, delays: FloatArray
) -> tuple[ForwardModel, FloatArray]:
    """Return the forward model of the keyed times, and the markers' velocities there [mm/s]."""
    before, now, after = (
        displacements_at(trajectories, time - delays)
        for time in (-_HALF_INTERVAL, 0.0, _HALF_INTERVAL)
    )
    timed = replace(pairs, markers=np.asarray(pairs.markers) + now)
    return fit_pairs_forward(timed, _SCALES, prior), (after - before) / (2 * _HALF_INTERVAL)


def whiten_pairs(forward: ForwardModel, velocity: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return whitened velocities and residuals of the pairs: (pairs, 3 markers) each.

    `velocity`: of the markers, (pairs, markers, 3) [mm/s].
    """
    root = np.linalg.cholesky(forward.inverse)  # C^-1 = root root', so that L^-1 = root'
    both = (
        root.transpose(0, 2, 1) @ velocity.transpose(1, 0, 2),
        np.linalg.solve(root, forward.dual.transpose(1, 0, 2)),  # dual: C^-1 r
    )
    first, second = (each.transpose(1, 0, 2).reshape(len(velocity), -1) for each in both)
    return first, second


def measure_step(velocity: FloatArray, residual: FloatArray) -> tuple[float, float]:
    """Return the step of whitened pairs, and the largest change that is not significant [s]."""
    from scipy.special import stdtrit  # SciPy is only loaded for training

    degrees, information = len(velocity) - 1, max(float((velocity**2).sum()), 1e-12)
    step = float((velocity * residual).sum()) / information
    if not degrees:
        return step, np.inf
    projected = velocity @ (residual - step * velocity).T
    error = float(np.linalg.norm(projected)) / degrees**0.5 / information
    return step, float(stdtrit(degrees, 1 - _FALSE_POSITIVE_RATE / 2)) * error
