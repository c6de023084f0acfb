"""Authoring and reading of prims, uniform attributes, timing and arrays."""

import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pxr import Gf, Sdf, Usd, Vt

from usdface.core.arrays import Float32Array, FloatArray, IntArray, RealArray
from usdface.core.errors import InputError
from usdface.core.rates import check_frame_span
from usdface.core.text import pluralize

TrainingScore = TypeVar("TrainingScore")

_GAPS = "face:source:unseen"
"""Of weights in takes, and in performances retargeted from them."""


def define_prim(layer: Sdf.Layer, path: Sdf.Path, type_name: str) -> Sdf.PrimSpec:
    """Define a typed prim in a layer."""
    prim = Sdf.CreatePrimInLayer(layer, path)
    prim.specifier = Sdf.SpecifierDef
    prim.typeName = type_name
    return prim


def define_in_scope(layer: Sdf.Layer, scope: str, type_name: str) -> Sdf.PrimSpec:
    """Define a prim of one of our types, with its name, in a Scope that is the default prim.

    Tools and validators expect a default prim of a known type.
    """
    root = define_prim(layer, Sdf.Path(f"/{scope}"), "Scope")
    layer.defaultPrim = scope
    return define_prim(layer, root.path.AppendChild(type_name), type_name)


def prim_in_scope(stage: Usd.Stage, type_name: str) -> Usd.Prim | None:
    """Return the prim of a type in the default prim, or, in older files, the default prim."""
    root = stage.GetDefaultPrim()
    prims = (root, root.GetChild(type_name)) if root else ()
    return next((prim for prim in prims if prim and prim.GetTypeName() == type_name), None)


def trained_prim(path: Path, stage: Usd.Stage, type_name: str) -> Usd.Prim:
    """Return the prim of a mapping or retargeting; of pairs, say which command trains on them."""
    prim, root = prim_in_scope(stage, type_name), stage.GetDefaultPrim()
    if prim is not None:
        return prim
    kind = type_name.removeprefix("Face").lower()
    command = "train" if kind == "mapping" else "train-retarget"
    cause = f"no {type_name} is its default prim or in it; make one with `usdface {command}`"
    if root and root.GetName() in ("Pairs", "References"):
        command = "train-retarget" if root.GetName() == "Pairs" else "train"
        if command == "train" and root.GetChild("Source"):  # weights, of takes without markers
            command = "train-retarget --references"
        cause = f"it holds pairs, to train on with `usdface {command}`"
    raise InputError(f"{path}: not a {kind}: {cause}")


def read_training(
    path: Path, prim: Usd.Prim, schema: str, candidate: Callable[..., TrainingScore]
) -> tuple[dict[str, Any], tuple[TrainingScore, ...]]:
    """Return the settings of a training, and the errors of its candidates with NaN for null."""
    try:
        settings = json.loads(text_of(prim, f"face:{schema}:settings") or "{}")
        scores = json.loads(text_of(prim, f"face:{schema}:scores") or "[]")
        return dict(settings), tuple(
            candidate(**{key: math.nan if value is None else value for key, value in each.items()})
            for each in scores
        )
    except (ValueError, TypeError, AttributeError, RecursionError) as error:
        raise InputError(
            f"{path} <{prim.GetPath()}>: its settings or scores are no valid JSON: {error}; "
            "train again"
        ) from error


def top_path(path: str | Sdf.Path) -> Sdf.Path:
    """Return the path of the top prim at or above a prim, which references of a rig are to."""
    return Sdf.Path(path).GetPrefixes()[0]


def prim_or_root(stage: Usd.Stage, path: str | None, *, file: Path, option: str) -> Usd.Prim:
    """Return the prim that an option names, or the pseudo-root of the stage if it names none."""
    prim = stage.GetPseudoRoot() if path is None else stage.GetPrimAtPath(path)
    if not prim:
        raise InputError(f"{file}: there is no prim <{path}>; check {option}")
    return prim


def prims_below(top: Usd.Prim, kind: type) -> list[Usd.Prim]:
    """Return the prims of a schema at and below a prim, those in instances too."""
    return [each for each in Usd.PrimRange(top, Usd.TraverseInstanceProxies()) if each.IsA(kind)]


def define_reference_prim(
    layer: Sdf.Layer, path: Sdf.Path, asset: str, source: Sdf.Path
) -> Sdf.PrimSpec:
    """Define a prim that only references a prim of an asset."""
    prim = Sdf.CreatePrimInLayer(layer, path)
    prim.specifier = Sdf.SpecifierDef
    prim.referenceList.prependedItems = [Sdf.Reference(asset, source)]
    return prim


def apply_api(prim: Sdf.PrimSpec, name: str) -> None:
    """Apply an API schema to a prim of a layer."""
    prim.SetInfo("apiSchemas", Sdf.TokenListOp.Create(prependedItems=[name]))


def check_not_instanced(file: Path, prim: Usd.Prim) -> None:
    """Refuse a prim inside an instanceable one, where USD ignores overs."""
    if prim.IsInstanceProxy():
        raise InputError(
            f"{file} <{prim.GetPath()}>: lies inside an instanceable prim, and USD ignores what is "
            "said below one; set instanceable = false there"
        )


def value_of(prim: Usd.Prim, name: str) -> Any:
    """Return an attribute's default value, or None."""
    attribute = prim.GetAttribute(name)
    return attribute.Get() if attribute else None


def stated_spec(prim: Usd.Prim, name: str) -> tuple[Sdf.AttributeSpec, Sdf.LayerOffset] | None:
    """Return where an attribute has its value, and how USD moves the times of samples there.

    Numbers of frames are not moved by layer offsets and rates.
    """
    attribute = prim.GetAttribute(name) if prim else None
    stack = attribute.GetPropertyStackWithLayerOffsets(Usd.TimeCode.Default()) if attribute else ()
    return next((each for each in stack if each[0].HasDefaultValue()), None)


def file_of(prim: Usd.Prim, name: str) -> Path | None:
    """Return the file that an attribute names, which may be missing; None without one.

    Its path is relative to the layer that states it.
    """
    asset, found = value_of(prim, name), stated_spec(prim, name)
    if asset is not None and not isinstance(asset, Sdf.AssetPath):
        raise TypeError(f"{name} is {asset!r}, no path of a file")
    if found is None or not asset or not asset.path:
        return None
    return Path(asset.resolvedPath or found[0].layer.ComputeAbsolutePath(asset.path))


def text_of(prim: Usd.Prim, name: str, time: float | None = None) -> str:
    """Return a string or token of a prim, by default not at a time code; empty if missing."""
    attribute = prim.GetAttribute(name)
    when = Usd.TimeCode.Default() if time is None else time
    return str(attribute.Get(when) or "") if attribute else ""


def key_times(attribute: Usd.Attribute) -> list[float]:
    """Return the time codes of samples; of a spline, its ends and all whole ones between."""
    if not attribute.HasSpline():
        return list(attribute.GetTimeSamples())
    knots = list(attribute.GetSpline().GetKnots())
    check_frame_span(f"<{attribute.GetPath()}>", knots[0], knots[-1], samples=None)
    whole = range(math.ceil(knots[0]), math.floor(knots[-1]) + 1)
    return sorted({knots[0], *map(float, whole), knots[-1]})


def unique_names(wanted: Iterable[str], *, longest: int | None = None) -> list[str]:
    """Return names in the same order, with a number appended to those that repeat earlier ones.

    `longest`: number of characters beyond which a name is cut.
    """
    names = dict[str, None]()
    for base in wanted:
        unique, number = base[:longest], 2
        while unique in names:
            ending = f"_{number}"
            unique = base + ending if longest is None else base[: longest - len(ending)] + ending
            number += 1
        names[unique] = None
    return list(names)


def names_in(attribute: Usd.Attribute) -> tuple[str, ...]:
    """Return the names in an array attribute; none if it has no value or is missing."""
    return tuple(map(str, attribute.Get() or ())) if attribute else ()


def author_uniform(prim: Sdf.PrimSpec, name: str, kind: Sdf.ValueTypeName, value: object) -> None:
    """Write an attribute that does not change over time."""
    Sdf.AttributeSpec(prim, name, kind, Sdf.VariabilityUniform).default = value


def author_series(
    prim: Sdf.PrimSpec,
    name: str,
    kind: Sdf.ValueTypeName,
    values: Iterable[object],
    *,
    first: int = 1,
) -> None:
    """Write the values of an attribute at consecutive time codes, from `first` on."""
    path, write = Sdf.AttributeSpec(prim, name, kind).path, prim.layer.SetTimeSample
    for time, value in enumerate(values, start=first):
        write(path, time, value)


def author_gaps(prim: Sdf.PrimSpec, stretches: Sequence[tuple[int, int]]) -> None:
    """Write the first and last frame of each stretch without a capture, if there are any."""
    if stretches:
        pairs = Vt.Vec2iArray([Gf.Vec2i(*stretch) for stretch in stretches])
        author_uniform(prim, _GAPS, Sdf.ValueTypeNames.Int2Array, pairs)


def read_gaps(prim: Usd.Prim) -> tuple[tuple[int, int], ...]:
    """Return the stretches that `author_gaps` wrote, moved as USD moves the times of samples."""
    found = stated_spec(prim, _GAPS)
    if found is None:
        return ()
    spec, moved = found
    return tuple((round(moved * int(a)), round(moved * int(b))) for a, b in spec.default)


def doubles(values: ArrayLike) -> Vt.DoubleArray:
    """Return an array of any shape as a flat array of doubles."""
    return Vt.DoubleArray.FromNumpy(np.ascontiguousarray(values, dtype=np.float64).ravel())


def vector_array(values: FloatArray) -> Vt.Vec3fArray:
    """Return points or directions, (n, 3), as a USD array."""
    return Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(values, dtype=np.float32))


def index_array(values: IntArray) -> Vt.IntArray:
    """Return indices or counts as a USD array."""
    return Vt.IntArray.FromNumpy(np.ascontiguousarray(values, dtype=np.int32))


def paths_in(layer: Sdf.Layer) -> list[Sdf.Path]:
    """Return the paths of all specs of a layer."""
    paths: list[Sdf.Path] = []
    layer.Traverse(Sdf.Path.absoluteRootPath, paths.append)
    return paths


def prim_paths_in(layer: Sdf.Layer) -> list[Sdf.Path]:
    """Return the paths of all prims of a layer."""
    return [path for path in paths_in(layer) if path.IsPrimPath()]


def sampled_properties(layer: Sdf.Layer) -> list[Sdf.Path]:
    """Return the paths of the attributes that have time samples or a spline in a layer."""
    attributes = filter(None, map(layer.GetAttributeAtPath, paths_in(layer)))
    return [
        each.path
        for each in attributes
        if each.HasSpline() or layer.GetNumTimeSamplesForPath(each.path)
    ]


def retime_layer(layer: Sdf.Layer, rate: float) -> None:
    """Change a layer's rate, and move its samples so that their times in seconds do not change."""
    factor = rate / layer.timeCodesPerSecond
    layer.timeCodesPerSecond = rate
    if factor != 1:
        move_samples(layer, Sdf.LayerOffset(0, factor))


def move_samples(layer: Sdf.Layer, moved: Sdf.LayerOffset) -> None:
    """Move a layer's samples and splines by a layer offset."""
    above = Sdf.Layer.CreateAnonymous()
    above.timeCodesPerSecond = layer.timeCodesPerSecond
    above.subLayerPaths, above.subLayerOffsets[0] = [layer.identifier], moved
    stage = Usd.Stage.Open(above)  # moves the tangents of splines as well
    specs = (layer.GetAttributeAtPath(path) for path in paths_in(layer))
    splined = [each for each in specs if each and each.HasSpline()]
    splines = [stage.GetAttributeAtPath(each.path).GetSpline() for each in splined]
    for spec, spline in zip(splined, splines, strict=True):
        spec.SetSpline(spline)
    for path in sampled_properties(layer):
        times = layer.ListTimeSamplesForPath(path)
        values = [layer.QueryTimeSample(path, time) for time in times]
        for time in times:
            layer.EraseTimeSample(path, time)
        for time, value in zip(times, values, strict=True):
            layer.SetTimeSample(path, moved * time, value)


def author_weights(
    prim: Sdf.PrimSpec, shapes: Sequence[str], weights: RealArray, *, first: int = 1
) -> None:
    """Write BlendShape weights, (rows, shapes), to an animation from a time code on."""
    author_uniform(prim, "blendShapes", Sdf.ValueTypeNames.TokenArray, list(shapes))
    rows = map(Vt.FloatArray.FromNumpy, np.ascontiguousarray(weights, np.float32))
    author_series(prim, "blendShapeWeights", Sdf.ValueTypeNames.FloatArray, rows, first=first)


def author_timing(layer: Sdf.Layer, *, rate: Fraction, first: float, last: float) -> None:
    """Set rates and range; USD rescales layers without a rate."""
    layer.timeCodesPerSecond = float(rate)
    layer.framesPerSecond = float(rate)
    layer.startTimeCode = first
    layer.endTimeCode = last


ARRAYS = "face:array:"
"""Namespace of arrays; an array's shape has its name and ``:shape``."""


def author_arrays(
    prim: Sdf.PrimSpec,
    arrays: Mapping[str, FloatArray | Float32Array],
    *,
    namespace: str = ARRAYS,
) -> None:
    """Write arrays by name, without loss; any but single precision as double."""
    kinds = Sdf.ValueTypeNames
    for name, array in arrays.items():
        kind, values = kinds.DoubleArray, doubles(array)
        if array.dtype == np.float32:
            kind, values = kinds.FloatArray, Vt.FloatArray.FromNumpy(np.ravel(array))
        author_uniform(prim, f"{namespace}{name}", kind, values)
        shape = Vt.IntArray([int(size) for size in array.shape])
        author_uniform(prim, f"{namespace}{name}:shape", kinds.IntArray, shape)


def read_arrays(path: Path, prim: Usd.Prim) -> dict[str, FloatArray]:
    """Return the arrays that `author_arrays` wrote to a prim."""
    arrays = {}
    for attribute in prim.GetAttributes():
        name = attribute.GetName()
        if name.startswith(ARRAYS) and not name.endswith(":shape"):
            shape = prim.GetAttribute(f"{name}:shape").Get()
            if shape is None:
                raise InputError(f"{path} <{attribute.GetPath()}>: has no :shape beside it")
            arrays[name.removeprefix(ARRAYS)] = shaped(
                path, attribute.Get(), tuple(int(size) for size in shape), name
            )
    return arrays


def shaped(path: Path, value: object, shape: tuple[int, ...], name: str) -> FloatArray:
    """Return an attribute's numbers in a shape, one size of which may be -1."""
    array = np.array(value if value is not None else [], dtype=np.float64)
    try:
        array = array.reshape(shape)
    except ValueError as error:
        raise InputError(
            f"{path}: {name} has {array.size} numbers, which make no array of shape {shape}; "
            "train again"
        ) from error
    if not np.isfinite(array).all():
        raise InputError(f"{path}: {name} holds NaN or infinity; train again")
    return array


def read_array_samples(
    path: Path,
    attribute: Usd.Attribute,
    times: Sequence[float],
    names: Sequence[str],
    size: tuple[int, ...] = (),
    *,
    kind: type[np.floating] = np.float64,
    remedy: str,
) -> NDArray[Any]:
    """Return an array attribute over time, finite numbers: (times, names, *size).

    Parameters
    ----------
    names : sequence of str
        Of the elements of a sample.
    size : tuple of int
        Shape of an element.
    """
    out = np.zeros((len(times), len(names), *size), kind)
    if not names:
        return out
    where = f"{path} <{attribute.GetPath()}> time code"
    query = Usd.AttributeQuery(attribute)  # twice as fast as the attribute
    for index, time in enumerate(times):
        value = query.Get(time)
        if value is None or len(value) != len(names):
            count = "no value" if value is None else pluralize(len(value), "value")
            expected = pluralize(len(names), "name")
            raise InputError(f"{where} {time:g}: {count} for {expected}; {remedy}")
        out[index] = value
    with np.errstate(over="ignore", invalid="ignore"):
        sum_is_finite = np.isfinite(out.sum())  # four times as fast as of each number
    if not sum_is_finite and not (finite := np.isfinite(out)).all():
        row, column, *_ = np.argwhere(~finite)[0].tolist()
        raise InputError(
            f"{where} {times[row]:g}: {names[column]} is {out[row, column]}, not finite; {remedy}"
        )
    return out
