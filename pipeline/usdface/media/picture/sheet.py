"""A contact sheet: what was captured beside what was solved, frame by frame, with its error.

A sheet is composed from data alone. Its parts (header, error strip, legend, rows of tiles) are
functions of their own, so that another layout is another order of calls.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from usdface.core.arrays import ByteImage, FloatArray
from usdface.core.errors import InputError
from usdface.media.picture.canvas import Color, fill_box, new_picture, outline_box
from usdface.media.picture.color import bytes_from_linear, heat_ramp
from usdface.media.picture.error_strip import ErrorCurve, draw_error_strip, strip_height
from usdface.media.picture.palette import PAGE
from usdface.media.picture.sheet_layout import (
    CAPTION,
    COLUMN_HEAD,
    FACTS,
    GROUP_GAP,
    GUTTER,
    LEGEND_LINE,
    MARGIN,
    TITLE,
    Layout,
    SheetPage,
    SheetRow,
    Tile,
    all_errors,
    check_sheet,
    has_legend,
    lay_out,
    legend_bar,
    legend_lines,
)
from usdface.media.picture.text import TextStyle, draw_text, text_width
from usdface.media.picture.tiles import empty_tile, fit_picture

__all__ = ["ErrorCurve", "SheetPage", "SheetRow", "Tile", "compose_sheet"]

MAX_PIXELS = 400_000_000

_RULE: Color = (58, 61, 67)
_FRAME: Color = (64, 67, 74)

_TITLE_STYLE = TextStyle(size=42, color=(244, 245, 247), weight="bold")
_FACTS_STYLE = TextStyle(size=20, color=(166, 171, 180))
_COLUMN = TextStyle(size=21, color=(198, 203, 211), weight="bold")
_TEXT = TextStyle(size=17, color=(198, 203, 211))
_DIM = TextStyle(size=17, color=(132, 137, 146))
_CODE = TextStyle(size=17, color=(222, 225, 230), weight="mono")
_VALUE = TextStyle(size=21, color=(214, 217, 223))
_BEST = TextStyle(size=21, color=(255, 255, 255), weight="bold")


def compose_sheet(spec: SheetPage) -> ByteImage:
    """Compose a contact sheet.

    Parameters
    ----------
    spec : SheetPage

    Returns
    -------
    (height, width, 3) uint8 array
        sRGB.

    Raises
    ------
    InputError
        If there is no row, a row's tiles do not fit the columns, or the sheet would be too large.
    """
    check_sheet(spec)
    layout = lay_out(spec)
    if layout.width * layout.height > MAX_PIXELS:
        raise InputError(
            f"a sheet of {layout.width} × {layout.height} pixels is too large; ask for fewer rows "
            "or smaller tiles"
        )
    high = spec.high if spec.high is not None else round_range(all_errors(spec))
    page = new_picture(layout.width, layout.height, PAGE)
    inner = layout.width - 2 * MARGIN
    y = draw_header(page, spec.title, spec.facts, x=MARGIN, y=MARGIN - 8, width=inner)
    if spec.curves:
        draw_error_strip(
            page,
            spec.curves,
            x=MARGIN,
            y=y,
            width=inner,
            first_frame=spec.first_frame,
            high=high,
            marks=[(row.frame, str(n)) for n, row in enumerate(spec.rows, start=1)],
            unit=spec.unit,
        )
        y += strip_height(len(spec.curves))
    if has_legend(spec):
        notes = legend_lines(spec.notes, layout.width)
        draw_legend(page, notes, x=MARGIN, y=y, width=inner, high=high, unit=spec.unit)
    for group in range(layout.groups):
        first = group * layout.rows_per_group
        rows = spec.rows[first : first + layout.rows_per_group]
        if rows:
            x = MARGIN + group * (layout.group_width + GROUP_GAP)
            _draw_group(page, spec, layout, rows, first, x=x, high=high)
    return page


def round_range(errors: FloatArray) -> float:
    """Return a round number that nearly all errors stay below; 1 when there are none."""
    finite = errors[np.isfinite(errors)]
    if not len(finite) or finite.max() <= 0:
        return 1.0
    wanted = max(float(np.percentile(finite, 98)), 1e-3)
    magnitude = 10.0 ** np.floor(np.log10(wanted))
    return next(
        float(m * magnitude) for m in (1, 1.5, 2, 3, 4, 5, 6, 8, 10) if m * magnitude >= wanted
    )


def draw_header(
    page: ByteImage, title: str, facts: Sequence[str], *, x: int, y: int, width: int
) -> int:
    """Write title and facts; return where the next part begins."""
    draw_text(page, title, x=x, y=y, style=_TITLE_STYLE, max_width=width)
    y += TITLE
    if facts:
        draw_text(page, "   ·   ".join(facts), x=x, y=y, style=_FACTS_STYLE, max_width=width)
        y += FACTS
    fill_box(page, x, y + 6, width, 1, _RULE)
    return y + 18


def draw_legend(
    page: ByteImage,
    notes: Sequence[str],
    *,
    x: int,
    y: int,
    width: int,
    high: float,
    unit: str,
) -> None:
    """Draw the ramp with its ends, and notes beside it, each on a line of its own."""
    bar = legend_bar(width)
    ramp = bytes_from_linear(heat_ramp(np.linspace(0, 1, bar)))
    start = x + draw_text(page, "0", x=x, y=y, style=_TEXT) + 8
    page[y + 5 : y + 20, start : start + bar] = ramp
    end = start + bar + 8
    end += draw_text(page, f"{high:g} {unit}", x=end, y=y, style=_TEXT) + 28
    for number, line in enumerate(notes):
        below = y + number * LEGEND_LINE
        draw_text(page, line, x=end, y=below, style=_DIM, max_width=x + width - end)


def _draw_group(
    page: ByteImage,
    spec: SheetPage,
    layout: Layout,
    rows: Sequence[SheetRow],
    first: int,
    *,
    x: int,
    high: float,
) -> None:
    """Draw column heads and the rows below them."""
    y = layout.head_height
    at = x
    for label, width in zip(spec.columns, layout.column_widths, strict=True):
        draw_text(page, label, x=at + 2, y=y, style=_COLUMN, max_width=width)
        at += width + GUTTER
    y += COLUMN_HEAD
    fill_box(page, x, y - 4, layout.group_width, 1, _RULE)
    for number, row in enumerate(rows, start=first + 1):
        _draw_row(page, spec, layout, row, number, x=x, y=y, high=high)
        y += layout.row_height


def _draw_row(
    page: ByteImage,
    spec: SheetPage,
    layout: Layout,
    row: SheetRow,
    number: int,
    *,
    x: int,
    y: int,
    high: float,
) -> None:
    badge = str(number)
    wide = max(text_width(badge, _CODE) + 12, 26)
    fill_box(page, x, y + 2, wide, 24, _RULE)
    draw_text(page, badge, x=x + wide // 2, y=y + 3, style=_CODE, anchor="middle")
    at, right = x + wide + 12, x + layout.group_width
    labels = (
        (f"frame {row.frame}", _CODE),
        (row.timecode, _CODE),
        (row.said, _TEXT),
        (row.note, _DIM),
    )
    for label, style in labels:
        if label:
            room = max(right - at, 0)
            at += draw_text(page, label, x=at, y=y + 3, style=style, max_width=room) + 20
    top = y + CAPTION
    known = [t.value for t in row.tiles if t.value is not None and np.isfinite(t.value)]
    best = min(known) if len(known) > 1 else None
    at = x
    for tile, width in zip(row.tiles, layout.column_widths, strict=True):
        height = layout.tile_height
        if tile.pixels is None:
            picture = empty_tile(width, height, tile.caption or "nothing to show")
        else:
            picture = fit_picture(tile.pixels, width=width, height=height)
        page[top : top + height, at : at + width] = picture
        outline_box(page, at, top, width, height, _FRAME)
        below = top + height + 2
        used = 0
        if tile.value is not None:
            color = bytes_from_linear(heat_ramp(np.array([tile.value]), high=high))[0]
            fill_box(page, at, below + 6, 16, 16, (int(color[0]), int(color[1]), int(color[2])))
            style = _BEST if tile.value == best else _VALUE
            label, style = _value_label(tile.value, spec.unit, style, room=width - 24)
            level = below + (_VALUE.size - style.size) // 2
            used = 38 + draw_text(page, label, x=at + 24, y=level, style=style)
        if tile.pixels is not None:
            draw_text(
                page,
                tile.caption,
                x=at + used,
                y=below + 1,
                style=_DIM,
                max_width=max(width - used, 0),
            )
        at += width + GUTTER


def _value_label(value: float, unit: str, style: TextStyle, *, room: int) -> tuple[str, TextStyle]:
    """Return an error's label as large as there is room for; never a part of its digits."""
    number = f"{value:.2f}" if np.isfinite(value) else "no value"
    whole = f"{number} {unit}" if np.isfinite(value) else number
    sizes = [replace(style, size=size) for size in (style.size, 17, 14)]
    choices = [(label, one) for label in (whole, number) for one in sizes]
    smallest = number, replace(style, size=11)
    return next((pair for pair in choices if text_width(*pair) <= room), smallest)
