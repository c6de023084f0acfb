"""Smooth tracks within bounds: a banded system, linear in the frames.

Minimises ``sum_t r_t (w_t - y_t)^2 + penalty sum_t (w_{t-1} - 2 w_t + w_{t+1})^2`` within bounds,
for every track by itself. Its normal matrix has five diagonals. Which samples lie at a bound is
found by a primal-dual active set: exact, in a few solves. Where a low cut-off makes it cycle, an
interior point finds them, in some dozens.

The filter bank is the smoothing of the paper of the cross-mapping: a motion is split into a pyramid
of bands, each an octave wide; gains scale each of them. With gains of 0 and 1, finest bands left
out, the pyramid is one short filter of finite length: what it does at a frame ends `reach` frames
away.

References
----------
Hintermueller, Ito and Kunisch (2002), SIAM J. Optim. 13(3), 865-888: the active set. Nocedal
and Wright (2006), Numerical Optimization, section 16.6: the interior point.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from usdface.core.arrays import FloatArray

_KERNEL = np.array([1.0, 4.0, 6.0, 4.0, 1.0]) / 16.0  # Burt and Adelson's, a = 3/8


def apply_filter_bank(values: ArrayLike, *, gains: Sequence[float]) -> FloatArray:
    """Split curves into bands, weigh the bands and add them up again.

    G₀ is the curve and G₍ₖ₊₁₎ = Gₖ smoothed by a kernel spread over 2ᵏ frames; the bands are
    Lₖ = Gₖ − G₍ₖ₊₁₎, and the result is G_n + Σ gainₖ Lₖ. Curves go on at their ends as they end.

    Parameters
    ----------
    values : (frames, curves) array
    gains : sequence of float
        One for each band, the finest first: band k holds about rate/2ᵏ⁺² to rate/2ᵏ⁺¹ Hz. All 1
        gives the curves back.

    Returns
    -------
    (frames, curves) float array
        Bands amplified or left out may take values beyond where they were: limit them last.

    References
    ----------
    Bruderlin and Williams (1995), Motion signal processing, SIGGRAPH, section 2.1; Deng et al.
    (2006), section 6: weights smoothed after mapping.
    """
    level = _checked(values)
    if not np.isfinite(gains).all():
        raise ValueError(f"gains must be finite, got {list(gains)}")
    out = np.zeros_like(level)
    for band, gain in enumerate(gains):
        coarser = _smoothed(level, 1 << band)
        out += gain * (level - coarser)
        level = coarser
    out += level
    return out


def filter_reach(bands: int) -> int:
    """Return how many frames away a frame still counts with so many bands left out."""
    return 2 * ((1 << bands) - 1)


def _checked(values: ArrayLike) -> FloatArray:
    curves = np.array(values, dtype=np.float64)
    if curves.ndim != 2:
        raise ValueError(f"values have shape {curves.shape}, not (frames, curves)")
    if not np.isfinite(curves).all():
        raise ValueError("values must be finite")
    return curves


def _smoothed(level: FloatArray, spread: int) -> FloatArray:
    frames = len(level)
    if not frames:
        return level
    padded = np.pad(level, ((2 * spread, 2 * spread), (0, 0)), mode="edge")
    out = np.zeros_like(level)
    for tap, share in enumerate(_KERNEL):
        out += share * padded[tap * spread : tap * spread + frames]
    return out


LEAST_CUTOFF_SHARE = 1e-4
"""[of the rate] A lower cut-off leaves nothing but a line, to within rounding: the penalty grows as
its fourth power."""

_MOST_ACTIVE_SET_ROUNDS = 30
_PIN_WEIGHT = 1e8  # of a sample held at its bound, over the largest diagonal entry
_MOST_INTERIOR_STEPS = 100
_CENTRING_SHARE = 0.1  # of the duality gap, aimed at by the next step
_CLOSED_GAP_SHARE = 1e-15  # of the first duality gap
_BOUND_SLACK = 1e-9  # by which a weight may exceed a bound before it is held there
_DIFFUSE_VARIANCE = 1e6  # of the prior on the first value and slope: nothing is known of them


def cutoff_penalty(cutoff_hz: float, rate: float) -> float:
    """Return the penalty that halves a motion of this frequency.

    Parameters
    ----------
    cutoff_hz : float
        From `LEAST_CUTOFF_SHARE` of the rate to half of it.
    """
    if not LEAST_CUTOFF_SHARE * rate <= cutoff_hz <= rate / 2:
        raise ValueError(
            f"a cut-off must lie between {LEAST_CUTOFF_SHARE * rate:g} Hz and half the rate of "
            f"{rate:g} frames per second, got {cutoff_hz:g} Hz"
        )
    return float((2 * np.sin(np.pi * cutoff_hz / rate)) ** -4)


def smooth_within_bounds(
    tracks: FloatArray, *, penalty: float, trust: FloatArray, lower: FloatArray, upper: FloatArray
) -> FloatArray:
    """Smooth every column under its bounds: (frames, n).

    Parameters
    ----------
    tracks : (frames, n) float array
    penalty : float
        On squared second differences; 0 only brings the tracks within their bounds.
    trust : (frames,) float array
        Weight of each frame, positive: frames with little follow their neighbours.
    lower, upper : (n,) float arrays
    """
    _check(tracks, penalty, trust)
    if len(tracks) < 3 or penalty == 0:
        clipped: FloatArray = np.clip(tracks, lower, upper)
        return clipped
    bands = _normal_bands(len(tracks), penalty, trust)
    right = trust[:, None] * tracks
    out: FloatArray = _solve(bands, right)
    outside = (out < lower - _BOUND_SLACK) | (out > upper + _BOUND_SLACK)
    for column in np.flatnonzero(outside.any(axis=0)):
        out[:, column] = _bounded(
            bands, right[:, column], out[:, column], float(lower[column]), float(upper[column])
        )
    return out


def _check(tracks: FloatArray, penalty: float, trust: FloatArray) -> None:
    if not np.isfinite(tracks).all():
        raise ValueError("tracks hold values that are not finite")
    if trust.shape != (len(tracks),) or not (trust > 0).all():
        raise ValueError(f"trust must be {len(tracks)} positive numbers")
    if not penalty >= 0:
        raise ValueError(f"penalty must not be negative, got {penalty}")


def _solve(bands: FloatArray, right: FloatArray) -> FloatArray:
    from scipy.linalg import solveh_banded  # only when wanted: it takes half a second

    solved: FloatArray = solveh_banded(bands, right, check_finite=False)
    return solved


def _bounded(
    bands: FloatArray, right: FloatArray, free: FloatArray, lower: float, upper: float
) -> FloatArray:
    """Solve one track; samples that pull beyond a bound are held at it."""
    active = np.zeros(len(free), dtype=np.int8)
    value = free
    for _ in range(_MOST_ACTIVE_SET_ROUNDS):
        pull = right - _product(bands, value)  # where active: the force into the bound
        wanted = np.where(active == 0, 0, np.where(active > 0, pull > 0, pull < 0) * active)
        wanted = np.where((active == 0) & (value > upper + _BOUND_SLACK), 1, wanted)
        wanted = np.where((active == 0) & (value < lower - _BOUND_SLACK), -1, wanted)
        if (wanted == active).all():
            break
        active = wanted.astype(np.int8)
        value = _pinned(bands, right, active, lower, upper)
    else:  # it cycles
        active = _active_set_by_interior_point(bands, right, lower, upper)
        value = _pinned(bands, right, active, lower, upper)
    clipped: FloatArray = np.clip(value, lower, upper)
    return clipped


def _pinned(
    bands: FloatArray, right: FloatArray, active: NDArray[np.int8], lower: float, upper: float
) -> FloatArray:
    """Solve with samples held at a bound: the upper where active is 1, the lower where -1."""
    weight = _PIN_WEIGHT * float(bands[-1].max()) * (active != 0)
    stiff = bands.copy()
    stiff[-1] += weight
    value = _solve(stiff, right + weight * np.where(active > 0, upper, lower))
    return np.where(active > 0, upper, np.where(active < 0, lower, value))


def _active_set_by_interior_point(
    bands: FloatArray, right: FloatArray, lower: float, upper: float
) -> NDArray[np.int8]:
    """Find which samples lie at a bound by an interior-point method, which never cycles."""
    value = np.full(len(right), (lower + upper) / 2)
    below = above = np.full(len(right), max(float(np.abs(right).max()), 1e-300))
    first = float(below[0]) * (upper - lower)
    for _ in range(_MOST_INTERIOR_STEPS):
        low, high = value - lower, upper - value
        gap = float(below @ low + above @ high) / (2 * len(value))
        if gap < _CLOSED_GAP_SHARE * first:
            break
        down, up = _CENTRING_SHARE * gap / low - below, _CENTRING_SHARE * gap / high - above
        stiff = bands.copy()
        stiff[-1] += below / low + above / high
        step = _solve(stiff, right - _product(bands, value) + below - above + down - up)
        down, up = down - below / low * step, up + above / high * step
        room = min(
            float(np.where(move < 0, -left / np.where(move < 0, move, -1.0), np.inf).min())
            for left, move in ((low, step), (high, -step), (below, down), (above, up))
        )
        length = min(1.0, 0.995 * room)
        value = value + length * step
        below, above = below + length * down, above + length * up
    at_lower = below > bands[-1] * (value - lower)
    at_upper = above > bands[-1] * (upper - value)
    return np.where(at_upper, 1, np.where(at_lower, -1, 0)).astype(np.int8)


def _normal_bands(frames: int, penalty: float, trust: FloatArray) -> FloatArray:
    """Return the upper bands of ``diag(trust) + penalty D'D``, the diagonal last."""
    bands = np.zeros((3, frames))
    row = np.array([1.0, -2.0, 1.0])
    for i in range(3):
        for j in range(i, 3):
            bands[2 - (j - i), j : frames - 2 + j] += penalty * row[i] * row[j]
    bands[2] += trust
    return bands


def _product(bands: FloatArray, vector: FloatArray) -> FloatArray:
    """Multiply the symmetric banded matrix by a vector."""
    out: FloatArray = bands[2] * vector
    for off in (1, 2):
        side = bands[2 - off, off:]
        out[:-off] += side * vector[off:]
        out[off:] += side * vector[:-off]
    return out


class FixedLagSmoother:
    """The same smoothing as frames arrive: each is returned when `lag` later ones are known.

    The result for a frame is that of smoothing the take up to `lag` frames after it, without
    bounds: a Kalman filter over the last ``lag + 1`` frames, whose gain is shared by all tracks.
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

    def push(self, values: FloatArray, trust: float = 1.0) -> FloatArray | None:
        """Take in one frame; return the frame `lag` before it, or None while there is none."""
        if self._seen == 0:
            self._mean[:] = values
            # A wide prior on where the tracks come from and how fast.
            self._covariance[:2, :2] = _DIFFUSE_VARIANCE * np.array([[1.0, 1.0], [1.0, 2.0]])
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

    def finish(self) -> list[FloatArray]:
        """Return the frames that are not yet returned, in order."""
        left = min(self.lag, self._seen)
        return [self._mean[k].copy() for k in reversed(range(left))]
