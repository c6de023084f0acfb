"""Distances from markers to every point of a mesh, ready for regression."""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import BoolArray, Float32Array, FloatArray, IntArray
from usdface.core.errors import InputError
from usdface.core.progress import Progress, silent
from usdface.numerics.surface.geodesic import Metric, euclidean_distances, geodesic_distances
from usdface.numerics.surface.surface_graph import MeshFaults

BLEND = 0.39
"""Share of the geodesic distance that W06 found best (section 5, Fig. 6)."""

FEWEST_MARKERS = 4
"""A field that is linear over the face has four numbers for each axis."""


@dataclass(frozen=True)
class UnreachedReport:
    """What no path over the surface joins: there the straight line stands for the distance.

    Attributes
    ----------
    points : (points,) bool array
        Points that no marker reaches: islands without a marker (teeth, eyes) and loose points.
        They follow the markers by straight lines.
    pairs : int
        Pairs of markers on different islands.
    islands : int
        Connected pieces of the mesh.
    islands_without_marker : int
    faults : MeshFaults
    """

    points: BoolArray
    pairs: int
    islands: int
    islands_without_marker: int
    faults: MeshFaults

    def describe(self) -> tuple[str, ...]:
        """Return what a person should know, a sentence each; none where all is well."""
        lines = []
        if self.points.any():
            lines.append(
                f"{self.points.sum()} of {len(self.points)} points lie on "
                f"{self.islands_without_marker} islands without a marker and follow by straight "
                "lines; bind markers there or keep those parts out of the mesh"
            )
        if self.pairs:
            lines.append(f"{self.pairs} pairs of markers sit on different islands")
        if self.faults.nonmanifold_edges:
            lines.append(f"{self.faults.nonmanifold_edges} edges have more than two faces")
        if self.faults.degenerate_faces:
            lines.append(f"{self.faults.degenerate_faces} faces use a point twice or have no area")
        return tuple(lines)


@dataclass(frozen=True)
class SurfaceDistances:
    """Distances over a mesh at rest and through the air; both finite everywhere.

    Attributes
    ----------
    points : (N, 3) float32 array
        The mesh [mm].
    marker_positions : (M, 3) float array
        Where the markers sit on it [mm].
    geodesic_to_points : (M, N) float32 array
        [mm]
    geodesic_between : (M, M) float array
        [mm]
    euclidean_to_points : (M, N) float32 array
        [mm]
    euclidean_between : (M, M) float array
        [mm]
    metric : str
    unreached : UnreachedReport
    """

    points: Float32Array
    marker_positions: FloatArray
    geodesic_to_points: Float32Array
    geodesic_between: FloatArray
    euclidean_to_points: Float32Array
    euclidean_between: FloatArray
    metric: Metric
    unreached: UnreachedReport

    def blended_to_points(self, weight: float = BLEND) -> Float32Array:
        """``w * geodesic + (1 - w) * Euclidean`` to every point: (M, N) float32 array [mm]."""
        out = np.multiply(self.euclidean_to_points, np.float32(1 - weight))
        out += np.float32(weight) * self.geodesic_to_points
        return out

    def blended_between(self, weight: float = BLEND) -> FloatArray:
        """Blend between markers alike: (M, M) float array [mm]."""
        out: FloatArray = weight * self.geodesic_between + (1 - weight) * self.euclidean_between
        return out

    def scaled(self, positions: FloatArray | Float32Array) -> FloatArray:
        """Centre positions on the markers and scale them to about 1: (n, 3) float array."""
        centre = self.marker_positions.mean(axis=0)
        size = np.sqrt(((self.marker_positions - centre) ** 2).mean())
        return np.asarray((positions - centre) / size, np.float64)


def surface_distances(
    points: FloatArray,
    face_counts: IntArray,
    face_indices: IntArray,
    marker_faces: IntArray,
    marker_barycentrics: FloatArray,
    *,
    marker_corners: IntArray | None = None,
    metric: Metric = "dijkstra",
    progress: Progress = silent,
) -> SurfaceDistances:
    """Measure from every marker to every point (W06, "Geodesic manifold distances").

    Parameters
    ----------
    points : (N, 3) float array
        The mesh at rest [mm].
    face_counts, face_indices : int arrays
        Polygons as USD stores them.
    marker_faces : (M,) int array
        Polygon each marker sits on.
    marker_barycentrics : (M, 3) float array
        Share of each of three corners, sum 1.
    marker_corners : (M, 3) int array, optional
        Points that the shares belong to; by default the first three corners of the polygon.
    metric : {'dijkstra', 'dijkstra-diagonals', 'heat'}
        The paper's, on edges; the same over polygons' diagonals too; the heat method.
    progress : callable

    Raises
    ------
    InputError
        If there are fewer than four markers, no faces, points that are not finite, or markers that
        are not on the mesh.
    """
    rest = np.asarray(points, np.float64)
    counts, indices = np.asarray(face_counts, np.int64), np.asarray(face_indices, np.int64)
    faces = np.asarray(marker_faces, np.int64)
    shares = np.asarray(marker_barycentrics, np.float64)
    if len(faces) < FEWEST_MARKERS:
        raise InputError(
            f"{len(faces)} markers are bound to the mesh; at least {FEWEST_MARKERS} are needed"
        )
    corners = marker_corners
    try:
        if corners is None:
            corners = _first_corners(counts, indices, faces)
        found = geodesic_distances(
            rest,
            counts,
            indices,
            faces=faces,
            corners=np.asarray(corners, np.int64),
            weights=shares,
            metric=metric,
            progress=progress,
        )
    except ValueError as error:
        raise InputError(str(error)) from error
    to_points, between = found.to_points, found.between
    straight = euclidean_distances(found.positions, rest)
    straight_between = np.linalg.norm(found.positions[:, None] - found.positions, axis=2)
    lost = ~np.isfinite(to_points)
    lost_pairs = ~np.isfinite(between)
    reached_islands = np.unique(found.islands[corners[:, 0]])
    np.copyto(to_points, straight, where=lost)
    return SurfaceDistances(
        points=rest.astype(np.float32),
        marker_positions=found.positions,
        geodesic_to_points=to_points,
        geodesic_between=np.where(lost_pairs, straight_between, between),
        euclidean_to_points=straight,
        euclidean_between=straight_between,
        metric=metric,
        unreached=UnreachedReport(
            points=np.asarray(lost.all(axis=0)),
            pairs=int(lost_pairs.sum()) // 2,
            islands=int(found.islands.max()) + 1,
            islands_without_marker=int(found.islands.max()) + 1 - len(reached_islands),
            faults=found.faults,
        ),
    )


def _first_corners(counts: IntArray, indices: IntArray, faces: IntArray) -> IntArray:
    if not len(counts):
        raise ValueError("the mesh has no face; distances over it need a surface")
    fits = (faces >= 0) & (faces < len(counts))
    if not fits.all() or (counts[faces] < 3).any():
        bad = int(np.flatnonzero(~fits)[0]) if not fits.all() else 0
        raise ValueError(
            f"marker {bad} sits on face {faces[bad]} and the mesh has {len(counts)} faces of 3 "
            "corners or more; bind the markers to this mesh"
        )
    starts = np.cumsum(counts) - counts
    first: IntArray = indices[starts[faces][:, None] + np.arange(3)]
    return first
