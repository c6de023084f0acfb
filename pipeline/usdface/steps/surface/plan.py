"""A take laid on a mesh and ready to move it: binding, proportions, distances, regression."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from usdface.core.arrays import Float32Array, FloatArray, IntArray
from usdface.core.errors import InputError
from usdface.core.progress import Progress, part
from usdface.core.provenance import hash_text
from usdface.core.text import pluralize
from usdface.model.surface.binding import DOUBTFUL
from usdface.model.surface.distance import (
    SurfaceDistances,
    UnreachedReport,
    surface_distances,
)
from usdface.model.surface.fit import (
    SurfaceMotion,
    SurfaceRegression,
    fit_surface_regression,
)
from usdface.numerics.registration.marker_binding import (
    FEWEST_MARKERS,
    MarkerBinding,
    Proportions,
    fit_proportions,
)
from usdface.numerics.registration.surface_places import SurfacePlaces
from usdface.numerics.surface.surface_graph import MeshFaults
from usdface.specs.surface import SurfaceSpec
from usdface.steps.surface.bound_take import TakeSample, bind_take, landmark_places, sample_take
from usdface.usdio.rig.mesh import FaceMesh, read_face_mesh
from usdface.usdio.surface.binding import read_binding
from usdface.usdio.surface.distance_cache import CachedDistances, read_distances, write_distances
from usdface.usdio.take.read import TakeReader

_REACH = 4.0
"""How far markers reach by default, in the median distance from one to its nearest."""


@dataclass(frozen=True)
class SurfacePlan:
    """All that moving a mesh by a take needs.

    Attributes
    ----------
    face : FaceMesh
    sample : TakeSample
    columns : (markers,) int array
        The take's markers that are bound, in the binding's order.
    places : SurfacePlaces
    proportions : Proportions
        From the performer's face to the mesh's.
    distances : SurfaceDistances
    regression : SurfaceRegression
    fade : (points, 1) float32 array
        Share of its motion that each point keeps [0-1]; 0 far from every marker, where regression
        would only extrapolate.
    notes : tuple of str
        What the user should know.
    """

    face: FaceMesh
    sample: TakeSample
    columns: IntArray
    places: SurfacePlaces
    proportions: Proportions
    distances: SurfaceDistances
    regression: SurfaceRegression
    fade: Float32Array
    notes: tuple[str, ...]

    def displacements(self, positions: FloatArray | Float32Array) -> FloatArray:
        """Return how far frames move the bound markers, in the mesh's proportions [mm].

        Parameters
        ----------
        positions : (frames, markers, 3) float array
            All markers of the take, stabilised [mm].
        """
        moved = positions[:, self.columns].astype(np.float64) - self.sample.neutral[self.columns]
        return np.asarray(moved @ self.proportions.linear.T)

    def deform(self, displacements: FloatArray) -> SurfaceMotion:
        """Move the whole mesh at a few frames."""
        moved = self.regression.deform(displacements)
        return SurfaceMotion(moved.mean * self.fade, moved.sd)

    def stream(self, displacements: FloatArray) -> Iterator[SurfaceMotion]:
        """Move the whole mesh at many frames, some at a time."""
        for moved in self.regression.stream(displacements):
            yield SurfaceMotion(moved.mean * self.fade, moved.sd)


def plan_surface(
    spec: SurfaceSpec, take: TakeReader, *, out: Path, progress: Progress
) -> SurfacePlan:
    """Read, bind, measure and fit.

    Parameters
    ----------
    spec : SurfaceSpec
    take : TakeReader
    out : Path
        Distances are kept beside it.
    progress : callable

    Raises
    ------
    InputError
        If take, mesh and binding do not go together.
    """
    progress(0.0, "reading")
    face = read_face_mesh(spec.mesh, prim=spec.mesh_prim)
    sample = sample_take(take)
    progress(0.1, "placing the markers")
    binding, notes = _bind(spec, sample, face)
    kept = [i for i, name in enumerate(binding.names) if name in sample.names]
    columns = np.array([sample.names.index(binding.names[i]) for i in kept], np.int64)
    if len(kept) < FEWEST_MARKERS:
        raise InputError(
            f"{spec.take}: {len(kept)} of its {len(sample.names)} markers are bound to "
            f"{spec.mesh}; at least {FEWEST_MARKERS} are needed: bind this take's markers"
        )
    if len(kept) < len(binding.names):
        lost = [name for name in binding.names if name not in sample.names]
        notes.append(f"the take lacks {len(lost)} of the bound markers: {', '.join(lost[:5])}")
    places = SurfacePlaces(
        binding.places.faces[kept], binding.places.corners[kept], binding.places.weights[kept]
    )
    try:
        proportions = fit_proportions(
            sample.neutral[columns],
            places.positions(face.mesh.points),
            weight=binding.confidence[kept],
        )
    except ValueError as error:
        raise InputError(f"{spec.take} does not lie on {spec.mesh}: {error}") from error
    progress(0.3, "measuring distances over the mesh")
    distances = _distances(spec, face, places, out, part(progress, 0.3, 0.6))
    notes.extend(distances.unreached.describe())
    progress(0.6, "fitting the regression")
    moved = sample.positions[:, columns] - sample.neutral[columns]
    regression = fit_surface_regression(
        distances,
        moved @ proportions.linear.T,
        method=spec.method,
        sampler=spec.sampler,
        blend=None if spec.choose_blend else spec.blend,
        length_scale=spec.length_scale,
        device=spec.device,
        precision=spec.precision,
    )
    fade = _fade(distances, spec.reach)
    progress(1.0, "ready")
    return SurfacePlan(
        face, sample, columns, places, proportions, distances, regression, fade, tuple(notes)
    )


def _bind(spec: SurfaceSpec, sample: TakeSample, face: FaceMesh) -> tuple[MarkerBinding, list[str]]:
    notes = []
    if spec.binding is not None:
        read = read_binding(spec.binding, face)
        binding = read.binding
        if read.left_out:
            notes.append(f"left out by the binding: {', '.join(read.left_out[:8])}")
    else:
        pinned = landmark_places(spec.landmarks, sample.names, face, spec.take)
        binding = bind_take(sample, face, pinned=pinned, sources=dict.fromkeys(pinned, "landmark"))
        notes.append("the markers were bound anew; `usdface bind` shows where, to be corrected")
    doubtful = int((binding.confidence < DOUBTFUL).sum())
    if doubtful:
        notes.append(
            f"at doubtful places: {pluralize(doubtful, 'marker')}; look with `usdface bind`"
        )
    if face.others:
        notes.append(f"{len(face.others)} other meshes of {spec.mesh.name} stay as they are")
    return binding, notes


def _fade(distances: SurfaceDistances, reach: float | None) -> Float32Array:
    """Return 1 near the markers, 0 beyond their reach, and a smooth step between."""
    if reach is None:
        others = distances.geodesic_between + np.diag(
            np.full(len(distances.geodesic_between), np.inf)
        )
        reach = _REACH * float(np.median(others.min(axis=1)))
    nearest = distances.geodesic_to_points.min(axis=0)
    share = np.clip(2 - nearest / np.float32(reach / 2), 0, 1)
    return np.asarray((share**2 * (3 - 2 * share))[:, None], np.float32)


def distances_path(out: Path, face: FaceMesh) -> Path:
    """Return where distances are kept: beside the output, by the hash of the surface."""
    return out.with_name(f"{face.file.stem}.{face.hash[:8]}.distances.usdc")


def _distances(
    spec: SurfaceSpec, face: FaceMesh, places: SurfacePlaces, out: Path, progress: Progress
) -> SurfaceDistances:
    mesh = face.mesh
    numbers = (places.faces.tolist(), places.corners.tolist(), places.weights.round(7).tolist())
    key = hash_text(f"{face.hash} {spec.metric} {numbers}")
    path = distances_path(out, face)
    cached = read_distances(path, key=key)
    if cached is not None:
        return _from_cache(cached, spec, face, places)
    found = surface_distances(
        mesh.points,
        mesh.face_counts,
        mesh.face_indices,
        places.faces,
        places.weights,
        marker_corners=places.corners,
        metric=spec.metric,
        progress=progress,
    )
    write_distances(path, _to_cache(found), key=key)
    return found


def _to_cache(found: SurfaceDistances) -> CachedDistances:
    unreached = found.unreached
    return CachedDistances(
        arrays={
            "geodesicToPoints": found.geodesic_to_points,
            "geodesicBetween": found.geodesic_between,
            "euclideanToPoints": found.euclidean_to_points,
            "euclideanBetween": found.euclidean_between,
            "unreached": unreached.points,
        },
        facts={
            "pairs": unreached.pairs,
            "islands": unreached.islands,
            "islandsWithoutMarker": unreached.islands_without_marker,
            "nonmanifoldEdges": unreached.faults.nonmanifold_edges,
            "degenerateFaces": unreached.faults.degenerate_faces,
            "loosePoints": unreached.faults.loose_points,
        },
    )


def _from_cache(
    cached: CachedDistances, spec: SurfaceSpec, face: FaceMesh, places: SurfacePlaces
) -> SurfaceDistances:
    arrays, facts = cached.arrays, cached.facts
    return SurfaceDistances(
        points=face.mesh.points.astype(np.float32),
        marker_positions=places.positions(face.mesh.points),
        geodesic_to_points=arrays["geodesicToPoints"].astype(np.float32),
        geodesic_between=arrays["geodesicBetween"].astype(np.float64),
        euclidean_to_points=arrays["euclideanToPoints"].astype(np.float32),
        euclidean_between=arrays["euclideanBetween"].astype(np.float64),
        metric=spec.metric,
        unreached=UnreachedReport(
            points=arrays["unreached"].astype(np.bool_),
            pairs=facts["pairs"],
            islands=facts["islands"],
            islands_without_marker=facts["islandsWithoutMarker"],
            faults=MeshFaults(
                facts["nonmanifoldEdges"], facts["degenerateFaces"], facts["loosePoints"]
            ),
        ),
    )
