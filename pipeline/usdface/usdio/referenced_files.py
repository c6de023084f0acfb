"""What a USD file refers to: files and their range of frames, and targets that are lost."""

from collections.abc import Iterable
from pathlib import Path

from pxr import Ar, Sdf, Usd, UsdUtils

from usdface.core.rates import check_frame_span
from usdface.core.sidecars import edits_path
from usdface.usdio.layers import open_layer, usd_errors_as_input_errors
from usdface.usdio.reached import check_reached


def referenced_files(path: Path) -> list[Path]:
    """Return a USD file, its layers, and their textures, movies and sounds that exist."""
    layers, assets, _ = _dependencies(path)
    files = (*layers, *(asset for asset in assets if asset.is_file()), path)
    return sorted({file.resolve(): file for file in files}.values())


def dependencies(path: Path) -> list[Path]:
    """Return all layers of a USD file, with itself first."""
    layers = _dependencies(path)[0]
    return [path, *(layer for layer in layers if layer.resolve() != path.resolve())]


def all_files(path: Path) -> list[Path]:
    """Return all files that a USD file refers to, also missing ones."""
    return [file for files in _dependencies(path) for file in files]


def _dependencies(path: Path) -> tuple[list[Path], list[Path], list[Path]]:
    """Return the layers, the other files and the missing ones that a USD file refers to."""
    layer = open_layer(path)
    with usd_errors_as_input_errors(path, "finding what it refers to"):
        reached = check_reached(layer)
        layers, assets, missing = UsdUtils.ComputeAllDependencies(layer.identifier)
    # USD's list evaluates expressions with the variables of each layer alone.
    layer_files = [each.realPath for each in (*layers, *reached)]
    return _on_disk(layer_files), _on_disk(assets), _on_disk(missing)


def _on_disk(identifiers: Iterable[str]) -> list[Path]:
    """Return distinct files, of those in packages the package."""
    files = (Ar.SplitPackageRelativePathOuter(identifier)[0] for identifier in identifiers)
    return [Path(file) for file in dict.fromkeys(files) if file]


def frame_range_of(path: Path) -> tuple[int, int] | None:
    """Return the first and last frame of a take or a performance, if it has a range."""
    layer = open_layer(path)
    with usd_errors_as_input_errors(path, "reading its range"):
        if not (layer.HasStartTimeCode() and layer.HasEndTimeCode()):
            return None
        start, end = layer.startTimeCode, layer.endTimeCode
    check_frame_span(f"{path}: startTimeCode to endTimeCode", start, end, samples=None)
    first, last = round(start), round(end)
    return (first, last) if last >= first else None


def missing_sublayers(path: Path) -> list[str]:
    """Return the names of missing sublayers that were written with a layer, except edits."""
    layer = open_layer(path)
    sublayers = [path.parent / asset for asset in layer.subLayerPaths]
    return [
        file.name
        for file in sublayers
        if file.name.startswith(f"{path.stem}.") and file != edits_path(path) and not file.is_file()
    ]


def lost_targets(stage: Usd.Stage) -> dict[Sdf.Path, str]:
    """Return the properties with a target that no reference brings, and what to do, by their path.

    Such as the binding of a material beside the top prim of a rig, which USD drops.
    """
    return {
        each.GetPath(): lost
        for prim in stage.Traverse()
        for each in prim.GetAuthoredProperties()
        if (lost := _lost_target(prim, each))
    }


def _lost_target(prim: Usd.Prim, of_prim: Usd.Property) -> str:
    is_relationship = isinstance(of_prim, Usd.Relationship)
    if not (is_relationship or of_prim.HasAuthoredConnections()):
        return ""
    arcs = Usd.PrimCompositionQuery(prim).GetCompositionArcs()  # nodes do not outlive them
    nodes = [arc.GetTargetNode() for arc in arcs]
    for spec in of_prim.GetPropertyStack():
        targets = spec.targetPathList if is_relationship else spec.connectionPathList
        at, layer = spec.path.GetPrimPath(), spec.layer
        here = [each for each in nodes if each.path == at and layer in each.layerStack.layers]
        for target in targets.GetAddedOrExplicitItems() if here else ():
            node, mapped = here[0], target
            while not node.IsRootNode():
                above = node.mapToParent.MapSourceToTarget(mapped)
                if above.isEmpty:
                    top = node.GetPathAtIntroduction()
                    return (
                        f"{Path(layer.realPath).name} targets <{target}>, which lies outside "
                        f"<{top}>, the prim that is referenced, and is lost; put it below <{top}>"
                    )
                node, mapped = node.parent, above
        if targets.isExplicit:
            break  # it hides those of weaker layers
    return ""
