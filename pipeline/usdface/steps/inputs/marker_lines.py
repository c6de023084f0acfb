"""Lines between neighbouring markers of lips, lids and brows, for pictures and pages."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from usdface.capture.face_landmarks import LANDMARK_ROWS
from usdface.core.arrays import IntArray, index_of
from usdface.core.deformer import Deformer
from usdface.model.placement.marker_rows import rows_by_label, rows_by_place
from usdface.model.placement.rig_landmarks import find_landmarks
from usdface.model.selection.baseline import BlendshapeEquation

_LEAST_KNOWN = 0.8
"""Share of the landmarks in rows above which a take is one of `track`."""


def marker_lines(labels: Sequence[str], positions: ArrayLike) -> IntArray:
    """Return the markers joined by lines, (lines, 2), as far as labels show neighbours.

    `positions`: (markers, 3), at rest; see `rows_by_label`. Landmarks of `track` are joined as in
    MediaPipe's mesh.
    """
    place = index_of(labels)
    named = [name for row in LANDMARK_ROWS for name in row]
    if sum(name in place for name in named) >= _LEAST_KNOWN * len(named):
        rows = [np.array([place[name] for name in row if name in place]) for row in LANDMARK_ROWS]
    else:
        rows = rows_by_label(labels, positions)
    return _lines(rows)


def lines_on_rig(
    labels: Sequence[str], equation: BlendshapeEquation, deformer: Deformer, shapes: Sequence[str]
) -> IntArray:
    """Return lines as `marker_lines` does, or by the markers' placement if labels show none."""
    by_label = marker_lines(labels, equation.neutral)
    if len(by_label):
        return by_label
    try:
        skin = deformer.face_skin()
    except ValueError:  # no skin that shapes move
        return by_label
    places = skin.to_frame(equation.virtual.places(deformer.neutral))
    return _lines(rows_by_place(places, find_landmarks(skin, shapes)))


def _lines(rows: Sequence[IntArray]) -> IntArray:
    lines = [np.stack([row[:-1], row[1:]], axis=1) for row in rows if len(row) > 1]
    return np.concatenate(lines or [np.zeros((0, 2), np.int64)]).astype(np.int64)
