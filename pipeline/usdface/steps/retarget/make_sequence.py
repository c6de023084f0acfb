"""A stretch of the source and one of the target in, a sequence out."""

import numpy as np

from usdface.core.controls import EmotionalSequence
from usdface.core.errors import InputError
from usdface.core.progress import Progress, silent
from usdface.core.provenance import Provenance
from usdface.numerics.motion.sequence_search import mean_face_distance
from usdface.runner.result import StepResult
from usdface.specs.paths import frame_range
from usdface.specs.retarget import MakeSequenceSpec
from usdface.steps.inputs.source_motion import read_source_motion
from usdface.usdio.retarget.controls import read_control_clip
from usdface.usdio.retarget.sequences import write_sequence


def run(
    spec: MakeSequenceSpec, *, provenance: Provenance, progress: Progress = silent
) -> StepResult:
    """Cut both sides out and write them side by side."""
    source = read_source_motion(spec.source, frame_range(spec.source_frames))
    attributes = spec.attributes or None
    read = read_control_clip(
        spec.target, attributes=attributes, frames=frame_range(spec.target_frames)
    )
    target = read.clip.controls
    for path, count in ((spec.source, len(source.weights)), (spec.target, len(target))):
        if count < 2:
            raise InputError(f"{path}: {count} frame is no sequence; give at least 2")
    if mean_face_distance(source.weights) == 0.0:
        raise InputError(
            f"{spec.source}: frames {source.first_frame}-{source.last_frame} stand still, so "
            "nothing would tell them from a face at rest; choose a stretch that moves"
        )
    sequence = EmotionalSequence(
        label=spec.label,
        source_shapes=source.names,
        source=source.weights,
        target=target,
        key_weights=np.ones(len(target)),
    )
    write_sequence(spec.out, sequence, rate=read.rate, provenance=provenance)
    progress(1.0, "done")
    notes = []
    if source.rate != read.rate:
        notes.append(
            f"the source runs at {float(source.rate):g} and the target at {float(read.rate):g} "
            "frames per second; frames are taken as they are"
        )
    return StepResult(
        (spec.out,),
        f"{spec.label}: {len(source.weights)} frames of {len(source.names)} source shapes, "
        f"{len(target)} frames of {target.summary}",
        tuple(notes),
        {
            "label": spec.label,
            "source_frames": len(source.weights),
            "target_frames": len(target),
        },
    )
