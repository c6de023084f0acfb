"""How far a performance is from what it should have been: figures an animator can place.

Weights alone mislead: half a weight of a squint is hardly seen, half a blink is an open eye. So
errors are also measured where they show, on the surface and between the lips.
"""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import BoolArray, FloatArray, IntArray
from usdface.numerics.regression.cross_validation import (
    surface_errors_mm,
    surface_rms_mm,
    weight_rmse,
)

PEAK_QUANTILE = 0.97
"""Of a blink's true weights: frames above are its peaks. Where none is, for the eyes are shut so
long, frames at it are."""

CLOSED_MM = 1.0
"""Lips no further apart than this are meant to be closed."""

_QUANTILE_95 = 0.95
_LEAST_ROUGHNESS = 1e-9


@dataclass(frozen=True)
class SurfaceError:
    """Errors of one region over time."""

    frames_mm: FloatArray
    """(frames,): root mean square distance of the region's points [mm]."""
    rms_mm: float
    p95_mm: float
    max_mm: float
    """`rms_mm`, `p95_mm`, `max_mm`: Over the frames [mm]."""


@dataclass(frozen=True)
class LipError:
    """Errors of the distance between the lips."""

    truth_mm: FloatArray
    solved_mm: FloatArray
    """`truth_mm`, `solved_mm`: (frames,): the distance; below 0 the lips overlap [mm]."""
    rms_mm: float
    """Of the difference [mm]."""
    closed_bias_mm: float
    """Mean difference where the truth is closed: above 0 the mouth does not close [mm]; NaN where
    it never is."""


@dataclass(frozen=True)
class ShapeErrors:
    """Errors of each shape over the frames."""

    rmse: FloatArray
    bias: FloatArray
    largest: FloatArray
    """`rmse`, `bias`, `largest`: (shapes,): root mean square, mean, and largest size of the
    weight's error."""


def measure_weights(errors: FloatArray, *, observable: BoolArray | None = None) -> float:
    """Return the root mean square error over frames and shapes.

    Parameters
    ----------
    errors : (frames, shapes) float array
    observable : (shapes,) bool array, optional
        Shapes that count; by default all. NaN where none does.
    """
    counted = errors if observable is None else errors[:, observable]
    return weight_rmse(counted) if counted.size else float("nan")


def measure_shapes(errors: FloatArray) -> ShapeErrors:
    """Return the errors of each shape: (frames, shapes) float array."""
    return ShapeErrors(
        rmse=np.sqrt((errors**2).mean(axis=0)),
        bias=errors.mean(axis=0),
        largest=np.abs(errors).max(axis=0),
    )


def measure_surface(key_errors: FloatArray, gram: FloatArray) -> SurfaceError:
    """Return how far errors move a surface.

    Parameters
    ----------
    key_errors : (frames, keys) float array
        Differences of key weights; those of channel weights where no shape has in-betweens.
    gram : (keys, keys) float array
    """
    frames_mm = surface_errors_mm(key_errors, gram)
    return SurfaceError(
        frames_mm=frames_mm,
        rms_mm=surface_rms_mm(key_errors, gram),
        p95_mm=float(np.quantile(frames_mm, _QUANTILE_95)),
        max_mm=float(frames_mm.max()),
    )


def measure_lips(
    truth_keys: FloatArray, solved_keys: FloatArray, gap: FloatArray, *, rest_mm: float
) -> LipError:
    """Return how far the distance between the lips is off.

    Parameters
    ----------
    truth_keys, solved_keys : (frames, keys) float arrays
    gap : (keys,) float array
        How far each key at 1 parts the lips [mm].
    rest_mm : float
        Their distance at rest [mm].
    """
    truth, solved = rest_mm + truth_keys @ gap, rest_mm + solved_keys @ gap
    off = solved - truth
    closed = truth <= max(CLOSED_MM, rest_mm)
    return LipError(
        truth_mm=truth,
        solved_mm=solved,
        rms_mm=float(np.sqrt((off**2).mean())),
        closed_bias_mm=float(off[closed].mean()) if closed.any() else float("nan"),
    )


def blink_peak_bias(errors: FloatArray, truth: FloatArray, blinks: IntArray) -> float:
    """Return the mean error of blinks at their peaks: below 0 the eyes do not shut.

    Parameters
    ----------
    errors, truth : (frames, shapes) float arrays
    blinks : (n,) int array
        Columns of the shapes that shut an eye.

    Returns
    -------
    float
        NaN where there is no blink.
    """
    acted = truth[:, blinks]
    high = np.quantile(acted, PEAK_QUANTILE, axis=0) if len(acted) else np.zeros(len(blinks))
    peaks = acted > high
    if not peaks.any():
        peaks = (acted >= high) & (acted > 0)
    found = errors[:, blinks][peaks]
    return float(found.mean()) if len(found) else float("nan")


def relative_jitter(solved: FloatArray, truth: FloatArray, frames: IntArray) -> float:
    """Return the roughness of the solve over that of the truth: 1 is as smooth as it should be.

    Roughness is the mean size of the third difference, over runs of consecutive frames.

    Parameters
    ----------
    solved, truth : (frames, shapes) float arrays
    frames : (frames,) int array
        Ascending frame numbers.

    Returns
    -------
    float
        NaN where no four frames follow each other.
    """
    rough = [np.abs(np.diff(rows, 3, axis=0)) for rows in (solved, truth)]
    consecutive = frames[3:] - frames[:-3] == 3
    if not consecutive.any():
        return float("nan")
    mine, theirs = (float(each[consecutive].mean()) for each in rough)
    return mine / max(theirs, _LEAST_ROUGHNESS)
