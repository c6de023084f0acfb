"""Smoothing of tracks: filter banks, penalised least squares within bounds, and fixed-lag filters.

Penalised least squares minimises ``sum_t r_t (w_t - y_t)^2 + penalty sum_t (w_{t-1} - 2 w_t +
w_{t+1})^2`` within bounds, for every track. Its normal matrix has five diagonals. The samples at a
bound are found by a primal-dual active-set method, which is exact after a few solves. Where it
cycles, at low cut-offs, an interior-point method finds them in some dozens.

The filter bank is the smoothing of the paper of the cross-mapping: a pyramid of bands, each an
octave wide, scaled by gains. With gains of 0 and 1 it is a filter of finite length; see
`filter_reach`.

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
    """Return curves with the bands of their Laplacian pyramid scaled.

    G₀ is the curve and G₍ₖ₊₁₎ = Gₖ smoothed by a kernel dilated by 2ᵏ frames; the bands are Lₖ = Gₖ
    − G₍ₖ₊₁₎, and the result is G_n + Σ gainₖ Lₖ. Curves are padded by their end values. Returns
    (frames, curves), which may exceed the range of the input unless all gains are 1.

    Parameters
    ----------
    values : (frames, curves) array
    gains : sequence of float
        Of each band, the finest first: band k has about rate/2ᵏ⁺² to rate/2ᵏ⁺¹ Hz.

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
    """Return the reach of the filter without the finest `bands`, on either side [frames]."""
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
"""[of the rate] Lower cut-offs leave only a line, to within rounding: the penalty is their fourth
power."""

_MOST_ACTIVE_SET_ROUNDS = 30
_PIN_WEIGHT = 1e8  # of a sample fixed at its bound, over the largest diagonal entry
_MOST_INTERIOR_STEPS = 100
_CENTRING_SHARE = 0.1  # target of the next step for the duality gap
_CLOSED_GAP_SHARE = 1e-15  # of the first duality gap, at convergence
_BOUND_SLACK = 1e-9  # tolerance of the bounds
_DIFFUSE_VARIANCE = 1e6  # of the prior on the first value and slope


def cutoff_penalty(cutoff_hz: float, rate: float) -> float:
    """Return the penalty that halves the amplitude at a frequency.

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
    """Smooth every column within its bounds: (frames, n).

    Parameters
    ----------
    tracks : (frames, n) float array
    penalty : float
        Of squared second differences; 0 only clips the tracks.
    trust : (frames,) float array
        Weight of each frame, positive.
    lower, upper : (n,) float arrays
    """
    if not np.isfinite(tracks).all():
        raise ValueError("tracks hold values that are not finite")
    if len(tracks) < 3 or penalty == 0:
        return np.asarray(np.clip(tracks, lower, upper))
    bands = _normal_bands(len(tracks), penalty, trust)
    right = trust[:, None] * tracks
    out: FloatArray = _solve(bands, right)
    outside = (out < lower - _BOUND_SLACK) | (out > upper + _BOUND_SLACK)
    for column in np.flatnonzero(outside.any(axis=0)):
        out[:, column] = _bounded(
            bands, right[:, column], out[:, column], float(lower[column]), float(upper[column])
        )
    return out


def _solve(bands: FloatArray, right: FloatArray) -> FloatArray:
    from scipy.linalg import solveh_banded  # imported late: it takes half a second

    return np.asarray(solveh_banded(bands, right, check_finite=False))


def _bounded(
    bands: FloatArray, right: FloatArray, free: FloatArray, lower: float, upper: float
) -> FloatArray:
    """Solve one track within bounds by a primal-dual active-set method."""
    active = np.zeros(len(free), dtype=np.int8)
    value = free
    for _ in range(_MOST_ACTIVE_SET_ROUNDS):
        multiplier = right - _product(bands, value)
        outward = np.where(active > 0, multiplier > 0, multiplier < 0)
        following = np.where(active == 0, 0, outward * active)
        following = np.where((active == 0) & (value > upper + _BOUND_SLACK), 1, following)
        following = np.where((active == 0) & (value < lower - _BOUND_SLACK), -1, following)
        if (following == active).all():
            break
        active = following.astype(np.int8)
        value = _pinned(bands, right, active, lower, upper)
    else:  # it cycles
        active = _active_set_by_interior_point(bands, right, lower, upper)
        value = _pinned(bands, right, active, lower, upper)
    return np.asarray(np.clip(value, lower, upper))


def _pinned(
    bands: FloatArray, right: FloatArray, active: NDArray[np.int8], lower: float, upper: float
) -> FloatArray:
    """Solve with samples fixed at a bound: the upper where active is 1, the lower where -1."""
    weight = _PIN_WEIGHT * float(bands[-1].max()) * (active != 0)
    stiff = bands.copy()
    stiff[-1] += weight
    value = _solve(stiff, right + weight * np.where(active > 0, upper, lower))
    return np.where(active > 0, upper, np.where(active < 0, lower, value))


def _active_set_by_interior_point(
    bands: FloatArray, right: FloatArray, lower: float, upper: float
) -> NDArray[np.int8]:
    """Find the samples at a bound by an interior-point method, which does not cycle."""
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
    """Fixed-lag smoother of the same model: a frame is returned `lag` frames later.

    The result for a frame equals that of smoothing the take up to `lag` frames after it, without
    bounds. A Kalman filter over the last ``lag + 1`` frames, whose gain is shared by all tracks.
    """

    def __init__(self, tracks: int, *, penalty: float, lag: int) -> None:
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
            self._covariance[:2, :2] = _DIFFUSE_VARIANCE * np.array([[1.0, 1.0], [1.0, 2.0]])
        else:
            self._mean = self._move @ self._mean
            self._covariance = self._move @ self._covariance @ self._move.T
            if self._seen > 1:
                self._covariance[0, 0] += self._drive
        gain = self._covariance[:, 0] / (self._covariance[0, 0] + 1 / trust)
        self._mean += gain[:, None] * (values - self._mean[0])
        self._covariance -= np.outer(gain, self._covariance[0])
        self._seen += 1
        return self._mean[self.lag].copy() if self._seen > self.lag else None

    def finish(self) -> list[FloatArray]:
        """Return the frames that are not yet returned, in order."""
        left = min(self.lag, self._seen)
        return [self._mean[k].copy() for k in reversed(range(left))]
