"""Of a shape that a tool keys on every mesh apart: what its user changed.

One mesh counts, the one with the most shapes, which is the face. What differs from others alone
could not tell a change from what was left: an export holds what was given, too, which edits made
since, by this export's own import among them, have left behind.
"""

from collections.abc import Mapping

import numpy as np

from usdface.assets import FloatArray, IntArray
from usdface.steps.weight_tables import WeightTable

CUT_TO = (0.0, 1.0)
"""Blender's sliders after an import: weights beyond come back as these."""
CUT_WITHIN = 1e-5
"""float32 there and back."""


def weights_meant(table: WeightTable, name: str, rows: IntArray, shown: FloatArray) -> FloatArray:
    """Return a shape's weights at some rows, those that a tool had cut as they are shown.

    Parameters
    ----------
    table : WeightTable
    name : str
        One of the table's.
    rows : (n,) int array
        Of the table.
    shown : (n,) float array
        What the shape is now. Where that lies beyond `CUT_TO` and the tool's weight is at the end,
        it was cut and not changed.
    """
    weights: FloatArray = table.weights[rows, table.names.index(name)]
    if not table.meshes:
        return weights
    end = np.clip(shown, *CUT_TO)
    return np.where((end != shown) & (np.abs(weights - end) < CUT_WITHIN), shown, weights)


def changed_elsewhere(
    table: WeightTable,
    name: str,
    rows: IntArray,
    *,
    meant: FloatArray,
    shown: FloatArray,
    solved: FloatArray,
    least: float,
) -> list[str]:
    """Return the meshes on which a shape was changed at a frame where the mesh that counts was not.

    A mesh that shows the solve was left as it was given.
    """
    found = []
    still = np.abs(meant - shown) <= least
    for mesh, weights in table.elsewhere.get(name, {}).items():
        other = weights[rows]
        changed = (np.abs(other - shown) > least) & (np.abs(other - solved) > least)
        if (still & changed & ((other > CUT_TO[0]) & (other < CUT_TO[1]))).any():
            found.append(mesh)
    return found


def elsewhere_notes(table: WeightTable, found: Mapping[str, list[str]]) -> tuple[str, ...]:
    """Return what to tell of shapes that were changed on meshes that do not count, by shape."""
    return tuple(
        f"{name} differs between {', '.join(meshes)} and {table.meshes[table.names.index(name)]}, "
        "which counts, as it has the most shapes; change it there"
        for name, meshes in list(found.items())[:5]
    )
