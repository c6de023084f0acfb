"""Rows of markers along lips, lids and brows, found by what the labels say."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from usdface.core.arrays import FloatArray, IntArray
from usdface.core.errors import InputError
from usdface.model.placement.label_hints import LabelHint, label_hint

MOST_WINDING = 1.6
"""Length of a row over the distance of its ends, seen from the front. Lips and lids reach 1.4; what
winds further holds two rows, such as both edges of a brow, and is not drawn."""

_CORNERS = {
    "lip_upper": ("mouth_L", "mouth_R"),
    "lip_lower": ("mouth_L", "mouth_R"),
    **{f"lid_crease_{side}": (f"eye_inner_{side}", f"eye_outer_{side}") for side in "LR"},
    **{f"lid_lower_{side}": (f"eye_inner_{side}", f"eye_outer_{side}") for side in "LR"},
    "brow_L": (),
    "brow_R": (),
}
"""Rows, each with the landmarks that end it and that it shares with others."""


def rows_by_label(labels: Sequence[str], positions: ArrayLike) -> list[IntArray]:
    """Return the markers of each row, in the order in which they lie across the face.

    Parameters
    ----------
    positions : (markers, 3) array
        At rest, the face looking along +Z, Y up [mm]; a marker without one is in no row.

    Returns
    -------
    list of (n,) int array
        Columns of the labels, at least two in each; labels that say nothing are in none.
    """
    at = np.asarray(positions, np.float64)
    if at.shape != (len(labels), 3):
        raise InputError(f"{len(labels)} labels with positions of shape {at.shape}; give one each")
    hints = [label_hint(label) for label in labels]
    rows = []
    for row, corners in _CORNERS.items():
        own = [i for i, hint in enumerate(hints) if _is_of(hint, row)]
        ends = [i for i, hint in enumerate(hints) if hint.landmarks in {(c,) for c in corners}]
        if not own:
            continue
        members = np.array([i for i in (*own, *ends) if np.isfinite(at[i]).all()], np.int64)
        ordered = members[np.argsort(at[members, 0], kind="stable")]
        if len(ordered) > 1 and _winding(at[ordered, :2]) < MOST_WINDING:
            rows.append(ordered)
    return rows


def _is_of(hint: LabelHint, row: str) -> bool:
    """Whether a marker lies in a row by itself, and not as the corner that ends it."""
    if row.startswith("brow_"):
        return hint.region == "brow" and hint.side == row[-1]
    return bool(hint.landmarks) and hint.landmarks[0] == row


def _winding(points: FloatArray) -> float:
    length = np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
    return float(length / max(np.linalg.norm(points[-1] - points[0]), 1e-9))
