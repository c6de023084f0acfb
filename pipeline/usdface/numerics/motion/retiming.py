"""A motion played faster or slower, without overshooting its keys."""

import numpy as np
from scipy.interpolate import PchipInterpolator

from usdface.core.arrays import FloatArray


def stretch_motion(motion: FloatArray, frames: int) -> FloatArray:
    """Resample a motion to another number of frames; its first and last frame stay.

    Monotone cubics (Fritsch and Carlson 1980): a peak keeps its height and nothing swings past it.

    Parameters
    ----------
    motion : (n, controls) float array
    frames : int

    Raises
    ------
    ValueError
        If either length is below 2.
    """
    if len(motion) < 2 or frames < 2:
        raise ValueError(f"cannot stretch {len(motion)} frames to {frames}; both need at least 2")
    if frames == len(motion):
        return motion.copy()
    old = np.linspace(0.0, 1.0, len(motion))
    return np.asarray(PchipInterpolator(old, motion, axis=0)(np.linspace(0.0, 1.0, frames)))
