"""One performance in, a performance of every target out."""

from pathlib import Path

import numpy as np

from usdface.core.arrays import FloatArray
from usdface.core.assets import Rig
from usdface.core.controls import Retargeting
from usdface.core.errors import InputError
from usdface.core.progress import Progress, part, silent
from usdface.core.provenance import Provenance
from usdface.core.sidecars import controls_path, weights_path
from usdface.core.text import first_few, pluralize
from usdface.model.retarget.train import retarget
from usdface.runner.result import StepResult
from usdface.specs.paths import frame_range
from usdface.specs.retarget import RetargetSpec
from usdface.steps.inputs.edit_ranges import edit_notes
from usdface.steps.inputs.source_motion import (
    MOVING_WEIGHT,
    SourceMotion,
    read_source_motion,
    source_columns,
)
from usdface.steps.inputs.weight_tables import read_alpha
from usdface.usdio.performance.weights_layer import make_header
from usdface.usdio.retarget.control_performance import writing_control_performance
from usdface.usdio.retarget.retargeting import read_retargeting
from usdface.usdio.rig.read import read_rig

_CHUNK_FRAMES = 8192


def run(spec: RetargetSpec, *, provenance: Provenance, progress: Progress = silent) -> StepResult:
    """Retarget to each target in turn; all are read before the first is written."""
    motion = read_source_motion(spec.source, frame_range(spec.frames))
    targets = [_target(spec, index) for index in range(len(spec.out))]
    alpha = None
    if spec.alpha is not None:
        frames = np.arange(motion.first_frame, motion.last_frame + 1)
        alpha = read_alpha(spec.alpha, frames)
    notes: list[str] = []
    outputs: list[Path] = []
    for index, (trained, rig) in enumerate(targets):
        out = spec.out[index]
        share = part(progress, index / len(targets), (index + 1) / len(targets))
        notes += [
            f"{out.name}: {note}"
            for note in _write(spec, out, motion, trained, rig, alpha, share, provenance)
        ]
        outputs += [out, weights_path(out)]
        if trained.joints or trained.attributes:
            outputs.append(controls_path(out))
    count = len(motion.weights)
    return StepResult(
        tuple(outputs),
        f"{pluralize(count, 'frame')} on {pluralize(len(targets), 'target')}",
        tuple(notes),
        {
            "frames": count,
            "targets": [
                {
                    "out": str(out),
                    "method": trained.method,
                    "shapes": len(trained.shapes),
                    "joints": len(trained.joints),
                    "attributes": len(trained.attributes),
                }
                for out, (trained, _) in zip(spec.out, targets, strict=True)
            ],
        },
    )


def _target(spec: RetargetSpec, index: int) -> tuple[Retargeting, Rig]:
    path = spec.retargeting[index]
    trained = read_retargeting(path)
    file = spec.rig[index] if spec.rig else trained.target_rig
    if file is None or not file.is_file():
        raise InputError(f"{path}: its target's rig {file or ''} is not there; name it with --rig")
    rig = read_rig(file, prim=None if spec.rig else trained.target_prim or None)
    rig.check_has(trained.shapes, source=path, remedy="train again for this rig")
    if spec.alpha is not None and trained.method != "hybrid":
        raise InputError(
            f"{path}: alpha blends the two parts of a hybrid, and this retargeting is "
            f"{trained.method}; train with --method hybrid"
        )
    return trained, rig


def _write(
    spec: RetargetSpec,
    out: Path,
    motion: SourceMotion,
    trained: Retargeting,
    rig: Rig,
    alpha: FloatArray | None,
    progress: Progress,
    provenance: Provenance,
) -> list[str]:
    source, said = source_columns(spec.source, motion, trained.source_shapes)
    notes = [*said, *_dead(trained, source)]
    with writing_control_performance(
        out,
        make_header(
            rig,
            shape_names=trained.shapes,
            rate=motion.rate,
            first_frame=motion.first_frame,
            last_frame=motion.last_frame,
            place=spec.prim,
            timecode_start=motion.timecode_start,
        ),
        rig,
        joints=trained.joints,
        attributes=trained.attributes,
        provenance=provenance,
    ) as writer:
        for start in range(0, len(source), _CHUNK_FRAMES):
            rows = slice(start, start + _CHUNK_FRAMES)
            share = None if alpha is None else alpha[rows]
            writer.append(retarget(trained, source[rows], alpha=share))
            done = min(start + _CHUNK_FRAMES, len(source))
            progress(done / len(source), f"{out.name}: frame {motion.first_frame + done - 1}")
    return [*notes, *edit_notes(out)]


def _dead(trained: Retargeting, source: FloatArray) -> list[str]:
    """Name source shapes that move here though no pair used them."""
    moving = np.abs(source).max(axis=0) > MOVING_WEIGHT
    unused = trained.arrays.get("unused", np.zeros(len(trained.source_shapes))) > 0
    names = [
        name
        for name, moves, dead in zip(trained.source_shapes, moving, unused, strict=True)
        if moves and dead
    ]
    if not names:
        return []
    return [
        f"{len(names)} source shapes move in this performance and no pair uses them, so the target "
        f"does not follow: {first_few(names)}"
    ]
