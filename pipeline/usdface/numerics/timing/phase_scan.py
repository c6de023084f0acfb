"""Find one recording in another by phase alone, window by window, wherever it may be.

A window of two seconds has tens of thousands of independent phases: where the same sound is in the
other recording they line up, even under noise as loud as the speech, which drowns the onsets. It
costs a transform of the whole recording a window, so it is for what onsets leave undecided.
"""

from dataclasses import dataclass

import numpy as np
from scipy import fft

from usdface.core.arrays import Float32Array, FloatArray, IntArray
from usdface.numerics.timing.window_delays import loud_windows, speech_band, whitened_product

_BLOCK_SAMPLES = 1 << 20
"""A minute at 16 kHz: longer transforms take memory and save no time."""

_PEAKS_PER_WINDOW = 3
"""Taken of each window: a sound that repeats has several, all of them right."""
_PEAK_SPACING_SECONDS = 0.05
"""Peaks nearer than this are one."""
_TOLERANCE_SECONDS = 0.002
"""Within which windows agree on a shift."""


@dataclass(frozen=True)
class PhaseVote:
    """A shift that windows agree on, searched for everywhere."""

    shift: float
    """How much later the sound is in the second recording, at the middle of the windows [s]."""
    middle: float
    """That middle on the clock of the first recording [s]."""
    votes: int
    """Windows that agree on it."""
    rival: float
    """The other shift with most votes [s]; NaN where no two windows agree on another."""
    rival_votes: int
    """Windows that agree on that."""
    windows: int
    """How many windows were searched for."""


def scan_phase(
    first: Float32Array,
    second: Float32Array,
    *,
    rate: int,
    window: float,
    count: int,
    largest_drift: float,
) -> PhaseVote | None:
    """Let windows of the first recording vote on where they are in the second.

    Parameters
    ----------
    first, second : (samples,) float32 array
    rate : int
        Samples per second of both.
    window : float
        Length of a window [s].
    count : int
        How many windows to search for, at most.
    largest_drift : float
        Largest change of the shift per second, as a share.

    Returns
    -------
    PhaseVote or None
        None where no window holds a sound.
    """
    size = round(window * rate)
    room = max(len(first) - size, 0)
    starts = np.unique(np.linspace(0, room, min(count, 2 * room // size + 1)).astype(np.int64))
    starts = loud_windows(first, starts, size)
    taper = np.hanning(size).astype(np.float32)
    times, delays = list[float](), list[FloatArray]()
    for start in starts.tolist():
        heights = _heights(first[start : start + size] * taper, second, rate)
        places = _highest(heights, spacing=round(_PEAK_SPACING_SECONDS * rate))
        if len(places):
            times.append((start + size / 2) / rate)
            delays.append((places - (size - 1) - start) / rate)
    if not times:
        return None
    return _count_votes(np.array(times), delays, largest_drift)


def _heights(sound: Float32Array, second: Float32Array, rate: int) -> Float32Array:
    """Return how well a window fits at each place, from wholly before the second to after it."""
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
            found = np.abs(fft.irfft(product, length)[: min(step, total - begin)])
            # Whitening makes each block equally loud: compare within it.
            heights[begin : begin + len(found)] = found / max(
                float(np.sqrt(np.mean(found**2))), 1e-30
            )
    return heights


def _highest(heights: Float32Array, *, spacing: int) -> IntArray:
    left = heights.copy()
    places = list[int]()
    for _ in range(_PEAKS_PER_WINDOW):
        place = int(np.argmax(left))
        if not left[place] > 0:
            break
        places.append(place)
        left[max(place - spacing, 0) : place + spacing + 1] = 0
    return np.array(places, np.int64)


def _count_votes(times: FloatArray, delays: list[FloatArray], largest_drift: float) -> PhaseVote:
    middle = float((times[0] + times[-1]) / 2)
    owners = np.repeat(np.arange(len(times)), [len(each) for each in delays])
    places = np.concatenate(delays)
    away = np.abs(times[owners] - middle)
    reach = _TOLERANCE_SECONDS + largest_drift * (away[:, None] + away[None, :])
    near = np.abs(places[:, None] - places[None, :]) < reach
    votes = np.array([len(np.unique(owners[row])) for row in near])
    # Of equal votes the one nearest the middle, where drift has moved it least.
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
