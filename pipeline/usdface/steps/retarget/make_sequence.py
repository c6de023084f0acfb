"""Pair a range of source motion with a target animation, as a sequence; read one at a rate."""

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from usdface.core.arrays import FloatArray, columns_by_name
from usdface.core.controls import EmotionalSequence
from usdface.core.errors import InputError
from usdface.core.progress import Progress
from usdface.core.provenance import Provenance
from usdface.core.text import first_few
from usdface.model.retarget.control_space import control_space
from usdface.numerics.motion.laplacian_warp import stretch_motion
from usdface.numerics.motion.sequence_search import mean_face_distance
from usdface.runner.result import StepResult
from usdface.specs.paths import frame_range
from usdface.specs.retarget import MakeSequenceSpec
from usdface.steps.inputs.source_motion import read_source_motion
from usdface.usdio.retarget.controls import read_control_clip
from usdface.usdio.retarget.sequences import read_sequence, sequence_rate, write_sequence


def run(spec: MakeSequenceSpec, *, provenance: Provenance, progress: Progress) -> StepResult:
    """Cut both ranges and write the sequence."""
    source = read_source_motion(spec.source, frame_range(spec.source_frames))
    attributes = spec.attributes or None
    read = read_control_clip(
        spec.target, attributes=attributes, frames=frame_range(spec.target_frames)
    )
    target = read.controls
    for path, count, option in (
        (spec.source, len(source.weights), "--source-frames"),
        (spec.target, len(target), "--target-frames"),
    ):
        if count < 2:
            raise InputError(
                f"{path}: {count} frame to pair, and a sequence needs at least 2; widen {option}"
            )
    motion = columns_by_name(source.weights, source.names, source.free)
    if not source.free or mean_face_distance(motion) == 0.0:
        raise InputError(
            f"{spec.source}: frames {source.first_frame}-{source.last_frame} do not move, and "
            "would match any face at rest; choose frames that move"
        )
    factor = read.rate / source.rate
    alike = abs(source.rate - read.rate) < RATE_TOLERANCE
    weights = motion if alike else motion_at_rate(motion, factor)
    sequence = EmotionalSequence(
        label=spec.label,
        source_shapes=source.free,
        source=weights,
        target=target,
        key_weights=np.ones(len(target)),
    )
    write_sequence(spec.out, sequence, rate=read.rate, provenance=provenance)
    notes = []
    if not alike:
        notes.append(
            f"the source runs at {float(source.rate):g} and the target at {float(read.rate):g} "
            f"frames per second; the source is resampled to {len(weights)} frames"
        )
    if target.attributes and not spec.attributes:
        notes.append(f"including the attributes that move: {first_few(target.attributes)}")
    return StepResult(
        (spec.out,),
        f"{spec.label}: {len(weights)} frames of {len(source.free)} source shapes, "
        f"{len(target)} frames of {target.summary}",
        tuple(notes),
        {
            "label": spec.label,
            "source_frames": len(weights),
            "target_frames": len(target),
        },
    )


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
