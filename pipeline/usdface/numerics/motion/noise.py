"""Measurement noise and spikes of single tracks, and takes without motion."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from usdface.core.arrays import MAD_TO_DEVIATION, BoolArray, FloatArray, RealArray, runs

_THIRD_DIFFERENCE_GAIN = np.sqrt(20.0)
"""Standard deviation of third differences over that of white noise: sqrt(1² + 3² + 3² + 1²)."""
_SAMPLE_FRAMES = 20_000
_STILL_MM, _STILL_NOISE_DEVIATIONS = 0.5, 6.0
"""Largest range of a coordinate of a still face: the larger of the two."""

_LEAP_MEDIAN_STEPS = 12.0
_LEAP_NOISE_DEVIATIONS = 8.0
"""A step larger than both is a leap."""
_LONGEST_SPIKE_FRAMES = 150
_RETURN_COSINE = -0.5
"""Largest cosine between a leap and the leap back."""
_SPIKE_MOST_SHARE = 0.3
"""[of its samples] Spikes of a marker with more of them are taken for its motion."""
_USUAL_STEP_FRAMES = 20_000


def marker_noise(positions: ArrayLike, visible: ArrayLike) -> FloatArray:
    """Return the standard deviation of each marker's measurement noise, per coordinate.

    From the median of absolute third differences, robust to motion, gaps, swaps and spikes.

    Parameters
    ----------
    positions : (frames, markers, 3) array_like
    visible : (frames, markers) array_like of bool

    Returns
    -------
    (markers,) float array
        In the unit of `positions`; 0 for a marker without four frames in a row.
    """
    points, seen = np.asarray(positions), np.asarray(visible, bool)
    noise = np.zeros(points.shape[1])
    start = max(0, (len(points) - _SAMPLE_FRAMES) // 2)
    stretch = slice(start, start + _SAMPLE_FRAMES)
    tracks, shown = points[stretch], np.ascontiguousarray(seen[stretch].T)
    if len(tracks) < 4:
        return noise
    for marker, good in enumerate(shown):
        track = np.ascontiguousarray(tracks[:, marker].T, np.float64)
        whole = good[3:] & good[2:-1] & good[1:-2] & good[:-3]
        differences = np.abs(np.diff(track, 3))
        if not whole.all():
            differences = differences[:, whole]
        if differences.size:
            middle = np.median(differences)
            noise[marker] = MAD_TO_DEVIATION * middle / _THIRD_DIFFERENCE_GAIN
    return noise


def measurement_noise(positions: ArrayLike, visible: ArrayLike) -> float:
    """Return the median of `marker_noise` over the markers; 0 when there are none."""
    noise = marker_noise(positions, visible)
    return float(np.median(noise)) if noise.size else 0.0


def still_range_mm(clips: Sequence[RealArray], noise_mm: float) -> float | None:
    """Return the largest range of a coordinate over all clips if no marker moves, else None.

    Parameters
    ----------
    clips : sequence of (frames, markers, 3) float arrays
        [mm] Of the same markers in one space, without head motion and without gaps.
    noise_mm : float
        Standard deviation of the measurement noise per coordinate.
    """
    filled = [clip for clip in clips if clip.size]
    if not filled:
        return 0.0
    high = np.max([clip.max(axis=0) for clip in filled], axis=0)
    low = np.min([clip.min(axis=0) for clip in filled], axis=0)
    largest = float((high - low).max())
    return None if largest > max(_STILL_MM, _STILL_NOISE_DEVIATIONS * noise_mm) else largest


def find_spikes(positions: RealArray, visible: BoolArray, *, noise: FloatArray) -> BoolArray:
    """Return the samples between a leap and the next leap back: (frames, markers) bool array.

    In a short take a low-rank model would fit them as directions of the face's motion.

    Parameters
    ----------
    positions : (frames, markers, 3) float array
        [mm] Without head motion.
    visible : (frames, markers) bool array
        Leaps across a gap start at the last sample before it.
    noise : (markers,) float array
        Standard deviation of the measurement noise per coordinate [mm].
    """
    spikes = np.zeros_like(visible)
    for marker, seen in enumerate(visible.T):
        frames = np.flatnonzero(seen)
        if len(frames) < 4:
            continue
        steps = np.diff(positions[frames, marker].astype(np.float64), axis=0)
        sizes = np.linalg.norm(steps, axis=1)
        usual = float(np.median(sizes[:_USUAL_STEP_FRAMES]))
        leaps = sizes > max(
            _LEAP_MEDIAN_STEPS * usual, _LEAP_NOISE_DEVIATIONS * float(noise[marker]), 1e-6
        )
        # Leaps in consecutive steps are one leap: their sum.
        joined = [(start, stop, steps[start:stop].sum(axis=0)) for start, stop in runs(leaps)]
        track = np.zeros(len(seen), bool)
        for (_, leave, out), (back, _, home) in pairwise(joined):
            lengths = float(np.linalg.norm(out) * np.linalg.norm(home))
            short = frames[back] - frames[leave] < _LONGEST_SPIKE_FRAMES
            if out @ home < _RETURN_COSINE * lengths and short:
                track[frames[leave] : frames[back] + 1] = True
        if (track & seen).sum() <= _SPIKE_MOST_SHARE * len(frames):
            spikes[:, marker] = track & seen
    return spikes
