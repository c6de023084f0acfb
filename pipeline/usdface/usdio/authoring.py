"""The few ways in which layers are filled: prims, uniform attributes, arrays."""

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
