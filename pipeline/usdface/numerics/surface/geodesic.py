"""Geodesic distances from places on a mesh to all its points: W06, "Geodesic manifold distances".

Two metrics: the paper's, Dijkstra's algorithm on the edges; and the same with the diagonals of
every polygon. From a place, anywhere on a face, the distances to that face's corners are straight
lines, and paths continue from the corners.
"""

from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import dijkstra
from scipy.spatial.distance import cdist

from usdface.core.arrays import Float32Array, FloatArray, IntArray, frame_blocks
from usdface.core.progress import Progress, silent
from usdface.numerics.surface.surface_graph import MeshFaults, join_parts, surface_graph
from usdface.numerics.surface.surface_places import SurfacePoints

Metric = Literal["dijkstra", "dijkstra-diagonals"]

_BLOCK_PLACES = 32
"""Places per call of Dijkstra's algorithm, whose result is in double precision."""


@dataclass(frozen=True)
class Geodesics:
    """Distances over a surface; infinite between parts that are not connected."""

    to_points: Float32Array
    """(places, points) [mm]"""
    between: FloatArray
    """(places, places) [mm]; symmetric, 0 on the diagonal."""
    positions: FloatArray
    """(places, 3) [mm]"""
    islands: IntArray
    """(points,): connected part of each point."""
    faults: MeshFaults
    """Of the mesh."""


def geodesic_distances(
    points: FloatArray,
    face_counts: IntArray,
    face_indices: IntArray,
    places: SurfacePoints,
    *,
    metric: Metric = "dijkstra",
    limit: float = np.inf,
    progress: Progress = silent,
) -> Geodesics:
    """Return distances from every place to every point, and between places.

    Parts that only duplicated points separate are one surface; see `join_parts`.

    Parameters
    ----------
    points : (points, 3) float array
        The mesh at rest [mm].
    face_counts, face_indices : int arrays
        Polygons as USD stores them.
    metric : {'dijkstra', 'dijkstra-diagonals'}
    limit : float, optional
        Distance beyond which points are not reached [mm].
    """
    if metric not in get_args(Metric):
        raise ValueError(f"no metric {metric!r}; there are {', '.join(get_args(Metric))}")
    joined = join_parts(points, face_counts, face_indices)
    _check_places(face_counts, face_indices, places)
    face_indices, places = joined[face_indices], replace(places, corners=joined[places.corners])
    graph, islands, faults = surface_graph(
        points, face_counts, face_indices, diagonals=metric != "dijkstra"
    )
    positions = places.positions(points)
    starts = np.cumsum(face_counts) - face_counts
    polygons = [
        np.unique(face_indices[starts[face] : starts[face] + face_counts[face]])
        for face in places.faces
    ]
    lengths = [
        np.linalg.norm(points[polygon] - place, axis=1)
        for polygon, place in zip(polygons, positions, strict=True)
    ]
    to_points = _shortest_paths(graph, polygons, lengths, limit, progress)
    between = _between(to_points, places.faces, positions, polygons, lengths)
    if (joined != np.arange(len(points))).any():
        to_points = to_points[:, joined]
        islands = np.unique(islands[joined], return_inverse=True)[1]
    return Geodesics(to_points, between, positions, islands, faults)


def euclidean_distances(positions: FloatArray, points: FloatArray) -> Float32Array:
    """Return Euclidean distances from places to points: (places, points)."""
    out = np.empty((len(positions), len(points)), np.float32)
    for part in frame_blocks(len(positions), frames=_BLOCK_PLACES):
        out[part] = cdist(positions[part], points)
    return out


def _shortest_paths(
    graph: sparse.csr_array,
    polygons: list[IntArray],
    lengths: list[FloatArray],
    limit: float,
    progress: Progress,
) -> Float32Array:
    """Run Dijkstra from places, as nodes with directed edges to their face's corners.

    Directed, so that no path leads through another place.
    """
    count = graph.shape[0]
    out = np.empty((len(polygons), count), np.float32)
    for block in frame_blocks(len(polygons), frames=_BLOCK_PLACES):
        chosen = polygons[block]
        places = len(chosen)
        row = np.repeat(np.arange(places), [len(polygon) for polygon in chosen])
        value = np.maximum(np.concatenate(lengths[block]), 1e-9)
        joined = sparse.csr_array((value, (row, np.concatenate(chosen))), (places, count))
        whole: Any = sparse.block_array(
            [[graph, None], [joined, sparse.csr_array((places, places))]], format="csr"
        )
        starts = count + np.arange(places)
        out[block] = dijkstra(whole, indices=starts, limit=limit)[:, :count]
        progress(block.stop / len(polygons), "measuring distances along edges")
    return out


def _between(
    to_points: Float32Array,
    faces: IntArray,
    positions: FloatArray,
    polygons: list[IntArray],
    lengths: list[FloatArray],
) -> FloatArray:
    """Return the shortest distance by a corner of the place's face; straight on the same face."""
    entered = np.stack(
        [
            (to_points[:, polygon].astype(np.float64) + length).min(axis=1)
            for polygon, length in zip(polygons, lengths, strict=True)
        ],
        axis=1,
    )
    straight = cdist(positions, positions)
    entered = np.where(faces[:, None] == faces, straight, np.maximum(entered, straight))
    between: FloatArray = np.minimum(entered, entered.T)
    np.fill_diagonal(between, 0.0)
    return between


def _check_places(face_counts: IntArray, face_indices: IntArray, places: SurfacePoints) -> None:
    corners, weights = places.corners, places.weights
    starts = np.cumsum(face_counts) - face_counts
    for place in range(len(places.faces)):
        face = int(places.faces[place])
        if not 0 <= face < len(face_counts):
            raise ValueError(
                f"marker {place} sits on face {face} and the mesh has {len(face_counts)}; "
                "bind the markers to this mesh"
            )
        polygon = face_indices[starts[face] : starts[face] + face_counts[face]]
        if not np.isin(corners[place], polygon).all():
            raise ValueError(
                f"marker {place}: points {corners[place].tolist()} are not corners of face {face}"
            )
    valid = np.isfinite(weights).all(axis=1) & (weights.min(axis=1, initial=0) > -1e-4)
    off = np.flatnonzero(~valid | (np.abs(weights.sum(axis=1) - 1) > 1e-3))
    if len(off):
        raise ValueError(
            f"marker {off[0]} is not on its face: its weights {weights[off[0]].tolist()} must be "
            "0 or more with sum 1; bind it to the nearest place on the mesh"
        )
