"""Motion of a rig's points by joints and Xforms of a performance, in addition to its shapes.

A point p, displaced by shapes, is mapped to ``p + sum over parts of w (K p - p)``, with K the
transform of a joint, or of a mesh, from rest to the frame. Linear blend skinning, if the rest pose
is the bind pose.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdSkel
from scipy import sparse

from usdface.core.arrays import BoolArray, FloatArray, IntArray
from usdface.core.assets import Rig, point_slices
from usdface.usdio.authoring import names_in, top_path
from usdface.usdio.layers import refusing_wrong_types
from usdface.usdio.performance.read import PerformanceReader
from usdface.usdio.rig.mesh import skel_bindings
from usdface.usdio.rig.read import open_variant
from usdface.usdio.rig.reference import rig_path_of, stage_with_rig
from usdface.usdio.units import column_matrix, rest_transforms, stage_to_ours


class PointMotion:
    """Rigid parts of a rig, and their transforms in a frame."""

    shares: sparse.csc_array
    """(points, parts): skinning weights of the points of all meshes."""
    moves_as_one = False
    """Whether one part has all points."""

    def transforms(self, frame: int) -> FloatArray:
        """Return each part's transform from rest: (parts, 4, 4), for column vectors [mm]."""
        raise NotImplementedError

    def apply(self, points: FloatArray, frame: int, *, vectors: bool = False) -> FloatArray:
        """Return points of all meshes, (points, 3) [mm], moved by joints and Xforms.

        Or `vectors` at the points, without translation.
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
        source = top_path(rig.prim)
        rig_path = Sdf.Path(rig_path_of(reader.stage, reader.animation))
        self._ours = np.eye(4)
        root, rest = Sdf.Path(rig.prim), open_variant(rig.file, rig.variants)
        self._ours[:3, :3] = stage_to_ours(rest)
        posed = root.ReplacePrefix(source, rig_path)
        stage = reader.stage
        if not UsdSkel.Root(stage.GetPrimAtPath(posed)):  # only overs: the rig's file is missing
            stage = stage_with_rig(path, rig, Sdf.Path(rig_path))
        # A shot may place the character, on its top prim or above, which is no motion of the face.
        top = UsdGeom.Xformable(stage.GetPrimAtPath(rig_path))
        if top and top.TransformMightBeTimeVarying():
            source, rig_path = Sdf.Path.absoluteRootPath, rig_path.GetParentPath()
        self.levels_up = posed.pathElementCount - rig_path.pathElementCount
        """From the SkelRoot to the prim relative to which points move."""
        self._rest, self._posed = _Placement(rest, root, source), _Placement(stage, posed, rig_path)
        self._ours = self._ours @ self._rest.world_of_base(Usd.TimeCode.Default())
        self._parts: list[tuple[Sdf.Path, int]] = []
        """Path relative to the SkelRoot, and joint index of its skeleton, or -1 for the prim."""
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
        rows, columns, values = list[IntArray](), list[IntArray](), list[FloatArray]()
        number: dict[tuple[Sdf.Path, int], int] = {}
        for mesh, own in zip(rig.meshes, point_slices(rig.meshes), strict=True):
            below = Sdf.Path(mesh.path).MakeRelativePath(Sdf.Path(rig.prim))
            for part, points, share in self._shares_of(below, len(mesh.points)):
                rows.append(own.start + points)
                columns.append(np.full(len(points), number.setdefault(part, len(number))))
                values.append(share)
        self._parts = list(number)
        count = sum(len(mesh.points) for mesh in rig.meshes)
        if not rows:
            return sparse.csc_array((count, 0))
        entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
        return sparse.csc_array(entries, shape=(count, len(number)))

    def _shares_of(
        self, mesh: Sdf.Path, count: int
    ) -> Iterator[tuple[tuple[Sdf.Path, int], IntArray, FloatArray]]:
        """Yield the moving parts of a mesh, with the points and weights of each."""
        query, target = self._rest.binding(mesh)
        if query is None or target is None or not target.HasJointInfluences():
            if self._posed.moves(mesh):
                yield (mesh, -1), np.arange(count), np.ones(count)
            return
        skeleton = query.GetPrim().GetPath().MakeRelativePath(self._rest.root)
        order = list(map(str, query.GetJointOrder()))
        mesh_joints = list(map(str, target.GetJointOrder() or order))
        skeleton_moves = self._posed.moves(skeleton)
        driven = names_in(self._animation.GetJointsAttr())
        moving = [
            (index, joint)
            for index, joint in enumerate(mesh_joints)
            if joint in order
            and (skeleton_moves or any(f"{joint}/".startswith(f"{each}/") for each in driven))
        ]
        if not moving:
            return
        indices, weights = _influences(target, count)
        for index, joint in moving:
            share = np.where(indices == index, weights, 0.0).sum(axis=1)
            points = np.flatnonzero(share)
            if len(points):
                yield (skeleton, order.index(joint)), points, share[points]


def points_following(rig: Rig, path: str, *, is_joint: bool) -> BoolArray:
    """Return the points of all meshes with more than half their weight on a joint, or in a prim."""
    if not is_joint:
        return np.concatenate(
            [np.full(len(mesh.points), Sdf.Path(mesh.path).HasPrefix(path)) for mesh in rig.meshes]
        )
    root = Sdf.Path(rig.prim)
    rest = _Placement(open_variant(rig.file, rig.variants), root, root)
    following = []
    for mesh in rig.meshes:
        share = np.zeros(len(mesh.points))
        query, target = rest.binding(Sdf.Path(mesh.path).MakeRelativePath(rest.root))
        if query is not None and target is not None and target.HasJointInfluences():
            joints = target.GetJointOrder() or query.GetJointOrder()
            below = [at for at, each in enumerate(joints) if f"{each}/".startswith(f"{path}/")]
            indices, weights = _influences(target, len(share))
            share = np.where(np.isin(indices, below), weights, 0.0).sum(axis=1)
        following.append(share > 0.5)
    return np.concatenate(following)


def _influences(target: UsdSkel.SkinningQuery, count: int) -> tuple[IntArray, FloatArray]:
    """Return the joints of each point and their weights: (points, k) each."""
    joints, weights = target.ComputeVaryingJointInfluences(count)
    return np.array(joints).reshape(count, -1), np.array(weights).reshape(count, -1)


class _Placement:
    """Transforms of the prims and joints below a SkelRoot of one stage, relative to a base.

    `base`: path of the SkelRoot, or of a prim above it.
    """

    def __init__(self, stage: Usd.Stage, root: Sdf.Path, base: Sdf.Path) -> None:
        self.stage, self.root, self._base = stage, root, stage.GetPrimAtPath(base)
        self._cache = UsdSkel.Cache()
        self._bound = skel_bindings(self._cache, UsdSkel.Root(stage.GetPrimAtPath(root)))

    def binding(
        self, mesh: Sdf.Path
    ) -> tuple[UsdSkel.SkeletonQuery | None, UsdSkel.SkinningQuery | None]:
        """Return the skeleton and the skinning of a mesh, or None."""
        return self._bound.get(str(mesh.MakeAbsolutePath(self.root)), (None, None))

    def moves(self, below: Sdf.Path) -> bool:
        """Whether a prim, or one between it and the base, has an animated transform."""
        prim = self.stage.GetPrimAtPath(below.MakeAbsolutePath(self.root))
        while prim and prim != self._base:
            xform = UsdGeom.Xformable(prim)
            if xform and xform.TransformMightBeTimeVarying():
                return True
            prim = prim.GetParent()
        return False

    def _transforms(self, time: Usd.TimeCode) -> UsdGeom.XformCache:
        root = self.stage.GetPrimAtPath(self.root)
        return rest_transforms(root) if time.IsDefault() else UsdGeom.XformCache(time)

    def world_of_base(self, time: Usd.TimeCode) -> FloatArray:
        """Return the world transform of the base: (4, 4), for column vectors."""
        return column_matrix(self._transforms(time).GetLocalToWorldTransform(self._base))

    def placed(self, parts: list[tuple[Sdf.Path, int]], time: Usd.TimeCode) -> list[FloatArray]:
        """Return the transform of each part relative to the base: (4, 4), for column vectors.

        Of joints, the skinning transform; at the default time, that of the rest pose.
        """
        cache, skins = self._transforms(time), dict[Sdf.Path, list[FloatArray]]()
        back, out = np.linalg.inv(self.world_of_base(time)), []
        for path, joint in parts:
            prim = self.stage.GetPrimAtPath(path.MakeAbsolutePath(self.root))
            placed = back @ column_matrix(cache.GetLocalToWorldTransform(prim))
            if joint >= 0:
                if path not in skins:
                    skins[path] = self._skinning(prim, time)
                placed = placed @ skins[path][joint]
            out.append(placed)
        return out

    def _skinning(self, prim: Usd.Prim, time: Usd.TimeCode) -> list[FloatArray]:
        query = self._cache.GetSkelQuery(UsdSkel.Skeleton(prim))
        if not time.IsDefault():
            return [column_matrix(each) for each in query.ComputeSkinningTransforms(time)]
        rest = query.ComputeJointSkelTransforms(time, True)
        bind = query.GetJointWorldBindTransforms()
        return [column_matrix(b.GetInverse() * r) for b, r in zip(bind, rest, strict=True)]
