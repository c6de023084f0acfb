"""Measurement noise of a capture, estimated from third differences, and takes without motion."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from usdface.core.arrays import MAD_TO_DEVIATION, FloatArray, RealArray

_THIRD_DIFFERENCE_GAIN = np.sqrt(20.0)
"""Standard deviation of third differences over that of white noise: sqrt(1² + 3² + 3² + 1²)."""
_SAMPLE_FRAMES = 20_000
_STILL_MM, _STILL_NOISE_DEVIATIONS = 0.5, 6.0
"""Largest range of a coordinate of a still face: the larger of the two."""


def marker_noise(positions: ArrayLike, visible: ArrayLike) -> FloatArray:
    """Return the standard deviation of each marker's measurement noise, per coordinate.

    From the median of absolute third differences, robust to motion, gaps, swaps and spikes, in the
    middle 20,000 frames. Returns (markers,), in the unit of `positions` (frames, markers, 3); 0 for
    a marker without four frames in a row.
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
