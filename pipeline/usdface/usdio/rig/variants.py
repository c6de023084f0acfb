"""Variants of a rig that somebody chose where it is referenced."""

from pathlib import Path

from pxr import Sdf, Usd

from usdface.usdio.layers import open_stage


def carry_variants(layer: Sdf.Layer, stage: Usd.Stage, place: str, rig: Path, top: str) -> None:
    """Choose in a layer what a stage has of a rig's variants, where that is not the rig's own.

    Parameters
    ----------
    layer : Sdf.Layer
        Has the rig at the same place.
    stage : Usd.Stage
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
