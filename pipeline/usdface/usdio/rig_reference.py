"""Reference a rig into another stage and point its skeletons at an animation."""

import os
from pathlib import Path

from pxr import Sdf, Usd, UsdSkel

from usdface.assets import Rig
from usdface.errors import InputError
from usdface.usdio.authoring import apply_api, define_prim
from usdface.usdio.layers import open_stage, relative_path
from usdface.usdio.rig import skeletons_of


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
    layer : Sdf.Layer
    place : str
    rig : Rig
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
        if each.assetPath and (layer_path.parent / each.assetPath).resolve() == file.resolve():
            return range(index, index + 1)
    if not again or not there:
        return range(0)
    names = [each.primPath for each in there]
    first = names.index(reference.primPath) if reference.primPath in names else 0
    return range(first, first + 1)


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


def rig_of(stage: Usd.Stage, animation: Usd.Prim) -> tuple[Path, str]:
    """Return the file and SkelRoot of the rig that an animation drives in a composed stage.

    The file is the one that is referenced where the animation meets the rig, not one of those that
    the rig is built from.

    Raises
    ------
    InputError
        If no skeleton follows the animation.
    """
    for prim in stage.Traverse():
        if prim.IsA(UsdSkel.Skeleton) and _follows(prim, animation):
            found = _referenced_rig(prim, animation) or _defining_rig(prim)
            if found is not None:
                return found
    raise InputError(
        f"{stage.GetRootLayer().realPath} <{animation.GetPath()}>: no rig follows this animation; "
        "is the rig's file still where it was?"
    )


def _follows(skeleton: Usd.Prim, animation: Usd.Prim) -> bool:
    binding = UsdSkel.BindingAPI(skeleton)
    own = binding.GetAnimationSourceRel()
    if own and own.HasAuthoredTargets():
        return animation.GetPath() in own.GetTargets()
    source = binding.GetInheritedAnimationSource()
    return bool(source) and source.GetPath() == animation.GetPath()


def _referenced_rig(skeleton: Usd.Prim, animation: Usd.Prim) -> tuple[Path, str] | None:
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
                found = _skel_root_above(opened, skeleton.GetPath().ReplacePrefix(place, target))
                if found:
                    return Path(file), found
    return None


def _defining_rig(skeleton: Usd.Prim) -> tuple[Path, str] | None:
    """Return the weakest file that defines a skeleton: where nothing is referenced."""
    for spec in reversed(skeleton.GetPrimStack()):
        if spec.layer.realPath and spec.specifier == Sdf.SpecifierDef:
            found = _skel_root_above(_open(spec.layer.realPath), spec.path)
            if found:
                return Path(spec.layer.realPath), found
    return None


def _open(file: str) -> Usd.Stage:
    return open_stage(Path(os.path.relpath(file)))


def _skel_root_above(stage: Usd.Stage, skeleton: Sdf.Path) -> str:
    prim = stage.GetPrimAtPath(skeleton)
    while prim and not prim.IsA(UsdSkel.Root):
        prim = prim.GetParent()
    return str(prim.GetPath()) if prim else ""
