"""Markers on the mesh they are bound to, from the front and both sides: named, the doubtful marked.

Names stand beside the face, joined to their markers by lines, so that none lies on another.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import BoolArray, ByteImage, FloatArray
from usdface.core.assets import RigMesh
from usdface.core.errors import InputError
from usdface.media.face.camera import Camera, frame_face
from usdface.media.face.render import FaceRenderer, Quality
from usdface.media.picture.canvas import (
    draw_dot,
    draw_line,
    fill_box,
    new_picture,
    spread_rows,
)
from usdface.media.picture.color import BLUE, PAGE, SOFT, Color
from usdface.media.picture.sheet import draw_header
from usdface.media.picture.text import TextStyle, draw_text, text_width

_PAGE_MARGIN = 36
_HEAD_HEIGHT = 124
_NAMES_WIDTH = 250
"""Width of the list of names on either side of a face [pixels]."""

_NAME_MARGIN = 14

_PLACED: Color = (140, 226, 140)
_DOUBT: Color = (255, 128, 72)
_LINE: Color = (92, 98, 108)
_HIDDEN_MM = 3.0
_SIDE_DEGREES = 62.0


@dataclass(frozen=True)
class BoundMarkers:
    """What the picture shows of a binding.

    Attributes
    ----------
    positions : (markers, 3) float array
        On the mesh [mm].
    confidence : (markers,) float array
        [0-1]
    placed : (markers,) bool array
        True where a person placed the marker.
    doubtful : float
        Confidence below which a marker is marked.
    """

    names: tuple[str, ...]
    positions: FloatArray
    confidence: FloatArray
    placed: BoolArray
    doubtful: float = 0.5


def draw_binding(
    mesh: RigMesh,
    markers: BoundMarkers,
    *,
    title: str,
    facts: Sequence[str] = (),
    yaw_degrees: float = 0.0,
    height: int = 1000,
    quality: Quality = "final",
) -> ByteImage:
    """Draw the picture: the front with every name, and the two sides with the names they add.

    Parameters
    ----------
    yaw_degrees : float
        How far the face is turned from looking along +Z [degrees].
    height : int
        Of the front view [pixels].
    quality : {'draft', 'final'}

    Returns
    -------
    (height, width, 3) uint8 array
        sRGB.

    Raises
    ------
    InputError
        If there is no marker.
    """
    if not markers.names:
        raise InputError(f"{title}: no marker to draw")
    renderer = FaceRenderer([mesh])
    reach = _near_markers(mesh.points, markers.positions)
    panels = [
        _draw_view(mesh, renderer, markers, reach, (side, yaw_degrees), height, quality)
        for side in (-_SIDE_DEGREES, 0.0, _SIDE_DEGREES)
    ]
    width = sum(panel.shape[1] for panel in panels) + 2 * _PAGE_MARGIN
    page = new_picture(width, _HEAD_HEIGHT + height + _PAGE_MARGIN, PAGE)
    y = draw_header(page, title, facts, margin=_PAGE_MARGIN)
    x = _PAGE_MARGIN
    for panel in panels:
        page[_HEAD_HEIGHT : _HEAD_HEIGHT + height, x : x + panel.shape[1]] = panel
        x += panel.shape[1]
    _draw_key(page, x=width - _PAGE_MARGIN - 560, y=y - 58)
    return page


def _near_markers(points: FloatArray, at: FloatArray) -> FloatArray:
    """Return 1 for points of the face, 0 for neck and shoulders that carry no marker."""
    box = np.ptp(at, axis=0).max() * 0.12
    low, high = at.min(axis=0) - box, at.max(axis=0) + box
    inside: FloatArray = ((points >= low) & (points <= high)).all(axis=1).astype(np.float64)
    return inside


def _draw_view(
    mesh: RigMesh,
    renderer: FaceRenderer,
    markers: BoundMarkers,
    reach: FloatArray,
    turn: tuple[float, float],
    height: int,
    quality: Quality,
) -> ByteImage:
    side, facing = turn
    front = side == 0.0
    size = round(height * (0.92 if front else 0.66))
    camera = frame_face(mesh.points, weights=reach, yaw_degrees=side + facing, aspect=size / height)
    width = size + 2 * _NAMES_WIDTH
    panel = renderer.render(mesh.points, camera=camera, width=width, height=height, quality=quality)
    at = camera.project(markers.positions, width=width, height=height)[:, :2]
    seen = _seen(mesh, camera, markers.positions)
    if not front:  # only what the front shows badly: markers on this side of the face
        right = np.array([np.cos(np.radians(facing)), 0.0, -np.sin(np.radians(facing))])
        across = markers.positions @ right
        seen &= np.sign(side) * (across - np.median(across)) > 0.18 * np.ptp(across)
    _draw_names(panel, markers, at, seen)
    return panel


def _seen(mesh: RigMesh, camera: Camera, at: FloatArray) -> BoolArray:
    """Say which markers the mesh does not hide, by a depth buffer of its points."""
    cells = 160
    points = camera.project(mesh.points, width=cells, height=cells)
    own = camera.project(at, width=cells, height=cells)
    depth = np.full((cells, cells), np.inf)
    column, row = points[:, 0].astype(int), points[:, 1].astype(int)
    inside = (column >= 0) & (column < cells) & (row >= 0) & (row < cells)
    np.minimum.at(depth, (row[inside], column[inside]), points[inside, 2])
    c, r = (np.clip(own[:, i].astype(int), 0, cells - 1) for i in (0, 1))
    seen: BoolArray = own[:, 2] < depth[r, c] + 4 * _HIDDEN_MM
    return seen


def _draw_names(panel: ByteImage, markers: BoundMarkers, at: FloatArray, seen: BoolArray) -> None:
    height, width = panel.shape[:2]
    for left in (True, False):
        side = np.flatnonzero(seen & ((at[:, 0] < width / 2) == left))
        side = side[np.argsort(at[side, 1], kind="stable")]
        rows = spread_rows(
            at[side, 1],
            spacing=min(19.0, height / max(len(side), 1)),
            height=height,
            margin=_NAME_MARGIN,
        )
        for marker, row in zip(side.tolist(), rows.tolist(), strict=True):
            color = _color(markers, marker)
            text = markers.names[marker]
            doubt = color == _DOUBT
            if doubt:
                text = f"{text}  {markers.confidence[marker]:.2f}"
            style = TextStyle(size=15, color=color, weight="bold" if doubt else "regular")
            x = _NAMES_WIDTH - 40 if left else width - _NAMES_WIDTH + 40
            draw_line(panel, (x + (6 if left else -6), row), at[marker], _LINE, thickness=1.0)
            long = min(text_width(text, style), _NAMES_WIDTH - 50)
            start = x - long - 3 if left else x - 3
            # A wide head reaches under the names.
            fill_box(panel, start, round(row) - 9, long + 6, 19, PAGE, cover=0.55)
            draw_text(
                panel,
                text,
                x=x,
                y=round(row) - 10,
                style=style,
                anchor="right" if left else "left",
                max_width=_NAMES_WIDTH - 50,
            )
    for marker in np.flatnonzero(seen).tolist():
        color = _color(markers, marker)
        x, y = at[marker]
        draw_dot(panel, x, y, 5.5, (16, 17, 19))
        draw_dot(panel, x, y, 4.2, color)
        if color == _DOUBT:
            draw_dot(panel, x, y, 10.0, color, hollow=True)


def _color(markers: BoundMarkers, marker: int) -> Color:
    if markers.placed[marker]:
        return _PLACED
    return _DOUBT if markers.confidence[marker] < markers.doubtful else BLUE


def _draw_key(page: ByteImage, *, x: int, y: int) -> None:
    for color, label in (
        (BLUE, "proposed"),
        (_DOUBT, "uncertain: look at it"),
        (_PLACED, "placed by a person"),
    ):
        draw_dot(page, x + 8, y + 12, 6.0, color)
        style = TextStyle(size=17, color=SOFT)
        x += 24 + draw_text(page, label, x=x + 22, y=y, style=style) + 22
