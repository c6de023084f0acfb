"""Coarse shift between two recordings: correlation of onsets, and vote of windows by phase.

Two microphones record different spectra of the same sound, but the same onsets in each band. Over
long recordings the clocks drift by more than the width of the peak, so stretches of a minute are
correlated separately and added along each possible drift. The resolution is 10 ms.

By phase, a window of two seconds has tens of thousands of independent phases, which match the same
sound in the other recording even under noise as loud as the speech, which masks onsets. It takes a
transform of the whole recording per window, so it is used where onsets are ambiguous.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy import fft

from usdface.core.arrays import MAD_TO_DEVIATION, Float32Array, FloatArray, IntArray, frame_blocks
from usdface.numerics.timing.window_delays import loud_windows, speech_band, whitened_product

_BLOCK_SAMPLES = 1 << 20
"""A minute at 16 kHz: longer transforms take memory and save no time."""

_PEAKS_PER_WINDOW = 3
"""A repeating sound has several correct ones."""
_PEAK_SPACING_SECONDS = 0.05
"""Least distance of separate peaks."""
_TOLERANCE_SECONDS = 0.002
"""Largest difference of shifts that agree."""


@dataclass(frozen=True)
class PhaseVote:
    """The shift on which most windows agree."""

    shift: float
    """Delay of the second recording, at the middle of the windows [s]."""
    middle: float
    """That middle on the clock of the first recording [s]."""
    votes: int
    """Windows that agree on it."""
    rival: float
    """The other shift with most votes [s]; NaN if no two windows agree on another."""
    rival_votes: int
    windows: int
    """Number of windows."""


def scan_phase(
    first: Float32Array,
    second: Float32Array,
    *,
    rate: int,
    window: float,
    count: int,
    largest_drift: float,
) -> PhaseVote | None:
    """Locate windows of the first recording in the second, and return the most frequent shift.

    Returns None for silence.

    Parameters
    ----------
    first, second : (samples,) float32 array
    window : float
        Length of a window [s].
    count : int
        Most windows.
    largest_drift : float
        Largest change of the shift per second.
    """
    size = round(window * rate)
    room = max(len(first) - size, 0)
    starts = np.unique(np.linspace(0, room, min(count, 2 * room // size + 1)).astype(np.int64))
    starts = loud_windows(first, starts, size)
    taper = np.hanning(size).astype(np.float32)
    times, delays = list[float](), list[FloatArray]()
    for start in starts.tolist():
        heights = _whitened_correlation(first[start : start + size] * taper, second, rate)
        places = _largest_peaks(heights, spacing=round(_PEAK_SPACING_SECONDS * rate))
        if len(places):
            times.append((start + size / 2) / rate)
            delays.append((places - (size - 1) - start) / rate)
    if not times:
        return None
    return _count_votes(np.array(times), delays, largest_drift)


def _whitened_correlation(sound: Float32Array, second: Float32Array, rate: int) -> Float32Array:
    """Return the whitened correlation of a window with the second recording at all lags."""
    size = len(sound)
    total = len(second) + size - 1
    length = fft.next_fast_len(min(total, _BLOCK_SAMPLES) + size, real=True)
    step = length - size + 1
    spectrum = fft.rfft(sound, length)
    band = speech_band(length, rate=rate)
    padded = np.pad(second, (size - 1, size - 1))
    heights = np.zeros(total, np.float32)
    for begin in range(0, total, step):
        block = padded[begin : begin + length]
        product = whitened_product(spectrum, fft.rfft(block, length), band=band)
        if product is not None:
            lags = np.abs(fft.irfft(product, length)[: min(step, total - begin)])
            # Whitened blocks are equally loud: normalise each.
            lags /= max(float(np.sqrt(np.mean(lags**2))), 1e-30)
            heights[begin : begin + len(lags)] = lags
    return heights


def _largest_peaks(heights: Float32Array, *, spacing: int) -> IntArray:
    remaining = heights.copy()
    places = list[int]()
    for _ in range(_PEAKS_PER_WINDOW):
        place = int(np.argmax(remaining))
        if not remaining[place] > 0:
            break
        places.append(place)
        remaining[max(place - spacing, 0) : place + spacing + 1] = 0
    return np.array(places, np.int64)


def _count_votes(times: FloatArray, delays: list[FloatArray], largest_drift: float) -> PhaseVote:
    middle = float((times[0] + times[-1]) / 2)
    owners = np.repeat(np.arange(len(times)), [len(of_window) for of_window in delays])
    places = np.concatenate(delays)
    away = np.abs(times[owners] - middle)
    reach = _TOLERANCE_SECONDS + largest_drift * (away[:, None] + away[None, :])
    near = np.abs(places[:, None] - places[None, :]) < reach
    votes = np.array([len(np.unique(owners[row])) for row in near])
    # Of equal votes the one nearest the middle, where drift matters least.
    best = int(np.lexsort((away, -votes))[0])
    others = np.flatnonzero(np.abs(places - places[best]) > _PEAK_SPACING_SECONDS)
    rival = others[int(np.argmax(votes[others]))] if len(others) else best
    rival_votes = int(votes[rival]) if len(others) else 0
    return PhaseVote(
        shift=float(np.median(places[near[best]])),
        middle=middle,
        votes=int(votes[best]),
        rival=float(places[rival]) if rival_votes > 1 else np.nan,
        rival_votes=rival_votes,
        windows=len(times),
    )


HOPS_PER_SECOND = 100
_WINDOW_SECONDS = 0.025
_BAND_COUNT = 24
_LOWEST_HZ, _HIGHEST_HZ = 125.0, 7000.0
_FRAMES_AT_ONCE = 1 << 14

_STRETCH_HOPS = 60 * HOPS_PER_SECOND
"""A minute, in which a drift of 300 ppm is less than two hops."""

_PEAK_HOPS = 30
"""Half width of a peak: autocorrelation of onsets by syllables."""

_SHORTEST_OVERLAP = HOPS_PER_SECOND
_OVERLAP_SHARE = 0.2
"""Least overlap that is scored: one second, and this share of the shorter recording."""
_RIVAL_PEAK = 6.0
"""Least score of a significant second peak: the largest of a million random scores is 5."""


@dataclass(frozen=True)
class OnsetCorrelation:
    """Correlation of the onsets of two recordings over shifts."""

    shifts: FloatArray
    """(n,): delay of the second recording against the first [s]; ascending."""
    scores: FloatArray
    """(n,): correlation in robust standard deviations of all shifts; NaN where the overlap is too
    short."""
    shift: float
    """The best, at the middle of the first recording [s]."""
    drift: float
    """Growth of the shift per second, of the values tried."""
    drift_step: float
    """Distance between the values tried; 0 for one value."""
    peak: float
    """Score of the best shift."""
    rival: float
    """The second best shift, apart from the best peak [s]."""
    ratio: float
    """Best over second best: the smaller of the ratios of the scores and, for a significant second
    peak, of the correlations per second of overlap. 1 for a sound that repeats."""


def onset_flux(sound: Float32Array, *, rate: int) -> Float32Array:
    """Return the spectral flux of a sound (samples,) by band, a hundred times a second.

    Returns (24, hops), the positive differences of the logarithmic power; each band has mean 0 and
    deviation 1, or is 0 if it is constant.
    """
    hop, size = rate // HOPS_PER_SECOND, round(_WINDOW_SECONDS * rate)
    count = (len(sound) - size) // hop + 1
    if count < 2:
        return np.zeros((_BAND_COUNT, 0), np.float32)
    length = fft.next_fast_len(size, real=True)
    highest = min(_HIGHEST_HZ, 0.45 * rate)
    bins = np.geomspace(_LOWEST_HZ, highest, _BAND_COUNT + 1) * length / rate
    edges: IntArray = np.round(bins).astype(np.int64)
    # Low bands may be narrower than one bin of the spectrum: each has at least one.
    for index in range(1, len(edges)):
        edges[index] = max(edges[index], edges[index - 1] + 1)
    window = np.hanning(size).astype(np.float32)
    frames = sliding_window_view(sound, size)[::hop]
    power = np.empty((_BAND_COUNT, count), np.float32)
    for block in frame_blocks(count, frames=_FRAMES_AT_ONCE):
        spectrum = fft.rfft(frames[block] * window, length, axis=1)
        energy = spectrum.real**2 + spectrum.imag**2
        power[:, block] = np.add.reduceat(energy[:, : edges[-1]], edges[:-1], axis=1).T
    # A floor at the band's median power, without digital silence, suppresses noise.
    floor = np.empty((_BAND_COUNT, 1), np.float32)
    for band, row in enumerate(power):
        audible = row[row > 1e-9 * row.max()]
        floor[band] = np.median(audible) if len(audible) else 1.0
    rise = np.maximum(np.diff(np.log(power + floor), axis=1), 0)
    rise -= rise.mean(axis=1, keepdims=True)
    deviation = rise.std(axis=1, keepdims=True)
    rise /= np.where(deviation > 1e-6, deviation, np.inf)
    return np.asarray(rise)


def correlate_onsets(
    first: Float32Array, second: Float32Array, *, largest_drift: float
) -> OnsetCorrelation | None:
    """Return the correlation of onsets over shifts, at the best drift.

    Returns None if the recordings are too short, or one is constant.

    Parameters
    ----------
    first, second : (bands, hops) float32 array
        From `onset_flux`.
    largest_drift : float
        Largest change of the shift per second.
    """
    hops = first.shape[1], second.shape[1]
    if min(hops) < _SHORTEST_OVERLAP or not first.any() or not second.any():
        return None
    middles, products = _stretch_products(first, second)
    overlap = _overlap(*hops)
    shortest = max(_SHORTEST_OVERLAP, _OVERLAP_SHARE * min(hops))
    enough = overlap >= shortest
    weight = np.where(enough, 1 / np.sqrt(np.maximum(overlap, 1)), 0.0).astype(np.float32)
    drifts = _drifts(hops[0], largest_drift)
    best_sum, best_drift, best_score = np.zeros(0, np.float32), 0.0, -np.inf
    for drift in drifts:
        total = np.zeros(sum(hops) - 1, np.float32)
        for middle, (place, product) in zip(middles, products, strict=True):
            _add_at(total, product, place - round(drift * (middle - hops[0] / 2)))
        score = float((total * weight).max())
        if score > best_score:
            best_sum, best_drift, best_score = total, drift, score
    shifts = (np.arange(sum(hops) - 1) - (hops[0] - 1)) / HOPS_PER_SECOND
    return _rank_shifts(
        shifts,
        best_sum.astype(np.float64),
        np.where(enough, overlap, np.nan),
        drift=best_drift,
        drift_step=float(drifts[1] - drifts[0]) if len(drifts) > 1 else 0.0,
    )


def _rank_shifts(
    shifts: FloatArray,
    products: FloatArray,
    overlap: FloatArray,
    *,
    drift: float,
    drift_step: float,
) -> OnsetCorrelation:
    # Over the root of the overlap, the variance of random correlations is equal at all shifts.
    scores = products / np.sqrt(overlap)
    centre = np.nanmedian(scores)
    deviation = MAD_TO_DEVIATION * float(np.nanmedian(np.abs(scores - centre)))
    scores = (scores - centre) / max(deviation, 1e-12)
    best = int(np.nanargmax(scores))
    away = np.isfinite(scores)
    away[max(best - _PEAK_HOPS, 0) : best + _PEAK_HOPS + 1] = False
    peak, ratio, rival = float(scores[best]), np.inf, np.nan
    candidates = np.flatnonzero(away)
    if len(candidates):
        second = candidates[int(np.argmax(scores[candidates]))]
        rival, ratio = float(shifts[second]), peak / max(float(scores[second]), 1e-12)
        # A repeating sound agrees equally well one period away, over a shorter overlap.
        real = candidates[scores[candidates] >= _RIVAL_PEAK]
        if len(real):
            agreement = products / overlap
            repeat = real[int(np.argmax(agreement[real]))]
            repeat_ratio = float(agreement[best] / agreement[repeat])
            if repeat_ratio < ratio:
                rival, ratio = float(shifts[repeat]), repeat_ratio
    return OnsetCorrelation(
        shifts, scores, float(shifts[best]), drift, drift_step, peak, rival, ratio
    )


def _stretch_products(
    first: Float32Array, second: Float32Array
) -> tuple[list[float], list[tuple[int, Float32Array]]]:
    """Correlate each stretch of the first with all of the second.

    Returns the middles of the stretches, and for each the index of its first lag and its products.
    """
    hops = first.shape[1]
    edges = np.linspace(0, hops, -(-hops // _STRETCH_HOPS) + 1).astype(int)
    size = int(np.diff(edges).max())
    length = fft.next_fast_len(second.shape[1] + size, real=True)
    spectrum = fft.rfft(second, length, axis=1)
    middles, products = list[float](), list[tuple[int, Float32Array]]()
    for start, stop in pairwise(edges.tolist()):
        stretch = fft.rfft(first[:, start:stop], length, axis=1)
        product = fft.irfft((stretch.conj() * spectrum).sum(axis=0), length).astype(np.float32)
        before = stop - start - 1
        lags = np.concatenate([product[length - before :], product[: second.shape[1]]])
        middles.append((start + stop) / 2)
        products.append((hops - stop, lags))
    return middles, products


def _overlap(first: int, second: int) -> FloatArray:
    """Return the overlap at each lag [hops], from the second before the first to after it."""
    lags = np.arange(first + second - 1) - (first - 1)
    overlap = np.minimum(first, second - lags) - np.maximum(0, -lags)
    return overlap.astype(np.float64)


def _drifts(hops: int, largest: float) -> FloatArray:
    """Return the drifts to try, spaced by one hop at either end of the recording."""
    if hops <= _STRETCH_HOPS:
        return np.zeros(1)
    count = int(np.ceil(largest * hops / 2))
    return np.linspace(-largest, largest, 2 * count + 1)


def _add_at(total: Float32Array, part: Float32Array, place: int) -> None:
    start, stop = max(place, 0), min(place + len(part), len(total))
    if stop > start:
        total[start:stop] += part[start - place : stop - place]
