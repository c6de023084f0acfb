"""Picture of markers bound to a surface, from the front and both sides, with a verdict.

Names are listed beside the face and joined to their markers by lines.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from usdface.core.arrays import BoolArray, ByteImage, FloatArray, IntArray
from usdface.core.assets import RigMesh
from usdface.media.face.camera import Camera, frame_face
from usdface.media.face.render import FaceRenderer, Quality
from usdface.media.picture.canvas import draw_dot, draw_line, fill_box, new_picture, space_rows
from usdface.media.picture.color import BLUE, GREEN, PAGE, SOFT, Color
from usdface.media.picture.sheet import draw_header, draw_verdict
from usdface.media.picture.sheet_layout import VERDICT_SCALE, verdict_lines
from usdface.media.picture.text import TextStyle, draw_text, text_width

_PAGE_MARGIN = 30
_HEAD_HEIGHT = 128
_VERDICT_HEIGHT = 34
_NAMES_WIDTH = 128
"""Width of the list of names beside a face [pixels]."""

_NAME_GAP = 24
"""Gap between the names and the face, for lines [pixels]."""

_NAME_SIZE = 13
_NAME_LINE = 15.0
_LEAST_NAME_LINE = 12.0
"""Distance of names below which they would cover each other, so that some are left out [pixels]."""

_NAME_MARGIN = 14

_FRONT_WIDTH, _SIDE_WIDTH = 460, 236
_VIEW_HEIGHT = 660
"""[pixels]; with the names, the page is 1600 wide."""

_WARNING_COLOR: Color = (255, 128, 72)
_LINE: Color = (92, 98, 108)
_HIDDEN_MM = 3.0
_SIDE_DEGREES = 62.0

_ONE_SIDED_SHARE = 0.25
"""Extent of the markers on one side of the face over that on the other, up to which they are on
one side: those of the midline are up to 6 mm off, and a cheek 50."""


@dataclass(frozen=True)
class BoundMarkers:
    """A binding to draw."""

    names: tuple[str, ...]
    positions: FloatArray
    """(markers, 3): on the surface [mm]."""
    warnings: tuple[str, ...]
    """Reason to check each marker, in a word or two, or empty."""
    placed: BoolArray
    """(markers,): whether a person placed the marker."""
    wanted: dict[int, FloatArray] = field(default_factory=dict)
    """dict of int to (3,) float array: expected position of such a marker, drawn as a ring
    [mm]."""


def draw_binding(
    meshes: Sequence[RigMesh],
    markers: BoundMarkers,
    *,
    title: str,
    verdict: tuple[str, str] = ("", ""),
    facts: Sequence[str] = (),
    yaw_degrees: float = 0.0,
    quality: Quality = "final",
) -> ByteImage:
    """Draw the front with all names that fit, and both sides with those of their outer markers.

    (height, 1600, 3) uint8 array, sRGB. Meshes are at rest; hidden ones are not drawn. `verdict`:
    ``'good'``, ``'check'`` or ``'bad'``, and the sentence, or empty. `yaw_degrees`: heading of the
    face, 0 along +Z.
    """
    renderer = FaceRenderer(meshes)
    points = np.concatenate([mesh.points for mesh in meshes])
    # Points within the markers' bounding box, without neck and shoulders.
    at = _both_sides(points, markers.positions, yaw_degrees)
    box = np.ptp(at, axis=0).max() * 0.12
    low, high = at.min(axis=0) - box, at.max(axis=0) + box
    reach = ((points >= low) & (points <= high)).all(axis=1).astype(np.float64)
    views = [
        _view(points, markers, reach, side=side, facing=yaw_degrees)
        for side in (-_SIDE_DEGREES, 0.0, _SIDE_DEGREES)
    ]
    hidden = ~np.any([view.seen for view in views], axis=0)
    views[1] = replace(views[1], named=views[1].named | hidden)
    panels = [_draw_view(points, renderer, markers, view, quality) for view in views]
    width = sum(panel.shape[1] for panel in panels) + 2 * _PAGE_MARGIN
    lines = verdict_lines(verdict, width, VERDICT_SCALE) if verdict[1] else ()
    head = _HEAD_HEIGHT + len(lines) * _VERDICT_HEIGHT
    page = new_picture(width, head + _VIEW_HEIGHT + _PAGE_MARGIN, PAGE)
    y = draw_header(page, title, facts, margin=_PAGE_MARGIN)
    if verdict[1]:
        draw_verdict(page, verdict, x=_PAGE_MARGIN, y=y - 4, scale=VERDICT_SCALE)
    x = _PAGE_MARGIN
    for panel in panels:
        page[head : head + _VIEW_HEIGHT, x : x + panel.shape[1]] = panel
        x += panel.shape[1]
    _draw_key(page, right=width - _PAGE_MARGIN, y=_PAGE_MARGIN - 4)
    return page


def _both_sides(points: FloatArray, at: FloatArray, facing: float) -> FloatArray:
    """Return positions, and of markers on one side of the face also their mirror images.

    All views then show the whole face at one size.
    """
    right = _right(facing)
    reach, across = points @ right, at @ right
    middle = (reach.min() + reach.max()) / 2
    away = across - middle
    if min(-away.min(), away.max()) > _ONE_SIDED_SHARE * np.abs(away).max():
        return at
    return np.concatenate([at, at - 2 * away[:, None] * right])


def _right(facing: float) -> FloatArray:
    """Return the direction to the right of the picture from the front."""
    return np.array([np.cos(np.radians(facing)), 0.0, -np.sin(np.radians(facing))])


@dataclass(frozen=True)
class _View:
    """One view of the page."""

    camera: Camera
    width: int
    columns: tuple[bool, bool]
    """Whether names are listed on the left, and on the right."""
    seen: BoolArray
    named: BoolArray
    """`seen`, `named`: (markers,): visible markers, and those named in this view."""


def _view(
    points: FloatArray, markers: BoundMarkers, reach: FloatArray, *, side: float, facing: float
) -> _View:
    front = side == 0.0
    size = _FRONT_WIDTH if front else _SIDE_WIDTH
    camera = frame_face(
        points, weights=reach, yaw_degrees=side + facing, aspect=size / _VIEW_HEIGHT
    )
    columns = (True, True) if front else (side < 0, side > 0)
    seen = named = _seen(points, camera, markers.positions)
    if not front:  # a side names its outer markers, which the front shows badly
        # Its names are on its outer edge; a lens shift moves the face off the centre.
        shift = np.sign(side) * (_NAMES_WIDTH + _NAME_GAP) / _VIEW_HEIGHT
        camera = replace(camera, shift=(float(shift), 0.0))
        across = markers.positions @ _right(facing)
        named = seen & (np.sign(side) * (across - np.median(across)) > 0.18 * np.ptp(across))
    width = size + sum(columns) * (_NAMES_WIDTH + _NAME_GAP)
    return _View(camera, width, columns, seen, named)


def _draw_view(
    points: FloatArray, renderer: FaceRenderer, markers: BoundMarkers, view: _View, quality: Quality
) -> ByteImage:
    camera, width, height = view.camera, view.width, _VIEW_HEIGHT
    panel = renderer.render(points, camera=camera, width=width, height=height, quality=quality)
    at = camera.project(markers.positions, width=width, height=height)[:, :2]
    wanted = {
        marker: camera.project(place[None], width=width, height=height)[0, :2]
        for marker, place in markers.wanted.items()
        if view.seen[marker]
    }
    _draw_names(panel, markers, at, view.named, view.columns)
    for marker in np.flatnonzero(view.named & ~view.seen).tolist():
        draw_dot(panel, at[marker, 0], at[marker, 1], 4.6, _color(markers, marker), hollow=True)
    for marker, place in wanted.items():
        draw_line(panel, at[marker], place, _WARNING_COLOR, thickness=1.4)
        draw_dot(panel, place[0], place[1], 5.0, _WARNING_COLOR, hollow=True)
    for marker in np.flatnonzero(view.seen).tolist():
        color = _color(markers, marker)
        x, y = at[marker]
        draw_dot(panel, x, y, 4.6, (16, 17, 19))
        draw_dot(panel, x, y, 3.6, color)
        if markers.warnings[marker]:
            draw_dot(panel, x, y, 8.0, color, hollow=True)
    return panel


def _seen(points: FloatArray, camera: Camera, at: FloatArray) -> BoolArray:
    """Return the markers that are visible in a depth buffer of the surface's points."""
    cells = 160
    cloud = camera.project(points, width=cells, height=cells)
    own = camera.project(at, width=cells, height=cells)
    depth = np.full((cells, cells), np.inf)
    column, row = cloud[:, 0].astype(int), cloud[:, 1].astype(int)
    inside = (column >= 0) & (column < cells) & (row >= 0) & (row < cells)
    np.minimum.at(depth, (row[inside], column[inside]), cloud[inside, 2])
    c, r = (np.clip(own[:, i].astype(int), 0, cells - 1) for i in (0, 1))
    return np.asarray(own[:, 2] < depth[r, c] + 4 * _HIDDEN_MM)


def _draw_names(
    panel: ByteImage,
    markers: BoundMarkers,
    at: FloatArray,
    named: BoolArray,
    columns: tuple[bool, bool],
) -> None:
    """Write names in the left column, the right column, or both."""
    height, width = panel.shape[:2]
    middle = float(np.median(at[named, 0])) if named.any() else width / 2
    for left in (True, False):
        if not columns[0 if left else 1]:
            continue
        mine = named if sum(columns) == 1 else named & ((at[:, 0] < middle) == left)
        side = np.flatnonzero(mine)
        side = side[np.argsort(at[side, 1], kind="stable")]
        side = _listed_markers(markers, side, int((height - 2 * _NAME_MARGIN) / _LEAST_NAME_LINE))
        rows = space_rows(
            at[side, 1],
            spacing=min(_NAME_LINE, (height - 2 * _NAME_MARGIN) / max(len(side), 1)),
            height=height,
            margin=_NAME_MARGIN,
        )
        x = _NAMES_WIDTH if left else width - _NAMES_WIDTH
        for marker, row in zip(side.tolist(), rows.tolist(), strict=True):
            draw_line(panel, (x + (6 if left else -6), row), at[marker], _LINE, thickness=1.0)
            _write_name(panel, markers, marker, x=x, row=round(row), left=left)


def _listed_markers(markers: BoundMarkers, listed: IntArray, most: int) -> IntArray:
    """Return the markers to name: doubtful ones, those placed by a person, and others between."""
    if len(listed) <= most:
        return listed
    first = np.array([bool(markers.warnings[each]) or markers.placed[each] for each in listed])
    chosen, rest = np.flatnonzero(first)[:most], np.flatnonzero(~first)
    spread = np.linspace(0, len(rest) - 1, most - len(chosen)).round().astype(int)
    return np.asarray(listed[np.sort(np.concatenate([chosen, rest[spread]]))])


def _write_name(
    panel: ByteImage, markers: BoundMarkers, marker: int, *, x: int, row: int, left: bool
) -> None:
    warning = markers.warnings[marker]
    text = f"{markers.names[marker]}  {warning}" if warning else markers.names[marker]
    style = TextStyle(
        size=_NAME_SIZE, color=_color(markers, marker), weight="bold" if warning else "regular"
    )
    room = _NAMES_WIDTH - 4
    long = min(text_width(text, style), room)
    start = x - long - 3 if left else x - 3
    # A wide head may reach the names.
    fill_box(panel, start, row - 8, long + 6, 16, PAGE, cover=0.55)
    draw_text(
        panel, text, x=x, y=row - 9, style=style, anchor="right" if left else "left", max_width=room
    )


def _color(markers: BoundMarkers, marker: int) -> Color:
    if markers.placed[marker]:
        return GREEN
    return _WARNING_COLOR if markers.warnings[marker] else BLUE


def _draw_key(page: ByteImage, *, right: int, y: int) -> None:
    for color, label in (
        (GREEN, "placed by a person"),
        (_WARNING_COLOR, "look at it"),
        (BLUE, "proposed"),
    ):
        style = TextStyle(size=14, color=SOFT)
        right -= text_width(label, style)
        draw_text(page, label, x=right, y=y, style=style)
        draw_dot(page, right - 12, y + 9, 5.0, color)
        right -= 40
