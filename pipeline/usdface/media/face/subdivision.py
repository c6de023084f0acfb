"""Catmull-Clark subdivision as a matrix.

The matrix depends on the topology only: posing the fine mesh is one sparse product.
"""

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from usdface.core.arrays import FloatArray, IntArray
from usdface.numerics.surface.triangulation import Sparse, following_corners


@dataclass(frozen=True)
class Subdivision:
    """A finer mesh over the same surface."""

    matrix: Sparse
    """(fine points, points): fine points = matrix @ points; those of the cage's points first."""
    face_counts: IntArray
    """(fine faces,): all 4."""
    face_indices: IntArray
    """(4 * fine faces,)"""
    parents: IntArray
    """(fine faces,): cage polygon of each fine face."""


def catmull_clark(
    face_counts: IntArray, face_indices: IntArray, *, point_count: int
) -> Subdivision:
    """Return one step of Catmull-Clark subdivision, with creases along borders.

    Border edges are creases, and a border point of a single face is fixed: USD's
    ``interpolateBoundary = edgeAndCorner``. Polygons of fewer than three corners are ignored.

    References
    ----------
    Catmull and Clark (1978), Computer-Aided Design 10(6), 350-355.
    """
    face_of_corner = np.repeat(np.arange(len(face_counts)), face_counts)
    kept = face_counts[face_of_corner] >= 3
    kept_faces = np.flatnonzero(face_counts >= 3)
    counts = face_counts[kept_faces]
    points = face_indices[kept]
    faces = np.repeat(np.arange(len(counts)), counts)
    following = following_corners(counts)
    pairs = np.sort(np.stack([points, points[following]], axis=1), axis=1)
    edges, edge_of_corner = np.unique(pairs, axis=0, return_inverse=True)
    edge_of_corner = edge_of_corner.reshape(-1)

    # (f,) face points: the mean of the corners.
    face_matrix = _matrix(1.0 / counts[faces], faces, points, (len(counts), point_count))
    edge_matrix = _edge_points(edges, edge_of_corner, faces, face_matrix, point_count)
    point_matrix = _moved_points(edges, edge_of_corner, faces, points, face_matrix, point_count)

    first_edge, first_face = point_count, point_count + len(edges)
    previous = np.empty_like(following)
    previous[following] = np.arange(len(points))
    quads = np.stack(
        [
            points,
            first_edge + edge_of_corner,
            first_face + faces,
            first_edge + edge_of_corner[previous],
        ],
        axis=1,
    )
    return Subdivision(
        matrix=sparse.csr_array(sparse.vstack([point_matrix, edge_matrix, face_matrix])),
        face_counts=np.full(len(quads), 4, np.int64),
        face_indices=quads.ravel(),
        parents=kept_faces[faces],
    )


def _edge_points(
    edges: IntArray,
    edge_of_corner: IntArray,
    faces: IntArray,
    face_matrix: Sparse,
    point_count: int,
) -> Sparse:
    """Edge points: mean of both ends and both face points inside, of the ends on a border."""
    inside = np.bincount(edge_of_corner, minlength=len(edges)) == 2
    rows = np.repeat(np.arange(len(edges)), 2)
    ends = np.where(inside, 0.25, 0.5)
    own = _matrix(np.repeat(ends, 2), rows, edges.ravel(), (len(edges), point_count))
    touching = _matrix(
        np.where(inside[edge_of_corner], 0.25, 0.0),
        edge_of_corner,
        faces,
        (len(edges), face_matrix.shape[0]),
    )
    return own + touching @ face_matrix


def _moved_points(
    edges: IntArray,
    edge_of_corner: IntArray,
    faces: IntArray,
    points: IntArray,
    face_matrix: Sparse,
    point_count: int,
) -> Sparse:
    """Vertex points: (Q + 2R + (n - 3)S) / n inside, (e1 + 6S + e2) / 8 on a border, or S."""
    border_edges = edges[np.bincount(edge_of_corner, minlength=len(edges)) != 2]
    border_degree = np.bincount(border_edges.ravel(), minlength=point_count)
    faces_about = np.bincount(points, minlength=point_count)
    inside = (border_degree == 0) & (faces_about > 2)
    smooth_border = (border_degree == 2) & (faces_about > 1)

    valence = np.maximum(faces_about, 1).astype(np.float64)
    share = np.where(inside, 1 / valence**2, 0.0)
    # R is the mean of the edge midpoints, half of which is the point itself.
    ends = np.concatenate([edges[:, 0], edges[:, 1]])
    others = np.concatenate([edges[:, 1], edges[:, 0]])
    shape = (point_count, point_count)
    over_edges = _matrix(share[ends], ends, others, shape)
    over_faces = _matrix(share[points], points, faces, (point_count, face_matrix.shape[0]))
    border_ends = border_edges.ravel()
    border_others = border_edges[:, ::-1].ravel()
    over_border = _matrix(
        np.where(smooth_border[border_ends], 0.125, 0.0), border_ends, border_others, shape
    )
    keep = np.where(inside, (valence - 2) / valence, np.where(smooth_border, 0.75, 1.0))
    own = _matrix(keep, np.arange(point_count), np.arange(point_count), shape)
    return own + over_edges + over_faces @ face_matrix + over_border


def _matrix(
    values: FloatArray, rows: IntArray, columns: IntArray, shape: tuple[int, int]
) -> Sparse:
    return sparse.csr_array((values, (rows, columns)), shape=shape)
