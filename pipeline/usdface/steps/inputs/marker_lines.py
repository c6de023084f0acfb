"""Lines between neighbouring markers of lips, lids and brows, for pictures and pages.

Rows of markers are found by labels, or by positions on a rig.
"""

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from usdface.capture.face_landmarks import LANDMARK_ROWS
from usdface.core.arrays import FloatArray, IntArray, index_of
from usdface.core.deformer import Deformer
from usdface.model.placement.label_hints import LabelHint, label_hint
from usdface.model.placement.rig_landmarks import find_landmarks
from usdface.model.selection.baseline import BlendshapeEquation

_MOST_WINDING = 1.6
"""Largest ratio of a row's length to its extent. Lips and lids reach 1.4; larger ratios are of two
rows taken for one, such as both edges of a brow, and are not drawn."""

_ROW_REACH_MM = 5.0
"""Distance from a row on an adult's face below which a marker without a label belongs to it:
markers are glued beside the edges of lips and lids, and placed to a few millimetres."""

_SHARED_MM = 1.0
"""A marker this much farther from another row than from its own is in both, as the corner that they
share, if it is the nearest to that corner."""

_CORNERS = {
    "lip_upper": ("mouth_R", "mouth_L"),
    "lip_lower": ("mouth_R", "mouth_L"),
    **{f"lid_crease_{side}": (f"eye_inner_{side}", f"eye_outer_{side}") for side in "LR"},
    **{f"lid_lower_{side}": (f"eye_inner_{side}", f"eye_outer_{side}") for side in "LR"},
    "brow_L": (),
    "brow_R": (),
}
"""Rows, each named for the landmark in its middle, with those that end it and that it shares with
others. Brows have none, as their landmarks are centroids of motion, not points of a line."""

_LEAST_PLACED = 3
"""Fewest markers of a row without labels: two may be the corners of a mouth."""

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


def rows_by_label(labels: Sequence[str], positions: ArrayLike) -> list[IntArray]:
    """Return the markers of each row, in the order in which they lie across the face.

    Returns the columns of each row's labels, at least two in each; labels that say nothing are in
    none.

    `positions`: (markers, 3), at rest [mm]; a marker without one is in no row.
    """
    at = np.asarray(positions, np.float64)
    hints = [label_hint(label) for label in labels]
    rows = []
    for row, corners in _CORNERS.items():
        own = [i for i, hint in enumerate(hints) if _is_of(hint, row)]
        ends = [i for i, hint in enumerate(hints) if hint.landmarks in {(c,) for c in corners}]
        if not own:
            continue
        rows += _in_order(at, [*own, *ends])
    return rows


def rows_by_place(places: ArrayLike, landmarks: Mapping[str, FloatArray]) -> list[IntArray]:
    """Return the markers of each row as `rows_by_label` does, by the landmarks that they lie near.

    Parameters
    ----------
    places : (markers, 3) array
        On the rig at rest, in the frame of the landmarks [mm].
    landmarks : mapping of str to (3,) array
        As `find_landmarks` names them; rows that lack one are left out.
    """
    at = np.asarray(places, np.float64)
    lines = [(corners[0], row, corners[1]) for row, corners in _CORNERS.items() if corners]
    paths = [[landmarks[name] for name in line] for line in lines if landmarks.keys() >= set(line)]
    if not paths:
        return []
    away = np.stack([_distance(at[:, :2], np.array(path)[:, :2]) for path in paths])
    nearest = np.nan_to_num(away, nan=np.inf).min(axis=0)
    is_of = (away <= nearest + _SHARED_MM) & (away < _ROW_REACH_MM)
    shared = is_of.sum(axis=0) > 1
    for corner in [end for path in paths for end in (path[0], path[-1])]:
        from_corner = np.linalg.norm(at - corner, axis=1)
        beside = np.flatnonzero(shared & (from_corner < 2 * _ROW_REACH_MM))
        for marker in beside[from_corner[beside].argsort()][1:].tolist():
            is_of[:, marker] = np.arange(len(paths)) == away[:, marker].argmin()
    members = [np.flatnonzero(each) for each in is_of if each.sum() >= _LEAST_PLACED]
    return [row for each in members for row in _in_order(at, each.tolist())]


def _distance(points: FloatArray, path: FloatArray) -> FloatArray:
    """Return how far points are from a line of straight pieces."""
    pieces = []
    for start, end in pairwise(path):
        along = end - start
        share = np.clip((points - start) @ along / (along @ along), 0, 1)
        pieces.append(np.linalg.norm(points - start - share[:, None] * along, axis=1))
    return np.asarray(np.min(pieces, axis=0))


def _in_order(at: FloatArray, members: Sequence[int]) -> list[IntArray]:
    """Return a row in the order of its longest axis; nothing if it is no row."""
    row = np.array([each for each in members if np.isfinite(at[each]).all()], np.int64)
    if len(row) < 2:
        return []
    centred = at[row] - at[row].mean(axis=0)
    along = centred @ np.linalg.svd(centred, full_matrices=False)[2][0]
    order = np.argsort(along, kind="stable")
    length = np.linalg.norm(np.diff(at[row[order]], axis=0), axis=1).sum()
    return [row[order]] if length < _MOST_WINDING * np.ptp(along) else []


def _is_of(hint: LabelHint, row: str) -> bool:
    """Whether a marker lies in a row by itself, and not as the corner that ends it."""
    if row.startswith("brow_"):
        return hint.region == "brow" and hint.side == row[-1]
    return bool(hint.landmarks) and hint.landmarks[0] == row
