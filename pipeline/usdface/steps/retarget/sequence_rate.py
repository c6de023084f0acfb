"""Resample sequences to another rate."""

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

from usdface.core.arrays import FloatArray
from usdface.core.controls import EmotionalSequence
from usdface.model.retarget.control_space import control_space
from usdface.numerics.motion.laplacian_warp import stretch_motion
from usdface.usdio.retarget.sequences import read_sequence, sequence_rate

RATE_TOLERANCE = 1e-3
"""Largest difference of equal rates [frames/s]: layers store them as floats."""


def read_sequence_at(path: Path, rate: Fraction) -> tuple[EmotionalSequence, str]:
    """Read a sequence, resampled to `rate`; return it with a note, empty if rates are equal."""
    sequence, stored = read_sequence(path), sequence_rate(path)
    if abs(stored - rate) < RATE_TOLERANCE:
        return sequence, ""
    factor = rate / stored
    space = control_space(sequence.target)  # rotations are resampled as rotation vectors
    resampled = replace(
        sequence,
        source=motion_at_rate(sequence.source, factor),
        target=space.decode(motion_at_rate(space.encode(sequence.target), factor)),
        key_weights=motion_at_rate(sequence.key_weights[:, None], factor)[:, 0],
    )
    note = (
        f"{path.name} runs at {float(stored):g} frames per second, and is resampled to "
        f"{float(rate):g}: {len(sequence.source)} and {len(sequence.target)} frames become "
        f"{len(resampled.source)} and {len(resampled.target)}"
    )
    return resampled, note


def motion_at_rate(motion: FloatArray, factor: Fraction) -> FloatArray:
    """Return a motion at another rate, `factor` times as high: (frames, n)."""
    return stretch_motion(motion, max(round((len(motion) - 1) * factor) + 1, 2))
