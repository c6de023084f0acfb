"""The few ways in which layers are filled: prims, uniform attributes, arrays, timing."""

from fractions import Fraction

import numpy as np
from numpy.typing import ArrayLike
from pxr import Sdf, Vt


def define_prim(layer: Sdf.Layer, path: Sdf.Path, type_name: str) -> Sdf.PrimSpec:
    """Define a typed prim in a layer."""
    prim = Sdf.CreatePrimInLayer(layer, path)
    prim.specifier = Sdf.SpecifierDef
    prim.typeName = type_name
    return prim


def apply_api(prim: Sdf.PrimSpec, name: str) -> None:
    """Apply an API schema to a prim of a layer."""
    prim.SetInfo("apiSchemas", Sdf.TokenListOp.Create(prependedItems=[name]))


def author_uniform(prim: Sdf.PrimSpec, name: str, kind: Sdf.ValueTypeName, value: object) -> None:
    """Write an attribute that does not change over time."""
    Sdf.AttributeSpec(prim, name, kind, Sdf.VariabilityUniform).default = value


def doubles(values: ArrayLike) -> Vt.DoubleArray:
    """Return an array of any shape as a flat array of doubles."""
    return Vt.DoubleArray.FromNumpy(np.ascontiguousarray(values, dtype=np.float64).ravel())


def retime_layer(layer: Sdf.Layer, rate: float) -> None:
    """Give a layer another rate, and move its samples so that they stay where they are in time."""
    factor = rate / layer.timeCodesPerSecond
    layer.timeCodesPerSecond = rate
    if factor == 1:
        return
    sampled: list[Sdf.Path] = []

    def look(path: Sdf.Path) -> None:
        if path.IsPropertyPath() and layer.GetNumTimeSamplesForPath(path):
            sampled.append(path)

    layer.Traverse(Sdf.Path.absoluteRootPath, look)
    for path in sampled:
        times = layer.ListTimeSamplesForPath(path)
        values = [layer.QueryTimeSample(path, time) for time in times]
        for time in times:
            layer.EraseTimeSample(path, time)
        for time, value in zip(times, values, strict=True):
            layer.SetTimeSample(path, time * factor, value)


def author_timing(layer: Sdf.Layer, *, rate: Fraction, first: float, last: float) -> None:
    """Set rate and range: USD rescales a layer silently when one rate is missing."""
    layer.timeCodesPerSecond = float(rate)
    layer.framesPerSecond = float(rate)
    layer.startTimeCode = first
    layer.endTimeCode = last
