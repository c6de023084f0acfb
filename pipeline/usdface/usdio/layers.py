"""Open stages and write layers so that a reader sees the old file or the new one, never half."""

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
from usdface.core.provenance import Provenance
from usdface.core.replacing import replacing_together
from usdface.core.sidecars import LAYER_SUFFIXES
from usdface.usdio.crate import check_crate
from usdface.usdio.plugin import SCHEMA_VERSION
from usdface.usdio.reached import check_composed, check_reached

FRAMES_IN_MEMORY = 1 << 15

VALUES_IN_MEMORY = 1 << 23
"""Long takes are saved to disk whenever this many frames or values have been written, so that
memory stays bounded."""


@contextlib.contextmanager
def usd_errors_as_input_errors(path: Path, doing: str) -> Iterator[None]:
    """Turn USD's own errors into an InputError that names the file; keep its chatter off stderr."""
    delegate = UsdUtils.CoalescingDiagnosticDelegate()
    try:
        yield
    except Tf.ErrorException as error:
        raise InputError(f"{path}: USD failed while {doing}: {usd_reason(error)}") from error
    except UnicodeDecodeError as error:  # damage turned a name into bytes that Python cannot take
        raise InputError(f"{path}: a value that is needed for {doing} is no text") from error
    finally:
        delegate.TakeUncoalescedDiagnostics()


def usd_reason(error: Tf.ErrorException) -> str:
    """Return in one line what USD says first, which the others follow from.

    It may quote a broken file's bytes. What says the same at the end with its place is better.
    """
    try:
        texts = [
            each.commentary if isinstance(each, Tf.Error) else str(each) for each in error.args
        ]
        first, last = (" ".join(each.split()) for each in (texts[0], texts[-1]))
        return last if first in last else first
    except UnicodeDecodeError:
        return "it holds bytes that are no text"


def is_layer_name(path: Path) -> bool:
    """Whether USD would open a file of this name as a layer; a package is one."""
    try:
        return bool(Usd.Stage.IsSupportedFile(str(path)))
    except UnicodeEncodeError as error:
        raise InputError(
            f"{str(path)!a}: holds bytes that are no text, which USD cannot open; rename it"
        ) from error


def open_layer(path: Path) -> Sdf.Layer:
    """Open one layer as it is on disk now."""
    if path.is_dir():
        raise InputError(f"{path}: is a folder; name a file in it")
    if not path.is_file():
        raise InputError(f"{path}: no such file; check the path")
    if not is_layer_name(path):
        raise InputError(
            f"{path}: not a USD file by its name; expected .usd, .usda, .usdc or .usdz"
        )
    check_may_open(path)
    check_crate(path)
    with usd_errors_as_input_errors(path, "opening it"):
        layer = Sdf.Layer.FindOrOpen(str(path))
        if layer is not None:
            layer.Reload()
            _check_schema(layer, path)
    if layer is None:
        raise InputError(f"{path}: not a readable USD layer; is it complete, and really USD?")
    return layer


def _check_schema(layer: Sdf.Layer, path: Path) -> None:
    schema = _usdface_data(layer).get("schema", 0)
    if isinstance(schema, int) and schema > SCHEMA_VERSION:
        raise InputError(
            f"{path}: written with usdface schema {schema}, this version knows {SCHEMA_VERSION}; "
            "update usdface"
        )


def _usdface_data(layer: Sdf.Layer) -> dict[str, Any]:
    """Return what a layer keeps under our name; nothing, where that is no dictionary."""
    data = layer.customLayerData.get("usdface")
    return dict(data) if isinstance(data, dict) else {}


def _check_rate(layer: Sdf.Layer, path: Path) -> None:
    """Refuse rates by which USD could not place a layer's samples: it would search without end."""
    rate = layer.timeCodesPerSecond
    if not 0 < rate < math.inf:
        raise InputError(
            f"{path}: timeCodesPerSecond is {rate:g}; a take needs a rate above 0, and so does "
            "every other layer: restore it, or set the rate it was written with"
        )


def open_stage(path: Path) -> Usd.Stage:
    """Open a stage from a file as it is on disk now."""
    layer = open_layer(path)
    with usd_errors_as_input_errors(path, "composing it"):
        check_reached(layer)
        stage = Usd.Stage.Open(layer)
        check_composed(stage)
        for used in stage.GetUsedLayers():
            if not used.anonymous:
                used.Reload()
                _check_schema(used, Path(used.realPath))
                _check_rate(used, Path(used.realPath))
        missing = sorted(
            asset
            for asset in layer.subLayerPaths
            if not Sdf.Layer.FindOrOpen(layer.ComputeAbsolutePath(asset))
        )
    if missing:
        raise InputError(
            f"{path}: its sublayer {missing[0]} cannot be read; put it back beside the file, "
            "or take it out of the layer's subLayers"
        )
    return stage


def check_layer_name(path: Path) -> None:
    """Refuse a file name that USD would not recognise, before any work is done."""
    if path.suffix not in LAYER_SUFFIXES:
        raise InputError(
            f"{path}: a USD layer is written, so the name must end in {', '.join(LAYER_SUFFIXES)}"
        )


@contextlib.contextmanager
def new_layer(path: Path, provenance: Provenance | None = None) -> Iterator[Sdf.Layer]:
    """Yield an empty layer that replaces the file at `path` once the block ends without error."""
    with new_layers({path: provenance}) as (layer,):
        yield layer


@contextlib.contextmanager
def new_layers(made: Mapping[Path, Provenance | None]) -> Iterator[tuple[Sdf.Layer, ...]]:
    """Yield empty layers that replace files together, once the block ends without error.

    All are saved before the first takes its place, so a disk that fills leaves every old one.

    Parameters
    ----------
    made : mapping of Path to Provenance or None
        What to write, and what each layer says of its making; one that refers to others comes
        last.
    """
    paths = list(made)
    for path in paths:
        check_layer_name(path)
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
    """Let a layer say what made it; what other tools keep there stays."""
    if provenance is not None:
        layer.customLayerData = dict(layer.customLayerData) | {
            "usdface": provenance_data(provenance)
        }


def _reload(path: Path) -> None:
    """Let this process see a layer that was replaced on disk, if it has it open."""
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


def provenance_data(provenance: Provenance) -> dict[str, object]:
    """Return what ``customLayerData["usdface"]`` holds."""
    return {
        "version": provenance.version,
        "schema": SCHEMA_VERSION,
        "step": provenance.step,
        "spec": provenance.spec,
        "specHash": provenance.spec_hash,
        # A path may hold characters that a dictionary key may not: keep two lists.
        "inputs": Vt.StringArray(list(provenance.inputs.keys())),
        "inputHashes": Vt.StringArray(list(provenance.inputs.values())),
    }


def read_provenance(path: Path) -> Provenance | None:
    """Return what a layer says of its making, or None if this package did not write it."""
    layer = open_layer(path)
    with usd_errors_as_input_errors(path, "reading what it says of its making"):
        data = _usdface_data(layer)
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
    """Refuse a file name by which no layer could refer to the file, or to one beside it.

    Raises
    ------
    InputError
        If it has control characters, which USD takes in no path, or a backslash, which it takes for
        a folder's end on every system.
    """
    wrong = [each for each in path.name if each == "\\" or unicodedata.category(each) == "Cc"]
    if wrong:
        raise InputError(
            f"{str(path)!r}: {wrong[0]!r} cannot be part of a name that a USD layer refers to; "
            "choose another"
        )


def relative_path(target: Path, layer_path: Path) -> str:
    """Return `target` as a layer beside it should name it: relative, so that folders can move.

    USD goes up from a folder by its name, the system by where it is: behind a link these are two
    places. A path that leads there by both is preferred to one by the name that was given.
    """
    named, real = Path(os.path.abspath(layer_path.parent)), layer_path.resolve().parent  # noqa: PTH100
    ways = [os.path.relpath(target.resolve(), real), os.path.relpath(target, named)]

    def leads(way: str, folder: Path) -> bool:
        return Path(os.path.normpath(folder / way)).resolve() == target.resolve()

    sound = [way for way in ways if leads(way, named)]
    check_asset_name(target)
    relative = next((way for way in sound if leads(way, real)), (sound or ways)[0])
    relative = relative.replace(os.sep, "/")
    return relative if relative.startswith(".") else f"./{relative}"


P = ParamSpec("P")
R = TypeVar("R")


def refusing_wrong_types(read: Callable[P, R]) -> Callable[P, R]:
    """Turn what Python or USD says of a value of another type into an InputError for the file.

    USD keeps an attribute's type as it was authored, whatever its schema says, so any value may
    come out. The reader's first argument is a path, or has one.
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
