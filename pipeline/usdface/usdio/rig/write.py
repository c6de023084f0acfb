"""Write a rig as a UsdSkel asset that USD tools and DCCs open with its shapes working."""

from pathlib import Path

import numpy as np
from pxr import Gf, Kind, Sdf, Usd, UsdGeom, UsdSkel, Vt

from usdface.core.arrays import FloatArray, IntArray
from usdface.core.assets import Rig, RigMesh, ShapeKey
from usdface.core.provenance import Provenance
from usdface.usdio.layers import new_layer
from usdface.usdio.rig.read import RANGE_ATTRIBUTE
from usdface.usdio.units import MM_PER_STAGE_UNIT, author_units


def write_rig(path: Path, rig: Rig, *, provenance: Provenance | None = None) -> None:
    """Write a rig: one SkelRoot with a one-joint Skeleton, and its meshes bound to it.

    Parameters
    ----------
    rig : Rig
        `rig.prim` names the SkelRoot; mesh paths must lie below it.
    """
    with new_layer(path, provenance) as layer:
        author_units(layer)
        stage = Usd.Stage.Open(layer)
        root_path = Sdf.Path(rig.prim)
        root = UsdSkel.Root.Define(stage, root_path)
        stage.SetDefaultPrim(stage.GetPrimAtPath(root_path.GetPrefixes()[0]))
        Usd.ModelAPI(stage.GetDefaultPrim()).SetKind(Kind.Tokens.component)
        skeleton = _define_skeleton(stage, root_path)
        for mesh in rig.meshes:
            _define_mesh(stage, mesh, skeleton, rig)
        extent = UsdGeom.BBoxCache(Usd.TimeCode.Default(), [UsdGeom.Tokens.default_])
        box = extent.ComputeUntransformedBound(root.GetPrim()).ComputeAlignedRange()
        root.CreateExtentAttr([Gf.Vec3f(box.GetMin()), Gf.Vec3f(box.GetMax())])


def _define_skeleton(stage: Usd.Stage, root: Sdf.Path) -> UsdSkel.Skeleton:
    UsdGeom.Scope.Define(stage, root.AppendChild("rig"))
    skeleton = UsdSkel.Skeleton.Define(stage, root.AppendPath("rig/skeleton"))
    # Some DCCs skip a skeleton without joints, and the shapes with it.
    skeleton.CreateJointsAttr(["head"])
    skeleton.CreateBindTransformsAttr([Gf.Matrix4d(1)])
    skeleton.CreateRestTransformsAttr([Gf.Matrix4d(1)])
    UsdSkel.BindingAPI.Apply(skeleton.GetPrim())
    return skeleton


def _define_mesh(stage: Usd.Stage, mesh: RigMesh, skeleton: UsdSkel.Skeleton, rig: Rig) -> None:
    for prefix in Sdf.Path(mesh.path).GetParentPath().GetPrefixes():
        if not stage.GetPrimAtPath(prefix):
            UsdGeom.Scope.Define(stage, prefix)
    geometry = UsdGeom.Mesh.Define(stage, mesh.path)
    points = _vectors(mesh.points / MM_PER_STAGE_UNIT)
    geometry.CreatePointsAttr(points)
    geometry.CreateExtentAttr(UsdGeom.PointBased.ComputeExtent(points))
    geometry.CreateFaceVertexCountsAttr(_integers(mesh.face_counts))
    geometry.CreateFaceVertexIndicesAttr(_integers(mesh.face_indices))
    geometry.CreateSubdivisionSchemeAttr(mesh.subdivision)
    if mesh.colors is not None:
        color = geometry.CreateDisplayColorPrimvar(UsdGeom.Tokens.vertex)
        color.Set(_vectors(mesh.colors))
    if mesh.normals is not None:
        geometry.CreateNormalsAttr(_vectors(mesh.normals))
        geometry.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    binding = UsdSkel.BindingAPI.Apply(geometry.GetPrim())
    binding.CreateSkeletonRel().SetTargets([skeleton.GetPath()])
    binding.CreateJointIndicesPrimvar(constant=True, elementSize=1).Set([0])
    binding.CreateJointWeightsPrimvar(constant=True, elementSize=1).Set([1.0])
    binding.CreateGeomBindTransformAttr(Gf.Matrix4d(1))
    targets = []
    for shape in mesh.shapes:
        low, high = rig.ranges[rig.shapes.index(shape.name)]
        target = UsdSkel.BlendShape.Define(stage, geometry.GetPath().AppendChild(shape.name))
        _define_keys(target, shape.keys)
        if (low, high) != (0.0, 1.0):
            attribute = target.GetPrim().CreateAttribute(
                RANGE_ATTRIBUTE, Sdf.ValueTypeNames.Double2, custom=True
            )
            attribute.Set(Gf.Vec2d(low, high))
        targets.append(target.GetPath())
    if targets:
        binding.CreateBlendShapesAttr([shape.name for shape in mesh.shapes])
        binding.CreateBlendShapeTargetsRel().SetTargets(targets)


def _define_keys(target: UsdSkel.BlendShape, keys: tuple[ShapeKey, ...]) -> None:
    """Write a shape's keys over one list of points: USD shares it between in-betweens."""
    points = np.unique(np.concatenate([key.points for key in keys]))
    target.CreatePointIndicesAttr(_integers(points))
    for key in keys:
        offsets = _vectors(_spread(key.points, key.offsets, points) / MM_PER_STAGE_UNIT)
        if key.weight == 1.0:
            target.CreateOffsetsAttr(offsets)
        else:
            between = target.CreateInbetween(f"at{round(key.weight * 100)}")
            between.SetWeight(key.weight)
            between.SetOffsets(offsets)
        if key.normal_offsets is not None:
            normals = _vectors(_spread(key.points, key.normal_offsets, points))
            if key.weight == 1.0:
                target.CreateNormalOffsetsAttr(normals)
            else:
                between.CreateNormalOffsetsAttr(normals)


def _spread(own: IntArray, values: FloatArray, points: IntArray) -> FloatArray:
    spread = np.zeros((len(points), 3))
    spread[np.searchsorted(points, own)] = values
    return spread


def _vectors(values: FloatArray) -> Vt.Vec3fArray:
    return Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(values, dtype=np.float32))


def _integers(values: IntArray) -> Vt.IntArray:
    return Vt.IntArray.FromNumpy(np.ascontiguousarray(values, dtype=np.int32))
