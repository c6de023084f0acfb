"""Where a rig's points are at rest: mesh space through skinning into millimetres, Y up."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom, UsdSkel, Vt

from usdface.core.arrays import FloatArray
from usdface.usdio.units import column_matrix, transform_points


@dataclass(frozen=True)
class PlacedMesh:
    """A mesh at rest and the per-point linear maps that carry its shapes along."""

    points: FloatArray
    """(n, 3) [mm]"""
    linear: FloatArray
    """(n, 3, 3) or (3, 3): turns an offset in mesh space into ours; per point where skinning bends
    the mesh."""

    def offsets(self, points: NDArray[np.int64], offsets: FloatArray) -> FloatArray:
        """Turn offsets of some points from mesh space into millimetres, Y up."""
        if self.linear.ndim == 2:
            return np.asarray(offsets @ self.linear.T)
        return np.asarray(np.einsum("nij,nj->ni", self.linear[points], offsets))

    def normals(self, normals: FloatArray, points: NDArray[np.int64] | None = None) -> FloatArray:
        """Turn normals, or what is added to them, into our space; unit ones stay unit.

        Of the points given; of all by default.
        """
        linear = self.linear
        if linear.ndim == 3 and points is not None:
            linear = linear[points]
        volume = np.abs(np.linalg.det(linear))
        if not np.all(volume > 0):
            return normals  # a mesh that is flattened has no other
        # The inverse transpose keeps normals upright where a scale is not the same all ways.
        turn = np.linalg.inv(linear) * np.cbrt(volume)[..., None, None]
        if turn.ndim == 2:
            return np.asarray(normals @ turn)
        return np.asarray(np.einsum("nji,nj->ni", turn, normals))


class RestPose:
    """The skeletons of a SkelRoot at rest, resolved once for all its meshes."""

    def __init__(self, root: UsdSkel.Root, ours: FloatArray) -> None:
        self._root = root
        self._ours = ours
        self._transforms = UsdGeom.XformCache()

    @cached_property
    def _bindings(self) -> dict[str, tuple[UsdSkel.SkeletonQuery, UsdSkel.SkinningQuery]]:
        cache = UsdSkel.Cache()
        predicate = Usd.TraverseInstanceProxies()
        cache.Populate(self._root, predicate)
        found = {}
        for binding in cache.ComputeSkelBindings(self._root, predicate):
            query = cache.GetSkelQuery(binding.GetSkeleton())
            for target in binding.GetSkinningTargets():
                found[str(target.GetPrim().GetPath())] = (query, target)
        return found

    def place(self, prim: Usd.Prim, local: FloatArray) -> PlacedMesh:
        """Place the points of a mesh as UsdSkel does when no joint is animated."""
        query, target = self._bindings.get(str(prim.GetPath()), (None, None))
        if query and target and target.HasJointInfluences():
            skinned = _skin_at_rest(query, target, local)
            if skinned is not None:
                world = column_matrix(self._transforms.GetLocalToWorldTransform(query.GetPrim()))
                linear = self._ours @ world[:3, :3] @ skinned.linear
                return PlacedMesh(transform_points(world, skinned.points) @ self._ours.T, linear)
        world = column_matrix(self._transforms.GetLocalToWorldTransform(prim))
        return PlacedMesh(transform_points(world, local) @ self._ours.T, self._ours @ world[:3, :3])


def _skin_at_rest(
    query: UsdSkel.SkeletonQuery, target: UsdSkel.SkinningQuery, local: FloatArray
) -> PlacedMesh | None:
    """Skin points in skeleton space at the rest pose; None where the binding is incomplete."""
    rest = query.ComputeJointSkelTransforms(Usd.TimeCode.Default(), atRest=True)
    bind = query.GetJointWorldBindTransforms()
    if not rest or not bind or len(rest) != len(bind):
        return None
    skinning = Vt.Matrix4dArray([b.GetInverse() * r for b, r in zip(bind, rest, strict=True)])
    mapper = target.GetJointMapper()
    if mapper and not mapper.IsIdentity():
        skinning = mapper.RemapTransforms(skinning)

    def skin(points: FloatArray) -> FloatArray | None:
        moved = Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(points, dtype=np.float32))
        if not target.ComputeSkinnedPoints(skinning, moved, Usd.TimeCode.Default()):
            return None
        return np.array(moved, dtype=np.float64)

    placed = skin(local)
    if placed is None:
        return None
    # Linear blend skinning is affine in each point: its linear part, column by column, is what
    # a unit step along each axis does. Steps as large as the mesh keep float32 honest.
    size = max(float(np.ptp(local, axis=0).max()), 1e-6) if len(local) else 1.0
    columns = []
    for axis in np.eye(3):
        stepped = skin(local + size * axis)
        if stepped is None:
            return None
        columns.append((stepped - placed) / size)
    linear = np.stack(columns, axis=-1)
    if len(linear) and np.allclose(linear, linear[0], atol=1e-6):
        exact = np.round(linear.mean(axis=0), 6)
        if np.array_equal(exact, np.eye(3)):
            return PlacedMesh(placed, np.eye(3))
    return PlacedMesh(placed, linear)
