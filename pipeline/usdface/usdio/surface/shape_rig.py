"""Rigs for meshes without shapes: a new asset that references the mesh and adds BlendShapes.

The mesh's file is not written; its materials, texture coordinates and other meshes are referenced.
Existing shapes are disabled in the new asset.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pxr import Gf, Kind, Sdf, Tf, Usd, UsdGeom, UsdSkel, Vt

from usdface.core.arrays import FloatArray
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.usdio.authoring import (
    apply_api,
    author_uniform,
    define_prim,
    define_reference_prim,
    index_array,
    top_path,
    unique_names,
    vector_array,
)
from usdface.usdio.layers import new_layer, open_stage, relative_path
from usdface.usdio.rig.mesh import FaceMesh
from usdface.usdio.units import author_units, row_matrix, stage_to_ours, transform_points

ASSET = "asset"
SHAPES = "shapes"
SKELETON = "skeleton"
_LONGEST_NAME = 63
"""Some DCCs truncate longer names of shapes."""


@dataclass(frozen=True)
class NewShape:
    """The face of one frame, to be written as a shape."""

    name: str
    """Converted to a valid prim name when it is written."""
    moved_mm: FloatArray
    """(points, 3): displacement from rest [mm], Y up."""
    take: str
    frame: int
    """`take`, `frame`: Of the capture."""


def shape_names(wanted: list[str]) -> list[str]:
    """Return valid and unique names of channels and prims, in the same order."""
    valid = (str(Tf.MakeValidIdentifier(each.strip() or "shape")) for each in wanted)
    return unique_names(valid, longest=_LONGEST_NAME)


def write_shape_rig(
    path: Path,
    face: FaceMesh,
    shapes: list[NewShape],
    *,
    name: str = "Face",
    least_mm: float = 0.02,
    provenance: Provenance,
) -> dict[str, int]:
    """Write a rig: a SkelRoot with a one-joint Skeleton, the mesh's asset, and shapes on the mesh.

    Returns the number of points that each shape moves, by the name of its channel and its prim.

    Parameters
    ----------
    face : FaceMesh
        The mesh; its file is referenced.
    name : str
        Of the SkelRoot, the new default prim.
    least_mm : float
        Smallest displacement of a point that is stored in a shape [mm].
    """
    if not shapes:
        raise InputError(f"{path}: there is no shape to write; choose at least one frame")
    root = Sdf.Path(f"/{Tf.MakeValidIdentifier(name)}")
    source = open_stage(face.file)
    top = top_path(face.path)
    mesh = Sdf.Path(face.path).ReplacePrefix(top, root.AppendChild(ASSET))
    with new_layer(path, provenance) as layer:
        author_units(layer, like=face.file)
        layer.defaultPrim = root.name
        define_prim(layer, root, "SkelRoot").SetInfo("kind", Kind.Tokens.component)
        _define_skeleton(layer, root.AppendChild(SKELETON))
        asset = define_reference_prim(
            layer, root.AppendChild(ASSET), relative_path(face.file, path), top
        )
        if Usd.ModelAPI(source.GetPrimAtPath(top)).GetKind():
            asset.SetInfo("kind", Kind.Tokens.subcomponent)  # it is now inside a component
        _override_asset_rig(layer, source, face.path, root.AppendChild(ASSET))
        points = _bind_mesh(layer, face, mesh, root.AppendChild(SKELETON), source)
        to_mesh_space = np.linalg.inv(stage_to_ours(source) @ face.world[:3, :3])
        define_prim(layer, root.AppendChild(SHAPES), "Scope")
        written, targets, extremes = dict[str, int](), [], [points]
        for shape, given in zip(shapes, shape_names([each.name for each in shapes]), strict=True):
            target = root.AppendPath(f"{SHAPES}/{given}")
            moved = np.flatnonzero(np.linalg.norm(shape.moved_mm, axis=1) >= least_mm)
            if not len(moved):
                raise InputError(
                    f"{path}: shape {given} (frame {shape.frame} of {shape.take}) moves no point "
                    f"by {least_mm:g} mm; choose a frame that differs from the neutral face"
                )
            offsets = shape.moved_mm[moved] @ to_mesh_space.T
            prim, kinds = define_prim(layer, target, "BlendShape"), Sdf.ValueTypeNames
            author_uniform(prim, "pointIndices", kinds.IntArray, index_array(moved))
            author_uniform(prim, "offsets", kinds.Vector3fArray, vector_array(offsets))
            made = {"take": shape.take, "frame": shape.frame, "name": shape.name}
            prim.customData = {"usdface": made}
            written[given] = len(moved)
            targets.append(target)
            extremes.append(points[moved] + offsets)
        binding = layer.GetPrimAtPath(mesh)
        names = Vt.TokenArray(list(written))
        author_uniform(binding, "skel:blendShapes", Sdf.ValueTypeNames.TokenArray, names)
        relation = Sdf.RelationshipSpec(binding, "skel:blendShapeTargets", False)
        relation.targetPathList.explicitItems = targets
        everything = transform_points(face.world, np.concatenate(extremes))
        extent = Sdf.AttributeSpec(
            layer.GetPrimAtPath(root), "extent", Sdf.ValueTypeNames.Float3Array
        )
        extent.default = vector_array(np.stack([everything.min(axis=0), everything.max(axis=0)]))
    return written


def _define_skeleton(layer: Sdf.Layer, path: Sdf.Path) -> None:
    prim = define_prim(layer, path, "Skeleton")
    # Some DCCs ignore skeletons without joints, with their shapes.
    kinds = Sdf.ValueTypeNames
    author_uniform(prim, "joints", kinds.TokenArray, Vt.TokenArray(["head"]))
    for name in ("bindTransforms", "restTransforms"):
        author_uniform(prim, name, kinds.Matrix4dArray, Vt.Matrix4dArray([Gf.Matrix4d(1)]))
    apply_api(prim, "SkelBindingAPI")


def _override_asset_rig(layer: Sdf.Layer, source: Usd.Stage, mesh: str, place: Sdf.Path) -> None:
    """Override the asset's SkelRoots and shapes, as a rig has one SkelRoot.

    Groups without a type above the mesh become Scopes: UsdSkel moves nothing below them.
    """
    top = top_path(mesh)
    for prim in Usd.PrimRange(source.GetPrimAtPath(top)):
        at = prim.GetPath().ReplacePrefix(top, place)
        if Sdf.Path(mesh).HasPrefix(prim.GetPath()) and not prim.IsA(UsdGeom.Imageable):
            Sdf.CreatePrimInLayer(layer, at).typeName = "Scope"
        if prim.IsA(UsdSkel.Root):
            Sdf.CreatePrimInLayer(layer, at).typeName = "Xform"
        if prim.IsA(UsdGeom.Mesh) and prim.GetAttribute("skel:blendShapes").HasAuthoredValue():
            over = Sdf.CreatePrimInLayer(layer, at)
            kind = Sdf.ValueTypeNames.TokenArray
            author_uniform(over, "skel:blendShapes", kind, Sdf.ValueBlock())
            relation = Sdf.RelationshipSpec(over, "skel:blendShapeTargets", False)
            relation.targetPathList.ClearEditsAndMakeExplicit()


def _bind_mesh(
    layer: Sdf.Layer, face: FaceMesh, path: Sdf.Path, skeleton: Sdf.Path, source: Usd.Stage
) -> FloatArray:
    """Bind the mesh to the new skeleton; return its points at rest in the mesh's space."""
    prim = Sdf.CreatePrimInLayer(layer, path)
    for name in ("skel:blendShapes", "skel:blendShapeTargets"):
        if name in prim.properties:
            prim.RemoveProperty(prim.properties[name])
    apply_api(prim, "SkelBindingAPI")
    kinds = Sdf.ValueTypeNames
    relation = Sdf.RelationshipSpec(prim, "skel:skeleton", False)
    relation.targetPathList.explicitItems = [skeleton]
    transform = Sdf.AttributeSpec(prim, "primvars:skel:geomBindTransform", kinds.Matrix4d)
    transform.default = row_matrix(face.world)
    for name, kind, value in (
        ("primvars:skel:jointIndices", kinds.IntArray, Vt.IntArray([0])),
        ("primvars:skel:jointWeights", kinds.FloatArray, Vt.FloatArray([1.0])),
    ):
        attribute = Sdf.AttributeSpec(prim, name, kind)
        attribute.default = value
        attribute.SetInfo("interpolation", "constant")
        attribute.SetInfo("elementSize", 1)
    if source.GetPrimAtPath(face.path).HasAttribute("skel:joints"):
        author_uniform(prim, "skel:joints", kinds.TokenArray, Sdf.ValueBlock())
    ours = stage_to_ours(source)
    home = np.asarray(np.linalg.inv(face.world), np.float64)
    rest = transform_points(home, face.mesh.points @ np.linalg.inv(ours).T)
    if not np.allclose(rest, face.local, atol=1e-5 * max(float(np.ptp(face.local)), 1e-9)):
        # The asset's skeleton deforms the mesh at rest, the new one does not: write the points.
        Sdf.AttributeSpec(prim, "points", kinds.Point3fArray).default = vector_array(rest)
    return rest
