"""The pictures of moved meshes: distances compared, and shapes as they were made."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from usdface.core.arrays import BoolArray, FloatArray
from usdface.core.progress import Progress
from usdface.core.provenance import Provenance
from usdface.core.timecode import shift_timecode
from usdface.media.face.render import Quality
from usdface.media.picture.image import write_image
from usdface.media.picture.sheet import SheetPage, compose_sheet
from usdface.media.picture.surface_comparison import ComparedFrame, draw_compared
from usdface.model.surface.binding import facing_yaw
from usdface.model.surface.fit import SurfaceRegression, fit_surface_regression
from usdface.numerics.manifold.hyper_posterior import HyperPrior
from usdface.numerics.regression.reference_design import most_different_rows
from usdface.runner.origin import provenance_metadata
from usdface.specs.surface import DeformSpec
from usdface.steps.surface.plan import SurfacePlan
from usdface.usdio.take.read import TakeReader

NOISE_BELIEVED = HyperPrior(medians=(9.0, 1e-6, 4.0, 1.0), spread=(1.5, 0.05, 1.5, 1.5))
"""Markers without noise: the surface then meets each of them, as an interpolant does."""

MOVING = 0.15
"""Of the largest motion: markers that move less need not be in the picture."""

_YAW_DEGREES = 18.0
"""A little from the side, where lips and lids show their depth."""


def write_comparison(
    spec: DeformSpec,
    plan: SurfacePlan,
    take: TakeReader,
    frames: tuple[int, int],
    *,
    provenance: Provenance | None,
    progress: Progress,
) -> None:
    """Draw the take's most different faces by each way of measuring distance, and write it."""
    if spec.picture is None:
        return
    progress(0.0, f"drawing {spec.picture.name}")
    inside = [i for i, f in enumerate(plan.sample.frames) if frames[0] <= f <= frames[1]]
    every = plan.displacements(plan.sample.positions)
    if spec.picture_noise:
        every = every + np.random.default_rng(0).normal(0, spec.picture_noise, every.shape)
    moved = every[inside]
    rows = np.sort(most_different_rows(moved.reshape(len(moved), -1), spec.rows))
    chosen = moved[rows]
    columns, ways = _ways(spec, plan, every)
    if spec.picture_noise and spec.method == "gp":  # it must know of the noise to smooth it
        ways = (*ways[:-1], _as_planned(spec, plan, every))
    surfaces = [each.deform(chosen) for each in ways]
    sds = surfaces[-1].sd
    rest = plan.face.mesh.points
    compared = [
        ComparedFrame(
            frame=plan.sample.frames[inside[row]],
            timecode=_timecode(take, plan.sample.frames[inside[row]]),
            surfaces=tuple(rest + plan.fade * each.mean[number] for each in surfaces),
            uncertainty_mm=None if sds is None else sds[number].astype(np.float64),
        )
        for number, row in enumerate(rows.tolist())
    ]
    _write(
        spec.picture,
        plan,
        compared,
        quality=spec.quality,
        title=f"{take.name} on {spec.mesh.stem}",
        columns=columns if sds is None else (*columns, "standard deviation"),
        facts=(
            f"{len(plan.columns)} markers",
            f"{len(rest)} points",
            f"left-out markers {plan.regression.diagnostics.left_out_rms_mm:.2f} mm",
            *((f"markers shaken by {spec.picture_noise:g} mm",) if spec.picture_noise else ()),
        ),
        notes=("standard deviation of each point, and its root mean square",)
        if sds is not None
        else (),
        provenance=provenance,
    )


def _ways(
    spec: DeformSpec, plan: SurfacePlan, moved: FloatArray
) -> tuple[tuple[str, ...], tuple[SurfaceRegression, ...]]:
    """Return what is compared: both distances alone, the blend with noise believed, the result."""

    def fit(blend: float, prior: HyperPrior | None = None) -> SurfaceRegression:
        return fit_surface_regression(
            plan.distances, moved, method=spec.method, sampler="shared", blend=blend, prior=prior
        )

    blend = plan.regression.blend
    alone = (fit(0.0), fit(1.0))
    if spec.method == "rbf":
        return ("Euclidean", "geodesic", f"blended {blend:.2f}: this result"), (
            *alone,
            plan.regression,
        )
    columns = ("Euclidean", "geodesic", f"blended {blend:.2f}, noise kept", "smoothed: this result")
    return columns, (*alone, fit(blend, NOISE_BELIEVED), plan.regression)


def _as_planned(spec: DeformSpec, plan: SurfacePlan, moved: FloatArray) -> SurfaceRegression:
    return fit_surface_regression(
        plan.distances, moved, method="gp", sampler=spec.sampler, blend=plan.regression.blend
    )


def write_shapes_picture(
    path: Path,
    plan: SurfacePlan,
    shapes: Sequence[tuple[str, int, FloatArray, FloatArray | None]],
    *,
    title: str,
    quality: Quality,
    provenance: Provenance | None,
) -> None:
    """Draw shapes, as (name, frame, moved points, uncertainty), and write the picture."""
    rest = plan.face.mesh.points
    compared = [
        ComparedFrame(frame, "", (rest + moved,), sd, note=name)
        for name, frame, moved, sd in shapes
    ]
    known = all(sd is not None for *_, sd in shapes)
    _write(
        path,
        plan,
        compared,
        quality=quality,
        title=title,
        columns=("shape", "standard deviation") if known else ("shape",),
        facts=(f"{len(shapes)} shapes", f"{len(rest)} points"),
        notes=("standard deviation of each point, and its root mean square",) if known else (),
        provenance=provenance,
    )


def _write(
    path: Path,
    plan: SurfacePlan,
    compared: list[ComparedFrame],
    *,
    quality: Quality,
    title: str,
    columns: tuple[str, ...],
    facts: tuple[str, ...],
    notes: tuple[str, ...],
    provenance: Provenance | None,
) -> None:
    at = plan.places.positions(plan.face.mesh.points)
    sds = [each.uncertainty_mm for each in compared if each.uncertainty_mm is not None]
    high = _round_up(float(np.percentile(np.stack(sds), 95))) if sds else 1.0
    rows = draw_compared(
        plan.face.mesh,
        compared,
        near=at[_moving(plan)],
        yaw_degrees=facing_yaw(plan.face.mesh, at) + _YAW_DEGREES,
        high_mm=high,
        quality=quality,
    )
    page = SheetPage(
        title=title, columns=columns, rows=tuple(rows), facts=facts, notes=notes, high=high
    )
    metadata = {} if provenance is None else provenance_metadata(provenance)
    write_image(path, compose_sheet(page), metadata=metadata)


def _moving(plan: SurfacePlan) -> BoolArray:
    """Say which markers the face's motion shows: a head's others would make it small."""
    moved = plan.displacements(plan.sample.positions)
    far = np.linalg.norm(moved, axis=2).max(axis=0)
    return np.asarray(far >= MOVING * far.max(), np.bool_)


def _round_up(value: float) -> float:
    power = 10.0 ** np.floor(np.log10(max(value, 1e-3)))
    return float(next(step * power for step in (1, 2, 3, 5, 10) if step * power >= value))


def _timecode(take: TakeReader, frame: int) -> str:
    start = take.timecode_at(take.first_frame)
    return shift_timecode(start, frame - take.first_frame, take.rate)
