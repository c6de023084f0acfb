"""Points of a performance posed by UsdSkel, with shapes and joints."""

from pathlib import Path

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdSkel, Vt

from usdface.core.arrays import FloatArray
from usdface.core.assets import Rig
from usdface.core.errors import InputError
from usdface.usdio.authoring import names_in, prims_below
from usdface.usdio.layers import open_stage, refusing_wrong_types
from usdface.usdio.performance.read import PerformanceReader
from usdface.usdio.rig.mesh import at_rest, skel_bindings
from usdface.usdio.rig.read import faces_below, find_face
from usdface.usdio.rig.reference import read_rig_of_stage, rig_path_of, stage_with_rig
from usdface.usdio.units import column_matrix, stage_to_ours, transform_points


class PosedRig:
    """The meshes of a performance, posed on demand."""

    @refusing_wrong_types
    def __init__(self, path: Path) -> None:
        self.path = path
        self.reader = PerformanceReader(path)
        file, prim = self.reader.rig()
        self.rig: Rig = read_rig_of_stage(self.reader.stage, self.reader.animation)
        self._stage = self.reader.stage
        # The face that moves, of a file with several.
        rig_path = rig_path_of(self._stage, self.reader.animation)
        face = Sdf.Path(prim).ReplacePrefix(Sdf.Path(prim).GetPrefixes()[0], Sdf.Path(rig_path))
        if not UsdSkel.Root(self._stage.GetPrimAtPath(face)) and not faces_below(
            self._stage.GetPseudoRoot()
        ):  # only overs: the rig's file is missing
            self._stage = stage_with_rig(path, self.rig, Sdf.Path(rig_path))
        face_path = str(face) if self._stage.GetPrimAtPath(face) else None
        root = UsdSkel.Root(find_face(self._stage, path, face_path))
        self._bound = skel_bindings(UsdSkel.Cache(), root)
        self._meshes = prims_below(root.GetPrim(), UsdGeom.Mesh)
        # In the rig's units, which references do not convert.
        self._ours = stage_to_ours(open_stage(file))
        if [len(mesh.points) for mesh in self.rig.meshes] != [
            len(at_rest(UsdGeom.Mesh(prim).GetPointsAttr()) or ()) for prim in self._meshes
        ]:
            raise InputError(f"{path}: its meshes are not those of {file}; map or retarget again")

    @refusing_wrong_types
    def points(self, frame: int) -> FloatArray:
        """Return the points of all meshes at a frame, concatenated [mm], Y up."""
        transforms = UsdGeom.XformCache(frame)
        weights = dict(zip(self.reader.names, self.reader.edited(frame, frame)[0], strict=True))
        return np.concatenate(
            [self._posed(prim, frame, transforms, weights) for prim in self._meshes]
        )

    def _posed(
        self, prim: Usd.Prim, frame: int, transforms: UsdGeom.XformCache, weights: dict[str, float]
    ) -> FloatArray:
        points = Vt.Vec3fArray(UsdGeom.Mesh(prim).GetPointsAttr().Get(frame))
        query, target = self._bound.get(str(prim.GetPath()), (None, None))
        if query is None or target is None:
            return _to_world(transforms.GetLocalToWorldTransform(prim), points, self._ours)
        _deform(prim, points, weights)
        joints = query.ComputeSkinningTransforms(frame)
        skinned = target.HasJointInfluences() and joints
        if skinned and target.ComputeSkinnedPoints(joints, points, frame):
            world = transforms.GetLocalToWorldTransform(query.GetPrim())
            return _to_world(world, points, self._ours)
        return _to_world(transforms.GetLocalToWorldTransform(prim), points, self._ours)


def _deform(prim: Usd.Prim, points: Vt.Vec3fArray, weights: dict[str, float]) -> None:
    """Move points by the mesh's shapes, in place."""
    binding = UsdSkel.BindingAPI(prim)
    names = names_in(binding.GetBlendShapesAttr())
    if not names:
        return
    query = UsdSkel.BlendShapeQuery(binding)
    mesh_weights = Vt.FloatArray([float(weights.get(name, 0.0)) for name in names])
    computed = query.ComputeSubShapeWeights(mesh_weights)
    query.ComputeDeformedPoints(
        *computed,
        query.ComputeBlendShapePointIndices(),
        query.ComputeSubShapePointOffsets(),
        points,
    )


def _to_world(world: object, points: Vt.Vec3fArray, ours: FloatArray) -> FloatArray:
    placed = transform_points(column_matrix(world), np.array(points, np.float64))
    return np.asarray(placed @ ours.T)
