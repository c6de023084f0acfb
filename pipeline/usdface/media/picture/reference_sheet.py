"""Sheet of references: video and markers of each pair beside the rig with its weights."""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import ByteImage
from usdface.core.errors import InputError
from usdface.media.face.raycast import background
from usdface.media.picture.canvas import fill_box, fit_picture, new_picture, outline_box
from usdface.media.picture.color import (
    BRIGHT,
    DIM,
    FRAME,
    GREEN,
    PAGE,
    PANEL,
    SOFT,
    Color,
    bytes_from_linear,
)
from usdface.media.picture.sheet import LARGEST_SHEET_PIXELS
from usdface.media.picture.text import TextStyle, draw_text, text_width

_PAGE_MARGIN = 40
_TILE_GUTTER = 6
BLOCK_GAP = 36
_HEAD_HEIGHT = 34
FOOT_HEIGHT = 54
_ROW_GAP = 26
_TITLE_HEIGHT = 100
PAGE_PAIRS = 6
"""Pairs per page, legible on landscape A4 and on a screen of 1600 pixels."""

_WRITING_LINES, _WRITING_LINE = 3, 46
"""Ruled lines below each pair on paper, and their distance [pixels]; about 7 mm on A4."""

PAGE_ASPECT = 1.414
"""Of a landscape page."""


@dataclass(frozen=True)
class ReferenceRow:
    """One pair."""

    number: int
    """Time code of the pair in the asset, from 1."""
    place: str
    """Take, frame and timecode."""
    spoken: str
    """Viseme and emotion, or empty."""
    tuned: bool
    video: ByteImage | None
    """(h, w, 3)"""
    missing: str
    """Reason if there is no video."""
    markers: ByteImage | None
    """(h, w, 3); None for a take of weights."""
    face: ByteImage
    """(h, w, 3): on a white background for paper; `markers` have a dark one."""
    weights: tuple[tuple[str, float], ...]
    """The strongest shapes, strongest first."""
    residual_mm: float | None
    """Residual of proposed weights [mm]; None for tuned pairs and without markers."""


@dataclass(frozen=True)
class PaperColors:
    """The colours of a sheet."""

    page: Color
    rule: Color
    empty: Color
    title: Color
    text: Color
    dim: Color
    tuned: Color


SCREEN = PaperColors(
    page=PAGE, rule=FRAME, empty=PANEL, title=BRIGHT, text=SOFT, dim=DIM, tuned=GREEN
)
PAPER = PaperColors(
    page=(255, 255, 255),
    rule=(176, 178, 182),
    empty=(246, 246, 247),
    title=(16, 17, 19),
    text=(30, 32, 36),
    dim=(104, 108, 116),
    tuned=(20, 120, 60),
)


def compose_reference_sheet(
    rows: tuple[ReferenceRow, ...],
    *,
    title: str,
    facts: tuple[str, ...],
    tile: int,
    paper: bool = False,
) -> ByteImage:
    """Compose the sheet of one row or more: (height, width, 3) uint8 array, sRGB.

    `tile`: height of every picture [pixels]. `paper`: dark on white.
    """
    palette = PAPER if paper else SCREEN
    shapes = [row.video.shape for row in rows if row.video is not None]
    aspect = max((shape[1] / shape[0] for shape in shapes), default=0.0)
    widths = (tile,) * (2 if any(row.markers is not None for row in rows) else 1)
    if aspect:
        widths = (round(tile * min(aspect, 16 / 9)), *widths)
    block = sum(widths) + _TILE_GUTTER * (len(widths) - 1)
    room = _WRITING_LINES * _WRITING_LINE if paper else 0
    height = _HEAD_HEIGHT + tile + FOOT_HEIGHT + room + _ROW_GAP
    columns = min(
        range(1, len(rows) + 1),
        key=lambda n: abs(np.log(_size(n, len(rows), block, height) / PAGE_ASPECT)),
    )
    wide = 2 * _PAGE_MARGIN + columns * block + (columns - 1) * BLOCK_GAP
    tall = 2 * _PAGE_MARGIN + _TITLE_HEIGHT + -(-len(rows) // columns) * height
    if wide * tall > LARGEST_SHEET_PIXELS:
        raise InputError(
            f"a sheet of {wide} × {tall} pixels is too large; ask for fewer --pairs or a smaller "
            "--tile"
        )
    page = new_picture(wide, tall, palette.page)
    bold = TextStyle(size=38, color=palette.title, weight="bold")
    inner = wide - 2 * _PAGE_MARGIN
    draw_text(page, title, x=_PAGE_MARGIN, y=_PAGE_MARGIN - 10, style=bold, max_width=inner)
    style = TextStyle(size=18, color=palette.dim)
    line = "   ·   ".join(facts)
    draw_text(page, line, x=_PAGE_MARGIN, y=_PAGE_MARGIN + 44, style=style, max_width=inner)
    fill_box(page, _PAGE_MARGIN, _PAGE_MARGIN + 78, inner, 1, palette.rule)
    for index, row in enumerate(rows):
        x = _PAGE_MARGIN + (index % columns) * (block + BLOCK_GAP)
        y = _PAGE_MARGIN + _TITLE_HEIGHT + index // columns * height
        _draw_row(page, row, widths, palette, x=x, y=y, tile=tile, paper=paper)
        below = y + _HEAD_HEIGHT + tile + FOOT_HEIGHT
        for down in range(_WRITING_LINE, room + 1, _WRITING_LINE):
            fill_box(page, x, below + down, block, 2, palette.rule)
    return page


def _size(columns: int, count: int, block: int, height: int) -> float:
    """Return width over height of a sheet."""
    wide = 2 * _PAGE_MARGIN + columns * (block + BLOCK_GAP)
    return wide / (2 * _PAGE_MARGIN + _TITLE_HEIGHT + -(-count // columns) * height)


def _draw_row(
    page: ByteImage,
    row: ReferenceRow,
    widths: tuple[int, ...],
    palette: PaperColors,
    *,
    x: int,
    y: int,
    tile: int,
    paper: bool,
) -> None:
    block = sum(widths) + _TILE_GUTTER * (len(widths) - 1)
    number = TextStyle(size=22, color=palette.title, weight="bold")
    text = TextStyle(size=16, color=palette.text)
    state = TextStyle(size=15, color=palette.tuned if row.tuned else palette.dim)
    at = x + draw_text(page, str(row.number), x=x, y=y, style=number) + 12
    label = "tuned" if row.tuned else "proposal"
    end = x + block - text_width(label, state)
    draw_text(page, label, x=end, y=y + 6, style=state)
    caption = "   ".join(part for part in (row.spoken, row.place) if part)
    draw_text(page, caption, x=at, y=y + 5, style=text, max_width=max(end - at - 10, 0))
    drawn = [row.face] if row.markers is None else [row.markers, row.face]
    pictures = [row.video, *drawn][-len(widths) :]
    at, top = x, y + _HEAD_HEIGHT
    for picture, width in zip(pictures, widths, strict=True):
        if picture is None:
            fill_box(page, at, top, width, tile, palette.empty)
            middle = TextStyle(size=15, color=palette.dim)
            draw_text(
                page,
                row.missing,
                x=at + width // 2,
                y=top + tile // 2 - 10,
                style=middle,
                anchor="middle",
                max_width=width,
            )
        else:
            shown = fit_picture(picture, width=width, height=tile, color=palette.empty)
            if paper and picture is row.markers:
                shown = as_ink(shown)
            page[top : top + tile, at : at + width] = shown
        outline_box(page, at, top, width, tile, palette.rule)
        at += width + _TILE_GUTTER
    _draw_weights(page, row, palette, x=x, y=top + tile + 5, width=block)


def _draw_weights(
    page: ByteImage, row: ReferenceRow, palette: PaperColors, *, x: int, y: int, width: int
) -> None:
    """Write the strongest weights on two lines, and the residual."""
    style = TextStyle(size=16, color=palette.text)
    dim = TextStyle(size=16, color=palette.dim)
    off = "" if row.residual_mm is None else f"residual {row.residual_mm:.1f} mm"
    right = x + width - text_width(off, dim)
    draw_text(page, off, x=right, y=y, style=dim)
    at, line = x, 0
    for name, value in row.weights:
        label = f"{name} {value:.2f}"
        wide = text_width(label, style)
        limit = right - 16 if line == 0 else x + width
        if at + wide > limit:
            if line:
                break
            at, line = x, 1
            if at + wide > x + width:
                break
        draw_text(page, label, x=at, y=y + 22 * line, style=style)
        at += wide + 18


def as_ink(picture: ByteImage) -> ByteImage:
    """Return a picture of light lines and dots on `background` as dark ink on white."""
    height, width = picture.shape[:2]
    light = picture.astype(np.float32).max(axis=2)
    wall = bytes_from_linear(background(height, width)).astype(np.float32).max(axis=2)
    cover = np.clip((light - wall) / (200.0 - wall), 0.0, 1.0) ** 0.7
    gray = (255.0 * (1.0 - cover)).astype(np.uint8)
    return np.repeat(gray[:, :, None], 3, axis=2)
