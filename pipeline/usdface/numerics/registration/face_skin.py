"""Samples of the outer skin of a rig's face, in the face's frame.

The frame's axes are left, up and forward of the character; its origin is that of the rig. The outer
skin is what cameras in front of the face see, by depth buffers: it excludes the inside of the
mouth, eyeballs, teeth and the back of the head, whatever the parts are called.
"""

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.spatial import KDTree

from usdface.core.arrays import BoolArray, Float32Array, FloatArray, IntArray, RealArray, rms_radius
from usdface.core.last_result import cache_last_result
from usdface.numerics.registration.virtual_markers import deltas_at
from usdface.numerics.rigid.rigid_alignment import align_rigid, alignment_residuals
from usdface.numerics.surface.surface_graph import connected_parts
from usdface.numerics.surface.triangulation import triangle_areas, triangle_normals

_SAMPLE_COUNT = 12_000  # about 2 mm apart on a face
_DEPTH_PIXELS = 200  # over the larger side: about 1.3 mm on a head
_DEPTH_TOLERANCE = 0.012  # of the larger side: folds of lids and lips pass, the mouth's inside not
_VIEWS_DEGREES = ((0, 0), (-30, 0), (30, 0), (-55, 0), (55, 0), (0, 20), (0, -30))  # yaw, pitch
_REACH_RADII = 3.2  # [RMS radii of the moving part]: ear to ear and hairline to throat
_SKIN_SHARE = 0.2  # of the largest visible piece: eyeballs, teeth and lashes are smaller


@dataclass(frozen=True)
class SurfaceSamples:
    """Points spread over the skin, densest where it moves."""

    corners: IntArray
    """(samples, 3): the triangle's points."""
    weights: FloatArray
    """(samples, 3): barycentric, sum 1."""
    positions: FloatArray
    """(samples, 3) [mm]"""
    areas: FloatArray
    """(samples,): area that each represents [mm^2]; smaller where the face moves much."""


def facing_direction(points: FloatArray, triangles: IntArray, activity: FloatArray) -> FloatArray:
    """Return the horizontal unit vector along which a face looks.

    It points from the centroid of the head to that of the part which the shapes move; on a mask
    without a back of the head, the winding of the triangles decides.

    Parameters
    ----------
    points : (points, 3) float array
        Y up.
    triangles : (triangles, 3) int array
    activity : (points,) float array
        Displacement of each point by the shapes.
    """
    a, corners = activity[triangles].mean(axis=1), points[triangles]
    cross = triangle_normals(points, triangles)
    area = np.linalg.norm(cross, axis=1) / 2
    if not (a * area).sum() > 0:
        raise ValueError("the shapes move no part of the surface; check that it is the face's mesh")
    middle = corners.mean(axis=1)
    size = float(np.ptp(corners.reshape(-1, 3), axis=0).max())
    ahead = np.average(middle, axis=0, weights=a * area) - np.average(middle, axis=0, weights=area)
    facing = np.array([ahead[0], 0, ahead[2]]) / (0.1 * size)
    outward = np.einsum("ij,i->j", cross, a) / (2 * (a * area).sum())
    facing += np.array([outward[0], 0, outward[2]])
    length = float(np.linalg.norm(facing))
    if length < 1e-3:
        raise ValueError("the face's direction is not determined by its shapes; name landmarks")
    return facing / length


def sample_outer_surface(
    points: FloatArray, triangles: IntArray, *, facing: FloatArray, activity: FloatArray
) -> SurfaceSamples:
    """Sample the skin of the face that is visible from the front.

    Parameters
    ----------
    points : (points, 3) float array
        Y up.
    triangles : (triangles, 3) int array
        Either winding.
    facing : (3,) float array
        Horizontal direction along which the face looks.
    activity : (points,) float array
        Displacement of each point by the shapes. Pieces that hardly move (eyeballs) and parts far
        from all movement (shoulders, the crown) are left out.
    """
    P, T = points, triangles
    middle, weight = P[T].mean(axis=1), activity[T].mean(axis=1) * triangle_areas(P, T)
    centre = np.average(middle, axis=0, weights=weight)
    distance = np.linalg.norm(middle - centre, axis=1)
    T = T[distance < _REACH_RADII * np.sqrt(np.average(distance**2, weights=weight))]
    density = 0.3 + activity[T].mean(axis=1) / activity.max()
    dense, weights, owner = _low_discrepancy_samples(P, T, density, count=3 * _SAMPLE_COUNT)
    frame = np.stack([np.cross([0.0, 1.0, 0.0], facing), [0.0, 1.0, 0.0], facing])
    visible = _visible_from_front((dense - P.mean(axis=0)) @ frame.T)
    visible &= _on_skin(P, T, owner, visible, activity)
    if not visible.any():
        raise ValueError("no part of the surface is visible from the front; check its facing")
    chosen = np.flatnonzero(visible)
    chosen = chosen[:: max(1, round(len(chosen) / _SAMPLE_COUNT))]
    share = 1 / density[owner[chosen]]
    areas = share * (triangle_areas(P, T).sum() * visible.mean() / share.sum())
    return SurfaceSamples(T[owner[chosen]], weights[chosen], dense[chosen], areas)


def _low_discrepancy_samples(
    P: FloatArray, T: IntArray, density: FloatArray, *, count: int
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Sample triangles in proportion to area times density, deterministically.

    Every n-th of the points is evenly spread as well.
    """
    steps = np.arange(1, count + 1)
    # R3 sequence (Roberts 2018): additive recurrence on powers of the root of x^4 = x + 1
    u, v, along = (np.modf(0.5 + steps * g)[0] for g in (0.8191725134, 0.6710436067, 0.5497004779))
    ends = np.cumsum(triangle_areas(P, T) * density)
    owner = np.minimum(np.searchsorted(ends, along * ends[-1], side="right"), len(T) - 1)
    fold = u + v > 1
    u, v = np.where(fold, 1 - u, u), np.where(fold, 1 - v, v)
    weights = np.stack([1 - u - v, u, v], axis=1)
    return np.einsum("nk,nkc->nc", weights, P[T[owner]]), weights, owner


def _visible_from_front(q: FloatArray) -> BoolArray:
    """Return which points are foremost in a depth buffer of some view; the face looks along +Z."""
    size = float(np.ptp(q, axis=0).max())
    visible = np.zeros(len(q), bool)
    for yaw, pitch in np.deg2rad(_VIEWS_DEGREES):
        toward = np.array([np.sin(yaw) * np.cos(pitch), np.sin(pitch), np.cos(yaw) * np.cos(pitch)])
        across = np.array([np.cos(yaw), 0.0, -np.sin(yaw)])
        plane = np.stack([q @ across, q @ np.cross(toward, across)], axis=1)
        pixel = np.floor((plane - plane.min(axis=0)) / size * _DEPTH_PIXELS).astype(np.int64)
        flat = pixel[:, 0] * (2 * _DEPTH_PIXELS) + pixel[:, 1]
        depth = q @ toward
        front = np.full(int(flat.max()) + 1, -np.inf)
        np.maximum.at(front, flat, depth)
        visible |= depth > front[flat] - _DEPTH_TOLERANCE * size
    return visible


def _on_skin(
    P: FloatArray, T: IntArray, owner: IntArray, visible: BoolArray, activity: FloatArray
) -> BoolArray:
    """Return which samples lie on a large connected part that moves, coincident points welded."""
    size = float(np.ptp(P, axis=0).max())
    _, weld = np.unique(np.round(P / (1e-5 * size)), axis=0, return_inverse=True)
    weld = weld.ravel()
    edges = np.concatenate([T[:, [0, 1]], T[:, [1, 2]]])
    piece = connected_parts(weld[edges], int(weld.max()) + 1)[weld]
    count = int(piece.max()) + 1
    visible_count = np.bincount(piece[T[owner[visible], 0]], minlength=count).astype(float)
    moved = np.zeros(count)
    np.maximum.at(moved, piece, activity)
    visible_count[moved < 0.1 * moved.max()] = 0
    large = visible_count >= _SKIN_SHARE * visible_count.max()
    return large[piece[T[owner, 0]]]


TYPICAL_SIZE_MM = 55.0
"""Root mean square radius of an adult's moving face."""

_ACTIVE_SHARE = 0.2
"""[of the largest displacement] Skin that moves less does not count for the plane of symmetry."""

_TRIMMED_SHARE = 0.8
"""[of the mirrored samples] The others may have no partner (ears, hair)."""


@dataclass(frozen=True)
class FaceSkin:
    """Samples of the outer skin, and their displacements by every shape, at an adult's size.

    Lengths that are stated on an adult's face so apply to rigs of any size.
    """

    corners: IntArray
    """(samples, 3): corners of each sample's triangle, as points of the rig."""
    shares: FloatArray
    """(samples, 3): their barycentric weights."""
    frame: FloatArray
    """(3, 3): rows are the character's left, up and forward."""
    unit: float
    """Size of the rig's face over an adult's, `TYPICAL_SIZE_MM`."""
    positions: FloatArray
    normals: FloatArray
    """`positions`, `normals`: (samples, 3): at rest, in the face's frame [mm]; see `to_frame`."""
    areas: FloatArray
    """(samples,): area that each represents [mm^2]."""
    deltas: Float32Array
    """(shapes, samples, 3): displacements by each shape in full, in the face's frame [mm]; 0 by
    those that carry the head or hide a part."""
    sagittal_x: float
    """Offset of the plane of symmetry along its normal, the X axis [mm]."""

    def to_frame(self, points: RealArray) -> FloatArray:
        """Return points or displacements of the rig, (..., 3), in the face's frame."""
        return np.asarray(points @ self.frame.T / self.unit, np.float64)

    def from_frame(self, points: RealArray) -> FloatArray:
        """Return points or displacements in the face's frame, (..., 3), in the rig's space."""
        return np.asarray(self.unit * (points @ self.frame), np.float64)

    def activity(self) -> FloatArray:
        """Return the root of the summed squared displacements of each sample: (samples,) [mm]."""
        return _activity(self.deltas)

    def mirrored(self, points: FloatArray) -> FloatArray:
        """Return points of the face's frame reflected in its plane of symmetry."""
        return points * [-1.0, 1.0, 1.0] + [2 * self.sagittal_x, 0.0, 0.0]


@cache_last_result
def sample_face_skin(points: FloatArray, triangles: IntArray, offsets: sparse.sparray) -> FaceSkin:
    """Sample the skin of a rig's face.

    Parameters
    ----------
    points : (points, 3) array
        At rest, Y up [mm].
    triangles : (triangles, 3) int array
    offsets : (shapes, 3 * points) sparse array
        Displacements by each shape in full [mm].
    """
    matrix = sparse.csc_array(offsets)
    deform = _shapes_that_deform(points, triangles, matrix.tocsr())
    if not deform.all():
        matrix = sparse.csc_array(sparse.diags_array(deform * 1.0) @ matrix)
    squares = np.asarray(matrix.power(2).sum(axis=0), float).reshape(-1, 3).sum(axis=1)
    activity = np.sqrt(squares)
    facing = facing_direction(points, triangles, activity)
    left = np.cross([0.0, 1.0, 0.0], facing)
    frame = np.stack([left, [0.0, 1.0, 0.0], facing])
    skin = sample_outer_surface(points, triangles, facing=facing, activity=activity)
    corners, shares = skin.corners, skin.weights
    normals = triangle_normals(points, corners) @ frame.T
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    # Each axis of a shape is contiguous, as placements multiply axis by axis.
    by_axis = deltas_at(matrix, corners, shares, axes=frame).astype(np.float32).toarray()
    deltas = np.moveaxis(by_axis.reshape(len(by_axis), 3, -1), 1, 2)
    moved = _activity(deltas)
    unit = rms_radius(skin.positions, moved) / TYPICAL_SIZE_MM
    deltas /= np.float32(unit)
    positions = skin.positions @ frame.T / unit
    return FaceSkin(
        corners,
        shares,
        frame,
        unit,
        positions,
        normals,
        skin.areas / unit**2,
        deltas,
        _sagittal_x(positions[moved > _ACTIVE_SHARE * moved.max()]),
    )


def _activity(deltas: Float32Array) -> FloatArray:
    total = np.zeros(deltas.shape[1])
    for shape in deltas:  # one at a time: their squares stay in the cache
        total += (shape**2).sum(axis=1, dtype=np.float64)
    return np.sqrt(total)


_CARRIED_SHARE = 0.85
"""[of the squared displacements] Rigid share from which a shape carries the head: jaws have up to
0.82 over the skin that they move, turns and nods that fade over the neck 0.91 or more."""

_MOVED_SHARE = 0.02
"""[of a shape's largest displacement] Smaller displacements are neglected."""


def _shapes_that_deform(
    points: FloatArray, triangles: IntArray, offsets: sparse.csr_array
) -> BoolArray:
    """Return the shapes that neither carry the head nor move points farther than its size.

    All shapes if no other is left.
    """
    areas = np.repeat(triangle_areas(points, triangles) / 3, 3)
    area = np.bincount(triangles.ravel(), areas, minlength=len(points))
    most = np.asarray(abs(offsets).max(axis=1).toarray()).ravel()
    moved, point = np.zeros(len(points), np.bool_), offsets.indices // 3
    large = np.abs(offsets.data) > _MOVED_SHARE * np.repeat(most, np.diff(offsets.indptr))
    moved[point[large]] = True
    rest, weights = points[moved], area[moved]
    deform = most <= (np.ptp(rest, axis=0).max() if len(rest) else 0.0)
    own_area = np.where(moved, area, 0.0)[point], offsets.indices, offsets.indptr
    most_area = sparse.csr_array(own_area, shape=offsets.shape).sum(axis=1)  # by each coordinate
    wide = 2 * most_area > weights.sum()
    for row in np.flatnonzero(deform & wide).tolist():
        step = offsets[[row]].toarray().reshape(-1, 3)[moved]
        square = (step**2).sum(axis=1)
        if 2 * weights[square > (_MOVED_SHARE * most[row]) ** 2].sum() > weights.sum():
            rigid = align_rigid((rest + step)[None], rest, weights=weights[None])
            left = alignment_residuals((rest + step)[None], rest, rigid)[0]
            deform[row] = weights @ left**2 > (1 - _CARRIED_SHARE) * (weights @ square)
    return deform if deform.any() else ~deform


def _sagittal_x(positions: FloatArray) -> float:
    """Fit the offset of the plane of symmetry by trimmed closest points on the reflection."""
    x = float(positions[:, 0].min() + positions[:, 0].max()) / 2
    tree = KDTree(positions)
    for _ in range(20):
        reflected = positions * [-1.0, 1.0, 1.0] + [2 * x, 0.0, 0.0]
        away, near = tree.query(reflected)
        close = away <= np.quantile(away, _TRIMMED_SHARE)
        step = 0.5 * float(np.median((positions[near] - reflected)[close, 0]))
        x += step
        if abs(step) < 1e-3:
            break
    return x
