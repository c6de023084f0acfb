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


def define_reference(layer: Sdf.Layer, place: str, rig: Rig, layer_path: Path) -> None:
    """Define a prim that references the rig's top prim; prims above it become Xforms."""
    source = Sdf.Path(rig.prim).GetPrefixes()[0]
    for above in Sdf.Path(place).GetParentPath().GetPrefixes():
        if not layer.GetPrimAtPath(above):
            define_prim(layer, above, "Xform")
    prim = Sdf.CreatePrimInLayer(layer, place)
    prim.specifier = Sdf.SpecifierDef
    reference = Sdf.Reference(relative_path(rig.file, layer_path), source)
    prim.referenceList.prependedItems = [reference]


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
    """Return the file and SkelRoot of the rig that an animation drives in a composed stage."""
    for prim in stage.Traverse():
        if not prim.IsA(UsdSkel.Skeleton):
            continue
        relation = UsdSkel.BindingAPI(prim).GetAnimationSourceRel()
        if not relation or animation.GetPath() not in relation.GetTargets():
            continue
        for spec in reversed(prim.GetPrimStack()):
            if spec.layer.realPath and spec.specifier == Sdf.SpecifierDef:
                root = spec.path
                opened = open_stage(Path(os.path.relpath(spec.layer.realPath)))
                found = opened.GetPrimAtPath(root)
                while found and not found.IsA(UsdSkel.Root):
                    found = found.GetParent()
                if found:
                    return Path(spec.layer.realPath), str(found.GetPath())
    raise InputError(
        f"{stage.GetRootLayer().realPath} <{animation.GetPath()}>: no rig follows this animation; "
        "is the rig's file still where it was?"
    )
