"""Cache of geodesic distances for one surface and its markers, as a layer."""

import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from pxr import Sdf

from usdface.core.arrays import BoolArray, Float32Array, FloatArray
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.usdio.authoring import ARRAYS, apply_api, author_arrays, author_uniform, define_prim
from usdface.usdio.layers import new_layer, open_layer
from usdface.usdio.units import author_units

_ROOT = Sdf.Path("/Distances")
KEY = "face:distances:key"
_FACTS = "face:distances:facts"

_CacheArray = FloatArray | Float32Array | BoolArray


@dataclass(frozen=True)
class CachedDistances:
    """Arrays and counts by name."""

    arrays: dict[str, _CacheArray]
    """float64, float32 or bool, of any shape; lengths in millimetres."""
    counts: dict[str, int] = field(default_factory=dict)


def write_distances(path: Path, cached: CachedDistances, *, key: str) -> None:
    """Write distances with a key of their surface and markers."""
    kinds = Sdf.ValueTypeNames
    with new_layer(path, Provenance(step="distances")) as layer:
        author_units(layer)
        layer.defaultPrim = _ROOT.name
        prim = define_prim(layer, _ROOT, "Scope")
        apply_api(prim, "FaceDistancesAPI")
        author_uniform(prim, KEY, kinds.String, key)
        author_uniform(prim, _FACTS, kinds.String, json.dumps(cached.counts))
        author_arrays(prim, cached.arrays)


def read_distances(path: Path, *, key: str) -> CachedDistances | None:
    """Return the distances of a key; None if the file is missing, damaged or of another key."""
    if not path.is_file():
        return None
    try:
        layer = open_layer(path)
    except InputError:
        return None  # a cache that cannot be read is computed again
    prim = layer.GetPrimAtPath(_ROOT)
    if prim is None or KEY not in prim.attributes or prim.attributes[KEY].default != key:
        return None
    values = {name: attribute.default for name, attribute in prim.attributes.items()}
    arrays: dict[str, _CacheArray] = {}
    try:
        for name, value in values.items():
            if name.startswith(ARRAYS) and not name.endswith(":shape"):
                shape = tuple(int(size) for size in values[f"{name}:shape"])
                arrays[name.removeprefix(ARRAYS)] = np.array(value).reshape(shape)
        counts = json.loads(values[_FACTS])
    except (KeyError, TypeError, ValueError, ArithmeticError, RecursionError):
        return None
    return CachedDistances(arrays, counts)
