"""Authored normals follow the surface."""

import numpy as np
from scipy.spatial.transform import Rotation

from tests.small_scan import small_scan
from usdface.numerics.surface.triangulation import (
    NormalTurner,
    normal_operator,
    triangulate,
    vertex_normals,
)


def _normals(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    return vertex_normals(points, triangles, normal_operator(triangles, point_count=len(points)))


def test_normals_turn_with_a_rigid_surface_but_for_spin() -> None:
    """Smooth normals turn exactly; authored ones turn as far as their surface's normal does."""
    scan = small_scan()
    turn = Rotation.from_rotvec([0.3, -0.2, 0.1]).as_matrix()
    triangles, _ = triangulate(scan.counts, scan.indices)
    smooth = _normals(scan.points, triangles)
    exact = NormalTurner(scan.points, scan.counts, scan.indices, smooth, per_corner=False)
    np.testing.assert_allclose(exact.turn(scan.points @ turn.T), smooth @ turn.T, atol=1e-9)


def test_a_surface_at_rest_keeps_its_normals() -> None:
    scan = small_scan()
    rng = np.random.default_rng(0)
    authored = rng.normal(size=(len(scan.indices), 3))
    authored /= np.linalg.norm(authored, axis=1, keepdims=True)
    turner = NormalTurner(scan.points, scan.counts, scan.indices, authored, per_corner=True)
    np.testing.assert_allclose(turner.turn(scan.points), authored, atol=1e-12)


def test_the_lean_of_a_normal_against_its_surface_is_kept() -> None:
    scan = small_scan()
    moved = scan.moved(1.0, 0.5, 1.0)
    authored = np.tile([0, 0.6, 0.8], (len(scan.points), 1))
    turner = NormalTurner(scan.points, scan.counts, scan.indices, authored, per_corner=False)
    triangles, _ = triangulate(scan.counts, scan.indices)
    lean = np.einsum("ij,ij->i", _normals(scan.points, triangles), authored)
    after = np.einsum("ij,ij->i", _normals(moved, triangles), turner.turn(moved))
    np.testing.assert_allclose(after, lean, atol=1e-9)
