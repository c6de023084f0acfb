"""Animate the points of a mesh by a cleaned take, in bounded memory."""

import numpy as np

from usdface.core.progress import Progress, part
from usdface.core.provenance import Provenance
from usdface.core.sidecars import points_path
from usdface.core.text import pluralize
from usdface.numerics.surface.triangulation import NormalTurner
from usdface.runner.result import StepResult
from usdface.specs.paths import frame_range
from usdface.specs.surface import DeformSpec
from usdface.steps.surface.picture import write_comparison
from usdface.steps.surface.plan import SurfacePlan, plan_surface, sampler_figures, sampler_notes
from usdface.usdio.rig.mesh import FaceMesh
from usdface.usdio.surface.point_cache import PointsFormat, PointsHeader, writing_points
from usdface.usdio.take.read import TakeReader

_CHUNK_FRAMES = 2048
"""Frames of markers per read, to bound memory."""


def run(spec: DeformSpec, *, provenance: Provenance, progress: Progress) -> StepResult:
    """Deform the mesh at every frame of the take, and write its points."""
    take = TakeReader(spec.take)
    first, last = take.frames_within(frame_range(spec.frames))
    plan = plan_surface(spec, take, progress=part(progress, 0.0, 0.2))
    face = plan.face
    turner = _normal_turner(face)
    uncertain = spec.uncertainty and spec.method == "gp"
    spread: list[float] = []
    with writing_points(
        spec.out,
        face,
        PointsHeader(
            rate=take.rate,
            first_frame=first,
            last_frame=last,
            rig_path=spec.prim,
            method=_method(spec, plan),
            timecode_start=take.timecode_at(first),
        ),
        PointsFormat(
            normals=turner is not None, uncertainty=uncertain, clip_bytes=spec.clip_mb << 20
        ),
        provenance=provenance,
    ) as writer:
        for start in range(first, last + 1, _CHUNK_FRAMES):
            stop = min(start + _CHUNK_FRAMES - 1, last)
            for moved in plan.stream(take, start, stop):
                points = face.local + face.to_mesh_space(moved.mean.astype(np.float64))
                writer.append(
                    points,
                    normals=None
                    if turner is None
                    else np.stack([turner.turn(each) for each in points]),
                    uncertainty_mm=moved.sd if uncertain else None,
                )
                if moved.sd is not None:
                    spread.extend(np.sqrt((moved.sd**2).mean(axis=1)).tolist())
                done = (writer.next_frame - first) / (last - first + 1)
                progress(0.2 + 0.7 * done, f"moved to frame {writer.next_frame - 1}")
    write_comparison(
        spec, plan, take, (first, last), provenance=provenance, progress=part(progress, 0.9, 1)
    )
    return _report(spec, plan, first, last, spread)


def _normal_turner(face: FaceMesh) -> NormalTurner | None:
    """Return the rotation of the mesh's authored normals; None if renderers ignore them."""
    if face.authored_normals is None or face.mesh.subdivision != "none":
        return None
    return NormalTurner(
        face.local,
        face.mesh.face_counts,
        face.mesh.face_indices,
        face.authored_normals,
        per_corner=face.normals == "faceVarying",
    )


def _method(spec: DeformSpec, plan: SurfacePlan) -> str:
    name = spec.method if spec.method == "rbf" else f"{spec.method}-{spec.sampler}"
    return f"{name}, blend {plan.model.blend:g}, {spec.metric}"


def _report(
    spec: DeformSpec, plan: SurfacePlan, first: int, last: int, spread: list[float]
) -> StepResult:
    count, points = last - first + 1, len(plan.face.mesh.points)
    model = plan.model
    summary = (
        f"{pluralize(count, 'frame')} of {pluralize(points, 'point')} moved by "
        f"{pluralize(len(plan.columns), 'marker')}"
    )
    if spread:
        summary += f", standard deviation {np.median(spread):.2f} mm"
    return StepResult(
        (spec.out, points_path(spec.out), *spec.paths_of("picture")),
        summary,
        (*plan.notes, *sampler_notes(model)),
        {
            "frames": count,
            "points": points,
            "markers": len(plan.columns),
            "blend": model.blend,
            "length_scale_mm": model.length_scale,
            "left_out_rms_mm": model.diagnostics.left_out_rms_mm,
            "covariance_clipped": model.diagnostics.clipped,
            **sampler_figures(model),
            "uncertainty_mm": float(np.median(spread)) if spread else None,
            "points_without_marker": int(plan.distances.unreached.points.sum()),
        },
    )
