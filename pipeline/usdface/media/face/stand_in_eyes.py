"""Stand-in eyeballs for a rig with lids and no eyes, so that the closure of lids can be judged.

Some face meshes end at the rims of the lids, and the eyes are in another asset. The stand-ins look
straight ahead and follow the skull; they are drawn, never written.
"""

from collections.abc import Sequence

import numpy as np
from scipy import sparse

from usdface.core.arrays import FloatArray, IntArray
from usdface.core.assets import RigMesh, point_slices
from usdface.media.face.mesh_topology import border_edges
from usdface.numerics.surface.surface_graph import connected_parts
from usdface.numerics.surface.triangulation import Sparse

_SHARE_OF_OPENING = 0.52  # radius over the width between the corners of the lids
_LEAST_BLINK = 0.10  # mean motion of a lid's rim in a blink over the largest motion
_OPENING = (0.05, 0.45)  # range of an eye hole's width over the face's
_CLEARANCE_SHARE = 0.02  # gap between ball and lids over the radius
_ANCHOR_COUNT = 64
_ROWS, _COLUMNS = 24, 48


def fit_stand_in_eyes(meshes: Sequence[RigMesh]) -> tuple[list[RigMesh], Sparse] | None:
    """Return eyeballs behind the two holes whose rims move in a blink; None without such a pair.

    Returns meshes at rest, named as eyes, and the matrix (ball points, points) that attaches them
    to the rig's points, exact under rigid motion of the head.
    """
    rest = np.concatenate([mesh.points for mesh in meshes])
    blink = np.concatenate([blink_offsets(mesh) for mesh in meshes])
    moved = np.linalg.norm(blink, axis=1)
    if not moved.any():
        return None
    holes = [
        hole
        for hole in _holes(meshes)
        if moved[hole].mean() > _LEAST_BLINK * moved.max()
        and _OPENING[0] < np.ptp(rest[hole, 0]) / np.ptp(rest[:, 0]) < _OPENING[1]
    ]
    if len(holes) != 2:
        return None
    balls = []
    for name, hole in zip(("standIn_eye_a", "standIn_eye_b"), holes, strict=True):
        radius = _SHARE_OF_OPENING * float(np.ptp(rest[hole, 0]))
        center = _behind_lids(rest, blink, moved, hole, radius=radius)
        balls.append(_ball(f"/{name}", center, radius))
    every = np.concatenate([ball.points for ball in balls])
    total = [np.zeros(len(mesh.points)) for mesh in meshes]
    for own, mesh in zip(total, meshes, strict=True):
        for shape in mesh.shapes:
            key = shape.keys[-1]
            own[key.points] += np.linalg.norm(key.offsets, axis=1)
    return balls, _hang(every, rest, np.concatenate(total))


def blink_offsets(mesh: RigMesh) -> FloatArray:
    """Return the displacement of each point by all blinks at 1: (points, 3) [mm]."""
    offsets = np.zeros_like(mesh.points, dtype=np.float64)
    for shape in mesh.shapes:
        if "blink" in shape.name.lower():
            offsets[shape.keys[-1].points] += shape.keys[-1].offsets
    return offsets


def _holes(meshes: Sequence[RigMesh]) -> list[IntArray]:
    """Return the points of each connected border, as indices into all meshes concatenated."""
    holes = list[IntArray]()
    for mesh, own in zip(meshes, point_slices(meshes), strict=True):
        border = border_edges(mesh)
        rim = np.unique(border)
        labels = connected_parts(np.searchsorted(rim, border), len(rim))
        holes += [own.start + rim[labels == hole] for hole in np.unique(labels)]
    return [hole for hole in holes if len(hole) >= 6]


def _behind_lids(
    rest: FloatArray, blink: FloatArray, moved: FloatArray, hole: IntArray, *, radius: float
) -> FloatArray:
    """Return the foremost centre at which no lid, open or shut, intersects the ball."""
    low, high = rest[hole].min(axis=0), rest[hole].max(axis=0)
    middle = (low + high) / 2
    near = np.linalg.norm((rest - middle)[:, :2], axis=1) < 1.1 * radius
    lids = np.union1d(np.flatnonzero(near & (moved > 0.1 * moved.max())), hole)
    swept = np.concatenate([rest[lids] + part * blink[lids] for part in (0.0, 0.33, 0.67, 1.0)])
    flat = np.linalg.norm((swept - middle)[:, :2], axis=1)
    inside = flat < 0.98 * radius
    front = np.sqrt(radius**2 - flat[inside] ** 2)
    # A percentile, because a few points on the inner side of the rim may intersect.
    depth = np.percentile(swept[inside, 2] - front, 4)
    return np.array([middle[0], middle[1], depth - _CLEARANCE_SHARE * radius])


def _ball(path: str, center: FloatArray, radius: float) -> RigMesh:
    down = np.linspace(0.02, np.pi - 0.02, _ROWS + 1)
    around = np.arange(_COLUMNS) * 2 * np.pi / _COLUMNS
    unit = np.stack(
        [
            np.sin(down)[:, None] * np.sin(around),
            np.broadcast_to(np.cos(down)[:, None], (_ROWS + 1, _COLUMNS)),
            np.sin(down)[:, None] * np.cos(around),
        ],
        axis=-1,
    )
    row, column = (grid.ravel() for grid in np.mgrid[:_ROWS, :_COLUMNS])
    right = (column + 1) % _COLUMNS
    above, below = row * _COLUMNS, (row + 1) * _COLUMNS
    quads = np.stack([above + column, below + column, below + right, above + right], axis=1)
    return RigMesh(
        path=path,
        points=center + radius * unit.reshape(-1, 3),
        face_counts=np.full(len(quads), 4, np.int64),
        face_indices=quads.ravel(),
    )


def _hang(balls: FloatArray, rest: FloatArray, moved: FloatArray) -> Sparse:
    """Return points as affine combinations of the points that the shapes move least."""
    still = np.argsort(moved, kind="stable")[: max(len(rest) // 10, min(len(rest), _ANCHOR_COUNT))]
    anchors = np.sort(still)[:: max(len(still) // _ANCHOR_COUNT, 1)]

    def affine(points: FloatArray) -> FloatArray:
        return np.column_stack(
            [(points - rest[anchors].mean(axis=0)) / 100.0, np.ones(len(points))]
        )

    shares = affine(balls) @ np.linalg.pinv(affine(rest[anchors]))
    rows = np.repeat(np.arange(len(balls)), len(anchors))
    columns = np.tile(anchors, len(balls))
    return sparse.csr_array((shares.ravel(), (rows, columns)), shape=(len(balls), len(rest)))
