"""Reference a rig into another stage and point its skeletons at an animation."""

import contextlib
import os
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdSkel

from usdface.core.assets import Rig
from usdface.core.errors import InputError
from usdface.core.rig_logic import Combination
from usdface.core.text import pluralize
from usdface.usdio.authoring import (
    apply_api,
    author_uniform,
    check_not_instanced,
    define_prim,
    define_reference_prim,
    names_in,
    top_path,
)
from usdface.usdio.layers import (
    open_stage,
    refusing_wrong_types,
    relative_path,
    usd_errors_as_input_errors,
)
from usdface.usdio.rig.read import (
    faces_below,
    find_face,
    read_combinations,
    read_rig,
    skeletons_of,
)
from usdface.usdio.units import MM_PER_STAGE_UNIT, row_matrix, stage_to_ours

UNITS = "xformOp:transform:units"


def define_reference(
    layer: Sdf.Layer, rig_path: str, rig: Rig, layer_path: Path, *, replace_rig: bool = False
) -> None:
    """Define a prim that references the rig's top prim; prims above it become Xforms.

    Other references of the prim are preserved.

    Parameters
    ----------
    layer_path : Path
        Final path of the layer.
    replace_rig : bool
        Replace the layer's reference to its previous rig, if it has none to this one.
    """
    source = top_path(rig.prim)
    for above in Sdf.Path(rig_path).GetParentPath().GetPrefixes():
        if not layer.GetPrimAtPath(above):
            define_prim(layer, above, "Xform")
    prim = Sdf.CreatePrimInLayer(layer, rig_path)
    prim.specifier = Sdf.SpecifierDef
    reference = Sdf.Reference(relative_path(rig.file, layer_path), source)
    references = prim.referenceList
    name = "explicitItems" if references.isExplicit else "prependedItems"
    existing = list(getattr(references, name))
    ours = _index_to_replace(existing, reference, rig.file, layer_path, replace_rig=replace_rig)
    setattr(references, name, [*existing[: ours.start], reference, *existing[ours.stop :]])


def convert_to_our_units(layer: Sdf.Layer, rig_path: str, rig: Rig) -> None:
    """Rotate and scale a referenced rig to centimetres, Y up; USD does not convert units."""
    stage = open_stage(rig.file)
    ours = stage_to_ours(stage) / MM_PER_STAGE_UNIT
    if np.allclose(ours, np.eye(3)):
        return
    top = UsdGeom.Xformable(stage.GetPrimAtPath(top_path(rig.prim)))
    operations = [each.GetOpName() for each in top.GetOrderedXformOps()] if top else []
    reset = [UsdGeom.XformOpTypes.resetXformStack] if top and top.GetResetXformStack() else []
    prim = Sdf.CreatePrimInLayer(layer, rig_path)
    Sdf.AttributeSpec(prim, UNITS, Sdf.ValueTypeNames.Matrix4d).default = row_matrix(ours)
    order = [*reset, UNITS, *operations]  # USD drops what is before a reset
    author_uniform(prim, "xformOpOrder", Sdf.ValueTypeNames.TokenArray, order)


def _index_to_replace(
    existing: list[Sdf.Reference],
    reference: Sdf.Reference,
    file: Path,
    layer_path: Path,
    *,
    replace_rig: bool,
) -> range:
    """Return the reference to replace: that to the same file, or that to a previous rig.

    The previous rig's is the first to a prim of this name, or the first.
    """
    for index, each in enumerate(existing):
        if _is_file_of(each, {file.resolve()}, layer_path):
            return range(index, index + 1)
    if not replace_rig or not existing:
        return range(0)
    names = [each.primPath for each in existing]
    first = names.index(reference.primPath) if reference.primPath in names else 0
    return range(first, first + 1)


def remove_reference(layer: Sdf.Layer, rig_path: str, files: Collection[Path], at: Path) -> None:
    """Remove a rig from its previous path, with prims that are empty without it.

    Parameters
    ----------
    files : collection of Path
        Resolved files, references to which are removed; others are preserved.
    at : Path
        Final path of the layer.
    """
    prim = layer.GetPrimAtPath(rig_path)
    if prim is None:
        return
    for name in ("explicitItems", "prependedItems"):
        existing = list(getattr(prim.referenceList, name))
        others = [each for each in existing if not _is_file_of(each, files, at)]
        if len(others) < len(existing):
            setattr(prim.referenceList, name, others)
    if not prim.hasReferences:
        prim.ClearReferenceList()
    while prim is not None and _is_empty(prim):
        above = prim.nameParent
        siblings = layer.rootPrims if above is None else above.nameChildren
        del siblings[prim.name]
        prim = above


def _is_empty(prim: Sdf.PrimSpec) -> bool:
    """Whether a prim has no opinions but its type."""
    opinions = set(prim.ListInfoKeys()) - {"specifier", "typeName"}
    return not (opinions or prim.nameChildren or prim.properties or prim.variantSets)


def _is_file_of(reference: Sdf.Reference, files: Collection[Path], at: Path) -> bool:
    """Whether a reference is to one of these files, resolved by USD or by the system."""
    if not reference.assetPath:
        return False
    named = at.parent / reference.assetPath
    return not {named.resolve(), Path(os.path.normpath(named.absolute())).resolve()}.isdisjoint(
        files
    )


def point_skeletons_at(layer: Sdf.Layer, rig_path: str, rig: Rig, animation: Sdf.Path) -> None:
    """Write overs that make the rig's skeletons follow an animation."""
    stage = open_stage(rig.file)
    top = top_path(rig.prim)
    for skeleton in skeletons_of(stage.GetPrimAtPath(rig.prim)):
        check_not_instanced(rig.file, skeleton)
        path = skeleton.GetPath().ReplacePrefix(top, Sdf.Path(rig_path))
        over = Sdf.CreatePrimInLayer(layer, path)
        apply_api(over, "SkelBindingAPI")
        source = Sdf.RelationshipSpec(over, "skel:animationSource", False)
        source.targetPathList.explicitItems = [animation]


def rig_path_of(stage: Usd.Stage, animation: Usd.Prim) -> str:
    """Return the prim path of the rig that an animation drives: that of its top prim.

    In our files it is the animation's parent; other tools use other places.
    """
    for skeleton, source in _driven_rigs(stage, animation):
        below = source.skeleton.MakeRelativePath(top_path(source.skeleton))
        rig_path = skeleton
        for _ in range(below.pathElementCount):
            rig_path = rig_path.GetParentPath()
        if not rig_path.isEmpty and rig_path.AppendPath(below) == skeleton:
            return str(rig_path)
    return str(animation.GetPath().GetParentPath())


def rig_of(stage: Usd.Stage, animation: Usd.Prim) -> tuple[Path, str]:
    """Return the file and SkelRoot of the rig that an animation drives in a composed stage.

    The outermost file with the rig and without the animation.
    """
    moved = os.environ.get(_MOVED_RIG)
    for _, source in _driven_rigs(stage, animation):
        return Path(moved) if moved else source.file, source.root
    where = f"{stage.GetRootLayer().realPath} <{animation.GetPath()}>"
    missing = missing_reference(stage.GetPseudoRoot())
    if missing is None:
        raise InputError(f"{where}: no rig follows this animation; reference the rig it is for")
    file, top = missing
    if moved:
        return Path(moved), _bound_face(stage, animation, moved, top)
    remedy = "say where it is by --rig"
    if moved is None:
        remedy = "write the performance on it where it is by `usdface join PERFORMANCE --rig RIG`"
    raise InputError(f"{where}: its rig, {file}, is gone; put it back, or {remedy}")


def _bound_face(stage: Usd.Stage, animation: Usd.Prim, file: str, top: str) -> str:
    """Return the SkelRoot of a file whose skeleton follows an animation in a stage without it."""
    opened, rig_path = _open(file), animation.GetPath().GetParentPath()
    bound = (each.GetPath() for each in stage.TraverseAll() if _follows(each, animation))
    roots = (_skel_root_above(opened, path.ReplacePrefix(rig_path, top)) for path in bound)
    return next(filter(None, roots), top)


@refusing_wrong_types
def replaced_motion_notes(stage: Usd.Stage, animation: Usd.Prim) -> list[str]:
    """Return a note if the rig's skeletons have an animation of joints, which another replaces."""
    file, prim = rig_of(stage, animation)
    rig_path, ours = rig_path_of(stage, animation), _joints(animation)
    rig_stage = open_stage(file)  # prims do not outlive their stage
    for skeleton in skeletons_of(rig_stage.GetPrimAtPath(prim)):
        source = UsdSkel.BindingAPI(skeleton).GetInheritedAnimationSource()
        joints = _joints(source) if source else ()
        if not set(joints) <= set(ours):
            at = source.GetPath().ReplacePrefix(top_path(prim), rig_path)
            return [
                f"{file.name} has an animation of {pluralize(len(joints), 'joint')}, <{at}>, "
                "which the solve replaces, as a skeleton has one: the joints rest. To keep "
                f"it, add `references = <{at}>` to <{animation.GetPath()}> in "
                f"{Path(stage.GetRootLayer().realPath).name}"
            ]
    return []


def _joints(animation: Usd.Prim) -> tuple[str, ...]:
    return names_in(UsdSkel.Animation(animation).GetJointsAttr())


_MOVED_RIG = "USDFACE_MOVED_RIG"
"""Environment variable, which worker processes inherit; empty without --rig, unset for commands
that do not have the option."""


@contextlib.contextmanager
def moved_rig(rig: Path | None) -> Iterator[None]:
    """Read the rig of all performances and references from one file, unless it is None."""
    before = os.environ.get(_MOVED_RIG)
    os.environ[_MOVED_RIG] = "" if rig is None else str(rig.resolve())
    try:
        yield
    finally:
        if before is None:
            del os.environ[_MOVED_RIG]
        else:
            os.environ[_MOVED_RIG] = before


def stage_with_rig(path: Path, rig: Rig, rig_path: Sdf.Path) -> Usd.Stage:
    """Open a performance with a reference to its rig, if its own is missing."""
    layer = Sdf.Layer.CreateAnonymous(".usda")
    layer.subLayerPaths = [str(path.resolve())]
    define_reference_prim(layer, rig_path, str(rig.file.resolve()), top_path(rig.prim))
    with usd_errors_as_input_errors(path, "composing it"):
        return Usd.Stage.Open(layer)


def missing_reference(top: Usd.Prim) -> tuple[str, str] | None:
    """Return the first missing file that prims refer to, and the prim in it."""
    below = Usd.PrimRange.AllPrims(top)
    specs = (spec for prim in below for spec in prim.GetPrimStack())
    for spec in specs:
        arcs = (spec.referenceList, spec.payloadList)
        for each in (arc for arcs_of in arcs for arc in arcs_of.GetAddedOrExplicitItems()):
            file = spec.layer.ComputeAbsolutePath(each.assetPath) if each.assetPath else ""
            if file and not Path(file).exists():
                return file, str(each.primPath)
    return None


def _follows(skeleton: Usd.Prim, animation: Usd.Prim) -> bool:
    binding = UsdSkel.BindingAPI(skeleton)
    relationship = binding.GetAnimationSourceRel()
    if relationship and relationship.HasAuthoredTargets():
        return animation.GetPath() in relationship.GetTargets()
    source = binding.GetInheritedAnimationSource()
    return bool(source) and source.GetPath() == animation.GetPath()


@dataclass(frozen=True)
class _Source:
    """The rig of a skeleton."""

    file: Path
    root: str
    """Its SkelRoot."""
    skeleton: Sdf.Path
    """The skeleton in it."""


def _driven_rigs(stage: Usd.Stage, animation: Usd.Prim) -> Iterator[tuple[Sdf.Path, _Source]]:
    """Yield the skeletons of a stage that follow an animation, with the rig of each."""
    for prim in stage.Traverse(Usd.TraverseInstanceProxies()):
        if prim.IsA(UsdSkel.Skeleton) and _follows(prim, animation):
            source = _referenced_rig(prim, animation) or _defining_rig(prim)
            if source is not None:
                yield prim.GetPath(), source


def _referenced_rig(skeleton: Usd.Prim, animation: Usd.Prim) -> _Source | None:
    """Return the outermost reference or payload with the skeleton and without the animation.

    One with the animation is a performance.
    """
    arcs = Usd.PrimCompositionQuery.Filter()
    arcs.arcTypeFilter = Usd.PrimCompositionQuery.ArcTypeFilter.ReferenceOrPayload
    arcs.dependencyTypeFilter = Usd.PrimCompositionQuery.DependencyTypeFilter.Direct
    for at in skeleton.GetPath().GetPrefixes():
        query = Usd.PrimCompositionQuery(skeleton.GetStage().GetPrimAtPath(at))
        query.filter = arcs
        for arc in query.GetCompositionArcs():
            file = arc.GetTargetLayer().realPath
            if not file or arc.GetTargetNode().layerStack == arc.GetIntroducingNode().layerStack:
                continue  # a reference within one file
            target = arc.GetTargetPrimPath().StripAllVariantSelections()
            opened = _open(file)
            if not opened.GetPrimAtPath(animation.GetPath().ReplacePrefix(at, target)):
                inside = skeleton.GetPath().ReplacePrefix(at, target)
                if root := _skel_root_above(opened, inside):
                    return _Source(Path(file), root, inside)
    return None


def _defining_rig(skeleton: Usd.Prim) -> _Source | None:
    """Return the weakest file that defines a skeleton, for rigs that are not referenced."""
    for spec in reversed(skeleton.GetPrimStack()):
        if spec.layer.realPath and spec.specifier == Sdf.SpecifierDef:
            if root := _skel_root_above(_open(spec.layer.realPath), spec.path):
                return _Source(Path(spec.layer.realPath), root, spec.path)
    return None


def _open(file: str) -> Usd.Stage:
    return open_stage(Path(os.path.relpath(file)))


def _skel_root_above(stage: Usd.Stage, skeleton: Sdf.Path) -> str:
    prim = stage.GetPrimAtPath(skeleton)
    root = UsdSkel.Root.Find(prim) if prim else None
    return str(root.GetPath()) if root else ""


def read_rig_of_stage(stage: Usd.Stage, animation: Usd.Prim) -> Rig:
    """Read the rig that an animation drives, with the variants that the stage selects."""
    file, prim = rig_of(stage, animation)
    rig_path, top = rig_path_of(stage, animation), str(top_path(prim))
    return read_rig(file, prim=prim, variants=variant_choices(stage, rig_path, file, top))


def combinations_of(stage: Usd.Stage, animation: Usd.Prim, path: Path) -> tuple[Combination, ...]:
    """Read the combinations of the rig that an animation drives; none if it is gone."""
    top = stage.GetPrimAtPath(rig_path_of(stage, animation))
    faces = [
        face
        for face in (faces_below(top) if top else ())
        if any(_follows(skeleton, animation) for skeleton in skeletons_of(face))
    ]
    moved = os.environ.get(_MOVED_RIG)
    if moved and not faces:
        rig_stage = open_stage(Path(moved))  # prims do not outlive their stage
        faces = [find_face(rig_stage, Path(moved), rig_of(stage, animation)[1])]
    return tuple(dict.fromkeys(each for face in faces for each in read_combinations(face, path)))


def variant_choices(
    stage: Usd.Stage, rig_path: str, rig: Path, top: str
) -> tuple[tuple[str, str, str], ...]:
    """Return a stage's selections of a rig's variants that are not the rig's defaults.

    Parameters
    ----------
    rig_path : str
        Prim path of the rig in the stage.
    rig : Path
        Its file.
    top : str
        The referenced prim of the file.
    """
    rig_stage, choices = open_stage(rig), list[tuple[str, str, str]]()
    for prim in Usd.PrimRange(stage.GetPrimAtPath(rig_path)):
        sets = prim.GetVariantSets()
        for name in sets.GetNames():
            choice = sets.GetVariantSelection(name)
            path = prim.GetPath().ReplacePrefix(Sdf.Path(rig_path), Sdf.Path(top))
            default = rig_stage.GetPrimAtPath(path)
            if not default or default.GetVariantSet(name).GetVariantSelection() != choice:
                choices.append((str(path), name, choice))
    return tuple(choices)
