"""Opening of stages, atomic writing of layers, their provenance and the paths in them."""

import contextlib
import functools
import math
import os
import unicodedata
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from pxr import Sdf, Tf, Usd, UsdUtils, Vt

from usdface.core.confinement import check_may_open
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance, hash_text
from usdface.core.replacing import replacing_together
from usdface.usdio import SCHEMA_VERSION
from usdface.usdio.crate import check_crate
from usdface.usdio.reached import cannot_be_opened, check_composed, check_reached

FRAMES_IN_MEMORY = 1 << 15

VALUES_IN_MEMORY = 1 << 23
"""Frames or values after which long takes are saved to disk, which bounds the memory."""


@contextlib.contextmanager
def usd_errors_as_input_errors(path: Path, doing: str) -> Iterator[None]:
    """Turn USD's errors into an InputError with the file's name, and suppress them on stderr."""
    delegate = UsdUtils.CoalescingDiagnosticDelegate()
    try:
        yield
    except Tf.ErrorException as error:
        raise InputError(f"{path}: USD failed while {doing}: {usd_reason(error)}") from error
    except UnicodeDecodeError as error:  # a damaged name
        raise InputError(f"{path}: a value that is needed for {doing} is no text") from error
    finally:
        delegate.TakeUncoalescedDiagnostics()


def usd_reason(error: Tf.ErrorException) -> str:
    """Return the first of USD's messages in one line, the cause of the others.

    Or the last, if it contains the first with its place. May quote a damaged file's bytes.
    """
    try:
        texts = [one.commentary if isinstance(one, Tf.Error) else str(one) for one in error.args]
        first, last = (" ".join(text.split()) for text in (texts[0], texts[-1]))
        return last if first in last else first
    except UnicodeDecodeError:
        return "it holds bytes that are no text"


def is_layer_name(path: Path) -> bool:
    """Whether USD opens files of this name as layers or packages."""
    try:
        return bool(Usd.Stage.IsSupportedFile(str(path)))
    except UnicodeEncodeError as error:
        raise InputError(
            f"{str(path)!a}: holds bytes that are no text, which USD cannot open; rename it"
        ) from error


def open_layer(path: Path) -> Sdf.Layer:
    """Open one layer, or a layer in a package (``a.usdz[b.usdc]``), or reload it from disk."""
    package, inner, _ = str(path).partition(".usdz[")
    file = Path(f"{package}.usdz") if inner else path
    if file.is_dir():
        raise InputError(f"{path}: is a folder; name a file in it")
    if not file.is_file():
        raise InputError(f"{path}: no such file; check the path")
    if not is_layer_name(path):
        raise InputError(
            f"{path}: not a USD file by its name; expected .usd, .usda, .usdc or .usdz"
        )
    check_may_open(file)
    check_crate(file)
    with usd_errors_as_input_errors(path, "opening it"):
        layer = Sdf.Layer.FindOrOpen(str(path))
        if layer is not None:
            layer.Reload()
            _check_schema(layer, path)
    if layer is None:
        raise InputError(f"{path}: not a readable USD layer; is it complete, and really USD?")
    return layer


def _check_schema(layer: Sdf.Layer, path: Path) -> None:
    schema = usdface_data(layer).get("schema", 0)
    if isinstance(schema, int) and schema > SCHEMA_VERSION:
        raise InputError(
            f"{path}: written with usdface schema {schema}, this version knows {SCHEMA_VERSION}; "
            "update usdface"
        )


def usdface_data(layer: Sdf.Layer) -> dict[str, Any]:
    """Return our dictionary in a layer's custom data, or an empty one."""
    data = layer.customLayerData.get("usdface")
    return dict(data) if isinstance(data, dict) else {}


def _check_rate(layer: Sdf.Layer, path: Path) -> None:
    """Refuse invalid rates, with which USD searches a layer's samples forever."""
    rate = layer.timeCodesPerSecond
    if not 0 < rate < math.inf:
        raise InputError(
            f"{path}: timeCodesPerSecond is {rate:g}; a take needs a rate above 0, and so does "
            "every other layer: restore it, or set the rate it was written with"
        )


def open_stage(path: Path) -> Usd.Stage:
    """Open a stage, with all layers reloaded from disk."""
    layer = open_layer(path)
    with usd_errors_as_input_errors(path, "composing it"):
        _held = check_reached(layer)  # or USD would read them again
        stage = Usd.Stage.Open(layer)
        check_composed(stage)
        for used in stage.GetUsedLayers():
            if not used.anonymous:
                used.Reload()
                _check_schema(used, Path(used.realPath))
                _check_rate(used, Path(used.realPath))
        variables = dict(layer.expressionVariables)
        missing = sorted(
            each for each in layer.subLayerPaths if cannot_be_opened(layer, each, variables)
        )
    if missing:
        link = " (a symbolic link, beside which USD looks)" if path.is_symlink() else ""
        raise InputError(
            f"{path}: its sublayer {missing[0]} cannot be read; put it back beside the file{link}, "
            "or take it out of the layer's subLayers"
        )
    return stage


@contextlib.contextmanager
def new_layer(path: Path, provenance: Provenance | None = None) -> Iterator[Sdf.Layer]:
    """Yield an empty layer that replaces the file at `path` if the block succeeds."""
    with new_layers({path: provenance}) as (layer,):
        yield layer


@contextlib.contextmanager
def new_layers(made: Mapping[Path, Provenance | None]) -> Iterator[tuple[Sdf.Layer, ...]]:
    """Yield empty layers that replace files together, if the block succeeds.

    All are saved before the first is renamed, so that a full disk leaves all old ones.

    `made`: paths and provenance; a layer that refers to others should be last.
    """
    paths = list(made)
    with (
        replacing_together(paths, then=_reload) as temporaries,
        usd_errors_as_input_errors(paths[-1], "writing it"),
    ):
        layers = tuple(Sdf.Layer.CreateNew(str(temporary)) for temporary in temporaries)
        yield layers
        for layer, (path, provenance) in zip(layers, made.items(), strict=True):
            author_provenance(layer, provenance)
            save_layer(layer, path)
        del layer, layers


def author_provenance(layer: Sdf.Layer, provenance: Provenance | None) -> None:
    """Store provenance in ``customLayerData["usdface"]``; other tools' data are not changed."""
    if provenance is None:
        return
    data = {
        "version": provenance.version,
        "schema": SCHEMA_VERSION,
        "step": provenance.step,
        "spec": provenance.spec,
        "specHash": hash_text(provenance.spec),
        # Two lists, since a path may have characters that a dictionary key may not.
        "inputs": Vt.StringArray(list(provenance.inputs.keys())),
        "inputHashes": Vt.StringArray(list(provenance.inputs.values())),
    }
    layer.customLayerData = dict(layer.customLayerData) | {"usdface": data}


def _reload(path: Path) -> None:
    """Reload a layer that was replaced on disk, if this process has it open."""
    stale = Sdf.Layer.Find(str(path))
    if stale is not None:
        stale.Reload(force=True)


def save_layer(layer: Sdf.Layer, path: Path) -> None:
    """Save a layer under its temporary name."""
    if not layer.Save():
        raise InputError(
            f"{path}: USD could not save it; is the disk full, or the folder gone? Nothing under "
            "its name was changed"
        )


def read_provenance(path: Path) -> Provenance | None:
    """Return a layer's provenance, or None if this package did not write it."""
    layer = open_layer(path)
    with usd_errors_as_input_errors(path, "reading what it says of its making"):
        data = usdface_data(layer)
        if "version" not in data:
            return None
        inputs = [data.get(key, ()) for key in ("inputs", "inputHashes")]
        if not all(isinstance(each, Vt.StringArray) for each in inputs):
            inputs = [(), ()]
        return Provenance(
            step=str(data.get("step", "")),
            spec=str(data.get("spec", "")),
            inputs=dict(zip(*inputs, strict=False)),
            version=str(data["version"]),
        )


def check_asset_name(path: Path) -> None:
    """Refuse a file name that cannot be part of an asset path.

    Control characters are invalid in USD, and backslashes are separators on all systems.
    """
    wrong = [char for char in path.name if char == "\\" or unicodedata.category(char) == "Cc"]
    if wrong:
        raise InputError(
            f"{str(path)!r}: {wrong[0]!r} cannot be part of a name that a USD layer refers to; "
            "choose another"
        )


def relative_path(target: Path, layer_path: Path) -> str:
    """Return the asset path of `target` relative to a layer, so that folders can be moved.

    USD resolves ``..`` lexically, the system by links. A path that is valid for both is preferred
    to one that is valid for USD alone.
    """
    named, real = Path(os.path.abspath(layer_path.parent)), layer_path.resolve().parent  # noqa: PTH100
    candidates = [os.path.relpath(target.resolve(), real), os.path.relpath(target, named)]

    def leads(relative: str, folder: Path) -> bool:
        return Path(os.path.normpath(folder / relative)).resolve() == target.resolve()

    valid = [relative for relative in candidates if leads(relative, named)]
    check_asset_name(target)
    relative = next((one for one in valid if leads(one, real)), (valid or candidates)[0])
    relative = relative.replace(os.sep, "/")
    return relative if relative.startswith(".") else f"./{relative}"


def sublayer_asset(layer: Sdf.Layer, file: Path, path: Path) -> str:
    """Return the asset path by which a layer at `path` opens a file as a sublayer, or would.

    Other tools write it without ``./``, or absolute.
    """
    wanted = file.resolve()
    opened = (each for each in layer.subLayerPaths if (path.parent / each).resolve() == wanted)
    return next(opened, None) or relative_path(file, path)


P = ParamSpec("P")
R = TypeVar("R")


def refusing_wrong_types(read: Callable[P, R]) -> Callable[P, R]:
    """Turn errors of values of a wrong type into an InputError with the file's name.

    Attributes may have other types than those of their schema. The reader's first argument is a
    path, or has one.
    """

    @functools.wraps(read)
    def reading(*given: P.args, **named: P.kwargs) -> R:
        try:
            return read(*given, **named)
        except (TypeError, ValueError, IndexError, OverflowError, Tf.ErrorException) as error:
            file = getattr(given[0], "path", given[0])
            reason = usd_reason(error) if isinstance(error, Tf.ErrorException) else str(error)
            raise InputError(
                f"{file}: a value is not of the type or the length that its place asks for "
                f"({reason}); write the file again"
            ) from error

    return reading
