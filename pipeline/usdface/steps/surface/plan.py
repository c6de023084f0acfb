"""Prepare the deformation of a mesh by a take: binding, proportions, distances, model."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from usdface.core.arrays import BoolArray, Float32Array, FloatArray, IntArray, smoothstep
from usdface.core.assets import RigMesh
from usdface.core.errors import InputError, as_input_error
from usdface.core.progress import Progress, part
from usdface.core.text import first_few, pluralize
from usdface.model.selection.baseline import PerformerMarkers
from usdface.model.surface.binding import UNCERTAIN_CONFIDENCE, propose_binding
from usdface.model.surface.distance import SurfaceDistances, surface_distances
from usdface.model.surface.fit import SurfaceModel, SurfaceMotion
from usdface.model.surface.gp_surface import GpOptions, fit_gp_surface
from usdface.model.surface.rbf_surface import fit_rbf_surface
from usdface.numerics.manifold.hyper_posterior import HyperPrior
from usdface.numerics.registration.marker_binding import (
    FEWEST_MARKERS,
    MarkerBinding,
    Proportions,
    fit_proportions,
)
from usdface.numerics.surface.surface_places import SurfacePoints, places_at_points
from usdface.specs.surface import SurfaceSpec
from usdface.steps.inputs.cleaned_takes import read_markers_at, spread_frames
from usdface.steps.inputs.placement import read_performer_markers
from usdface.usdio.rig.mesh import FaceMesh, read_face_mesh
from usdface.usdio.rig.read import read_rig
from usdface.usdio.surface.binding import read_binding
from usdface.usdio.take.read import TakeReader

_REACH_SPACINGS = 4.0
"""Default reach of the markers, as a multiple of the root mean square distance to the nearest one.
With the median, dense markers around the mouth hold cheeks with sparse markers still."""

_COINCIDENCE_MM = 0.01

_FEW_MARKERS = 14
"""Markers below which the prior of v0 weighs more than a tenth in its mean."""

PLAN_FRAMES = 400
"""Frames spread over a take, for binding and fitting."""


def bind_take(
    sample: PerformerMarkers,
    face: FaceMesh,
    *,
    pinned: dict[int, SurfacePoints],
    sources: dict[int, str],
) -> MarkerBinding:
    """Propose a binding, using the shapes of the mesh if its file is a rig."""
    return propose_binding(
        add_shapes(face),
        names=sample.labels,
        neutral=sample.neutral,
        positions=sample.positions.astype(np.float64),
        visible=sample.visible,
        rigid=sample.rigid,
        pins=pinned,
        sources=sources,
    )


def add_shapes(face: FaceMesh) -> RigMesh:
    """Return the mesh with its shapes, if its file is a rig."""
    try:
        rig = read_rig(face.file, prim=face.root)
    except InputError:
        return face.mesh
    found = [mesh for mesh in rig.meshes if mesh.path == face.path]
    return replace(face.mesh, shapes=found[0].shapes) if found else face.mesh


def landmark_places(
    landmarks: tuple[str, ...], names: tuple[str, ...], face: FaceMesh, take: Path
) -> dict[int, SurfacePoints]:
    """Return the place of each landmark NAME=POINT on the mesh, by marker index."""
    faults, found = [], {}
    for landmark in landmarks:
        name, _, number = landmark.rpartition("=")
        point = int(number)
        if name in names and names.index(name) in found:
            faults.append(f"{name} is given twice")
        elif name not in names:
            faults.append(f"{take}: has no marker {name!r}; it has {first_few(names)}")
        elif point >= len(face.mesh.points):
            faults.append(
                f"{face.file} <{face.path}>: has no point {point} for {name}, only "
                f"{len(face.mesh.points)}"
            )
        else:
            try:
                found[names.index(name)] = places_at_points(
                    face.mesh.face_counts, face.mesh.face_indices, np.array([point])
                )
            except ValueError as error:
                faults.append(f"{face.file} <{face.path}>: landmark {name}: {error}")
    if faults:
        raise InputError(f"{'; '.join(faults)}; correct --landmarks")
    return found


@dataclass(frozen=True)
class SurfacePlan:
    """A mesh and the model that deforms it by a take."""

    face: FaceMesh
    sample: PerformerMarkers
    """The take at `PLAN_FRAMES` frames."""
    columns: IntArray
    """(markers,): indices of the take's bound markers, in the binding's order."""
    places: SurfacePoints
    """Places of the bound markers on the mesh."""
    proportions: Proportions
    """From the performer's face to the mesh."""
    distances: SurfaceDistances
    """From the bound markers to the mesh."""
    model: SurfaceModel
    """Fitted to the sample."""
    fade: Float32Array
    """(points, 1): factor on each point's motion [0-1]; 0 far from every marker, where the model
    extrapolates."""
    notes: tuple[str, ...]

    def displacements(self, positions: FloatArray | Float32Array) -> FloatArray:
        """Return the displacements of the bound markers, in the mesh's proportions [mm].

        `positions`: all markers of the take, stabilised, (frames, markers, 3) [mm].
        """
        moved = positions[:, self.columns].astype(np.float64) - self.sample.neutral[self.columns]
        return np.asarray(moved @ self.proportions.linear.T)

    def deform(self, take: TakeReader, frames: Sequence[int]) -> SurfaceMotion:
        """Deform the mesh at a few frames of the take, in any order."""
        markers, rows = read_markers_at(take, sorted(frames)), np.argsort(np.argsort(frames))
        confidence = markers.confidence[rows][:, self.columns]
        moved = self.model.deform(self.displacements(markers.positions[rows]), confidence)
        return SurfaceMotion(moved.mean * self.fade, moved.sd)

    def stream(self, take: TakeReader, first: int, last: int) -> Iterator[SurfaceMotion]:
        """Deform the mesh at consecutive frames of the take, block by block."""
        markers = read_markers_at(take, range(first, last + 1))
        confidence = markers.confidence[:, self.columns]
        for moved in self.model.stream(self.displacements(markers.positions), confidence):
            yield SurfaceMotion(moved.mean * self.fade, moved.sd)


def plan_surface(spec: SurfaceSpec, take: TakeReader, *, progress: Progress) -> SurfacePlan:
    """Read mesh and take, bind, measure distances and fit the model."""
    face = read_face_mesh(spec.mesh, prim=spec.mesh_prim)
    sample = read_performer_markers(take, spread_frames(take, PLAN_FRAMES))
    progress(0.1, "placing the markers")
    binding, notes = _bind(spec, sample, face)
    bound = [i for i, name in enumerate(binding.names) if name in sample.labels]
    columns = np.array([sample.labels.index(binding.names[i]) for i in bound], np.int64)
    if len(bound) < FEWEST_MARKERS:
        raise InputError(
            f"{spec.take}: {len(bound)} of its {len(sample.labels)} markers are bound to "
            f"{spec.mesh}, at least {FEWEST_MARKERS} are needed; bind this take's markers"
        )
    if len(bound) < len(binding.names):
        missing = [name for name in binding.names if name not in sample.labels]
        notes.append(f"the take lacks {len(missing)} of the bound markers: {first_few(missing)}")
    places = binding.places.select(bound)
    with as_input_error(f"{spec.take} cannot be aligned with {spec.mesh}"):
        proportions = fit_proportions(
            sample.neutral[columns],
            places.positions(face.mesh.points),
            weight=binding.confidence[bound],
        )
    progress(0.3, "measuring distances over the mesh")
    distances = surface_distances(
        face.mesh.points,
        face.mesh.face_counts,
        face.mesh.face_indices,
        places,
        metric=spec.metric,
        progress=part(progress, 0.3, 0.6),
    )
    names = [sample.labels[column] for column in columns.tolist()]
    notes.extend(distances.unreached.describe(names))
    notes.extend(_coincidence_notes(spec, distances, names))
    progress(0.6, "fitting the regression")
    seen = sample.visible[:, columns]
    notes.extend(_unseen_notes(names, seen))
    moved = sample.positions[:, columns].astype(np.float64) - sample.neutral[columns]
    options = surface_options(spec, proportions)
    model = fit_surface(spec, distances, moved @ proportions.linear.T, options)
    if model.predicts_sd and len(bound) < _FEW_MARKERS:
        notes.append(
            f"{len(bound)} markers hardly tell how far the skin between them moves; there, the "
            "standard deviation is mostly that of any face (--priors)"
        )
    fade = _fade(distances, spec.reach)
    return SurfacePlan(
        face,
        sample,
        columns,
        places,
        proportions,
        distances,
        model,
        fade,
        tuple(notes),
    )


def surface_options(spec: SurfaceSpec, proportions: Proportions) -> GpOptions:
    """Return the model's options of a spec, priors scaled from the performer to the mesh."""
    spread, square = spec.prior_spread, proportions.scale**2
    v0, v1, a0, a1 = (median * square for median in spec.priors)
    return GpOptions(
        sampler=spec.sampler,
        blend=None if spec.choose_blend else spec.blend,
        length_scale=spec.length_scale,
        covariance=spec.covariance,
        prior=HyperPrior((v0, v1, a0, a1), (spread, spread, spread, spread)),
        folds=spec.folds,
        samples=spec.samples,
        burn_in=spec.burn_in,
    )


_LARGEST_RHAT = 1.1
"""Value above which chains have not mixed (Gelman et al. 2013, section 11.5)."""

_LEAST_CUT = 5e-4
"""Share of the covariance's norm below which the part cut off is rounding."""


def sampler_figures(model: SurfaceModel) -> dict[str, object]:
    """Return diagnostics of the sampled hyper-parameters; None if they were not sampled."""
    names = ("acceptance", "effective_samples", "rhat", "two_modes")
    values = [getattr(model.diagnostics, name) for name in names]
    return {
        name: None if np.isnan(value) else value for name, value in zip(names, values, strict=True)
    }


def sampler_notes(model: SurfaceModel) -> list[str]:
    """Return notes on the sampling of hyper-parameters and the clipping of the covariance."""
    quality, notes = model.diagnostics, []
    if not np.isnan(quality.acceptance):
        notes.append(
            f"hyper-parameters: acceptance {quality.acceptance:.2f}, "
            f"{quality.effective_samples:.0f} effective samples, R-hat {quality.rhat:.3f}"
            + ("; more --samples or --burn-in" if quality.rhat > _LARGEST_RHAT else "")
        )
    if quality.clipped > _LEAST_CUT:
        notes.append(
            f"the covariance was not positive definite: its negative part, {quality.clipped:.1%} "
            "of it, was cut off"
        )
    return notes


def fit_surface(
    spec: SurfaceSpec, distances: SurfaceDistances, displacements: FloatArray, options: GpOptions
) -> SurfaceModel:
    """Fit the model of --method; `rbf` uses only some of the options."""
    if spec.method == "rbf":
        return fit_rbf_surface(distances, displacements, blend=options.blend, folds=options.folds)
    return fit_gp_surface(distances, displacements, options)


def _bind(
    spec: SurfaceSpec, sample: PerformerMarkers, face: FaceMesh
) -> tuple[MarkerBinding, list[str]]:
    notes = []
    if spec.binding is not None:
        read = read_binding(spec.binding, face)
        binding = read.binding
        if read.left_out:
            notes.append(f"left out by the binding: {first_few(read.left_out)}")
    else:
        pinned = landmark_places(spec.landmarks, sample.labels, face, spec.take)
        binding = bind_take(sample, face, pinned=pinned, sources=dict.fromkeys(pinned, "landmark"))
        notes.append("the markers were bound automatically; check them with `usdface bind`")
    doubtful = int((binding.confidence < UNCERTAIN_CONFIDENCE).sum())
    if doubtful:
        notes.append(
            f"at uncertain places: {pluralize(doubtful, 'marker')}; check them with `usdface bind`"
        )
    if face.others:
        notes.append(f"other meshes of {spec.mesh.name}, which do not move: {len(face.others)}")
    return binding, notes


def _coincidence_notes(
    spec: SurfaceSpec, distances: SurfaceDistances, names: list[str]
) -> list[str]:
    """Return a note on markers at one place; refuse them if every marker is interpolated."""
    straight = spec.blend == 0 or spec.choose_blend  # else touching lips are apart
    between = distances.euclidean_between if straight else distances.geodesic_between
    pairs = np.argwhere(np.triu(between < _COINCIDENCE_MM, 1)).tolist()
    if not pairs:
        return []
    listed = first_few([f"{names[i]} and {names[j]}" for i, j in pairs])
    words = f"at one place of the mesh: {listed}; leave one of them out"
    if spec.method == "rbf":
        raise InputError(f"{spec.mesh}: {words}")
    return [words]


def _unseen_notes(names: list[str], seen: BoolArray) -> list[str]:
    """Return a note on markers without a position in some frames of the sample."""
    missing = 1 - seen.mean(axis=0)
    if not missing.any():
        return []
    worst = [names[i] for i in np.argsort(-missing, kind="stable") if missing[i] > 0]
    return [
        f"without a position in up to {missing.max():.0%} of the frames, where the others predict "
        f"them with more uncertainty: {pluralize(len(worst), 'marker')}, {first_few(worst)}"
    ]


def _fade(distances: SurfaceDistances, reach: float | None) -> Float32Array:
    """Return a factor per point: 1 near the markers, 0 beyond their reach [mm], smooth between."""
    if reach is None:
        between = distances.geodesic_between
        nearest_other = np.where(np.eye(len(between)), np.inf, between).min(axis=1)
        reach = _REACH_SPACINGS * float(np.sqrt((nearest_other**2).mean()))
    nearest = distances.geodesic_to_points.min(axis=0)
    return np.asarray(smoothstep(2 - nearest / np.float32(reach / 2))[:, None], np.float32)
