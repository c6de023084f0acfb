"""Motion of markers about the frame of a pair, which tells whether its keys are late."""

from collections.abc import Callable

import numpy as np

from usdface.core.arrays import FloatArray, IntArray

TRAJECTORY_SECONDS = np.arange(-9, 10) / 60
"""Times relative to the pair's frame: videos of 24 frames per second that are three frames late
are within, and 60 values per second follow a blink."""


def read_trajectories(
    frames: IntArray,
    *,
    rate: float,
    first: int,
    last: int,
    positions_at: Callable[[IntArray], FloatArray],
) -> FloatArray:
    """Return positions at `TRAJECTORY_SECONDS` about frames: (frames, times, markers, 3).

    Linear between frames, and constant beyond the take's first and last one.

    Parameters
    ----------
    frames : (n,) int array
    rate : float
        Frames per second.
    first, last : int
        Of the take.
    positions_at : callable
        Returns positions at ascending frame numbers.
    """
    wanted = np.clip(frames[:, None] + rate * TRAJECTORY_SECONDS, first, last)
    below = np.floor(wanted)
    needed, row = np.unique(np.stack([below, np.ceil(wanted)]), return_inverse=True)
    low, high = positions_at(needed.astype(np.int64))[row.reshape(2, *wanted.shape)]
    return np.asarray(low + (wanted - below)[:, :, None, None] * (high - low))


def displacements_at(trajectories: FloatArray, seconds: FloatArray) -> FloatArray:
    """Return the displacement of each pair's markers at a time of its own: (pairs, markers, 3).

    Parameters
    ----------
    trajectories : (pairs, times, markers, 3) array
        Displacements at `TRAJECTORY_SECONDS`.
    seconds : (pairs,) array
        Limited to `TRAJECTORY_SECONDS`.
    """
    at = np.interp(seconds, TRAJECTORY_SECONDS, np.arange(len(TRAJECTORY_SECONDS)))
    below, pairs = np.floor(at).astype(np.int64), np.arange(len(seconds))
    low, high = trajectories[pairs, below], trajectories[pairs, np.ceil(at).astype(np.int64)]
    return np.asarray(low + (at - below)[:, None, None] * (high - low))
