"""Contact sheets: captured frames beside solved ones, with errors.

Header, error strip, legend and rows of tiles are separate functions, which charts use as well.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from usdface.core.arrays import ByteImage
from usdface.core.errors import InputError
from usdface.media.picture.canvas import empty_tile, fill_box, fit_picture, new_picture, outline_box
from usdface.media.picture.color import (
    BRIGHT,
    DIM,
    FRAME,
    PAGE,
    RULE,
    SOFT,
    TEXT,
    VERDICT_COLORS,
    bytes_from_linear,
    heat_color,
    heat_ramp,
)
from usdface.media.picture.error_strip import ErrorCurve, ErrorStrip, draw_error_strip, strip_height
from usdface.media.picture.sheet_layout import (
    BADGE_GAP,
    CODE_STYLE,
    DIM_STYLE,
    FACTS_HEIGHT,
    GROUP_GAP,
    LABEL_GAP,
    LEGEND_LINE,
    PAGE_MARGIN,
    TEXT_STYLE,
    TILE_GUTTER,
    TITLE_HEIGHT,
    VERDICT_LINE,
    VERDICT_STYLE,
    Layout,
    SheetPage,
    SheetRow,
    Tile,
    badge_width,
    has_legend,
    header_height,
    lay_out,
    legend_bar,
    legend_lines,
    row_labels,
    verdict_lines,
    wrapped_note,
)
from usdface.media.picture.text import TextStyle, draw_text, text_width

__all__ = ["ErrorCurve", "SheetPage", "SheetRow", "Tile", "compose_sheet"]

LARGEST_SHEET_PIXELS = 400_000_000
HEADER_HEIGHT = header_height()

_TITLE_STYLE = TextStyle(size=40, color=BRIGHT, weight="bold")
_FACTS_STYLE = TextStyle(size=20, color=DIM)
_COLUMN_STYLE = TextStyle(size=21, color=SOFT, weight="bold")
_SMALLEST_HEAD = 0.6
"""[of its size] to which a long head of a column is made smaller before it is shortened."""
_VALUE_STYLE = TextStyle(size=21, color=TEXT)
_BEST_STYLE = TextStyle(size=21, color=(255, 255, 255), weight="bold")


def compose_sheet(spec: SheetPage) -> ByteImage:
    """Compose a contact sheet: (height, width, 3) sRGB."""
    layout = lay_out(spec)
    if layout.width * layout.height > LARGEST_SHEET_PIXELS:
        raise InputError(
            f"a sheet of {layout.width} × {layout.height} pixels is too large; ask for fewer rows "
            "or smaller tiles"
        )
    high = spec.high or 1.0  # without errors, nothing has a colour of the ramp
    page, scale = new_picture(layout.width, layout.height, PAGE), layout.scale
    inner = layout.width - 2 * PAGE_MARGIN
    y = draw_header(page, spec.title, spec.facts, margin=PAGE_MARGIN, scale=scale)
    y = draw_verdict(page, spec.verdict, y=y, scale=scale)
    if spec.curves:
        marks = tuple((row.frame, str(n)) for n, row in enumerate(spec.rows, start=1))
        strip = ErrorStrip(spec.curves, spec.first_frame, high, marks, scale=scale)
        draw_error_strip(page, strip, x=PAGE_MARGIN, y=y, width=inner)
        y += strip_height(len(spec.curves), scale)
    if has_legend(spec):
        notes = legend_lines(spec.notes, layout.width, scale)
        unit = "" if spec.high is None else f"{high:g} mm"
        draw_legend(page, notes, x=PAGE_MARGIN, y=y, width=inner, high=unit, scale=scale)
    for group in range(layout.groups):
        first = group * layout.rows_per_group
        rows = spec.rows[first : first + layout.rows_per_group]
        if rows:
            x = PAGE_MARGIN + group * (layout.group_width + GROUP_GAP)
            _draw_group(page, spec, layout, rows, first, x=x, high=high)
    return page


def draw_header(
    page: ByteImage, title: str, facts: Sequence[str], *, margin: int, scale: float = 1.0
) -> int:
    """Write title and facts at the top of a page; return the row below."""
    width, y = page.shape[1] - 2 * margin, margin - 8
    draw_text(page, title, x=margin, y=y, style=_TITLE_STYLE.scaled(scale), max_width=width)
    y += round(scale * TITLE_HEIGHT)
    if facts:
        line = "   ·   ".join(facts)
        draw_text(page, line, x=margin, y=y, style=_FACTS_STYLE.scaled(scale), max_width=width)
        y += round(scale * FACTS_HEIGHT)
    fill_box(page, margin, y + 6, width, 1, RULE)
    return y + 18


def draw_verdict(
    page: ByteImage, verdict: Sequence[str], *, y: int, scale: float = 1.0, x: int = PAGE_MARGIN
) -> int:
    """Write a verdict and a bar on the page's left edge in its colour; return the row below.

    `verdict`: as in `SheetPage`; may be empty.
    """
    if not verdict:
        return y
    color = VERDICT_COLORS[verdict[0]]
    fill_box(page, 0, 0, round(scale * 10), page.shape[0], color)
    first = len(verdict_lines(verdict[:2], page.shape[1], scale))
    for number, line in enumerate(verdict_lines(verdict, page.shape[1], scale)):
        style = replace(VERDICT_STYLE.scaled(scale), color=color if number < first else BRIGHT)
        draw_text(page, line, x=x, y=y, style=style)
        y += round(scale * VERDICT_LINE)
    return y


def draw_legend(
    page: ByteImage,
    notes: Sequence[str],
    *,
    x: int,
    y: int,
    width: int,
    high: str,
    scale: float = 1.0,
) -> None:
    """Draw the ramp from 0 to `high` unless that is empty, and the notes, one per line."""
    bar, style, end = legend_bar(width), TEXT_STYLE.scaled(scale), x
    if high:
        ramp = bytes_from_linear(heat_ramp(np.linspace(0, 1, bar)))
        start = x + draw_text(page, "0", x=x, y=y, style=style) + 8
        page[y + round(5 * scale) : y + round(20 * scale), start : start + bar] = ramp
        end = start + bar + 8
        end += draw_text(page, high, x=end, y=y, style=style) + round(28 * scale)
    for number, line in enumerate(notes):
        below = y + round(scale * number * LEGEND_LINE)
        room = x + width - end
        draw_text(page, line, x=end, y=below, style=DIM_STYLE.scaled(scale), max_width=room)


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
    """Draw a block of rows below its column heads."""
    y, style = layout.head_height, _COLUMN_STYLE.scaled(layout.scale)
    heads = list(zip(spec.columns, layout.column_widths, strict=True))
    at = x
    for label, width in heads:
        share = (width - 4) / max(text_width(label, style), 1)
        fitted = style.scaled(min(max(share, _SMALLEST_HEAD), 1.0))
        draw_text(page, label, x=at + 2, y=y, style=fitted, max_width=width)
        at += width + TILE_GUTTER
    y += layout.column_head
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
    scale = layout.scale
    dim, best_style, value_style = (
        style.scaled(scale) for style in (DIM_STYLE, _BEST_STYLE, _VALUE_STYLE)
    )
    _draw_row_head(page, layout, row, number, x=x, y=y)
    top = y + layout.head_lines * layout.caption_height
    known = [t.value for t in row.tiles if t.value is not None and np.isfinite(t.value)]
    best = min(known) if len(known) > 1 and spec.comparable else None
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
            side = round(16 * scale)
            fill_box(page, at, below + 6, side, side, heat_color(tile.value, high=high))
            style = best_style if tile.value == best else value_style
            label = f"{tile.value:.2f} mm" if np.isfinite(tile.value) else "no value"
            label, style = _fitted(label, style, room=width - side - 8)
            level = below + (value_style.size - style.size) // 2
            used = side + 22 + draw_text(page, label, x=at + side + 8, y=level, style=style)
        if tile.pixels is not None:
            room = max(width - used, 0)
            caption, style = _fitted(tile.caption, dim, room=room)
            draw_text(page, caption, x=at + used, y=below + 1, style=style, max_width=room)
        at += width + TILE_GUTTER


def _draw_row_head(
    page: ByteImage, layout: Layout, row: SheetRow, number: int, *, x: int, y: int
) -> None:
    """Write a row's number, frame and note; a long note is wrapped below."""
    scale, wide = layout.scale, badge_width(number, layout.scale)
    fill_box(page, x, y + 2, wide, round(24 * scale), RULE)
    code, dim = CODE_STYLE.scaled(scale), DIM_STYLE.scaled(scale)
    draw_text(page, str(number), x=x + wide // 2, y=y + 3, style=code, anchor="middle")
    at, right = x + wide + BADGE_GAP, x + layout.group_width
    lines = wrapped_note(row, number, layout)
    beside = [] if lines else [(row.note, DIM_STYLE)]
    for label, style in (*row_labels(row), *beside):
        room = max(right - at, 0)
        at += draw_text(page, label, x=at, y=y + 3, style=style.scaled(scale), max_width=room)
        at += LABEL_GAP
    for index, line in enumerate(lines, start=1):
        below = y + 3 + index * layout.caption_height
        draw_text(page, line, x=x, y=below, style=dim, max_width=layout.group_width)


def _fitted(label: str, style: TextStyle, *, room: int) -> tuple[str, TextStyle]:
    """Return a label, at need without its unit, and the largest style that fits.

    No digit is cut.
    """
    labels = label, label.removesuffix(" mm")
    sizes = [replace(style, size=size) for size in (style.size, 17, 14) if size <= style.size]
    choices = [(label, one) for label in labels for one in sizes]
    smallest = labels[-1], replace(style, size=11)
    return next((pair for pair in choices if text_width(*pair) <= room), smallest)
