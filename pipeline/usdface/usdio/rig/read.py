"""Reading of rigs: meshes bound to BlendShapes, ranges and combinations."""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np
from pxr import Usd, UsdGeom, UsdSkel

from usdface.core.arrays import FloatArray
from usdface.core.assets import MeshShape, Rig, RigMesh, ShapeKey
from usdface.core.errors import InputError
from usdface.core.rig_logic import Combination, CombinationMode, order_combinations
from usdface.usdio.authoring import names_in, prim_or_root, prims_below, text_of, top_path, value_of
from usdface.usdio.layers import open_stage, refusing_wrong_types
from usdface.usdio.rig.materials import read_face_colors
from usdface.usdio.rig.mesh import (
    PlacedMesh,
    RestPose,
    authored_normals,
    read_geometry,
    still_meshes,
)
from usdface.usdio.units import stage_to_ours

RANGE_ATTRIBUTE = "face:range"
"""Optional double2 of a BlendShape prim: lowest and highest weight."""

COMBINATION = "FaceCombinationAPI"
COMBINATION_PARTS = "face:combination:shapes"
COMBINATION_MODE = "face:combination:mode"
COMBINATION_WEIGHTS = "face:combination:weights"
COMBINATION_SPANS = "face:combination:spans"

_SAME_WEIGHT = 1e-6
"""Difference from 0 or 1 up to which UsdSkel ignores an in-between."""


@refusing_wrong_types
def read_rig(
    path: Path, *, prim: str | None = None, variants: tuple[tuple[str, str, str], ...] = ()
) -> Rig:
    """Read a character's face.

    Parameters
    ----------
    path : Path
        A USD file with a SkelRoot, a Skeleton and meshes bound to BlendShapes.
    prim : str, optional
        Path of the SkelRoot, or of a prim above it, if the file has several faces.
    variants : tuple of (prim path, variant set, variant)
        Selections instead of the file's.
    """
    stage = open_variant(path, variants)
    root = find_face(stage, path, prim)
    ours = stage_to_ours(stage)
    rest = RestPose(UsdSkel.Root(root), ours)
    meshes = tuple(_read_mesh(mesh, rest, path) for mesh in prims_below(root, UsdGeom.Mesh))
    every = tuple(dict.fromkeys(shape.name for mesh in meshes for shape in mesh.shapes))
    combinations = read_combinations(root, path)
    driven = {each.shape for each in combinations}
    shapes = tuple(name for name in every if name not in driven)
    return Rig(
        file=path,
        prim=str(root.GetPath()),
        shapes=shapes,
        meshes=meshes,
        ranges=_read_ranges(root, shapes, path),
        combinations=combinations,
        variants=variants,
    )


def open_variant(path: Path, variants: tuple[tuple[str, str, str], ...]) -> Usd.Stage:
    """Open a rig with selections of its variants; see `Rig.variants`."""
    stage = open_stage(path)
    with Usd.EditContext(stage, stage.GetSessionLayer()):
        for at, name, variant in variants:
            stage.OverridePrim(at).GetVariantSet(name).SetVariantSelection(variant)
    return stage


def shape_prims(root: Usd.Prim) -> Iterator[tuple[str, Usd.Prim]]:
    """Yield name and BlendShape prim of the shapes of all meshes below a prim."""
    for mesh in prims_below(root, UsdGeom.Mesh):
        binding = UsdSkel.BindingAPI(mesh)
        names = binding.GetBlendShapesAttr().Get() or []
        targets = binding.GetBlendShapeTargetsRel().GetTargets() if names else []
        for name, target in zip(names, targets, strict=False):  # `_read_mesh` refuses others
            yield str(name), root.GetStage().GetPrimAtPath(target)


def channel_shapes(mesh: UsdSkel.BindingAPI) -> dict[str, str]:
    """Return the name of the BlendShape prim of each channel of a mesh.

    Without the mesh's name, `head_GEO_jawOpen`, unless the channel is named like the prim.
    """
    channels = names_in(mesh.GetBlendShapesAttr())
    targets = [each.name for each in mesh.GetBlendShapeTargetsRel().GetTargets()]
    own = f"{mesh.GetPrim().GetName()}_"
    return {
        channel: target if channel == target else target.removeprefix(own)
        for channel, target in zip(channels, targets, strict=False)
    }


def channels_per_mesh(meshes: Iterable[UsdSkel.BindingAPI]) -> dict[str, list[str]]:
    """Return each shape's channels if these are named after mesh and shape, as in Maya.

    That is, if every channel consists of a prefix of its mesh and the name of its BlendShape prim;
    else nothing. By the prims' names; the channel of the mesh with the most shapes first.
    """
    by_mesh = []
    for mesh in meshes:
        shape_of = channel_shapes(mesh)
        prefixes = {channel.removesuffix(shape) for channel, shape in shape_of.items()}
        if len(prefixes) > 1 or prefixes & {"", *shape_of}:
            return {}
        by_mesh.append({shape: channel for channel, shape in shape_of.items()})
    by_shape: dict[str, list[str]] = {}
    for channel_of in sorted(by_mesh, key=len, reverse=True):
        for shape, channel in channel_of.items():
            if channel not in by_shape.setdefault(shape, []):
                by_shape[shape].append(channel)
    return by_shape


def read_combinations(root: Usd.Prim, path: Path) -> tuple[Combination, ...]:
    """Read the combinations below a SkelRoot; see `order_combinations`.

    Channels of one shape on several meshes are driven by that of the mesh with the most shapes.
    """
    combinations, names = dict[str, Combination](), set[str]()
    for name, prim in shape_prims(root):
        names.add(name)
        parts = names_in(prim.GetAttribute(COMBINATION_PARTS)) if prim else ()
        if not parts:
            continue
        combination = Combination(
            shape=name,
            parts=parts,
            mode=cast(CombinationMode, text_of(prim, COMBINATION_MODE) or "product"),
            weights=tuple(map(float, value_of(prim, COMBINATION_WEIGHTS) or ())),
            spans=tuple((low, high) for low, high in value_of(prim, COMBINATION_SPANS) or ()),
        )
        if combinations.setdefault(name, combination) != combination:
            raise InputError(
                f"{path} <{prim.GetPath()}>: states {combination}, another mesh "
                f"{combinations[name]}; make them equal"
            )
    for first, *others in channels_per_mesh(
        map(UsdSkel.BindingAPI, prims_below(root, UsdGeom.Mesh))
    ).values():
        for name in others:
            combinations.setdefault(name, Combination(name, (first,)))
    return order_combinations(combinations.values(), names, source=path)


def skeletons_of(root: Usd.Prim) -> list[Usd.Prim]:
    """Return the skeletons of the meshes with BlendShapes below a SkelRoot."""
    skeletons: dict[str, Usd.Prim] = {}
    for mesh in prims_below(root, UsdGeom.Mesh):
        if UsdSkel.BindingAPI(mesh).GetBlendShapesAttr().HasAuthoredValue():
            skeleton = UsdSkel.BindingAPI(mesh).GetInheritedSkeleton()
            if skeleton:
                skeletons[str(skeleton.GetPath())] = skeleton.GetPrim()
    return list(skeletons.values())


def faces_below(top: Usd.Prim) -> list[Usd.Prim]:
    """Return the outermost SkelRoots with BlendShapes below a prim."""
    faces = [
        root
        for root in prims_below(top, UsdSkel.Root)
        if any(map(_has_shapes, prims_below(root, UsdGeom.Mesh)))
    ]
    return [
        each
        for each in faces
        if not any(each.GetPath().HasPrefix(other.GetPath()) and each != other for other in faces)
    ]


def find_face(stage: Usd.Stage, path: Path, prim: str | None) -> Usd.Prim:
    """Return the one SkelRoot with BlendShapes in a stage, or below a prim of it."""
    top = prim_or_root(stage, prim, file=path, option="--prim")
    faces = faces_below(top)
    if not faces:
        orphans = [each for each in Usd.PrimRange(top) if _has_shapes(each)]
        if orphans:
            raise InputError(
                f"{path} <{orphans[0].GetPath()}>: has BlendShapes but no SkelRoot above it, so "
                "nothing can animate it; put it under a SkelRoot"
            )
        roots = prims_below(top, UsdSkel.Root)
        what = "no mesh with BlendShapes under its SkelRoot" if roots else "no SkelRoot"
        raise InputError(f"{path}: {what}; a rig needs meshes bound to BlendShapes (UsdSkel)")
    if len(faces) > 1:
        names = ", ".join(f"<{each.GetPath()}>" for each in faces)
        raise InputError(
            f"{path}: holds {len(faces)} faces, {names}; name one with --prim (`map`: --rig-prim)"
        )
    face = faces[0]
    if not skeletons_of(face):
        raise InputError(
            f"{path} <{face.GetPath()}>: its meshes have BlendShapes but no skel:skeleton; UsdSkel "
            "animates them only through a Skeleton: bind the meshes to one (a single joint will "
            "do) and apply SkelBindingAPI to them"
        )
    _check_below_top(face, path)
    _check_moves(face, path)
    return face


def _check_below_top(face: Usd.Prim, path: Path) -> None:
    """Refuse skeletons and BlendShapes that a reference to the face's top prim does not bring."""
    top = top_path(face.GetPath())
    used = [each.GetPath() for each in skeletons_of(face)]
    for mesh in prims_below(face, UsdGeom.Mesh):
        used += UsdSkel.BindingAPI(mesh).GetBlendShapeTargetsRel().GetTargets()
    outside = [each for each in used if not each.HasPrefix(top)]
    if outside:
        raise InputError(
            f"{path} <{outside[0]}>: moves <{face.GetPath()}> and lies outside <{top}>, the prim "
            f"that performances reference: the face would not move in them; put it below <{top}>"
        )


def _check_moves(face: Usd.Prim, path: Path) -> None:
    """Refuse a face of which USD animates no mesh."""
    still = still_meshes(UsdSkel.Root(face))
    bound = filter(_has_shapes, prims_below(face, UsdGeom.Mesh))
    if still and all(
        str(mesh.GetPath()) in still or not UsdSkel.BindingAPI(mesh).GetInheritedSkeleton()
        for mesh in bound
    ):
        mesh, reason = next(iter(still.items()))
        raise InputError(f"{path} <{mesh}>: {reason}")


def _has_shapes(prim: Usd.Prim) -> bool:
    return prim.IsA(UsdGeom.Mesh) and bool(UsdSkel.BindingAPI(prim).GetBlendShapesAttr().Get())


def _read_mesh(prim: Usd.Prim, rest: RestPose, path: Path) -> RigMesh:
    mesh, where = UsdGeom.Mesh(prim), f"{path} <{prim.GetPath()}>"
    bare, _, placed = read_geometry(prim, rest, where)
    face_colors, undrawn = read_face_colors(prim, len(bare.face_counts))
    visible = mesh.ComputeVisibility() != UsdGeom.Tokens.invisible
    drawn = mesh.ComputePurpose() in (UsdGeom.Tokens.default_, UsdGeom.Tokens.render)
    binding = UsdSkel.BindingAPI(prim)
    names = [str(name) for name in binding.GetBlendShapesAttr().Get() or []]
    targets = binding.GetBlendShapeTargetsRel().GetTargets()
    if len(names) != len(targets):
        raise InputError(
            f"{where}: {len(names)} skel:blendShapes but {len(targets)} skel:blendShapeTargets; "
            "they must pair up"
        )
    shapes = []
    for name, target in zip(names, targets, strict=True):
        shape = UsdSkel.BlendShape(prim.GetStage().GetPrimAtPath(target))
        if not shape:
            raise InputError(
                f"{where}: shape {name} targets <{target}>, which is no BlendShape; "
                "correct skel:blendShapeTargets"
            )
        shapes.append(MeshShape(name, _shape_keys(shape, placed, path)))
    return replace(
        bare,
        shapes=tuple(shapes),
        normals=_read_normals(mesh, placed, len(bare.face_indices)),
        visible=visible and drawn,
        face_colors=face_colors,
        undrawn=undrawn,
    )


def _shape_keys(shape: UsdSkel.BlendShape, placed: PlacedMesh, path: Path) -> tuple[ShapeKey, ...]:
    """Return the target and in-betweens by ascending weight."""
    where, point_count = f"{path} <{shape.GetPath()}>", len(placed.points)
    authored = shape.GetPointIndicesAttr().Get()
    points = np.arange(point_count) if not authored else np.array(authored, dtype=np.int64)
    if len(points) and (points.min() < 0 or points.max() >= point_count):
        raise InputError(
            f"{where}: pointIndices name a point beyond the mesh's {point_count}; repair the shape"
        )

    def check(values: object, what: str) -> FloatArray:
        array = np.array(values if values is not None else [], dtype=np.float64).reshape(-1, 3)
        if len(array) != len(points):
            raise InputError(
                f"{where}: {len(array)} {what} for {len(points)} points; they must pair up"
            )
        if not np.isfinite(array).all():
            raise InputError(f"{where}: {what} hold NaN or infinity; repair the shape")
        return array

    def key(weight: float, offsets: FloatArray, turned: object) -> ShapeKey:
        normals = placed.normals(check(turned, "normalOffsets"), points) if turned else None
        return ShapeKey(weight, points, placed.offsets(points, offsets), normals)

    offsets = shape.GetOffsetsAttr().Get()
    # A shape may turn normals alone, and then has no offsets.
    moved = check(offsets, "offsets") if offsets else np.zeros((len(points), 3))
    keys = [key(1.0, moved, shape.GetNormalOffsetsAttr().Get())]
    for between in shape.GetInbetweens():
        weight = between.GetWeight()
        # UsdSkel ignores an in-between at 0 or 1, where the neutral and the target are.
        if weight is None or min(abs(weight), abs(weight - 1.0)) <= _SAME_WEIGHT:
            continue
        if weight in [each.weight for each in keys]:
            raise InputError(f"{where}: has two in-betweens at weight {weight:g}; remove one")
        offsets = check(between.GetOffsets(), f"offsets of in-between {weight:g}")
        keys.append(key(float(weight), offsets, between.GetNormalOffsets()))
    return tuple(sorted(keys, key=lambda each: each.weight))


def _read_ranges(root: Usd.Prim, shapes: tuple[str, ...], path: Path) -> FloatArray:
    stated = dict[str, tuple[float, float]]()
    for name, prim in shape_prims(root):
        low, high = value_of(prim, RANGE_ATTRIBUTE) or (0.0, 0.0)
        if not (np.isfinite([low, high]).all() and low <= high):
            raise InputError(
                f"{path} <{prim.GetPath()}>: {RANGE_ATTRIBUTE} is {low:g} to {high:g}; write two "
                "finite weights, the lowest first"
            )
        if low < high and stated.setdefault(name, (low, high)) != (low, high):
            raise InputError(
                f"{path} <{prim.GetPath()}>: {RANGE_ATTRIBUTE} is {low:g} to {high:g}, on another "
                f"mesh {stated[name][0]:g} to {stated[name][1]:g}; one weight moves both: make "
                "them equal"
            )
    return np.array([stated.get(name, (0.0, 1.0)) for name in shapes], float).reshape(-1, 2)


def _read_normals(mesh: UsdGeom.Mesh, placed: PlacedMesh, corner_count: int) -> FloatArray | None:
    """Return a unit normal of each point, where they are authored so."""
    interpolation, _, normals = authored_normals(mesh, len(placed.points), corner_count)
    if normals is None or interpolation != "vertex":
        return None
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    if not np.isfinite(normals).all() or not (length > 0).all():
        return None
    return placed.normals(normals / length)
