"""Of a shape that a tool keys on every mesh apart: what its user changed.

Artists change the copy that they see, on the skin, say, and leave those of teeth and lashes.
"""

import numpy as np

from usdface.assets import FloatArray, IntArray
from usdface.steps.weight_tables import WeightTable

CUT_TO = (0.0, 1.0)
"""Blender's sliders after an import: weights beyond come back as these."""
CUT_WITHIN = 1e-5
"""float32 there and back."""


def weights_meant(table: WeightTable, name: str, rows: IntArray, shown: FloatArray) -> FloatArray:
    """Return a shape's weights at some rows: of its copies, the one farthest from what is shown.

    Parameters
    ----------
    table : WeightTable
    name : str
        One of the table's.
    rows : (n,) int array
        Of the table.
    shown : (n,) float array
        What the shape was when the tool was given it. Where that lies beyond `CUT_TO` and the copy
        is at the end, the tool has cut it: it counts as unchanged.
    """
    column = table.names.index(name)
    copies = table.weights[None, rows, column]
    if table.copies:
        copies = _uncut(table.copies[column][:, rows], shown)
    farthest = np.abs(copies - shown).argmax(axis=0)
    meant: FloatArray = copies[farthest, np.arange(len(rows))]
    return meant


def is_disputed(
    table: WeightTable, name: str, rows: IntArray, shown: FloatArray, *, least: float
) -> bool:
    """Return whether two copies of a shape were changed, and differently, at one frame."""
    if not table.copies:
        return False
    copies = _uncut(table.copies[table.names.index(name)][:, rows], shown)
    changed = np.abs(copies - shown) > least
    low = np.where(changed, copies, np.inf).min(axis=0)
    high = np.where(changed, copies, -np.inf).max(axis=0)
    return bool((high - low > least).any())


def dispute_note(names: list[str]) -> tuple[str, ...]:
    """Return what to tell of shapes whose copies were changed differently."""
    if not names:
        return ()
    return (
        f"changed differently on two meshes, where the larger change was taken: "
        f"{', '.join(names[:5])}",
    )


def _uncut(copies: FloatArray, shown: FloatArray) -> FloatArray:
    end = np.clip(shown, *CUT_TO)
    return np.where((end != shown) & (np.abs(copies - end) < CUT_WITHIN), shown, copies)
