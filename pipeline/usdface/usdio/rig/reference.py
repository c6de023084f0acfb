"""Reference a rig into another stage and point its skeletons at an animation."""

import contextlib
import os
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pxr import Ar, Gf, Sdf, Usd, UsdGeom, UsdSkel

from usdface.core.assets import Rig
from usdface.core.errors import InputError
from usdface.usdio.authoring import apply_api, author_uniform, define_prim
from usdface.usdio.layers import open_stage, relative_path, usd_errors_as_input_errors
from usdface.usdio.rig.read import skeletons_of
from usdface.usdio.units import MM_PER_STAGE_UNIT, stage_to_ours

UNITS = "xformOp:transform:units"


def default_place(rig: Rig) -> str:
    """Return where a rig goes when nobody says: the path of its own top prim."""
    return str(Sdf.Path(rig.prim).GetPrefixes()[0])


def define_reference(
    layer: Sdf.Layer, place: str, rig: Rig, layer_path: Path, *, again: bool = False
) -> None:
    """Define a prim that references the rig's top prim; prims above it become Xforms.

    What else the prim references stays, and in its order.

    Parameters
    ----------
    layer_path : Path
        Where the layer goes, which may have a temporary name.
    again : bool
        Whether this was done to the layer before, perhaps with another rig: that one's reference
        is then replaced.
    """
    source = Sdf.Path(rig.prim).GetPrefixes()[0]
    for above in Sdf.Path(place).GetParentPath().GetPrefixes():
        if not layer.GetPrimAtPath(above):
            define_prim(layer, above, "Xform")
    prim = Sdf.CreatePrimInLayer(layer, place)
    prim.specifier = Sdf.SpecifierDef
    reference = Sdf.Reference(relative_path(rig.file, layer_path), source)
    references = prim.referenceList
    name = "explicitItems" if references.isExplicit else "prependedItems"
    there = list(getattr(references, name))
    ours = _ours_among(there, reference, rig.file, layer_path, again=again)
    setattr(references, name, [*there[: ours.start], reference, *there[ours.stop :]])


def turn_to_our_units(layer: Sdf.Layer, place: str, rig: Rig) -> None:
    """Turn and scale a referenced rig to centimetres, Y up, beside what the layer itself holds.

    USD converts no units: a rig in metres, Z up, would lie on its back at a hundredth of its size.
    """
    stage = open_stage(rig.file)
    ours = stage_to_ours(stage) / MM_PER_STAGE_UNIT
    if np.allclose(ours, np.eye(3)):
        return
    top = UsdGeom.Xformable(stage.GetPrimAtPath(Sdf.Path(rig.prim).GetPrefixes()[0]))
    own = list(top.GetXformOpOrderAttr().Get() or ()) if top else []
    turned = np.eye(4)
    turned[:3, :3] = ours.T  # row vectors
    prim = Sdf.CreatePrimInLayer(layer, place)
    Sdf.AttributeSpec(prim, UNITS, Sdf.ValueTypeNames.Matrix4d).default = Gf.Matrix4d(
        turned.tolist()
    )
    author_uniform(prim, "xformOpOrder", Sdf.ValueTypeNames.TokenArray, [UNITS, *map(str, own)])


def _ours_among(
    there: list[Sdf.Reference],
    reference: Sdf.Reference,
    file: Path,
    layer_path: Path,
    *,
    again: bool,
) -> range:
    """Return which reference is to be replaced: that to the same file, or that to another rig.

    The other rig's is the first to a prim of this name, or the first of all, as we put it there.
    """
    for index, each in enumerate(there):
        if _is_file_of(each, {file.resolve()}, layer_path):
            return range(index, index + 1)
    if not again or not there:
        return range(0)
    names = [each.primPath for each in there]
    first = names.index(reference.primPath) if reference.primPath in names else 0
    return range(first, first + 1)


def remove_reference(layer: Sdf.Layer, place: str, files: Collection[Path], at: Path) -> None:
    """Take out a rig that stood elsewhere before, and what was defined for it alone.

    Parameters
    ----------
    place : str
        Where it stood. What others put there stays.
    files : collection of Path
        References to these are ours, resolved.
    at : Path
        Where the layer goes, which may have a temporary name.
    """
    prim = layer.GetPrimAtPath(place)
    if prim is None:
        return
    for name in ("explicitItems", "prependedItems"):
        there = list(getattr(prim.referenceList, name))
        kept = [each for each in there if not _is_file_of(each, files, at)]
        if len(kept) < len(there):
            setattr(prim.referenceList, name, kept)
    if not prim.hasReferences:
        prim.ClearReferenceList()
    while prim is not None and _is_empty(prim):
        above = prim.nameParent
        siblings = layer.rootPrims if above is None else above.nameChildren
        del siblings[prim.name]
        prim = above


def _is_empty(prim: Sdf.PrimSpec) -> bool:
    """Whether a prim is only there, with a type at most."""
    opinions = set(prim.ListInfoKeys()) - {"specifier", "typeName"}
    return not (opinions or prim.nameChildren or prim.properties or prim.variantSets)


def _is_file_of(reference: Sdf.Reference, files: Collection[Path], at: Path) -> bool:
    """Whether a reference is to one of these, as USD reads it or as the system does."""
    if not reference.assetPath:
        return False
    named = at.parent / reference.assetPath
    return not {named.resolve(), Path(os.path.normpath(named.absolute())).resolve()}.isdisjoint(
        files
    )


def point_skeletons_at(layer: Sdf.Layer, place: str, rig: Rig, animation: Sdf.Path) -> None:
    """Write overs that make the rig's skeletons follow an animation, wherever the rig is placed.

    Raises
    ------
    InputError
        If a skeleton lies inside an instanceable prim, where USD ignores overs.
    """
    stage = open_stage(rig.file)
    top = Sdf.Path(rig.prim).GetPrefixes()[0]
    for skeleton in skeletons_of(stage.GetPrimAtPath(rig.prim)):
        if skeleton.IsInstanceProxy():
            raise InputError(
                f"{rig.file} <{skeleton.GetPath()}>: lies inside an instanceable prim, and USD "
                "ignores what is said below one; set instanceable = false there"
            )
        path = skeleton.GetPath().ReplacePrefix(top, Sdf.Path(place))
        over = Sdf.CreatePrimInLayer(layer, path)
        apply_api(over, "SkelBindingAPI")
        source = Sdf.RelationshipSpec(over, "skel:animationSource", False)
        source.targetPathList.explicitItems = [animation]


def place_of(stage: Usd.Stage, animation: Usd.Prim) -> str:
    """Return where the rig that an animation drives stands: the prim to reference its top prim at.

    That is the animation's parent in what we write. Other tools put animations beside the rig.
    """
    for prim in stage.Traverse():
        if not (prim.IsA(UsdSkel.Skeleton) and _follows(prim, animation)):
            continue
        source = _source_of(prim, animation)
        if source is not None:
            below = source.skeleton.MakeRelativePath(source.skeleton.GetPrefixes()[0])
            place = prim.GetPath()
            for _ in range(below.pathElementCount):
                place = place.GetParentPath()
            if not place.isEmpty and place.AppendPath(below) == prim.GetPath():
                return str(place)
    return str(animation.GetPath().GetParentPath())


def rig_of(stage: Usd.Stage, animation: Usd.Prim) -> tuple[Path, str]:
    """Return the file and SkelRoot of the rig that an animation drives in a composed stage.

    The file is the one that is referenced where the animation meets the rig, not one of those that
    the rig is built from.
    """
    moved = os.environ.get(_MOVED_RIG)
    for prim in stage.Traverse():
        if prim.IsA(UsdSkel.Skeleton) and _follows(prim, animation):
            source = _source_of(prim, animation)
            if source is not None:
                return Path(moved) if moved else source.file, source.root
    where = f"{stage.GetRootLayer().realPath} <{animation.GetPath()}>"
    missing = missing_reference(stage.GetPseudoRoot())
    if missing is None:
        raise InputError(f"{where}: no rig follows this animation; reference the rig it is for")
    file, top = missing
    if moved:
        return Path(moved), top
    remedy = "say where it is by --rig"
    if moved is None:
        remedy = "write the performance on it where it is by `usdface join PERFORMANCE --rig RIG`"
    raise InputError(f"{where}: its rig, {file}, is gone; put it back, or {remedy}")


_MOVED_RIG = "USDFACE_MOVED_RIG"
"""Of the environment, which the processes that draw a movie share; empty where --rig is not given,
and not there where a command has no --rig."""


@contextlib.contextmanager
def moved_rig(rig: Path | None) -> Iterator[None]:
    """Take the rig of every performance and of all references from one file; None changes nothing.

    The prim is the one they refer to.
    """
    before = os.environ.get(_MOVED_RIG)
    os.environ[_MOVED_RIG] = "" if rig is None else str(rig.resolve())
    try:
        yield
    finally:
        if before is None:
            del os.environ[_MOVED_RIG]
        else:
            os.environ[_MOVED_RIG] = before


def stage_with_rig(path: Path, rig: Rig, place: Sdf.Path) -> Usd.Stage:
    """Open a performance with its rig from where that is now."""
    layer = Sdf.Layer.CreateAnonymous(".usda")
    layer.subLayerPaths = [str(path.resolve())]
    prim = Sdf.CreatePrimInLayer(layer, place)
    reference = Sdf.Reference(str(rig.file.resolve()), Sdf.Path(rig.prim).GetPrefixes()[0])
    prim.referenceList.prependedItems = [reference]
    with usd_errors_as_input_errors(path, "composing it"):
        return Usd.Stage.Open(layer)


def missing_reference(top: Usd.Prim) -> tuple[str, str] | None:
    """Return the first file that a prim refers to and that is gone, and the prim in it."""
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
    own = binding.GetAnimationSourceRel()
    if own and own.HasAuthoredTargets():
        return animation.GetPath() in own.GetTargets()
    source = binding.GetInheritedAnimationSource()
    return bool(source) and source.GetPath() == animation.GetPath()


@dataclass(frozen=True)
class _Source:
    """Where a skeleton comes from."""

    file: Path
    """The rig."""
    root: str
    """Its SkelRoot."""
    skeleton: Sdf.Path
    """The skeleton in it."""


def _source_of(skeleton: Usd.Prim, animation: Usd.Prim) -> _Source | None:
    return _referenced_rig(skeleton, animation) or _defining_rig(skeleton)


def _referenced_rig(skeleton: Usd.Prim, animation: Usd.Prim) -> _Source | None:
    """Return the outermost file, referenced or a payload, with the skeleton and no animation.

    One that has the animation as well is a performance, which a shot may reference in its turn.
    """
    arcs = Usd.PrimCompositionQuery.Filter()
    arcs.arcTypeFilter = Usd.PrimCompositionQuery.ArcTypeFilter.ReferenceOrPayload
    arcs.dependencyTypeFilter = Usd.PrimCompositionQuery.DependencyTypeFilter.Direct
    for place in skeleton.GetPath().GetPrefixes():
        query = Usd.PrimCompositionQuery(skeleton.GetStage().GetPrimAtPath(place))
        query.filter = arcs
        for arc in query.GetCompositionArcs():
            file = arc.GetTargetLayer().realPath
            if not file or arc.GetTargetNode().layerStack == arc.GetIntroducingNode().layerStack:
                continue  # a reference within one file
            target = arc.GetTargetPrimPath().StripAllVariantSelections()
            opened = _open(file)
            if not opened.GetPrimAtPath(animation.GetPath().ReplacePrefix(place, target)):
                inside = skeleton.GetPath().ReplacePrefix(place, target)
                found = _skel_root_above(opened, inside)
                if found:
                    return _Source(Path(file), found, inside)
    return None


def _defining_rig(skeleton: Usd.Prim) -> _Source | None:
    """Return the weakest file that defines a skeleton: where nothing is referenced."""
    for spec in reversed(skeleton.GetPrimStack()):
        if spec.layer.realPath and spec.specifier == Sdf.SpecifierDef:
            found = _skel_root_above(_open(spec.layer.realPath), spec.path)
            if found:
                return _Source(Path(spec.layer.realPath), found, spec.path)
    return None


def _open(file: str) -> Usd.Stage:
    if Ar.IsPackageRelativePath(file):  # was opened, and checked, with its package
        return Usd.Stage.Open(file)
    return open_stage(Path(os.path.relpath(file)))


def _skel_root_above(stage: Usd.Stage, skeleton: Sdf.Path) -> str:
    prim = stage.GetPrimAtPath(skeleton)
    while prim and not prim.IsA(UsdSkel.Root):
        prim = prim.GetParent()
    return str(prim.GetPath()) if prim else ""


def carry_variants(layer: Sdf.Layer, stage: Usd.Stage, place: str, rig: Path, top: str) -> None:
    """Choose in a layer what a stage has of a rig's variants, where that is not the rig's own.

    Parameters
    ----------
    layer : Sdf.Layer
        Has the rig at the same place.
    place : str
        Where the rig stands.
    rig : Path
        Its file.
    top : str
        The prim of that file which is referenced.
    """
    own = open_stage(rig)
    for prim in Usd.PrimRange(stage.GetPrimAtPath(place)):
        sets = prim.GetVariantSets()
        for name in sets.GetNames():
            choice = sets.GetVariantSelection(name)
            there = own.GetPrimAtPath(prim.GetPath().ReplacePrefix(Sdf.Path(place), Sdf.Path(top)))
            if not there or there.GetVariantSet(name).GetVariantSelection() != choice:
                Sdf.CreatePrimInLayer(layer, prim.GetPath()).variantSelections[name] = choice
