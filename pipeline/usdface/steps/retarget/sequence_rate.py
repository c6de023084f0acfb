"""Sequences at the rate of what they are used with."""

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

from usdface.core.arrays import FloatArray
from usdface.core.controls import Controls, EmotionalSequence
from usdface.model.retarget.control_space import control_space
from usdface.numerics.motion.laplacian_warp import stretch_motion
from usdface.usdio.retarget.sequences import read_sequence, sequence_rate

RATES_ALIKE = 1e-3
"""Frames per second that a rate may lose where a layer holds it as a float."""


def read_sequence_at(path: Path, rate: Fraction) -> tuple[EmotionalSequence, str]:
    """Read a sequence as it lasts at another rate.

    Returns
    -------
    sequence : EmotionalSequence
    note : str
        What to tell of it; empty where it runs at the rate.
    """
    sequence, own = read_sequence(path), sequence_rate(path)
    if abs(own - rate) < RATES_ALIKE:
        return sequence, ""
    factor = rate / own
    resampled = replace(
        sequence,
        source=motion_at_rate(sequence.source, factor),
        target=controls_at_rate(sequence.target, factor),
        key_weights=motion_at_rate(sequence.key_weights[:, None], factor)[:, 0],
    )
    note = (
        f"{path.name} runs at {float(own):g} frames per second, and this at {float(rate):g}: it is "
        f"resampled, its {len(sequence.source)} and {len(sequence.target)} frames to "
        f"{len(resampled.source)} and {len(resampled.target)}"
    )
    return resampled, note


def motion_at_rate(motion: FloatArray, factor: Fraction) -> FloatArray:
    """Return a motion at another rate, `factor` times as high: (frames, n)."""
    return stretch_motion(motion, max(round((len(motion) - 1) * factor) + 1, 2))


def controls_at_rate(controls: Controls, factor: Fraction) -> Controls:
    """Return controls at another rate; rotations through their vectors."""
    space = control_space(controls)
    return space.decode(motion_at_rate(space.encode(controls), factor))
