"""What layers are made of: found, relative, and with a word on where they come from."""

from pathlib import PurePosixPath, PureWindowsPath

from pxr import Sdf, Usd, UsdSkel, UsdUtils

from usdface.core.text import first_few
from usdface.usdio.checks.fault import Fault, is_solved


def _saved_layers(stage: Usd.Stage) -> list[Sdf.Layer]:
    return [each for each in stage.GetLayerStack(includeSessionLayers=False) if not each.anonymous]


def _is_ours(stage: Usd.Stage) -> bool:
    return any("usdface" in layer.customLayerData for layer in _saved_layers(stage))


def check_absolute_paths(stage: Usd.Stage) -> list[Fault]:
    """Find paths that only this machine has; layers that are not ours are let be."""
    if not _is_ours(stage):
        return []
    found = []
    for layer in _saved_layers(stage):
        named = [
            str(asset)
            for kind in UsdUtils.ExtractExternalReferences(layer.realPath)
            for asset in kind
        ]
        absolute = [
            asset
            for asset in named
            if PurePosixPath(asset).is_absolute() or PureWindowsPath(asset).is_absolute()
        ]
        if absolute:
            found.append(
                Fault(
                    "warning",
                    "/",
                    f"{layer.GetDisplayName()} names {first_few(absolute)} by an absolute path: on "
                    "another machine it is not there; name it relative to the layer",
                )
            )
    return found


def check_missing_files(stage: Usd.Stage) -> list[Fault]:
    """Find references and sublayers of our layers that are not where they should be."""
    if not _is_ours(stage):
        return []
    found = []
    for layer in _saved_layers(stage):
        missing = [
            asset
            for asset in layer.GetCompositionAssetDependencies()
            if asset and not Sdf.Layer.FindOrOpen(layer.ComputeAbsolutePath(asset))
        ]
        if missing:
            found.append(
                Fault(
                    "error",
                    "/",
                    f"{layer.GetDisplayName()} is built from {first_few(missing)}, which cannot be "
                    "opened: was it moved? Put it back, or map again with the rig where it is now",
                )
            )
    return found


def check_provenance(stage: Usd.Stage) -> list[Fault]:
    """Find solved animations of which no layer says what they were made from."""
    found = []
    for prim in stage.TraverseAll():
        if not prim.IsA(UsdSkel.Animation) or not is_solved(prim):
            continue
        specs = prim.GetPrimStack()
        if not any("usdface" in spec.layer.customLayerData for spec in specs):
            found.append(
                Fault(
                    "warning",
                    str(prim.GetPath()),
                    "says nothing of the take, the mapping and the versions it was made from, so "
                    "nobody can make it again; write it with usdface, or copy "
                    'customLayerData["usdface"] with the samples',
                )
            )
    return found
