"""Layers with the detections of a model in pictures, from which a take is made."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from pxr import Sdf

from usdface.core.arrays import Float32Array
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.usdio.authoring import author_arrays, author_uniform, define_prim
from usdface.usdio.layers import new_layer, open_stage, refusing_wrong_types

_ROOT = "Detections"
_PREFIX = "face:detections:"
_REMEDY = "make it again with `usdface track VIDEO --part --frames A-B --out PART`"


def write_detections(
    path: Path,
    arrays: Mapping[str, Float32Array],
    names: Mapping[str, tuple[str, ...]],
    *,
    provenance: Provenance | None,
) -> None:
    """Write arrays and lists of names, without loss; intermediate files have no provenance."""
    with new_layer(path, provenance) as layer:
        prim = define_prim(layer, Sdf.Path(f"/{_ROOT}"), "Scope")
        layer.defaultPrim = _ROOT
        single = {name: np.asarray(array, np.float32) for name, array in arrays.items()}
        author_arrays(prim, single, namespace=_PREFIX)
        for name, listed in names.items():
            author_uniform(prim, f"{_PREFIX}{name}", Sdf.ValueTypeNames.TokenArray, list(listed))


@refusing_wrong_types
def read_detections(
    path: Path, arrays: tuple[str, ...], names: tuple[str, ...]
) -> tuple[dict[str, Float32Array], dict[str, tuple[str, ...]]]:
    """Return arrays and lists of names by name."""
    stage = open_stage(path)
    prim = stage.GetDefaultPrim()
    if not prim or prim.GetName() != _ROOT:
        raise InputError(f"{path}: is no part of a tracked video; {_REMEDY}")

    def value(name: str) -> object:
        authored = prim.GetAttribute(f"{_PREFIX}{name}").Get()
        if authored is None:
            raise InputError(f"{path} <{prim.GetPath()}>: {_PREFIX}{name} is missing; {_REMEDY}")
        return authored

    by_name = {}
    for name in arrays:
        flat, shape = np.array(value(name), np.float32), np.array(value(f"{name}:shape"), int)
        if shape.min(initial=0) < 0 or flat.size != np.prod(shape) or np.isnan(flat).any():
            raise InputError(f"{path} <{prim.GetPath()}>: {_PREFIX}{name} is damaged; {_REMEDY}")
        by_name[name] = flat.reshape(shape)
    return by_name, {name: tuple(map(str, np.array(value(name), str))) for name in names}
