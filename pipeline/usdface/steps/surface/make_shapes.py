"""Make a BlendShape rig of a mesh from frames of a take."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from usdface.capture.text_table import csv_rows
from usdface.core.arrays import BoolArray, FloatArray
from usdface.core.errors import InputError
from usdface.core.progress import Progress, part
from usdface.core.provenance import Provenance
from usdface.core.text import first_few
from usdface.numerics.regression.reference_design import pivoted_selection
from usdface.runner.result import StepResult
from usdface.specs.surface import MakeShapesSpec
from usdface.steps.inputs.cleaned_takes import read_markers_at, spread_frames
from usdface.steps.surface.picture import write_shapes_picture
from usdface.steps.surface.plan import SurfacePlan, plan_surface, sampler_figures, sampler_notes
from usdface.usdio.references.read import read_pair_notes
from usdface.usdio.surface.shape_rig import NewShape, write_shape_rig
from usdface.usdio.take.read import TakeReader

_USABLE_SHARE = 0.9
"""Share of visible markers [0-1] below which a frame is not chosen."""

CANDIDATE_FRAMES = 4000
"""Frames of a take among which the most different are chosen, evenly spread."""


@dataclass(frozen=True)
class ShapeFrame:
    """A frame, and the name of its shape."""

    frame: int
    name: str


def given_frames(spec: MakeShapesSpec, take: TakeReader) -> tuple[ShapeFrame, ...]:
    """Return the frames of the options, in their order; empty if none are given."""
    if spec.names is not None:
        chosen = _from_csv(spec.names)
    elif spec.references is not None:
        chosen = _from_references(spec.references, take)
    else:
        parts = (text.partition("=") for text in spec.shape_frames)
        chosen = tuple(
            ShapeFrame(int(number), name.strip() or f"frame_{number}") for number, _, name in parts
        )
    outside = [
        each.frame for each in chosen if not take.first_frame <= each.frame <= take.last_frame
    ]
    if outside:
        raise InputError(
            f"{take.path}: has no frame {first_few(outside)}; give frames within "
            f"{take.first_frame}-{take.last_frame}"
        )
    seen: set[int] = set()
    for each in chosen:
        if each.frame in seen:
            raise InputError(f"frame {each.frame} is given for two shapes; give it once")
        seen.add(each.frame)
    return chosen


def choose_shape_frames(
    frames: list[int], displacements: FloatArray, usable: BoolArray, *, count: int
) -> tuple[ShapeFrame, ...]:
    """Choose the frames of a take that differ most from each other and from the neutral face."""
    allowed = np.flatnonzero(usable.mean(axis=1) >= _USABLE_SHARE)
    rows = allowed[pivoted_selection(displacements[allowed].reshape(len(allowed), -1), count)]
    if len(rows) < count:
        raise InputError(
            f"--count is {count}, but only {len(rows)} faces of the take differ from the neutral "
            "one and from each other; lower it"
        )
    chosen = sorted(frames[row] for row in rows.tolist())
    return tuple(ShapeFrame(frame, f"frame_{frame}") for frame in chosen)


def _from_csv(path: Path) -> tuple[ShapeFrame, ...]:
    found = []
    for where, row in csv_rows(path, ("frame", "name")):
        try:
            frame = int(str(row["frame"]).strip())
        except ValueError as error:
            raise InputError(
                f"{path} {where}: frame {row['frame']!r} is no whole number; correct it"
            ) from error
        found.append(ShapeFrame(frame, str(row["name"] or "").strip() or f"frame_{frame}"))
    if not found:
        raise InputError(f"{path}: has no rows; give a frame and a name for each shape")
    return tuple(found)


def _from_references(path: Path, take: TakeReader) -> tuple[ShapeFrame, ...]:
    pairs = [pair for pair in read_pair_notes(path) if pair.take == take.name]
    if not pairs:
        raise InputError(
            f"{path}: has no pair of the take {take.name!r}; select references from it first"
        )
    found = {}
    for pair in pairs:
        name = "_".join(part for part in (pair.emotion, pair.viseme) if part)
        found[pair.frame] = ShapeFrame(pair.frame, name or f"frame_{pair.frame}")
    return tuple(found[frame] for frame in sorted(found))


def run(spec: MakeShapesSpec, *, provenance: Provenance, progress: Progress) -> StepResult:
    """Choose frames, deform the mesh, and write the rig."""
    take = TakeReader(spec.take)
    chosen = given = given_frames(spec, take)
    plan = plan_surface(spec, take, progress=part(progress, 0.0, 0.6))
    if not given:
        frames = spread_frames(take, CANDIDATE_FRAMES)
        markers = read_markers_at(take, frames)
        displacements, seen = plan.displacements(markers.positions), markers.usable[:, plan.columns]
        chosen = choose_shape_frames(frames, displacements, seen, count=spec.count)
    progress(0.6, f"making {len(chosen)} shapes")
    moved = plan.deform(take, [each.frame for each in chosen])
    moving = np.linalg.norm(moved.mean, axis=2).max(axis=1) >= spec.least_mm
    if not (given or moving.all()):
        raise InputError(
            f"--count is {spec.count}, but {np.count_nonzero(moving)} of the faces that differ "
            f"most move a point by {spec.least_mm:g} mm; lower it, or take a livelier take"
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
    progress(0.8, f"wrote {spec.out.name}")
    write_shapes_picture(
        spec, plan, shapes, names=list(written), sd_mm=moved.sd, provenance=provenance
    )
    return _report(spec, plan, chosen, written)


def _report(
    spec: MakeShapesSpec, plan: SurfacePlan, chosen: tuple[ShapeFrame, ...], written: dict[str, int]
) -> StepResult:
    notes = [*plan.notes, *sampler_notes(plan.model)]
    renamed = [
        f"{frame.name} as {name}"
        for frame, name in zip(chosen, written, strict=True)
        if frame.name != name
    ]
    if renamed:
        notes.append(f"invalid or repeated names were changed: {first_few(renamed)}")
    share = np.mean(list(written.values())) / len(plan.face.mesh.points)
    return StepResult(
        (spec.out, *spec.paths_of("picture")),
        f"{len(written)} shapes on {len(plan.face.mesh.points)} points, each moving "
        f"{100 * share:.0f} % of them",
        tuple(notes),
        {
            "shapes": {
                name: {"frame": frame.frame, "points": count}
                for frame, (name, count) in zip(chosen, written.items(), strict=True)
            },
            "blend": plan.model.blend,
            "length_scale_mm": plan.model.length_scale,
            **sampler_figures(plan.model),
        },
    )
