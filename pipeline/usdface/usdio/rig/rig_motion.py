"""How joints and Xforms of a performance carry the points of its rig, beside its shapes.

A point p of the rig at rest, moved by shapes, goes to ``p + sum over parts of w (K p - p)``: K
takes a joint, or a mesh, from rest to where the frame has it. That is linear blend skinning where
joints rest as they were bound.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdSkel
from scipy import sparse

from usdface.core.arrays import BoolArray, FloatArray, IntArray
from usdface.core.assets import Rig
from usdface.usdio.layers import open_stage, refusing_wrong_types
from usdface.usdio.performance.read import PerformanceReader
from usdface.usdio.rig.reference import place_of, stage_with_rig
from usdface.usdio.units import column_matrix, stage_to_ours


class PointMotion:
    """What carries points beside the shapes: parts, and where they are in a frame."""

    shares: sparse.csc_array
    """(points, parts): how far each point of all meshes follows a part [0-1]."""
    moves_as_one = False
    """Whether one part carries all points."""

    def transforms(self, frame: int) -> FloatArray:
        """Return each part's way from rest at a frame: (parts, 4, 4), for column vectors [mm]."""
        raise NotImplementedError

    def carry(self, points: FloatArray, frame: int, *, vectors: bool = False) -> FloatArray:
        """Return points of all meshes, (points, 3) [mm], where joints and Xforms take them.

        Vectors at the points are only turned.
        """
        out = np.array(points, np.float64)
        for part, transform in enumerate(self.transforms(frame)):
            part_of = slice(*self.shares.indptr[part : part + 2].tolist())
            rows, share = self.shares.indices[part_of], self.shares.data[part_of]
            moved = points[rows] @ transform[:3, :3].T - points[rows]
            out[rows] += share[:, None] * (moved if vectors else moved + transform[:3, 3])
        return out


class RigMotion(PointMotion):
    """The joints and Xforms of a rig that move."""

    @refusing_wrong_types
    def __init__(self, path: Path, rig: Rig) -> None:
        self.path = path
        reader = PerformanceReader(path)
        self._animation = UsdSkel.Animation(reader.animation)
        source = Sdf.Path(rig.prim).GetPrefixes()[0]
        place = Sdf.Path(place_of(reader.stage, reader.animation))
        self._ours = np.eye(4)
        self._ours[:3, :3] = stage_to_ours(open_stage(rig.file))
        root = Sdf.Path(rig.prim)
        self._rest = _Placement(open_stage(rig.file), root)
        posed = root.ReplacePrefix(source, place)
        stage = reader.stage
        if not UsdSkel.Root(stage.GetPrimAtPath(posed)):  # overs alone: the rig has moved
            stage = stage_with_rig(path, rig, Sdf.Path(place))
        self._posed = _Placement(stage, posed)
        self._parts: list[tuple[Sdf.Path, int]] = []
        """Path below the SkelRoot, and joint in its skeleton, or -1 for the prim itself."""
        self.shares = self._read_shares(rig)
        at_rest = self._rest.placed(self._parts, Usd.TimeCode.Default())
        self._inverse = [np.linalg.inv(each) for each in at_rest]

    @refusing_wrong_types
    def transforms(self, frame: int) -> FloatArray:
        """Return each part's K at a frame: (parts, 4, 4), for column vectors [mm]."""
        placed = self._posed.placed(self._parts, Usd.TimeCode(frame))
        back = np.linalg.inv(self._ours)
        moved = [a @ b for a, b in zip(placed, self._inverse, strict=True)]
        return np.array([self._ours @ each @ back for each in moved]).reshape(-1, 4, 4)

    def _read_shares(self, rig: Rig) -> sparse.csc_array:
        rows, columns, values, start = list[IntArray](), list[IntArray](), list[FloatArray](), 0
        number: dict[tuple[Sdf.Path, int], int] = {}
        for mesh in rig.meshes:
            count = len(mesh.points)
            below = Sdf.Path(mesh.path).MakeRelativePath(Sdf.Path(rig.prim))
            for part, points, share in self._shares_of(below, count):
                rows.append(start + points)
                columns.append(np.full(len(points), number.setdefault(part, len(number))))
                values.append(share)
            start += count
        self._parts = list(number)
        if not rows:
            return sparse.csc_array((start, 0))
        entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
        return sparse.csc_array(entries, shape=(start, len(number)))

    def _shares_of(
        self, mesh: Sdf.Path, count: int
    ) -> Iterator[tuple[tuple[Sdf.Path, int], IntArray, FloatArray]]:
        """Yield the parts that a mesh follows and that move, with points and shares of each."""
        query, target = self._rest.binding(mesh)
        if query is None or target is None or not target.HasJointInfluences():
            if self._posed.moves(mesh):
                yield (mesh, -1), np.arange(count), np.ones(count)
            return
        skeleton = query.GetPrim().GetPath().MakeRelativePath(self._rest.root)
        order = list(map(str, query.GetJointOrder()))
        own = list(map(str, target.GetJointOrder() or order))
        driven, carried = self._driven_joints(), self._posed.moves(skeleton)
        moving = [
            (index, joint)
            for index, joint in enumerate(own)
            if joint in order
            and (carried or any(f"{joint}/".startswith(f"{each}/") for each in driven))
        ]
        if not moving:
            return
        indices, weights = (
            np.array(each).reshape(count, -1)
            for each in target.ComputeVaryingJointInfluences(count)
        )
        for index, joint in moving:
            share = np.where(indices == index, weights, 0.0).sum(axis=1)
            points = np.flatnonzero(share)
            if len(points):
                yield (skeleton, order.index(joint)), points, share[points]

    def _driven_joints(self) -> list[str]:
        """Return the joints that the performance animates; those below them follow."""
        if not self._animation.GetRotationsAttr().GetNumTimeSamples():
            return []
        return list(map(str, self._animation.GetJointsAttr().Get() or ()))


def points_following(rig: Rig, path: str, *, is_joint: bool) -> BoolArray:
    """Return which points of all meshes follow a joint for more than half, or lie below a prim."""
    if not is_joint:
        own = [
            np.full(len(each.points), Sdf.Path(each.path).HasPrefix(path)) for each in rig.meshes
        ]
        return np.concatenate(own)
    rest = _Placement(open_stage(rig.file), Sdf.Path(rig.prim))
    found = []
    for mesh in rig.meshes:
        share = np.zeros(len(mesh.points))
        query, target = rest.binding(Sdf.Path(mesh.path).MakeRelativePath(rest.root))
        if query is not None and target is not None and target.HasJointInfluences():
            joints = target.GetJointOrder() or query.GetJointOrder()
            below = [at for at, each in enumerate(joints) if f"{each}/".startswith(f"{path}/")]
            indices, weights = (
                np.array(each).reshape(len(share), -1)
                for each in target.ComputeVaryingJointInfluences(len(share))
            )
            share = np.where(np.isin(indices, below), weights, 0.0).sum(axis=1)
        found.append(share > 0.5)
    return np.concatenate(found)


class _Placement:
    """Where the prims and joints below a SkelRoot are, in one stage."""

    def __init__(self, stage: Usd.Stage, root: Sdf.Path) -> None:
        self.stage, self.root = stage, root
        skel_root, predicate = (
            UsdSkel.Root(stage.GetPrimAtPath(root)),
            Usd.TraverseInstanceProxies(),
        )
        self._cache = UsdSkel.Cache()
        self._cache.Populate(skel_root, predicate)
        self._bound = {
            target.GetPrim().GetPath(): (self._cache.GetSkelQuery(binding.GetSkeleton()), target)
            for binding in self._cache.ComputeSkelBindings(skel_root, predicate)
            for target in binding.GetSkinningTargets()
        }

    def binding(
        self, mesh: Sdf.Path
    ) -> tuple[UsdSkel.SkeletonQuery | None, UsdSkel.SkinningQuery | None]:
        """Return the skeleton and the skinning of a mesh; None where it has none."""
        return self._bound.get(mesh.MakeAbsolutePath(self.root), (None, None))

    def moves(self, below: Sdf.Path) -> bool:
        """Whether a prim, or one above it, moves over time."""
        prim = self.stage.GetPrimAtPath(below.MakeAbsolutePath(self.root))
        while prim and not prim.IsPseudoRoot():
            xform = UsdGeom.Xformable(prim)
            if xform and xform.TransformMightBeTimeVarying():
                return True
            prim = prim.GetParent()
        return False

    def placed(self, parts: list[tuple[Sdf.Path, int]], time: Usd.TimeCode) -> list[FloatArray]:
        """Return where each part is, in the stage's world: 4x4, for column vectors.

        Joints are where skinning takes a bound point; without a time, those of the rest pose.
        """
        cache, skins = UsdGeom.XformCache(time), dict[Sdf.Path, list[FloatArray]]()
        out = []
        for path, joint in parts:
            prim = self.stage.GetPrimAtPath(path.MakeAbsolutePath(self.root))
            world = column_matrix(cache.GetLocalToWorldTransform(prim))
            if joint >= 0:
                if path not in skins:
                    skins[path] = self._skinning(prim, time)
                world = world @ skins[path][joint]
            out.append(world)
        return out

    def _skinning(self, prim: Usd.Prim, time: Usd.TimeCode) -> list[FloatArray]:
        query = self._cache.GetSkelQuery(UsdSkel.Skeleton(prim))
        if not time.IsDefault():
            return [column_matrix(each) for each in query.ComputeSkinningTransforms(time)]
        rest = query.ComputeJointSkelTransforms(time, True)
        bind = query.GetJointWorldBindTransforms()
        return [column_matrix(b.GetInverse() * r) for b, r in zip(bind, rest, strict=True)]
