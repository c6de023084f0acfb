"""The skin of a rig's face as samples in the face's own frame: what a placement searches.

The frame's axes are left, up and forward of the character; its origin is that of the rig.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import KDTree

from usdface.core.arrays import FloatArray, IntArray
from usdface.numerics.registration.outer_surface import facing_direction, sample_outer_surface
from usdface.numerics.registration.virtual_markers import Offsets, deltas_at, sparse_offsets

_ACTIVE_SHARE = 0.2
"""Of the largest displacement: skin that moves less is not used to find the plane of symmetry."""

_TRIMMED_SHARE = 0.8
"""Of mirrored samples: the others may have no partner (ears, hair)."""


@dataclass(frozen=True)
class FaceSkin:
    """Samples of the outer skin, with what every shape does to them."""

    corners: IntArray
    """(samples, 3): points of the rig that carry each sample."""
    shares: FloatArray
    """(samples, 3): their barycentric weights."""
    frame: FloatArray
    """(3, 3): rows are the character's left, up and forward; ``own = points @ frame.T``."""
    positions: FloatArray
    normals: FloatArray
    """`positions`, `normals`: (samples, 3): at rest, in the face's frame [mm]."""
    areas: FloatArray
    """(samples,): what each sample stands for [mm^2]."""
    deltas: FloatArray
    """(shapes, samples, 3): what each shape at 1 does, in the face's frame [mm]."""
    sagittal_x: float
    """Where the plane of symmetry lies: its normal is the X axis [mm]."""
    size_mm: float
    """Root mean square radius of what moves; 55 on an adult's face."""

    def activity(self) -> FloatArray:
        """Return how far the shapes move each sample, root of summed squares: (samples,) [mm]."""
        return np.asarray(np.sqrt((self.deltas**2).sum(axis=(0, 2))))

    def mirrored(self, points: FloatArray) -> FloatArray:
        """Return points of the face's frame reflected in its plane of symmetry."""
        return np.asarray(points * [-1.0, 1.0, 1.0] + [2 * self.sagittal_x, 0.0, 0.0])


def sample_face_skin(
    points: ArrayLike, triangles: ArrayLike, offsets: Offsets, *, sample_count: int = 12_000
) -> FaceSkin:
    """Sample the skin of a rig's face.

    Parameters
    ----------
    points : (points, 3) array
        At rest, Y up [mm].
    triangles : (triangles, 3) int array
    offsets : (shapes, points, 3) array or (shapes, 3 * points) sparse array
        What each shape at 1 does to the points [mm].
    sample_count : int
        About how many samples.

    Raises
    ------
    ValueError
        If the arrays do not fit together, no shape moves anything, or the direction of the face is
        undetermined.
    """
    rest, faces = np.asarray(points, float), np.asarray(triangles, np.int64)
    matrix = sparse_offsets(offsets, point_count=len(rest))
    squares = np.asarray(matrix.power(2).sum(axis=0), float).reshape(-1, 3).sum(axis=1)
    activity = np.sqrt(squares)
    facing = facing_direction(rest, faces, activity)
    left = np.cross([0.0, 1.0, 0.0], facing)
    frame = np.stack([left, [0.0, 1.0, 0.0], facing])
    skin = sample_outer_surface(
        rest, faces, facing=facing, activity=activity, sample_count=sample_count
    )
    corners, shares = skin.corners, skin.weights
    positions = skin.positions @ frame.T
    sides = rest[corners]
    normals = np.cross(sides[:, 1] - sides[:, 0], sides[:, 2] - sides[:, 0]) @ frame.T
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    deltas = deltas_at(matrix, corners, shares) @ frame.T
    moved = np.sqrt((deltas**2).sum(axis=(0, 2)))
    weight = moved / moved.sum()
    radius = np.sqrt(weight @ ((positions - weight @ positions) ** 2).sum(axis=1))
    return FaceSkin(
        corners,
        shares,
        frame,
        positions,
        normals,
        skin.areas,
        deltas,
        _sagittal_x(positions[moved > _ACTIVE_SHARE * moved.max()]),
        float(radius),
    )


def _sagittal_x(positions: FloatArray) -> float:
    """Find where the plane of symmetry lies, by trimmed closest points on the reflection."""
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
