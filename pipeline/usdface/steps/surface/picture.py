"""Pictures of deformed meshes: comparison of metrics, and shapes."""

import contextlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from usdface.core.arrays import Float32Array, FloatArray
from usdface.core.assets import RigMesh
from usdface.core.errors import InputError
from usdface.core.progress import Progress
from usdface.core.provenance import Provenance
from usdface.media.face.render import Quality
from usdface.media.picture.color import UNKEYED_RANGE_MM
from usdface.media.picture.image import write_image
from usdface.media.picture.sheet import SheetPage, compose_sheet
from usdface.media.picture.surface_comparison import ComparedFrame, draw_compared
from usdface.model.surface.binding import facing_yaw
from usdface.model.surface.fit import SurfaceModel
from usdface.model.surface.gp_surface import GpOptions
from usdface.numerics.manifold.hyper_posterior import HyperPrior
from usdface.numerics.regression.reference_design import pivoted_selection
from usdface.specs.surface import DeformSpec, MakeShapesSpec
from usdface.steps.inputs.cleaned_takes import read_markers_at, spread_frames
from usdface.steps.surface.plan import PLAN_FRAMES, SurfacePlan, fit_surface, surface_options
from usdface.usdio.rig.mesh import FaceMesh, read_face_mesh
from usdface.usdio.surface.shape_rig import NewShape
from usdface.usdio.take.read import TakeReader

_NO_NOISE = HyperPrior(medians=(9.0, 1e-6, 4.0, 1.0), spread=(1.5, 0.05, 1.5, 1.5))
"""Noise v1 of about 1e-6 mm², with which the surface interpolates every marker."""

_MOVING_SHARE = 0.15
"""Share of the largest motion [0-1] above which markers must be in the picture."""

_RESULT = "this result"
_SD_NOTE = "standard deviation of each point, and its root mean square"
_FOLD_NOTES = {
    True: "points inside of lips and lids follow their own side, except in the Euclidean column",
    False: "points inside of lips and lids are treated like others, as published",
}


def write_comparison(
    spec: DeformSpec,
    plan: SurfacePlan,
    take: TakeReader,
    frames: tuple[int, int],
    *,
    provenance: Provenance,
    progress: Progress,
) -> None:
    """Draw the take's most different frames with each metric."""
    if spec.picture is None:
        return
    progress(0.0, f"drawing {spec.picture.name}")
    sampled = spread_frames(take, PLAN_FRAMES, frames)
    markers, rng = read_markers_at(take, sampled), np.random.default_rng(0)
    every, moved = (
        plan.displacements(each) + rng.normal(0, spec.picture_noise, each[:, plan.columns].shape)
        for each in (plan.sample.positions, markers.positions)
    )
    rows = np.sort(pivoted_selection(moved.reshape(len(moved), -1), spec.rows))
    rows = rows if len(rows) else np.zeros(1, np.int64)  # a still face
    columns, models = _compared_models(spec, plan, every)
    seen = markers.visible[rows][:, plan.columns].astype(np.float64)
    surfaces = [each.deform(moved[rows], seen) for each in models]
    sds = surfaces[-1].sd
    rest = plan.face.mesh.points
    compared = [
        ComparedFrame(
            frame=sampled[row],
            timecode=take.timecode_at(sampled[row]),
            surfaces=tuple(rest + plan.fade * each.mean[number] for each in surfaces),
            uncertainty_mm=None if sds is None else sds[number].astype(np.float64),
        )
        for number, row in enumerate(rows.tolist())
    ]
    page = SheetPage(
        title=f"{take.name} on {spec.mesh.stem}",
        columns=columns if sds is None else (*columns, "standard deviation"),
        rows=(),
        facts=(
            f"{len(plan.columns)} markers",
            f"{len(rest)} points",
            f"left-out markers {plan.model.diagnostics.left_out_rms_mm:.2f} mm",
            *((f"noise of {spec.picture_noise:g} mm added",) if spec.picture_noise else ()),
        ),
        notes=(
            f"{', '.join(columns[2:])}: both distances blended, geodesic {plan.model.blend:.0%}",
            *(() if sds is None else (_SD_NOTE,)),
            _FOLD_NOTES[spec.folds],
        ),
    )
    _write(spec.picture, plan, compared, page, quality=spec.quality, provenance=provenance)


def _compared_models(
    spec: DeformSpec, plan: SurfacePlan, moved: FloatArray
) -> tuple[tuple[str, ...], tuple[SurfaceModel, ...]]:
    """Return the compared models: each metric, the blend without and with smoothing."""
    options = replace(
        surface_options(spec, plan.proportions), sampler="shared", blend=plan.model.blend
    )

    def fit(of: GpOptions) -> SurfaceModel:
        return fit_surface(spec, plan.distances, moved, of)

    alone = fit(replace(options, blend=0.0)), fit(replace(options, blend=1.0))
    if spec.method == "rbf":
        return ("Euclidean", "geodesic", _RESULT), (*alone, plan.model)
    result = plan.model
    if spec.picture_noise:  # fitted to the noisy markers, to smooth them
        result = fit(replace(options, sampler=spec.sampler))
    columns = ("Euclidean", "geodesic", "unsmoothed", _RESULT)
    return columns, (*alone, fit(replace(options, prior=_NO_NOISE)), result)


def write_shapes_picture(
    spec: MakeShapesSpec,
    plan: SurfacePlan,
    shapes: Sequence[NewShape],
    *,
    names: Sequence[str],
    sd_mm: Float32Array | None,
    provenance: Provenance,
) -> None:
    """Draw shapes with their names."""
    if spec.picture is None:
        return
    rest = plan.face.mesh.points
    sds = [None] * len(shapes) if sd_mm is None else list(sd_mm.astype(np.float64))
    compared = [
        ComparedFrame(shape.frame, "", (rest + shape.moved_mm,), sd, note=name)
        for shape, name, sd in zip(shapes, names, sds, strict=True)
    ]
    page = SheetPage(
        title=f"shapes of {shapes[0].take} on {spec.mesh.stem}",
        columns=("shape",) if sd_mm is None else ("shape", "standard deviation"),
        rows=(),
        facts=(f"{len(shapes)} shapes", f"{len(rest)} points"),
        notes=() if sd_mm is None else (_SD_NOTE,),
    )
    _write(spec.picture, plan, compared, page, quality=spec.quality, provenance=provenance)


def _write(
    path: Path,
    plan: SurfacePlan,
    compared: list[ComparedFrame],
    page: SheetPage,
    *,
    quality: Quality,
    provenance: Provenance,
) -> None:
    at = plan.places.positions(plan.face.mesh.points)
    moved = plan.displacements(plan.sample.positions)
    far = np.linalg.norm(moved, axis=2).max(axis=0)
    rows = draw_compared(
        plan.face.mesh,
        compared,
        still=other_meshes(plan.face),
        near=at[far >= _MOVING_SHARE * far.max()],
        yaw_degrees=facing_yaw(plan.face.mesh, at),
        quality=quality,
    )
    page = replace(page, rows=tuple(rows), high=UNKEYED_RANGE_MM)
    write_image(path, compose_sheet(page), metadata=provenance.metadata)


def other_meshes(face: FaceMesh) -> list[RigMesh]:
    """Read the file's other meshes, without those that cannot be drawn."""
    found = []
    for path in face.others:
        with contextlib.suppress(InputError):
            found.append(read_face_mesh(face.file, prim=path).mesh)
    return found
