"""Checks of all files that a layer refers to, before USD opens them: integrity and confinement.

Asset paths may be expressions, such as ``@`"${SHOT}/rig.usda"`@``. Composition evaluates them with
the variables of the root layer, and those of the referenced layer as fallbacks, so that a layer
refers to different files under different roots.
"""

import contextlib
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pxr import Ar, Sdf, Tf, Usd, UsdUtils

from usdface.core.confinement import confinement_root
from usdface.core.errors import InputError
from usdface.usdio.authoring import paths_in
from usdface.usdio.crate import check_crate

_MOST_REACHED = 20_000
"""Pairs of a layer and variables."""

_Variables = dict[str, Any]


def check_reached(layer: Sdf.Layer) -> list[Sdf.Layer]:
    """Check and return all layers of a composition, the given one first, before USD opens them.

    `InputError` with the first damaged binary layer or, under confinement, the first file outside
    the folder.
    """
    waiting = [(layer, dict(layer.expressionVariables))]
    reached = {layer.identifier: layer}
    seen = {(layer.identifier, _key(waiting[0][1]))}
    while waiting:
        above, variables = waiting.pop()
        _check_tree(above)
        _check_assets_confined(above, variables)
        sublayers = set(above.subLayerPaths)
        for asset in above.GetCompositionAssetDependencies():
            name = evaluated(asset, variables)
            identifier = above.ComputeAbsolutePath(name) if name else ""
            if not name or not _is_file(identifier):
                continue  # left to USD and its resolver
            below = reached.get(identifier)
            if below is None:
                _check_confined(above, identifier)
                check_crate(Path(identifier))
                with contextlib.suppress(Tf.ErrorException):  # raised again by composition
                    below = Sdf.Layer.FindOrOpen(identifier)
            if below is None:
                continue
            reached[identifier] = below
            # Variables of a referenced layer are weaker; those of a sublayer are ignored.
            of_layer = (
                variables if asset in sublayers else dict(below.expressionVariables) | variables
            )
            key = (identifier, _key(of_layer))
            if key not in seen:
                seen.add(key)
                waiting.append((below, of_layer))
        if len(seen) > _MOST_REACHED:
            raise InputError(
                f"{layer.identifier}: is composed from more than {_MOST_REACHED} layers; flatten it"
            )
    return list(reached.values())


def _key(variables: _Variables) -> str:
    return repr(sorted((name, str(value)) for name, value in variables.items()))


def check_composed(stage: Usd.Stage) -> None:
    """Refuse a stage composed from a file outside the confinement, missed by `check_reached`."""
    if confinement_root() is None:
        return
    for used in stage.GetUsedLayers(includeClipLayers=True):
        _check_confined(stage.GetRootLayer(), used.realPath)


def evaluated(asset: str, variables: _Variables) -> str | None:
    """Return an asset path with its expression evaluated; None if that fails, empty for no file."""
    if not Sdf.VariableExpression.IsExpression(asset):
        return asset
    value = Sdf.VariableExpression(asset).Evaluate(variables).value
    return value if isinstance(value, str) else None


def cannot_be_opened(layer: Sdf.Layer, asset: str, variables: _Variables) -> bool:
    """Whether a layer refers to a layer that is missing, by a path or an expression."""
    name = evaluated(asset, variables)
    return name is None or bool(name and not Sdf.Layer.FindOrOpen(layer.ComputeAbsolutePath(name)))


def _check_assets_confined(layer: Sdf.Layer, variables: _Variables) -> None:
    """Refuse asset paths of a layer, with clips, textures and movies, outside the confinement."""
    if confinement_root() is None:
        return
    copy = layer
    if dict(layer.expressionVariables) != variables and layer.realPath:
        copy = Sdf.Layer.OpenAsAnonymous(layer.realPath)
        copy.expressionVariables = variables
    for names in UsdUtils.ExtractExternalReferences(copy.identifier):
        for name in filter(None, names):
            for file in _files_named(layer.ComputeAbsolutePath(name)):
                _check_confined(layer, file)


def _files_named(identifier: str) -> Iterator[str]:
    """Yield a file, or those of a pattern: ``<UDIM>`` of textures, ``#`` of clips."""
    path = Path(identifier)
    yield identifier
    if "#" not in path.name and "<UDIM>" not in path.name:
        return
    pattern = re.escape(path.name).replace(re.escape("<UDIM>"), r"\d{4}")
    pattern = re.sub(r"(\\#)+", r"-?\\d+", pattern)
    with contextlib.suppress(OSError):
        yield from (str(each) for each in path.parent.iterdir() if re.fullmatch(pattern, each.name))


def _check_confined(layer: Sdf.Layer, identifier: str) -> None:
    root = confinement_root()
    outer = Ar.SplitPackageRelativePathOuter(identifier)[0]
    if root is None or not Path(outer).is_absolute():
        return  # relative ones are left to the resolver
    if not Path(outer).resolve().is_relative_to(root.resolve()):
        raise InputError(
            f"{layer.realPath or layer.identifier}: refers to {outer}, which lies outside {root}\n"
            "move the files below it, or ask for another root"
        )


def _is_file(identifier: str) -> bool:
    try:
        return Path(identifier).is_file()
    except OSError:  # the name is too long, or the folder not readable
        return False


def _check_tree(layer: Sdf.Layer) -> None:
    """Refuse a binary layer with a damaged list of specs, on which USD aborts the process."""
    if layer.GetFileFormat().formatId == "usda":
        return
    for path in paths_in(layer):
        if path.IsPrimPath():
            exists = bool(layer.GetPrimAtPath(path))
        elif path.IsPrimPropertyPath():
            exists = bool(layer.GetPropertyAtPath(path))
        else:
            exists = not path.isEmpty
        if not exists:
            raise InputError(
                f"{layer.identifier}: a damaged binary layer: <{path}> is listed and not there; "
                "copy it again from where it came from, or write it again"
            )
