"""Distances over a mesh by the heat method: Crane, Weischedel and Wardetzky (2013).

The solver (potpourri3d) takes one connected mesh and starts from points. So each island is solved
by itself, and a place inside a face is the weighted mean of its corners' distances, which is exact
to second order; where it is not, at the face's own corners, the caller knows the straight line.
"""

import numpy as np
import potpourri3d

from usdface.core.arrays import Float32Array, FloatArray, IntArray
from usdface.core.progress import Progress, silent
from usdface.numerics.surface.triangulation import triangulate


def heat_distances(
    points: FloatArray,
    face_counts: IntArray,
    face_indices: IntArray,
    *,
    islands: IntArray,
    corners: IntArray,
    weights: FloatArray,
    progress: Progress = silent,
) -> Float32Array:
    """Measure from places to points by the heat method.

    Parameters
    ----------
    points : (points, 3) float array
    face_counts, face_indices : int arrays
        Non-manifold edges are allowed; faces of no area are left out.
    islands : (points,) int array
        Connected piece of each point.
    corners : (places, 3) int array
    weights : (places, 3) float array
    progress : callable

    Returns
    -------
    (places, points) float32 array
        In the points' unit; infinite where no path leads.

    Raises
    ------
    ValueError
        If the solver cannot factorise the mesh.
    """
    triangles, _ = triangulate(face_counts, face_indices)
    triangles = triangles[_areas(points, triangles) > 0]
    out = np.full((len(corners), len(points)), np.inf, np.float32)
    island_of_place = islands[corners[:, 0]]
    done, wanted = 0, int(np.count_nonzero(weights))
    for island in np.unique(island_of_place).tolist():
        places = np.flatnonzero(island_of_place == island)
        own = triangles[islands[triangles[:, 0]] == island]
        inside = np.unique(own)
        if not len(own) or not np.isin(corners[places], inside).all():
            raise ValueError(
                f"marker {places[0]} sits where the mesh has no area; use metric 'dijkstra'"
            )
        local = np.full(len(points), -1)
        local[inside] = np.arange(len(inside))
        solver = _factorise(points[inside], local[own])
        rows: FloatArray = np.zeros((len(places), len(inside)))
        starts, which = np.unique(corners[places], return_inverse=True)
        share = np.zeros((len(places), len(starts)))
        np.add.at(share, (np.arange(len(places))[:, None], which.reshape(-1, 3)), weights[places])
        for column in np.flatnonzero(share.any(axis=0)).tolist():
            distance = np.asarray(solver.compute_distance(int(local[starts[column]])))
            distance -= distance.min()
            for each in np.flatnonzero(share[:, column]).tolist():
                rows[each] += share[each, column] * distance
            done += 1
            progress(min(done / wanted, 1.0), "measuring distances by heat")
        for place, row in zip(places, rows, strict=True):
            out[place, inside] = row
    return out


def _factorise(points: FloatArray, triangles: IntArray) -> potpourri3d.MeshHeatMethodDistanceSolver:
    try:
        return potpourri3d.MeshHeatMethodDistanceSolver(points, triangles, use_robust=True)
    except (RuntimeError, ValueError) as error:
        raise ValueError(
            f"the heat method cannot solve this mesh ({error}); use metric 'dijkstra-diagonals'"
        ) from error


def _areas(points: FloatArray, triangles: IntArray) -> FloatArray:
    a, b, c = (points[triangles[:, i]] for i in range(3))
    areas: FloatArray = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return areas
