"""Chosen frames of a take become the shapes of a mesh that has none."""

import numpy as np

from usdface.core.errors import InputError
from usdface.core.progress import Progress, part, silent
from usdface.core.provenance import Provenance
from usdface.core.text import first_few
from usdface.runner.result import StepResult
from usdface.specs.surface import MakeShapesSpec
from usdface.steps.surface.frames import (
    CANDIDATE_FRAMES,
    ShapeFrame,
    choose_shape_frames,
    given_frames,
)
from usdface.steps.surface.picture import write_shapes_picture
from usdface.steps.surface.plan import SurfacePlan, plan_surface
from usdface.usdio.surface.shape_rig import NewShape, WrittenShape, write_shape_rig
from usdface.usdio.take.read import TakeReader


def run(spec: MakeShapesSpec, *, provenance: Provenance, progress: Progress = silent) -> StepResult:
    """Choose frames, move the mesh there, and write the rig."""
    take = TakeReader(spec.take)
    chosen = given_frames(spec, take)
    plan = plan_surface(spec, take, out=spec.out, progress=part(progress, 0.0, 0.6))
    chosen = chosen or _choose_frames(spec, plan, take)
    progress(0.6, f"making {len(chosen)} shapes")
    moved = plan.deform(
        np.concatenate([plan.frames(take, each.frame, each.frame) for each in chosen])
    )
    shapes = [
        NewShape(each.name, moved.mean[index].astype(np.float64), take.name, each.frame)
        for index, each in enumerate(chosen)
    ]
    written = write_shape_rig(
        spec.out,
        plan.face,
        shapes,
        name=spec.name,
        least_mm=spec.least_mm,
        provenance=provenance,
    )
    if spec.picture is not None:
        progress(0.8, f"drawing {spec.picture.name}")
        names = [shape.name for shape in written]
        write_shapes_picture(spec, plan, shapes, names=names, sd_mm=moved.sd, provenance=provenance)
    progress(1.0, "done")
    return _report(spec, plan, chosen, written)


def _choose_frames(
    spec: MakeShapesSpec, plan: SurfacePlan, take: TakeReader
) -> tuple[ShapeFrame, ...]:
    count = take.last_frame - take.first_frame + 1
    picks = np.unique(
        np.linspace(take.first_frame, take.last_frame, min(count, CANDIDATE_FRAMES)).astype(int)
    )
    rows, usable = [], []
    for start in range(0, len(picks), 512):
        span = picks[start : start + 512]
        markers = take.read(int(span[0]), int(span[-1])).markers
        if markers is None:
            raise InputError(f"{spec.take}: has no markers; ingest a capture that has")
        inside = span - span[0]
        rows.append(plan.displacements(markers.positions[inside]))
        known = markers.visible[inside] | (markers.confidence[inside] > 0)
        usable.append(known[:, plan.columns])
    return choose_shape_frames(
        picks.tolist(), np.concatenate(rows), np.concatenate(usable), count=spec.count
    )


def _report(
    spec: MakeShapesSpec,
    plan: SurfacePlan,
    chosen: tuple[ShapeFrame, ...],
    written: tuple[WrittenShape, ...],
) -> StepResult:
    notes = list(plan.notes)
    renamed = [
        f"{frame.name} as {shape.name}"
        for frame, shape in zip(chosen, written, strict=True)
        if frame.name != shape.name
    ]
    if renamed:
        notes.append(f"invalid or repeated names were changed: {first_few(renamed)}")
    share = np.mean([shape.points for shape in written]) / len(plan.face.mesh.points)
    return StepResult(
        (spec.out,) if spec.picture is None else (spec.out, spec.picture),
        f"{len(written)} shapes on {len(plan.face.mesh.points)} points, each moving "
        f"{100 * share:.0f} % of them",
        tuple(notes),
        {
            "shapes": {
                shape.name: {"frame": frame.frame, "points": shape.points}
                for frame, shape in zip(chosen, written, strict=True)
            },
            "blend": plan.model.blend,
            "length_scale_mm": plan.model.length_scale,
        },
    )
