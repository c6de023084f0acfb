"""A contact sheet: what was captured beside what was solved, frame by frame, with its error.

A sheet is composed from data alone. Its parts (header, error strip, legend, rows of tiles) are
functions of their own, so that another layout is another order of calls.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from usdface.core.arrays import ByteImage, FloatArray
from usdface.core.errors import InputError
from usdface.media.picture.canvas import fill_box, new_picture, outline_box
from usdface.media.picture.color import (
    BRIGHT,
    DIM,
    FRAME,
    PAGE,
    RULE,
    SOFT,
    TEXT,
    bytes_from_linear,
    heat_ramp,
)
from usdface.media.picture.error_strip import (
    ErrorCurve,
    ErrorStrip,
    draw_error_strip,
    strip_height,
)
from usdface.media.picture.sheet_layout import (
    CAPTION_HEIGHT,
    COLUMN_HEAD,
    FACTS_HEIGHT,
    GROUP_GAP,
    LEGEND_LINE,
    PAGE_MARGIN,
    TILE_GUTTER,
    TITLE_HEIGHT,
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

LARGEST_SHEET_PIXELS = 400_000_000
HEADER_HEIGHT = TITLE_HEIGHT + FACTS_HEIGHT + 10
"""Of title, facts and the rule below them, from a page's margin on [pixels]."""

_TITLE_STYLE = TextStyle(size=40, color=BRIGHT, weight="bold")
_FACTS_STYLE = TextStyle(size=20, color=DIM)
_COLUMN_STYLE = TextStyle(size=21, color=SOFT, weight="bold")
_TEXT_STYLE = TextStyle(size=17, color=SOFT)
_DIM_STYLE = TextStyle(size=17, color=DIM)
_CODE_STYLE = TextStyle(size=17, color=TEXT, weight="mono")
_VALUE_STYLE = TextStyle(size=21, color=TEXT)
_BEST_STYLE = TextStyle(size=21, color=(255, 255, 255), weight="bold")


def compose_sheet(spec: SheetPage) -> ByteImage:
    """Compose a contact sheet.

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
    if layout.width * layout.height > LARGEST_SHEET_PIXELS:
        raise InputError(
            f"a sheet of {layout.width} × {layout.height} pixels is too large; ask for fewer rows "
            "or smaller tiles"
        )
    high = spec.high if spec.high is not None else round_range(all_errors(spec))
    page = new_picture(layout.width, layout.height, PAGE)
    inner = layout.width - 2 * PAGE_MARGIN
    y = draw_header(page, spec.title, spec.facts, margin=PAGE_MARGIN)
    if spec.curves:
        marks = tuple((row.frame, str(n)) for n, row in enumerate(spec.rows, start=1))
        strip = ErrorStrip(spec.curves, spec.first_frame, high, marks, spec.unit)
        draw_error_strip(page, strip, x=PAGE_MARGIN, y=y, width=inner)
        y += strip_height(len(spec.curves))
    if has_legend(spec):
        notes = legend_lines(spec.notes, layout.width)
        draw_legend(page, notes, x=PAGE_MARGIN, y=y, width=inner, high=high, unit=spec.unit)
    for group in range(layout.groups):
        first = group * layout.rows_per_group
        rows = spec.rows[first : first + layout.rows_per_group]
        if rows:
            x = PAGE_MARGIN + group * (layout.group_width + GROUP_GAP)
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


def draw_header(page: ByteImage, title: str, facts: Sequence[str], *, margin: int) -> int:
    """Write title and facts at the top of a page; return the row where the next part begins."""
    width, y = page.shape[1] - 2 * margin, margin - 8
    draw_text(page, title, x=margin, y=y, style=_TITLE_STYLE, max_width=width)
    y += TITLE_HEIGHT
    if facts:
        line = "   ·   ".join(facts)
        draw_text(page, line, x=margin, y=y, style=_FACTS_STYLE, max_width=width)
        y += FACTS_HEIGHT
    fill_box(page, margin, y + 6, width, 1, RULE)
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
    start = x + draw_text(page, "0", x=x, y=y, style=_TEXT_STYLE) + 8
    page[y + 5 : y + 20, start : start + bar] = ramp
    end = start + bar + 8
    end += draw_text(page, f"{high:g} {unit}", x=end, y=y, style=_TEXT_STYLE) + 28
    for number, line in enumerate(notes):
        below = y + number * LEGEND_LINE
        draw_text(page, line, x=end, y=below, style=_DIM_STYLE, max_width=x + width - end)


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
        draw_text(page, label, x=at + 2, y=y, style=_COLUMN_STYLE, max_width=width)
        at += width + TILE_GUTTER
    y += COLUMN_HEAD
    fill_box(page, x, y - 4, layout.group_width, 1, RULE)
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
    wide = max(text_width(badge, _CODE_STYLE) + 12, 26)
    fill_box(page, x, y + 2, wide, 24, RULE)
    draw_text(page, badge, x=x + wide // 2, y=y + 3, style=_CODE_STYLE, anchor="middle")
    at, right = x + wide + 12, x + layout.group_width
    labels = (
        (f"frame {row.frame}", _CODE_STYLE),
        (row.timecode, _CODE_STYLE),
        (row.said, _TEXT_STYLE),
        (row.note, _DIM_STYLE),
    )
    for label, style in labels:
        if label:
            room = max(right - at, 0)
            at += draw_text(page, label, x=at, y=y + 3, style=style, max_width=room) + 20
    top = y + CAPTION_HEIGHT
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
        outline_box(page, at, top, width, height, FRAME)
        below = top + height + 2
        used = 0
        if tile.value is not None:
            color = bytes_from_linear(heat_ramp(np.array([tile.value]), high=high))[0]
            fill_box(page, at, below + 6, 16, 16, (int(color[0]), int(color[1]), int(color[2])))
            style = _BEST_STYLE if tile.value == best else _VALUE_STYLE
            label, style = _value_label(tile.value, spec.unit, style, room=width - 24)
            level = below + (_VALUE_STYLE.size - style.size) // 2
            used = 38 + draw_text(page, label, x=at + 24, y=level, style=style)
        if tile.pixels is not None:
            draw_text(
                page,
                tile.caption,
                x=at + used,
                y=below + 1,
                style=_DIM_STYLE,
                max_width=max(width - used, 0),
            )
        at += width + TILE_GUTTER


def _value_label(value: float, unit: str, style: TextStyle, *, room: int) -> tuple[str, TextStyle]:
    """Return an error's label as large as there is room for; never a part of its digits."""
    number = f"{value:.2f}" if np.isfinite(value) else "no value"
    whole = f"{number} {unit}" if np.isfinite(value) else number
    sizes = [replace(style, size=size) for size in (style.size, 17, 14)]
    choices = [(label, one) for label in (whole, number) for one in sizes]
    smallest = number, replace(style, size=11)
    return next((pair for pair in choices if text_width(*pair) <= room), smallest)
