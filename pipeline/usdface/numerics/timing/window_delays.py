"""Delays between two recordings with subsample accuracy, and a robust line through them.

By generalised cross-correlation with phase transform (Knapp and Carter 1976, IEEE Transactions on
Acoustics, Speech and Signal Processing 24(4), 320-327) in the band of speech, in which the peak of
the direct path is not smeared by reverberation.
"""

from dataclasses import dataclass

import numpy as np
from scipy import fft

from usdface.core.arrays import (
    MAD_TO_DEVIATION,
    BoolArray,
    ComplexArray,
    Float32Array,
    FloatArray,
    IntArray,
    frame_blocks,
)

_SHORTEST_BASE = 0.3
"""[of the points' span] Least distance of two points that propose a line."""

_MOST_ROUNDS = 6
_AGREEING_DEVIATIONS = 6.0
_PAIRS_AT_ONCE = 2048


@dataclass(frozen=True)
class RobustLine:
    """``y = intercept + slope * x``."""

    intercept: float
    slope: float
    agreeing: BoolArray
    """(n,): the points it was fitted to."""
    deviation: float
    """Root mean square distance of those."""


def fit_robust_line(
    x: FloatArray,
    y: FloatArray,
    *,
    tolerance: float,
    largest_slope: float,
    usual_slope: float,
    noise: float,
) -> RobustLine:
    """Fit a line by RANSAC over all pairs of points, and by least squares to the inliers.

    Fischler and Bolles (1981), without random draws.

    Parameters
    ----------
    x, y : (n,) float array
        At least one point.
    tolerance : float
        Largest distance of an inlier, in the unit of `y`; less if most are nearer.
    largest_slope : float
        Of lines that points propose.
    usual_slope : float
        Prior standard deviation of slopes, against steep lines through a few close points.
    noise : float
        Least standard deviation of a point, in the unit of `y`.
    """
    distance = _distances_to_best(x, y, tolerance, largest_slope)
    agreeing = np.zeros(len(x), bool)
    intercept, slope = 0.0, 0.0
    for _ in range(_MOST_ROUNDS):
        scale = max(noise, MAD_TO_DEVIATION * float(np.median(distance[distance < tolerance])))
        within = distance < min(tolerance, _AGREEING_DEVIATIONS * scale)
        if np.array_equal(within, agreeing):
            break
        agreeing = within
        intercept, slope = _least_squares(x[agreeing], y[agreeing], usual_slope, scale)
        distance = np.abs(y - intercept - slope * x)
    deviation = float(np.sqrt(np.mean(distance[agreeing] ** 2)))
    return RobustLine(intercept, slope, agreeing, deviation)


def _distances_to_best(
    x: FloatArray, y: FloatArray, tolerance: float, largest_slope: float
) -> FloatArray:
    """Return the distance of each point from the line through two of them with most support."""
    first, second = np.triu_indices(len(x), k=1)
    far = np.abs(x[second] - x[first]) >= _SHORTEST_BASE * np.ptp(x)
    first, second = first[far], second[far]
    with np.errstate(divide="ignore", invalid="ignore"):
        slopes = (y[second] - y[first]) / (x[second] - x[first])
    possible = np.abs(slopes) <= largest_slope  # NaN is not
    # Level lines through each point, for few points that are far from any line.
    through = np.concatenate([np.arange(len(x)), first[possible]])
    slopes = np.concatenate([np.zeros(len(x)), slopes[possible]])
    best = -1.0
    nearest = np.zeros(len(x))
    for pairs in frame_blocks(len(through), frames=_PAIRS_AT_ONCE):
        point, slope = through[pairs, None], slopes[pairs, None]
        distance = np.abs(y - y[point] - slope * (x - x[point]))
        # Near points weigh more (MSAC, Torr and Zisserman 2000), or a tilt that includes one more
        # point would win.
        support = np.maximum(1 - distance / tolerance, 0).sum(axis=1)
        index = int(np.argmax(support))
        if support[index] > best:
            best, nearest = float(support[index]), distance[index]
    return nearest


def _least_squares(
    x: FloatArray, y: FloatArray, usual_slope: float, noise: float
) -> tuple[float, float]:
    middle, level = float(x.mean()), float(y.mean())
    slope = float(((x - middle) * (y - level)).sum()) / float(
        ((x - middle) ** 2).sum() + (noise / usual_slope) ** 2
    )
    return level - slope * middle, slope


_DELAY_OVERSAMPLING = 4
"""Positions per sample, before parabolic interpolation."""

_LOUD_SHARE = 0.02
"""[of the power of loud windows] Quieter ones have no speech."""
_LEAST_WINDOWS = 8
"""Used however quiet they are."""
_WHITENING_EXPONENT = 0.8
"""Less than 1, which would amplify frequencies without signal."""

_LOWEST_HZ, _HIGHEST_HZ = 200.0, 6000.0


@dataclass(frozen=True)
class WindowDelays:
    """Delays of the second recording against the first, window by window."""

    times: FloatArray
    """(windows,): middle of each window on the clock of the first recording [s]."""
    delays: FloatArray
    """(windows,) [s]"""


def window_delays(
    first: Float32Array,
    second: Float32Array,
    *,
    rate: int,
    window: float,
    count: int,
    expected: tuple[float, float],
    radius: tuple[float, float],
) -> WindowDelays:
    """Measure the delay of the louder windows of one recording in another.

    Parameters
    ----------
    first, second : (samples,) float32 array
    window : float
        Length [s].
    count : int
        Most windows to measure; they overlap by half where there is room for fewer.
    expected : (2,) tuple of float
        Delay at time 0 [s] and its growth per second.
    radius : (2,) tuple of float
        Half width of the search around the expected delay: at the middle of the overlap [s], and
        its growth per second away from it.
    """
    size = round(window * rate)
    starts = _starts(len(first), len(second), rate, size, count, expected)
    starts = loud_windows(first, starts, size)
    middle = (starts[0] + starts[-1]) / 2 if len(starts) else 0.0
    taper = np.hanning(size).astype(np.float32)
    times, delays = list[float](), list[float]()
    for start in starts.tolist():
        seconds = (start + size / 2) / rate
        guess = round((expected[0] + expected[1] * seconds) * rate)
        reach = round((radius[0] + radius[1] * abs(start - middle) / rate) * rate)
        begin = start + guess - reach
        region = np.zeros(size + 2 * reach, np.float32)
        covered = second[max(begin, 0) : max(begin + len(region), 0)]
        region[max(-begin, 0) :][: len(covered)] = covered
        delay = _delay(first[start : start + size] * taper, region, reach, rate)
        if delay is not None:
            times.append(seconds)
            delays.append((guess - reach + delay) / rate)
    return WindowDelays(np.array(times), np.array(delays))


def loud_windows(sound: Float32Array, starts: IntArray, size: int) -> IntArray:
    """Return the starts of windows louder than pauses, at least eight."""
    if not len(starts):
        return starts
    power = np.array([np.mean(sound[start : start + size] ** 2) for start in starts.tolist()])
    enough = np.sort(power)[-min(_LEAST_WINDOWS, len(power))]
    return starts[power >= min(_LOUD_SHARE * float(np.quantile(power, 0.9)), float(enough))]


def speech_band(length: int, *, rate: int) -> Float32Array:
    """Return 1 at the frequencies of speech of a transform of `length` samples, else 0.

    Returns (length // 2 + 1,).
    """
    frequency = fft.rfftfreq(length, 1 / rate)
    band = (frequency > _LOWEST_HZ) & (frequency < min(_HIGHEST_HZ, 0.45 * rate))
    return band.astype(np.float32)


def whitened_product(
    first: ComplexArray, second: ComplexArray, *, band: Float32Array
) -> ComplexArray | None:
    """Return the partly whitened cross spectrum of two sounds.

    Returns (n,), or None for silence.

    Parameters
    ----------
    first, second : (n,) complex array
        Spectra of two sounds.
    band : (n,) float array
        Weight of each frequency.
    """
    cross = first.conj() * second
    size = np.abs(cross)
    median = float(np.median(size))
    if not median > 0:
        return None
    floor = 1e-3 * median**_WHITENING_EXPONENT
    return np.asarray(cross * (band / (size**_WHITENING_EXPONENT + floor)))


def _starts(
    first: int, second: int, rate: int, size: int, count: int, expected: tuple[float, float]
) -> IntArray:
    """Return the starts of windows over the part of the first that the second covers."""
    begin = max(0, round(-expected[0] * rate))
    end = min(first, round(second - expected[0] * rate)) - size
    if end < begin:
        return np.zeros(0, np.int64)
    room = 2 * (end - begin) // size + 1
    return np.unique(np.linspace(begin, end, min(room, count)).astype(np.int64))


def _delay(sound: Float32Array, region: Float32Array, reach: int, rate: int) -> float | None:
    """Return the delay of the sound in `region` [samples]; None for silence."""
    length = fft.next_fast_len(len(region) + len(sound), real=True)
    spectra = fft.rfft(sound, length), fft.rfft(region, length)
    whitened = whitened_product(*spectra, band=speech_band(length, rate=rate))
    if whitened is None:
        return None
    # Absolute value, as microphones and cables may invert the polarity.
    curve = np.abs(
        fft.irfft(whitened, length * _DELAY_OVERSAMPLING)[: 2 * reach * _DELAY_OVERSAMPLING + 1]
    )
    best = int(np.argmax(curve))
    between = 0.0
    if 0 < best < len(curve) - 1:
        left, peak, right = curve[best - 1 : best + 2].tolist()
        bend = left - 2 * peak + right
        between = 0.5 * (left - right) / bend if bend < 0 else 0.0
    return (best + between) / _DELAY_OVERSAMPLING
