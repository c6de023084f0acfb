"""Smooth tracks within bounds: a banded system, linear in the frames.

What is minimised is ``sum_t r_t (w_t - y_t)^2 + penalty sum_t (w_{t-1} - 2 w_t + w_{t+1})^2``
within bounds, for every track by itself. Its normal matrix has five diagonals. Which samples lie
at a bound is found by a primal-dual active set: exact, in a few solves. Where a low cut-off makes
it cycle, samples change one by one in each stretch of the take.

References
----------
Hintermueller, Ito and Kunisch (2002), SIAM J. Optim. 13(3), 865-888: the active set. Murty (1974),
Linear Algebra Appl. 9, 65-108: one change at a time never cycles.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SLOWEST = 1e-4
"""Share of the rate below which a cut-off leaves nothing but a line, and no digits to tell it."""

_ROUNDS = 1000
_PATIENCE = 3  # rounds without progress before samples change one at a time
_PINNED = 1e8  # weight of a sample held at its bound, against the largest of the equation
_UNHEARD = 8.0  # lengths over which a change halves; stretches further apart are on their own
_SLACK = 1e-9


def cutoff_penalty(cutoff_hz: float, rate: float) -> float:
    """Return the penalty that halves a motion of this frequency.

    Parameters
    ----------
    cutoff_hz : float
        From `SLOWEST` of the rate to half of it.
    rate : float
        Frames per second.

    Raises
    ------
    ValueError
        If the frequency cannot be in frames of this rate.
    """
    if not SLOWEST * rate <= cutoff_hz <= rate / 2:
        raise ValueError(
            f"a cut-off must lie between {SLOWEST * rate:g} Hz and half the rate of {rate:g} "
            f"frames per second, got {cutoff_hz:g} Hz"
        )
    return float((2 * np.sin(np.pi * cutoff_hz / rate)) ** -4)


def smooth_within_bounds(
    tracks: Array, *, penalty: float, trust: Array, lower: Array, upper: Array
) -> Array:
    """Smooth every column under its bounds.

    Parameters
    ----------
    tracks : (frames, n) float array
    penalty : float
        On squared second differences; 0 only brings the tracks within their bounds.
    trust : (frames,) float array
        Weight of each frame, positive: frames with little are told by their neighbours.
    lower, upper : (n,) float arrays

    Returns
    -------
    (frames, n) float array

    Raises
    ------
    ValueError
        If a value is not finite, a trust not positive or the penalty negative.
    """
    check_smoothing(tracks, penalty=penalty, trust=trust)
    if len(tracks) < 3 or penalty == 0:
        clipped: Array = np.clip(tracks, lower, upper)
        return clipped
    bands = _normal_bands(len(tracks), penalty, trust)
    right = trust[:, None] * tracks
    out: Array = _solve(bands, right)
    outside = (out < lower - _SLACK) | (out > upper + _SLACK)
    alone = _UNHEARD * (penalty / float(trust.min())) ** 0.25
    for column in np.flatnonzero(outside.any(axis=0)):
        limits = float(lower[column]), float(upper[column])
        out[:, column] = _bounded(bands, right[:, column], out[:, column], limits, alone=alone)
    return out


def check_smoothing(tracks: Array, *, penalty: float, trust: Array) -> None:
    """Refuse what cannot be smoothed.

    Raises
    ------
    ValueError
        If a value is not finite, a trust not positive or the penalty negative.
    """
    if not np.isfinite(tracks).all():
        raise ValueError("tracks hold values that are not finite")
    if trust.shape != (len(tracks),) or not (trust > 0).all():
        raise ValueError(f"trust must be {len(tracks)} positive numbers")
    if not penalty >= 0:
        raise ValueError(f"penalty must not be negative, got {penalty}")


def _solve(bands: Array, right: Array) -> Array:
    from scipy.linalg import solveh_banded  # only when wanted: it takes half a second

    solved: Array = solveh_banded(bands, right, check_finite=False)
    return solved


def _bounded(
    bands: Array, right: Array, free: Array, limits: tuple[float, float], *, alone: float
) -> Array:
    """Solve one track, samples that pull beyond a bound held at it.

    Changes more than `alone` frames apart do not hear of each other.
    """
    lower, upper = limits
    held = np.zeros(len(free), dtype=np.int8)
    value, weight = free, _PINNED * float(bands[-1].max())
    fewest, patience = len(free) + 1, _PATIENCE
    for _ in range(_ROUNDS):
        pull = right - _product(bands, value)  # where held: the force into the bound
        wanted = np.where(held == 0, 0, np.where(held > 0, pull > 0, pull < 0) * held)
        wanted = np.where((held == 0) & (value > upper + _SLACK), 1, wanted)
        wanted = np.where((held == 0) & (value < lower - _SLACK), -1, wanted).astype(np.int8)
        wrong = np.flatnonzero(wanted != held)
        if not len(wrong):
            break
        patience = _PATIENCE if len(wrong) < fewest else patience - 1
        fewest = min(fewest, len(wrong))
        if patience < 0:
            wrong = wrong[np.append(np.diff(wrong) > alone, True)]
        held[wrong] = wanted[wrong]
        pinned = bands.copy()
        pinned[-1] += weight * (held != 0)
        goal = np.where(held > 0, upper, lower)
        value = _solve(pinned, right + weight * (held != 0) * goal)
        value = np.where(held > 0, upper, np.where(held < 0, lower, value))
    clipped: Array = np.clip(value, lower, upper)
    return clipped


def _normal_bands(frames: int, penalty: float, trust: Array) -> Array:
    """Return the upper bands of ``diag(trust) + penalty D'D``, the diagonal last."""
    bands = np.zeros((3, frames))
    row = np.array([1.0, -2.0, 1.0])
    for i in range(3):
        for j in range(i, 3):
            bands[2 - (j - i), j : frames - 2 + j] += penalty * row[i] * row[j]
    bands[2] += trust
    return bands


def _product(bands: Array, vector: Array) -> Array:
    """Multiply the symmetric banded matrix by a vector."""
    out: Array = bands[2] * vector
    for off in (1, 2):
        side = bands[2 - off, off:]
        out[:-off] += side * vector[off:]
        out[off:] += side * vector[:-off]
    return out


class FixedLagSmoother:
    """The same smoothing as frames arrive: each is given out when `lag` later ones are known.

    What is given out for a frame is what the whole-take smoothing of all frames up to `lag` after
    it says of it, without bounds: a Kalman filter over the last ``lag + 1`` frames, whose gain is
    shared by all tracks.

    Parameters
    ----------
    tracks : int
    penalty : float
        As of `smooth_within_bounds`.
    lag : int
        Frames; not negative.
    """

    def __init__(self, tracks: int, *, penalty: float, lag: int) -> None:
        if lag < 0 or not penalty > 0:
            raise ValueError(f"lag must not be negative and penalty positive, got {lag}, {penalty}")
        size = max(lag + 1, 2)
        self.lag = lag
        self._move = np.eye(size, k=-1)
        self._move[0, :2] = 2.0, -1.0
        self._drive = 1 / penalty
        self._mean = np.zeros((size, tracks))
        self._covariance = np.zeros((size, size))
        self._seen = 0

    def push(self, values: Array, trust: float = 1.0) -> Array | None:
        """Take in one frame; return the frame `lag` before it, or None while there is none."""
        if self._seen == 0:
            self._mean[:] = values
            # Nothing is known of where the tracks come from or how fast: a wide prior on both.
            self._covariance[:2, :2] = _DIFFUSE * np.array([[1.0, 1.0], [1.0, 2.0]])
        else:
            self._mean = self._move @ self._mean
            self._covariance = self._move @ self._covariance @ self._move.T
            if self._seen > 1:
                self._covariance[0, 0] += self._drive
        known = self._covariance[0, 0] + 1 / trust
        gain = self._covariance[:, 0] / known
        self._mean += gain[:, None] * (values - self._mean[0])
        self._covariance -= np.outer(gain, self._covariance[0])
        self._seen += 1
        return self._mean[self.lag].copy() if self._seen > self.lag else None

    def finish(self) -> list[Array]:
        """Return the frames that are still owed, in order."""
        owed = min(self.lag, self._seen)
        return [self._mean[k].copy() for k in reversed(range(owed))]


_DIFFUSE = 1e6
