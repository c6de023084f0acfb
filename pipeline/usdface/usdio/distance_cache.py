"""Distances over a mesh as a layer: found once for a surface and its markers, read ever after."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pxr import Sdf, Vt

from usdface.errors import InputError
from usdface.provenance import Provenance
from usdface.usdio.authoring import apply_api, author_uniform, define_prim
from usdface.usdio.layers import author_units, new_layer, open_layer

ROOT = Sdf.Path("/Distances")
ARRAY = "face:array:"
KEY = "face:distances:key"

Arrays = dict[str, NDArray[np.float64]]


def write_distances(
    path: Path, arrays: Arrays, *, key: str, provenance: Provenance | None = None
) -> None:
    """Write named arrays under a key that says of which surface and markers they are.

    Parameters
    ----------
    path : Path
    arrays : dict of str to float array
        Of any shapes; lengths in millimetres.
    key : str
    provenance : Provenance, optional
    """
    with new_layer(path, provenance or Provenance(step="distances")) as layer:
        author_units(layer)
        layer.defaultPrim = ROOT.name
        prim = define_prim(layer, ROOT, "Scope")
        apply_api(prim, "FaceDistancesAPI")
        author_uniform(prim, KEY, Sdf.ValueTypeNames.String, key)
        for name, array in arrays.items():
            flat = np.ascontiguousarray(array, dtype=np.float32).ravel()
            values = Vt.FloatArray.FromNumpy(flat)
            author_uniform(prim, f"{ARRAY}{name}", Sdf.ValueTypeNames.FloatArray, values)
            shape = Vt.IntArray([int(size) for size in np.shape(array)])
            author_uniform(prim, f"{ARRAY}{name}:shape", Sdf.ValueTypeNames.IntArray, shape)


def read_distances(path: Path, *, key: str) -> Arrays | None:
    """Return the arrays of a key; None where the file is absent, unreadable or of another key."""
    if not path.is_file():
        return None
    try:
        layer = open_layer(path)
    except InputError:
        return None  # a cache that cannot be read is made again
    prim = layer.GetPrimAtPath(ROOT)
    if prim is None or KEY not in prim.attributes or prim.attributes[KEY].default != key:
        return None
    found: Arrays = {}
    for name, attribute in prim.attributes.items():
        if name.startswith(ARRAY) and not name.endswith(":shape"):
            shape = tuple(prim.attributes[f"{name}:shape"].default or ())
            values = np.array(attribute.default, dtype=np.float64)
            if values.size != int(np.prod(shape)):
                return None
            found[name.removeprefix(ARRAY)] = values.reshape(shape)
    return found
