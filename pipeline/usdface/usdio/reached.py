"""What a layer reaches: found without opening it, looked at, and held to the confinement root.

A name in a layer may be an expression, such as ``@`"${SHOT}/rig.usda"`@``. Composition evaluates it
with the variables of the root layer laid over those of the layer that is referenced, so one layer
reaches other files under other roots. The walk here does so too.
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
"""Layers, each counted once for every set of variables that reaches it."""

_Variables = dict[str, Any]


def check_reached(layer: Sdf.Layer) -> list[Sdf.Layer]:
    """Look at a layer, and at every one it is composed from, before USD opens that.

    Returns
    -------
    list of Sdf.Layer
        All of them, the layer itself first.

    Raises
    ------
    InputError
        Naming the first binary layer that does not hold together; if there is a root that confines
        all work, also the first file outside it, be it a layer or not.
    """
    waiting = [(layer, dict(layer.expressionVariables))]
    reached = {layer.identifier: layer}
    seen = {(layer.identifier, _key(waiting[0][1]))}
    while waiting:
        above, variables = waiting.pop()
        _check_tree(above)
        _check_assets_confined(above, variables)
        for asset, is_sublayer in _composed_of(above, variables):
            identifier = above.ComputeAbsolutePath(asset)
            if not _is_file(identifier):
                continue  # what lies elsewhere is for USD, and for its resolver
            below = reached.get(identifier)
            if below is None:
                _check_confined(above, identifier)
                check_crate(Path(identifier))
                with contextlib.suppress(Tf.ErrorException):  # USD says so again if it needs it
                    below = Sdf.Layer.FindOrOpen(identifier)
            if below is None:
                continue
            reached[identifier] = below
            # Those of a referenced layer are weaker; those of a sublayer count for nothing.
            way = variables if is_sublayer else dict(below.expressionVariables) | variables
            key = (identifier, _key(way))
            if key not in seen:
                seen.add(key)
                waiting.append((below, way))
        if len(seen) > _MOST_REACHED:
            raise InputError(
                f"{layer.identifier}: is composed from more than {_MOST_REACHED} layers; flatten it"
            )
    return list(reached.values())


def _key(variables: _Variables) -> str:
    return repr(sorted((name, str(value)) for name, value in variables.items()))


def check_composed(stage: Usd.Stage) -> None:
    """Refuse a stage that was composed from a file outside the root that confines all work.

    Raises
    ------
    InputError
        Naming the file: a way of naming it that the walk does not know.
    """
    root = confinement_root()
    if root is None:
        return
    for used in stage.GetUsedLayers(includeClipLayers=True):
        if used.realPath:
            _check_confined(stage.GetRootLayer(), used.realPath)


def evaluated(asset: str, variables: _Variables) -> str:
    """Return the name that an asset path stands for; empty if it is an expression without one."""
    if not Sdf.VariableExpression.IsExpression(asset):
        return asset
    value = Sdf.VariableExpression(asset).Evaluate(variables).value
    return value if isinstance(value, str) else ""


def _composed_of(layer: Sdf.Layer, variables: _Variables) -> Iterator[tuple[str, bool]]:
    """Yield what a layer names to be composed from, and whether it is a sublayer."""
    sublayers = set(layer.subLayerPaths)
    for asset in layer.GetCompositionAssetDependencies():
        if name := evaluated(asset, variables):
            yield name, asset in sublayers


def _check_assets_confined(layer: Sdf.Layer, variables: _Variables) -> None:
    """Refuse any name in a layer, of clips, textures and movies too, that leads out of the root."""
    if confinement_root() is None:
        return
    look = layer
    if dict(layer.expressionVariables) != variables and layer.realPath:
        look = Sdf.Layer.OpenAsAnonymous(layer.realPath)  # evaluated there by its own variables
        look.expressionVariables = variables
    for names in UsdUtils.ExtractExternalReferences(look.identifier):
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
        for each in path.parent.iterdir():
            if re.fullmatch(pattern, each.name):
                yield str(each)


def _check_confined(layer: Sdf.Layer, identifier: str) -> None:
    root = confinement_root()
    outer = Ar.SplitPackageRelativePathOuter(identifier)[0]
    if root is None or not Path(outer).is_absolute():
        return  # the latter names what only a resolver finds
    if not Path(outer).resolve().is_relative_to(root.resolve()):
        raise InputError(
            f"{layer.realPath or layer.identifier}: refers to {outer}, which lies outside {root}\n"
            "move the files below it, or ask for another root"
        )


def _is_file(identifier: str) -> bool:
    try:
        return Path(identifier).is_file()
    except OSError:  # a name that is too long, a folder that may not be looked into
        return False


def _check_tree(layer: Sdf.Layer) -> None:
    """Refuse a layer that lists prims or properties which it has not: USD ends the process there.

    Text cannot say so; a binary layer whose list of specs is damaged can.
    """
    if layer.GetFileFormat().formatId == "usda":
        return
    for path in paths_in(layer):
        if path.IsPrimPath():
            there = bool(layer.GetPrimAtPath(path))
        elif path.IsPrimPropertyPath():
            there = bool(layer.GetPropertyAtPath(path))
        else:
            there = not path.isEmpty  # as it is where a name is none
        if not there:
            raise InputError(
                f"{layer.identifier}: a damaged binary layer: <{path}> is listed and not there; "
                "copy it again from where it came from, or write it again"
            )
