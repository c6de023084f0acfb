"""Geodesic and Euclidean distances from markers to every point of a mesh."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import BoolArray, Float32Array, FloatArray, IntArray
from usdface.core.errors import InputError
from usdface.core.progress import Progress, silent
from usdface.core.text import counted, pluralize
from usdface.numerics.registration.marker_binding import FEWEST_MARKERS
from usdface.numerics.surface.geodesic import Metric, euclidean_distances, geodesic_distances
from usdface.numerics.surface.surface_graph import MeshFaults
from usdface.numerics.surface.surface_places import SurfacePoints

BLEND_PUBLISHED = 0.39
"""Share of the geodesic distance with the smallest error in W06 (section 5, Fig. 6) [0-1]."""


@dataclass(frozen=True)
class UnreachedReport:
    """Pairs without a path over the surface, whose distance is Euclidean."""

    points: BoolArray
    """(points,): points without a path to any marker: islands without a marker (teeth, eyes) and
    loose points."""
    apart: BoolArray
    """(markers,): those on other islands than most markers."""
    islands_without_marker: int
    faults: MeshFaults

    def describe(self, names: Sequence[str]) -> tuple[str, ...]:
        """Return a sentence for each finding; none if all pairs are connected.

        `names`: of the markers.
        """
        lines = []
        if self.points.any():
            lines.append(
                f"{self.points.sum()} of {len(self.points)} points are on "
                f"{pluralize(self.islands_without_marker, 'separate part')} without a marker and "
                "use straight-line distances; bind markers there, or omit these parts from the mesh"
            )
        if self.apart.any():
            apart = [name for name, other in zip(names, self.apart, strict=True) if other]
            lines.append(
                f"on other separate parts than most markers: {counted(apart, 'marker')}; check "
                "them with `usdface bind`"
            )
        if self.faults.nonmanifold_edges:
            lines.append(f"{self.faults.nonmanifold_edges} edges have more than two faces")
        if self.faults.degenerate_faces:
            lines.append(f"{self.faults.degenerate_faces} faces use a point twice or have no area")
        return tuple(lines)


@dataclass(frozen=True)
class SurfaceDistances:
    """Geodesic and Euclidean distances on a mesh at rest; all are finite."""

    points: Float32Array
    """(N, 3): the mesh [mm]."""
    marker_positions: FloatArray
    """(M, 3): positions of the markers on it [mm]."""
    geodesic_to_points: Float32Array
    """(M, N) [mm]"""
    geodesic_between: FloatArray
    """(M, M) [mm]"""
    euclidean_to_points: Float32Array
    """(M, N) [mm]"""
    euclidean_between: FloatArray
    """(M, M) [mm]"""
    unreached: UnreachedReport
    """Pairs whose geodesic distance is Euclidean."""

    def blended_to_points(self, weight: float) -> Float32Array:
        """``w * geodesic + (1 - w) * Euclidean`` to every point: (M, N) float32 array [mm]."""
        out = np.multiply(self.euclidean_to_points, np.float32(1 - weight))
        out += np.float32(weight) * self.geodesic_to_points
        return out

    def blended_between(self, weight: float) -> FloatArray:
        """``w * geodesic + (1 - w) * Euclidean`` between markers: (M, M) float array [mm]."""
        return np.asarray(weight * self.geodesic_between + (1 - weight) * self.euclidean_between)

    def scaled(self, positions: FloatArray | Float32Array) -> FloatArray:
        """Centre positions on the markers, and scale by the markers' standard deviation."""
        centre = self.marker_positions.mean(axis=0)
        size = np.sqrt(((self.marker_positions - centre) ** 2).mean())
        return np.asarray((positions - centre) / size, np.float64)


def surface_distances(
    points: FloatArray,
    face_counts: IntArray,
    face_indices: IntArray,
    markers: SurfacePoints,
    *,
    metric: Metric = "dijkstra",
    progress: Progress = silent,
) -> SurfaceDistances:
    """Return distances from every marker to every point (W06, "Geodesic manifold distances").

    Parameters
    ----------
    points : (N, 3) float array
        The mesh at rest [mm].
    face_counts, face_indices : int arrays
        Polygons as USD stores them.
    markers : SurfacePoints
        M places on the mesh.
    metric : {'dijkstra', 'dijkstra-diagonals'}
        Shortest paths along edges, as in the paper, or along edges and diagonals.
    """
    if len(markers.faces) < FEWEST_MARKERS:
        raise InputError(
            f"{len(markers.faces)} markers are bound to the mesh; at least {FEWEST_MARKERS} are "
            "needed"
        )
    try:
        found = geodesic_distances(
            points, face_counts, face_indices, markers, metric=metric, progress=progress
        )
    except ValueError as error:
        raise InputError(str(error)) from error
    to_points, between = found.to_points, found.between
    straight = euclidean_distances(found.positions, points)
    straight_between = np.linalg.norm(found.positions[:, None] - found.positions, axis=2)
    unreached = ~np.isfinite(to_points)
    unreached_pairs = ~np.isfinite(between)
    np.copyto(to_points, straight, where=unreached)
    of_markers = found.islands[markers.corners[:, 0]]
    return SurfaceDistances(
        points=points.astype(np.float32),
        marker_positions=found.positions,
        geodesic_to_points=to_points,
        geodesic_between=np.where(unreached_pairs, straight_between, between),
        euclidean_to_points=straight,
        euclidean_between=straight_between,
        unreached=UnreachedReport(
            points=np.asarray(unreached.all(axis=0)),
            apart=np.asarray(of_markers != np.bincount(of_markers).argmax()),
            islands_without_marker=int(found.islands.max()) + 1 - len(np.unique(of_markers)),
            faults=found.faults,
        ),
    )
