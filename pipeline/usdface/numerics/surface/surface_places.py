"""Places on a polygon mesh: a face, and a weight for each of its corners.

With one weight per corner of the polygon, a place does not depend on the triangulation.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import KDTree

from usdface.core.arrays import FloatArray, IntArray
from usdface.numerics.surface.triangulation import triangulate


@dataclass(frozen=True)
class SurfacePoints:
    """Points on a mesh that follow its deformation."""

    faces: IntArray
    """(places,): polygon of each place."""
    corners: IntArray
    """(places, 3): three points of the polygon."""
    weights: FloatArray
    """(places, 3): barycentric, sum 1."""

    def positions(self, points: FloatArray) -> FloatArray:
        """Return the positions of the places: (places, 3), in the points' unit."""
        return np.asarray(np.einsum("pk,pkc->pc", self.weights, points[self.corners]))

    @classmethod
    def join(cls, parts: Sequence["SurfacePoints"]) -> "SurfacePoints":
        """Return the places of all parts, in their order."""
        columns = zip(*((each.faces, each.corners, each.weights) for each in parts), strict=True)
        return cls(*map(np.concatenate, columns))

    def select(self, rows: IntArray | list[int]) -> "SurfacePoints":
        """Return some of the places."""
        return SurfacePoints(self.faces[rows], self.corners[rows], self.weights[rows])

    def replaced(self, others: Mapping[int, "SurfacePoints"]) -> "SurfacePoints":
        """Return the places, with the single places of `others` in the rows of its keys."""
        faces, corners, weights = self.faces.copy(), self.corners.copy(), self.weights.copy()
        for row, place in others.items():
            faces[row], corners[row] = place.faces[0], place.corners[0]
            weights[row] = place.weights[0]
        return SurfacePoints(faces, corners, weights)

    def rounded(self) -> "SurfacePoints":
        """Return the places with weights that single precision holds, with sum 1, exactly."""
        first = np.floor(self.weights[:, :2] * 2**20) / 2**20
        return replace(self, weights=np.column_stack([first, 1 - first.sum(axis=1)]))


def places_at_points(
    face_counts: IntArray, face_indices: IntArray, chosen: IntArray
) -> SurfacePoints:
    """Return the places of points of the mesh, each on the first face that uses it.

    Parameters
    ----------
    face_counts : (faces,) int array
    face_indices : (corners,) int array
    chosen : (places,) int array
        Indices of points.
    """
    triangles, owners = triangulate(face_counts, face_indices)
    used, first = np.unique(triangles.ravel(), return_index=True)
    at = np.minimum(np.searchsorted(used, chosen), max(len(used) - 1, 0))
    unused = chosen if not len(used) else chosen[used[at] != chosen]
    if len(unused):
        raise ValueError(f"point {unused[0]} belongs to no face; choose a point of the surface")
    rows = first[at] // 3
    corners = triangles[rows].reshape(-1, 3)
    return SurfacePoints(owners[rows], corners, (corners == chosen[:, None]).astype(float))


def places_of_corners(
    face_counts: IntArray, face_indices: IntArray, corners: IntArray, weights: FloatArray
) -> SurfacePoints:
    """Return places given by three points of one polygon each, or by one point three times.

    Corners and barycentric weights are (places, 3).
    """
    triangles, owners = triangulate(face_counts, face_indices)
    near = np.flatnonzero(np.isin(triangles, corners).all(axis=1))
    row_of = {tuple(sorted(triangles[row].tolist())): row for row in near.tolist()}
    single = (corners == corners[:, :1]).all(axis=1)
    faces, found = np.zeros(len(corners), np.int64), corners.copy()
    shares = np.array(weights, float)
    if single.any():
        at_points = places_at_points(face_counts, face_indices, corners[single, 0])
        faces[single], found[single] = at_points.faces, at_points.corners
        shares[single] = at_points.weights
    for index in np.flatnonzero(~single).tolist():
        row = row_of.get(tuple(sorted(corners[index].tolist())))
        if row is None:
            raise ValueError(f"points {corners[index].tolist()} share no face of the mesh")
        faces[index] = owners[row]
    return SurfacePoints(faces, found, shares)


def nearest_places(
    points: FloatArray, face_counts: IntArray, face_indices: IntArray, wanted: FloatArray
) -> SurfacePoints:
    """Return the places of the surface nearest to given positions (places, 3)."""
    triangles, owners = triangulate(face_counts, face_indices)
    if not len(triangles):
        raise ValueError("the mesh has no face to place anything on")
    rows = np.zeros(len(wanted), np.int64)
    weights = np.zeros((len(wanted), 3))
    corners = points[triangles]
    middles = corners.mean(axis=1)
    # The surface is no farther than the nearest corner, which bounds the candidate triangles.
    reach = float(np.sqrt(((corners - middles[:, None]) ** 2).sum(axis=2).max()))
    bound, _ = KDTree(points[np.unique(triangles)]).query(wanted)
    found = KDTree(middles).query_ball_point(wanted, bound + reach + 1e-9)
    for index, candidates in enumerate(found):
        near = np.array(sorted(candidates), np.int64)
        shares, away = _closest_on_triangles(corners[near], wanted[index])
        best = int(away.argmin())
        rows[index], weights[index] = near[best], shares[best]
    return SurfacePoints(owners[rows], triangles[rows], weights)


def polygon_weights(
    places: SurfacePoints, face_counts: IntArray, face_indices: IntArray
) -> list[FloatArray]:
    """Return one weight per corner of each place's polygon, in the polygon's order."""
    starts = np.cumsum(face_counts) - face_counts
    out = []
    for face, corners, weights in zip(places.faces, places.corners, places.weights, strict=True):
        polygon = face_indices[starts[face] : starts[face] + face_counts[face]]
        shares = np.zeros(len(polygon))
        for corner, weight in zip(corners.tolist(), weights.tolist(), strict=True):
            shares[int(np.flatnonzero(polygon == corner)[0])] += weight
        out.append(shares)
    return out


def place_on_polygon(
    points: FloatArray,
    face_counts: IntArray,
    face_indices: IntArray,
    *,
    face: int,
    weights: FloatArray,
) -> SurfacePoints:
    """Return the place with given weights over a polygon's corners.

    Weights over more than three corners are projected to the polygon's triangles.
    """
    if not 0 <= face < len(face_counts):
        raise ValueError(f"there is no face {face}; the mesh has {len(face_counts)}")
    count = int(face_counts[face])
    start = int(face_counts[:face].sum())
    polygon = face_indices[start : start + count]
    if count < 3 or weights.shape != (count,):
        raise ValueError(f"face {face} has {count} corners and {weights.size} weights are given")
    if not np.isfinite(weights).all() or weights.min() < -1e-4 or abs(weights.sum() - 1) > 1e-3:
        raise ValueError(f"the weights on face {face} are not 0 or more with sum 1: {weights}")
    shares = np.maximum(weights, 0) / np.maximum(weights, 0).sum()
    used = np.flatnonzero(shares)
    for fan in triangulate(np.array([count]), np.arange(count))[0]:
        if set(used) <= set(fan.tolist()):
            return SurfacePoints(np.array([face]), polygon[fan][None], shares[fan][None])
    wanted = (shares @ points[polygon])[None]
    near = nearest_places(points, np.array([count]), polygon, wanted)
    return SurfacePoints(np.array([face]), near.corners, near.weights)


def _closest_on_triangles(
    triangles: FloatArray, wanted: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return barycentric weights (triangles, 3) and squared distances of the points closest to one.

    The projection to the plane where it lies inside, else the closest of those to the three sides.
    """
    a, b, c = (triangles[:, i] for i in range(3))
    ab, ac = b - a, c - a
    d00, d01, d11 = ((x * y).sum(-1) for x, y in ((ab, ab), (ab, ac), (ac, ac)))
    size = np.maximum(d00 * d11 - d01**2, 1e-300)
    ap = wanted - a
    d20, d21 = (ap * ab).sum(-1), (ap * ac).sum(-1)
    v, w = (d11 * d20 - d01 * d21) / size, (d00 * d21 - d01 * d20) / size
    inside = (v >= 0) & (w >= 0) & (v + w <= 1)
    best = np.stack([1 - v - w, v, w], axis=-1)
    away = np.where(inside, _squared(wanted, triangles, best), np.inf)
    for first, second in ((0, 1), (1, 2), (2, 0)):
        start, side = triangles[:, first], triangles[:, second] - triangles[:, first]
        along = ((wanted - start) * side).sum(-1)
        t = np.clip(along / np.maximum((side**2).sum(-1), 1e-300), 0, 1)
        shares = np.zeros((len(t), 3))
        shares[:, first], shares[:, second] = 1 - t, t
        squared = _squared(wanted, triangles, shares)
        closer = squared < away
        best = np.where(closer[:, None], shares, best)
        away = np.where(closer, squared, away)
    return best, away


def _squared(wanted: FloatArray, triangles: FloatArray, shares: FloatArray) -> FloatArray:
    foot = np.einsum("tk,tkc->tc", shares, triangles)
    return np.asarray(((wanted - foot) ** 2).sum(-1))
