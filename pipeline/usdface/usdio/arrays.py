"""Arrays of any shape as attributes, and attributes over time as arrays: finite, or refused."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from pxr import Sdf, Usd, Vt

from usdface.core.arrays import FloatArray
from usdface.core.errors import InputError
from usdface.usdio.authoring import author_uniform, doubles

_PREFIX = "face:array:"
"""Before the name of each array; its shape is beside it, under the same name and ``:shape``."""


def author_arrays(prim: Sdf.PrimSpec, arrays: Mapping[str, FloatArray]) -> None:
    """Write arrays by name; read back, they are the same to the last bit."""
    kinds = Sdf.ValueTypeNames
    for name, array in arrays.items():
        author_uniform(prim, f"{_PREFIX}{name}", kinds.DoubleArray, doubles(array))
        shape = Vt.IntArray([int(size) for size in array.shape])
        author_uniform(prim, f"{_PREFIX}{name}:shape", kinds.IntArray, shape)


def read_arrays(path: Path, prim: Usd.Prim) -> dict[str, FloatArray]:
    """Return what `author_arrays` wrote to a prim of a trained asset.

    Raises
    ------
    InputError
        If an array has no shape, or other numbers than its shape says.
    """
    arrays = {}
    for attribute in prim.GetAttributes():
        name = attribute.GetName()
        if name.startswith(_PREFIX) and not name.endswith(":shape"):
            shape = prim.GetAttribute(f"{name}:shape").Get()
            if shape is None:
                raise InputError(f"{path} <{attribute.GetPath()}>: has no :shape beside it")
            arrays[name.removeprefix(_PREFIX)] = shaped(
                path, attribute.Get(), tuple(int(size) for size in shape), name
            )
    return arrays


def shaped(path: Path, value: object, shape: tuple[int, ...], name: str) -> FloatArray:
    """Return an attribute's numbers in a shape, of which one size may be -1.

    Raises
    ------
    InputError
        If their count is not that of the shape, or one is not finite.
    """
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
    times: Sequence[int],
    shape: tuple[int, ...],
    *,
    remedy: str,
) -> FloatArray:
    """Return an array attribute over time: (times, *shape).

    Raises
    ------
    InputError
        If a sample is missing, of another shape, or not finite.
    """
    out = np.zeros((len(times), *shape))
    if not shape[0]:
        return out
    for index, time in enumerate(times):
        value = attribute.Get(time)
        row = None if value is None else np.asarray(value, np.float64)
        if row is None or row.shape != shape or not np.isfinite(row).all():
            count = "none" if row is None else f"{len(row)}"
            raise InputError(
                f"{path} <{attribute.GetPath()}> time code {time}: {count} values where "
                f"{shape[0]} finite ones are needed, one for each name; {remedy}"
            )
        out[index] = row
    return out
