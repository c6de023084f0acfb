"""Writing of rigs as UsdSkel assets."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pxr import Gf, Kind, Sdf, Usd, UsdGeom, UsdSkel

from usdface.core.arrays import FloatArray, IntArray
from usdface.core.assets import Rig, RigMesh, ShapeKey
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.core.rig_logic import Combination
from usdface.usdio.authoring import index_array, top_path, vector_array
from usdface.usdio.layers import new_layer, open_stage, relative_path
from usdface.usdio.rig.read import (
    COMBINATION,
    COMBINATION_MODE,
    COMBINATION_PARTS,
    COMBINATION_SPANS,
    COMBINATION_WEIGHTS,
    RANGE_ATTRIBUTE,
    shape_prims,
)
from usdface.usdio.units import MM_PER_STAGE_UNIT, author_units


@dataclass(frozen=True)
class RigControls:
    """Joints and attributes of a rig."""

    joints: tuple[str, ...]
    """Paths, parents before their children."""
    places: FloatArray
    """(joints, 3): at rest [mm]."""
    influences: Mapping[str, tuple[IntArray, FloatArray]]
    """By the path of a mesh: joints of each point and their weights, (points, k) each. Other meshes
    follow the first joint."""
    attributes: tuple[str, ...]
    """Float attributes for deformers, as PRIM.ATTRIBUTE relative to the top prim."""


ONE_JOINT = RigControls(("head",), np.zeros((1, 3)), {}, ())
"""Some DCCs ignore skeletons without joints, with their shapes."""


def write_rig(path: Path, rig: Rig, *, controls: RigControls = ONE_JOINT) -> None:
    """Write a rig: one SkelRoot with a Skeleton, and its meshes bound to it, without normals.

    `rig`: `rig.prim` is the SkelRoot; mesh paths must be below it.
    """
    with new_layer(path) as layer:
        author_units(layer)
        stage = Usd.Stage.Open(layer)
        root_path = Sdf.Path(rig.prim)
        root = UsdSkel.Root.Define(stage, root_path)
        stage.SetDefaultPrim(stage.GetPrimAtPath(top_path(root_path)))
        Usd.ModelAPI(stage.GetDefaultPrim()).SetKind(Kind.Tokens.component)
        skeleton = _define_skeleton(stage, root_path, controls)
        for mesh in rig.meshes:
            _define_mesh(stage, mesh, skeleton, rig)
            _bind_joints(stage, mesh, controls)
        for name in controls.attributes:
            prim, _, attribute = name.partition(".")
            scope = UsdGeom.Scope.Define(stage, root_path.AppendPath(prim)).GetPrim()
            scope.CreateAttribute(attribute, Sdf.ValueTypeNames.Float, custom=True).Set(0.0)
        extent = UsdGeom.BBoxCache(Usd.TimeCode.Default(), [UsdGeom.Tokens.default_])
        box = extent.ComputeUntransformedBound(root.GetPrim()).ComputeAlignedRange()
        root.CreateExtentAttr([Gf.Vec3f(box.GetMin()), Gf.Vec3f(box.GetMax())])


def _define_skeleton(stage: Usd.Stage, root: Sdf.Path, controls: RigControls) -> UsdSkel.Skeleton:
    UsdGeom.Scope.Define(stage, root.AppendChild("rig"))
    skeleton = UsdSkel.Skeleton.Define(stage, root.AppendPath("rig/skeleton"))
    places = controls.places / MM_PER_STAGE_UNIT
    skeleton.CreateJointsAttr(list(controls.joints))
    skeleton.CreateBindTransformsAttr([_moved(place) for place in places])
    skeleton.CreateRestTransformsAttr([_moved(p) for p in from_parents(controls.joints, places)])
    UsdSkel.BindingAPI.Apply(skeleton.GetPrim())
    return skeleton


def _define_mesh(stage: Usd.Stage, mesh: RigMesh, skeleton: UsdSkel.Skeleton, rig: Rig) -> None:
    for prefix in Sdf.Path(mesh.path).GetParentPath().GetPrefixes():
        if not stage.GetPrimAtPath(prefix):
            UsdGeom.Scope.Define(stage, prefix)
    geometry = UsdGeom.Mesh.Define(stage, mesh.path)
    points = vector_array(mesh.points / MM_PER_STAGE_UNIT)
    geometry.CreatePointsAttr(points)
    geometry.CreateExtentAttr(UsdGeom.PointBased.ComputeExtent(points))
    geometry.CreateFaceVertexCountsAttr(index_array(mesh.face_counts))
    geometry.CreateFaceVertexIndicesAttr(index_array(mesh.face_indices))
    geometry.CreateSubdivisionSchemeAttr(mesh.subdivision)
    if mesh.colors is not None:
        color = geometry.CreateDisplayColorPrimvar(UsdGeom.Tokens.vertex)
        color.Set(vector_array(mesh.colors))
    binding = UsdSkel.BindingAPI.Apply(geometry.GetPrim())
    binding.CreateSkeletonRel().SetTargets([skeleton.GetPath()])
    binding.CreateGeomBindTransformAttr(Gf.Matrix4d(1))
    targets = []
    ranges = dict(zip(rig.shapes, rig.ranges.tolist(), strict=True))
    driven = {each.shape: each for each in rig.combinations}
    for shape in mesh.shapes:
        low, high = ranges.get(shape.name, (0.0, 1.0))
        target = UsdSkel.BlendShape.Define(stage, geometry.GetPath().AppendChild(shape.name))
        _define_keys(target, shape.keys)
        if (low, high) != (0.0, 1.0):
            attribute = target.GetPrim().CreateAttribute(
                RANGE_ATTRIBUTE, Sdf.ValueTypeNames.Double2, custom=True
            )
            attribute.Set(Gf.Vec2d(low, high))
        if shape.name in driven:
            author_combination(target.GetPrim(), driven[shape.name])
        targets.append(target.GetPath())
    if targets:
        binding.CreateBlendShapesAttr([shape.name for shape in mesh.shapes])
        binding.CreateBlendShapeTargetsRel().SetTargets(targets)


def from_parents(joints: tuple[str, ...], places: FloatArray) -> FloatArray:
    """Return the positions of joints relative to their parents: (joints, 3)."""
    relative = places.copy()
    for row, joint in enumerate(joints):
        parent = joint.rpartition("/")[0]
        if parent:
            relative[row] -= places[joints.index(parent)]
    return relative


def _moved(place: FloatArray) -> Gf.Matrix4d:
    return Gf.Matrix4d().SetTranslate(Gf.Vec3d(*place.tolist()))


def _bind_joints(stage: Usd.Stage, mesh: RigMesh, controls: RigControls) -> None:
    binding = UsdSkel.BindingAPI(stage.GetPrimAtPath(mesh.path))
    if mesh.path not in controls.influences:
        binding.CreateJointIndicesPrimvar(constant=True, elementSize=1).Set([0])
        binding.CreateJointWeightsPrimvar(constant=True, elementSize=1).Set([1.0])
        return
    joints, shares = controls.influences[mesh.path]
    size = joints.shape[1]
    indices = binding.CreateJointIndicesPrimvar(constant=False, elementSize=size)
    indices.Set(index_array(joints.ravel()))
    weights = binding.CreateJointWeightsPrimvar(constant=False, elementSize=size)
    weights.Set(shares.ravel().tolist())


def write_logic(
    path: Path, rig: Rig, combinations: tuple[Combination, ...], *, provenance: Provenance
) -> None:
    """Write a layer over a rig's file, with its combinations."""
    source, driven = open_stage(rig.file), {each.shape: each for each in combinations}
    with new_layer(path, provenance) as layer:
        author_units(layer, like=rig.file)
        root = source.GetRootLayer()
        for key in ("timeCodesPerSecond", "framesPerSecond", "startTimeCode", "endTimeCode"):
            if root.pseudoRoot.HasInfo(key):
                layer.pseudoRoot.SetInfo(key, root.pseudoRoot.GetInfo(key))
        layer.defaultPrim = top_path(rig.prim).name
        layer.subLayerPaths = [relative_path(rig.file, path)]
        stage = Usd.Stage.CreateInMemory()
        for name, shape in shape_prims(source.GetPrimAtPath(rig.prim)):
            if name not in driven:
                continue
            if shape.IsInstanceProxy() or shape.IsInPrototype():
                raise InputError(
                    f"{rig.file} <{shape.GetPath()}>: lies in an instance, where USD ignores what "
                    "is stated; make the asset not instanceable"
                )
            author_combination(stage.OverridePrim(shape.GetPath()), driven[name])
        for prim in stage.GetRootLayer().rootPrims:
            Sdf.CopySpec(stage.GetRootLayer(), prim.path, layer, prim.path)


def author_combination(prim: Usd.Prim, combination: Combination) -> None:
    """Write the combination of a BlendShape."""
    prim.ApplyAPI(COMBINATION)
    tokens, doubles = Sdf.ValueTypeNames.TokenArray, Sdf.ValueTypeNames.DoubleArray
    pairs = Sdf.ValueTypeNames.Double2Array
    for name, kind, value in (
        (COMBINATION_PARTS, tokens, list(combination.parts)),
        (COMBINATION_MODE, Sdf.ValueTypeNames.Token, combination.mode),
        (COMBINATION_WEIGHTS, doubles, list(combination.part_weights)),
        (COMBINATION_SPANS, pairs, [Gf.Vec2d(*span) for span in combination.spans]),
    ):
        if value:
            prim.CreateAttribute(name, kind, False, Sdf.VariabilityUniform).Set(value)


def _define_keys(target: UsdSkel.BlendShape, keys: tuple[ShapeKey, ...]) -> None:
    """Write a shape's keys over one list of points, which in-betweens share in USD."""
    points = np.unique(np.concatenate([key.points for key in keys]))
    target.CreatePointIndicesAttr(index_array(points))
    for key in keys:
        dense = np.zeros((len(points), 3))
        dense[np.searchsorted(points, key.points)] = key.offsets
        offsets = vector_array(dense / MM_PER_STAGE_UNIT)
        if key.weight == 1.0:
            target.CreateOffsetsAttr(offsets)
        else:
            between = target.CreateInbetween(f"at{round(key.weight * 100)}")
            between.SetWeight(key.weight)
            between.SetOffsets(offsets)
