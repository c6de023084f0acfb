"""A polygon mesh as a graph of straight segments, and its defects."""

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from usdface.core.arrays import FloatArray, IntArray
from usdface.numerics.surface.triangulation import polygon_edges, triangulate

_MOST_CORNERS = 8
"""Corners of a polygon up to which all its diagonals are used. In larger ones, only those of its
triangles: the others are many and, on a bent face, off the surface."""


@dataclass(frozen=True)
class MeshFaults:
    """Defects of a mesh; counted, never repaired."""

    nonmanifold_edges: int = 0
    """Edges with more than two faces; paths may use them."""
    degenerate_faces: int = 0
    """Faces that use a point twice or have fewer than three corners."""


def check_surface(points: FloatArray, face_counts: IntArray, face_indices: IntArray) -> None:
    """Check that arrays are a polygon mesh."""
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"points must be (points, 3), got {points.shape}; one rest pose, not many")
    if not len(face_counts):
        raise ValueError("the mesh has no face; distances over it need a surface")
    bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if len(bad):
        raise ValueError(
            f"{len(bad)} of {len(points)} points are not finite, the first is {bad[0]}; "
            "repair the mesh"
        )
    if face_counts.min() < 0 or face_counts.sum() != len(face_indices):
        raise ValueError(
            f"face counts add up to {face_counts.sum()} corners and {len(face_indices)} are given"
        )
    if len(face_indices) and not 0 <= face_indices.min() <= face_indices.max() < len(points):
        raise ValueError(
            f"faces use points {face_indices.min()} to {face_indices.max()} of {len(points)}"
        )


def surface_segments(
    face_counts: IntArray, face_indices: IntArray, *, diagonals: bool
) -> tuple[IntArray, MeshFaults]:
    """Return the pairs of points that a path may join directly: edges, and diagonals if wanted.

    Parameters
    ----------
    face_counts, face_indices : int arrays
        Polygons as USD stores them.
    diagonals : bool
        Whether paths may also cross a polygon from corner to corner.

    Returns
    -------
    segments : (segments, 2) int array
        Each once, the lower point first.
    faults : MeshFaults
    """
    starts = np.cumsum(face_counts) - face_counts
    edges, crossings = [], []
    degenerate = int((face_counts < 3).sum())
    for count in np.unique(face_counts[face_counts >= 3]).tolist():
        polygons = face_indices[starts[face_counts == count][:, None] + np.arange(count)]
        in_order = np.sort(polygons, axis=1)
        degenerate += int((in_order[:, 1:] == in_order[:, :-1]).any(axis=1).sum())
        edges.append(np.stack([polygons, np.roll(polygons, -1, axis=1)], axis=2).reshape(-1, 2))
        if diagonals and 3 < count <= _MOST_CORNERS:
            a, b = np.triu_indices(count, 2)
            crossings.append(np.stack([polygons[:, a], polygons[:, b]], axis=2).reshape(-1, 2))
    if diagonals and (face_counts > _MOST_CORNERS).any():
        triangles, _ = triangulate(face_counts, face_indices)
        crossings.append(triangles[:, [0, 2]])
    points = int(face_indices.max(initial=0)) + 1
    segments, face_count = _unique_pairs(
        np.concatenate(edges or [np.zeros((0, 2), np.int64)]), points
    )
    if crossings:
        segments, _ = _unique_pairs(np.concatenate([segments, *crossings]), points)
    return segments, MeshFaults(int((face_count > 2).sum()), degenerate)


def _unique_pairs(pairs: IntArray, points: int) -> tuple[IntArray, IntArray]:
    """Return distinct pairs, the lower point first, in order, and their counts."""
    low, high = pairs.min(axis=1), pairs.max(axis=1)
    distinct = low != high
    # One number per pair: np.unique over rows takes ten times as long.
    keys, counts = np.unique(low[distinct] * points + high[distinct], return_counts=True)
    return np.stack([keys // points, keys % points], axis=1), counts


def surface_graph(
    points: FloatArray, face_counts: IntArray, face_indices: IntArray, *, diagonals: bool
) -> tuple[sparse.csr_array, IntArray, MeshFaults]:
    """Build the graph of a mesh for shortest paths (W06, "Geodesic manifold distances").

    Points at the same position are two points: closed lips touch, but are far apart on the surface.
    See `join_parts`.

    Parameters
    ----------
    points : (points, 3) float array
        [mm]
    face_counts, face_indices : int arrays
        Polygons as USD stores them.
    diagonals : bool
        Whether paths may cross polygons. On quads, edges alone overestimate distances by 13 to
        25 %, edges and diagonals by about 5 %.

    Returns
    -------
    graph : (points, points) sparse array
        Symmetric; lengths [mm], at least 1e-9 mm, since 0 means that there is no edge.
    islands : (points,) int array
        Connected part of each point.
    faults : MeshFaults
    """
    check_surface(points, face_counts, face_indices)
    segments, faults = surface_segments(face_counts, face_indices, diagonals=diagonals)
    lengths = np.linalg.norm(points[segments[:, 0]] - points[segments[:, 1]], axis=1)
    lengths = np.maximum(lengths, 1e-9)
    both = np.concatenate([segments, segments[:, ::-1]])
    graph = sparse.csr_array(
        (np.concatenate([lengths, lengths]), (both[:, 0], both[:, 1])), (len(points), len(points))
    )
    return graph, connected_parts(segments, len(points)), faults


def join_parts(points: FloatArray, face_counts: IntArray, face_indices: IntArray) -> IntArray:
    """Find the points that exporters duplicate where texture coordinates or normals are split.

    These are ends of open edges of different parts, at the same positions. Edges of one part are
    not joined, since closed lips without an inner mouth touch like this, unless the cut has a
    single point on each side: a corner of a face that has a copy of its own.

    Returns
    -------
    joined : (points,) int array
        The first point that each one is a copy of; most often the point itself.
    """
    check_surface(points, face_counts, face_indices)
    edges, used = _unique_pairs(polygon_edges(face_counts, face_indices), len(points))
    parts = connected_parts(edges, len(points))
    edges = edges[used == 1]
    ends, corners = np.unique(edges, return_inverse=True)
    _, position = np.unique(points[ends], axis=0, return_inverse=True)
    at = position.ravel()[corners.reshape(edges.shape)]
    turned = at[:, 0] > at[:, 1]
    edges[turned], at[turned] = edges[turned, ::-1], at[turned, ::-1]
    order = np.lexsort((at[:, 1], at[:, 0]))
    edges, at = edges[order], at[order]
    touching = (at[1:] == at[:-1]).all(axis=1)
    other_part = (parts[edges[1:, 0]] != parts[edges[:-1, 0]])[touching]
    one, two = edges[:-1][touching], edges[1:][touching]
    apart = one != two  # ends
    longer = np.union1d(one[apart.all(axis=1)], two[apart.all(axis=1)])
    within_cuts = np.isin(one, longer) | np.isin(two, longer)
    joined = other_part[:, None] | (apart & ~within_cuts)
    pairs = np.stack([one[joined], two[joined]], axis=1)
    copies = connected_parts(pairs, len(points))
    return np.asarray(np.unique(copies, return_index=True)[1][copies])


def connected_parts(pairs: IntArray, points: int) -> IntArray:
    """Return the connected part of each point, given pairs (n, 2) of joined ones: (points,)."""
    graph = sparse.coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), (points, points))
    return np.asarray(connected_components(graph, directed=False)[1], np.int64)
