"""Write the baseline, the solve of the blendshape equation, as a performance."""

from dataclasses import replace

import numpy as np

from usdface.core.arrays import sample_frames
from usdface.core.assets import Rig
from usdface.core.deformer import Deformer
from usdface.core.progress import Progress
from usdface.core.provenance import Provenance
from usdface.core.sidecars import weights_path
from usdface.core.text import pluralize
from usdface.model.placement.rig_orientation import check_rig_upright
from usdface.model.selection.baseline import MOTION_FRAMES, BlendshapeEquation
from usdface.runner.result import StepResult
from usdface.specs.paths import frame_range
from usdface.specs.performance import MapSpec
from usdface.steps.inputs.cleaned_takes import read_markers_at
from usdface.steps.inputs.edit_ranges import performance_notes
from usdface.steps.inputs.placed_takes import PlacementScene
from usdface.steps.inputs.placement import (
    placed_equation,
    read_performer_markers,
    read_placement_of,
)
from usdface.steps.performance.map import frames_per_part, take_blocks
from usdface.usdio.performance.weights_layer import make_header
from usdface.usdio.performance.write import writing_performance
from usdface.usdio.rig.read import read_rig
from usdface.usdio.take.read import TakeReader


def run_baseline(spec: MapSpec, provenance: Provenance, progress: Progress) -> StepResult:
    """Solve the blendshape equation block by block, and write the performance."""
    rig, take = read_rig(spec.rig, prim=spec.rig_prim), TakeReader(spec.take)
    first, last = take.frames_within(frame_range(spec.frames))
    count = last - first + 1
    progress(0.0, "placing the markers on the rig")
    equation, placement_note = _equation(spec, take, rig)
    header = make_header(
        rig,
        shape_names=rig.shapes,
        rate=take.rate,
        first_frame=first,
        last_frame=last,
        rig_path=spec.prim,
        timecode_start=take.timecode_at(first),
    )
    squares, outside = [], 0
    with writing_performance(
        spec.out,
        replace(header, neutral_frame=take.neutral_frame),
        rig,
        part_frames=frames_per_part(spec, count, len(rig.shapes)),
        provenance=provenance,
    ) as writer:
        for block in take_blocks(take, first, last):
            rows = range(max(first, block.start), min(last + 1, block.stop))
            markers = read_markers_at(take, rows)
            seen = markers.usable
            solve = equation.solve_published if spec.unlimited else equation.propose
            weights = solve(markers.positions, visible=seen)
            writer.append(weights)
            squares.append(equation.residual_mm(markers.positions, weights, visible=seen) ** 2)
            low, high = rig.ranges.T
            outside += int(np.count_nonzero((weights < low) | (weights > high)))
            progress((rows.stop - first) / count, f"solved to frame {rows.stop - 1}")
    residual = float(np.sqrt(np.concatenate(squares).mean()))
    share = outside / (count * len(rig.shapes))
    return StepResult(
        (spec.out, weights_path(spec.out)),
        f"{pluralize(count, 'frame')} of the baseline; residual {residual:.2f} mm at the markers",
        (
            *check_rig_upright(rig),
            *placement_note,
            *_notes(spec, equation, rig, share),
            *performance_notes(spec.out),
        ),
        {"frames": count, "residual_mm": residual, "outside_ranges": share},
    )


def _equation(
    spec: MapSpec, take: TakeReader, rig: Rig
) -> tuple[BlendshapeEquation, tuple[str, ...]]:
    """Set up the equation from frames sampled over the whole take, so that chunks are equal.

    Returns it with a note on a placement that was made here and may be wrong.
    """
    count = take.last_frame - take.first_frame + 1
    picks = take.first_frame + sample_frames(count, MOTION_FRAMES)
    performer = read_performer_markers(take, picks.tolist())
    note: tuple[str, ...] = ()
    if spec.placement is not None:
        placement = read_placement_of(spec.placement, rig, performer.labels, performer.neutral)
    else:
        placed = PlacementScene(performer, rig).place(out=None, landmarks={})
        placement, verdict = placed.placement, placed.verdict
        if verdict.level != "good":
            note = (
                f"placement: {verdict.sentence}; look at it with `usdface place` and give it as "
                "--placement",
            )
    return placed_equation(placement, rig, Deformer(rig), performer), note


def _notes(spec: MapSpec, equation: BlendshapeEquation, rig: Rig, outside: float) -> list[str]:
    if spec.unlimited:
        return [
            f"{outside:.0%} of the weights are outside the rig's ranges; without --unlimited the "
            "equation is solved within the ranges, which is more accurate than clamping these "
            "weights"
        ]
    note = "" if equation.lids is None else equation.lids.note(rig.shapes)
    return [note] if note else []
