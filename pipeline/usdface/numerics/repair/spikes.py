"""Stretches in which a marker leaps away and back: swaps and strays, told from its own track alone.

A face does not leap. This needs no model of it, so it guards the learning of one: a short take
would otherwise take its own faults for ways in which the face moves.
"""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from usdface.numerics.repair.gaps import runs

_LEAP_STEPS = 12.0
"""Usual steps between frames that make a leap."""
_LEAP_NOISES = 8.0
_LONGEST = 150
"""[frames]"""
_BACK = -0.5
"""Cosine between leap and return."""
_MOST_SHARE = 0.3
"""A marker said to be away for longer just moves that way."""
_SAMPLE_FRAMES = 20_000


def find_excursions(
    positions: NDArray[np.floating], visible: NDArray[np.bool_], *, noise: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Find the samples between a leap and the next leap back.

    Parameters
    ----------
    positions : (frames, markers, 3) float array
        [mm] Without head motion.
    visible : (frames, markers) bool array
        A leap over a gap counts from the last sample before it.
    noise : (markers,) float array
        Standard deviation of the measurement noise per coordinate [mm].

    Returns
    -------
    (frames, markers) bool array
    """
    away = np.zeros_like(visible)
    for marker, seen in enumerate(visible.T):
        frames = np.flatnonzero(seen)
        if len(frames) < 4:
            continue
        steps = np.diff(positions[frames, marker].astype(np.float64), axis=0)
        sizes = np.linalg.norm(steps, axis=1)
        usual = float(np.median(sizes[:_SAMPLE_FRAMES]))
        leaps = sizes > max(_LEAP_STEPS * usual, _LEAP_NOISES * float(noise[marker]), 1e-6)
        # Frames that follow one another with leaps between them are one leap: its sum.
        joined = [(start, stop, steps[start:stop].sum(axis=0)) for start, stop in runs(leaps)]
        track = np.zeros(len(seen), bool)
        for (_, leave, there), (back, _, again) in pairwise(joined):
            lengths = float(np.linalg.norm(there) * np.linalg.norm(again))
            if there @ again < _BACK * lengths and frames[back] - frames[leave] < _LONGEST:
                track[frames[leave] : frames[back] + 1] = True
        if (track & seen).sum() <= _MOST_SHARE * len(frames):
            away[:, marker] = track & seen
    return away
