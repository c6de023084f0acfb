"""Content and layout of a contact sheet."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from textwrap import wrap

import numpy as np

from usdface.core.arrays import ByteImage
from usdface.media.picture.color import BRIGHT, DIM, SOFT, TEXT
from usdface.media.picture.error_strip import ErrorCurve, strip_height
from usdface.media.picture.text import TextStyle, text_width, wrap_text

BEST_ASPECT = 1.5
"""Width over height, between those of a screen and a landscape page."""

PAGE_MARGIN = 36
TILE_GUTTER = 6
GROUP_GAP = 40
_ROW_GAP = 14
CAPTION_HEIGHT = 30
COLUMN_HEAD = 36
_LEGEND_HEIGHT = 42
LEGEND_LINE = 24
READ_WIDTH = 1600
READ_LETTER = 12
"""Least height of letters on a sheet scaled to `READ_WIDTH` [pixels]."""

_SMALLEST_STYLE = 16
VERDICT_STYLE = TextStyle(size=23, color=BRIGHT, weight="bold")
VERDICT_LINE = 30
VERDICT_SCALE = 0.78
"""Scale of verdicts on charts, which have one line."""
CODE_STYLE = TextStyle(size=17, color=TEXT, weight="mono")
TEXT_STYLE = TextStyle(size=17, color=SOFT)
DIM_STYLE = TextStyle(size=17, color=DIM)
BADGE_GAP, LABEL_GAP = 12, 20

LEGEND_LETTERS = 110  # most letters in a line of notes
LEGEND_LETTER = 8  # approximate width of a letter [pixels]
LEAST_WIDTH = 800  # for title and strip above a few small tiles
TITLE_HEIGHT = 60
FACTS_HEIGHT = 34


@dataclass(frozen=True)
class Tile:
    """One picture of a row."""

    pixels: ByteImage | None
    """(h, w, 3): sRGB, of any size. None: an empty tile with `caption` as the reason."""
    caption: str = ""
    """Written below."""
    value: float | None = None
    """Error [mm]; written below with its colour on the ramp."""


@dataclass(frozen=True)
class SheetRow:
    """One frame of the take."""

    frame: int
    timecode: str
    """Empty if unknown."""
    tiles: tuple[Tile, ...]
    """One per column."""
    note: str = ""
    """Reason for showing this frame, or empty."""
    spoken: str = ""
    """Phone, viseme and emotion, or empty."""


@dataclass(frozen=True)
class SheetPage:
    """Content of a sheet."""

    title: str
    """The shot or the performance."""
    columns: tuple[str, ...]
    """Heads of the columns."""
    rows: tuple[SheetRow, ...]
    """In reading order."""
    verdict: tuple[str, ...] = ()
    """``'good'``, ``'check'`` or ``'bad'``, the reason and what to do; or empty."""
    facts: tuple[str, ...] = ()
    """Take, performer, mapping …, on one line."""
    curves: tuple[ErrorCurve, ...] = ()
    """Errors over the whole take, drawn as a strip."""
    first_frame: int = 0
    """Frame number of each curve's first value."""
    notes: tuple[str, ...] = ()
    """Legend: meaning of marks and colours, sources of the numbers."""
    high: float | None = None
    """Error in the ramp's last colour [mm]; None for a sheet without errors."""
    tile_height: int = 320
    """[pixels]"""
    comparable: bool = True
    """Whether the values of a row are the same quantity; the smallest is then bold."""


@dataclass(frozen=True)
class Layout:
    """Sizes of a sheet [pixels]."""

    column_widths: tuple[int, ...]
    tile_height: int
    groups: int
    rows_per_group: int
    head_height: int
    head_lines: int = 1
    """Text lines above the tiles of a row."""

    @property
    def scale(self) -> float:
        """Scale of text, larger on wide sheets, which are shown smaller."""
        return max(self.width * READ_LETTER / (READ_WIDTH * _SMALLEST_STYLE), 1.0)

    @property
    def caption_height(self) -> int:
        """Of the lines above and below a tile [pixels]."""
        return round(self.scale * CAPTION_HEIGHT)

    @property
    def column_head(self) -> int:
        """Of the heads of the columns [pixels]."""
        return round(self.scale * COLUMN_HEAD)

    @property
    def group_width(self) -> int:
        """Width of one block of rows."""
        return sum(self.column_widths) + TILE_GUTTER * (len(self.column_widths) - 1)

    @property
    def row_height(self) -> int:
        """Distance from one row's head to the next [pixels]."""
        return (self.head_lines + 1) * self.caption_height + self.tile_height + _ROW_GAP

    @property
    def width(self) -> int:
        """Width of the sheet."""
        groups = self.groups * self.group_width + (self.groups - 1) * GROUP_GAP
        return max(2 * PAGE_MARGIN + groups, LEAST_WIDTH)

    @property
    def height(self) -> int:
        """Height of the sheet."""
        return (
            self.head_height
            + self.column_head
            + self.rows_per_group * self.row_height
            + PAGE_MARGIN
        )


def has_legend(spec: SheetPage) -> bool:
    """Return whether the sheet has notes or errors."""
    valued = any(tile.value is not None for row in spec.rows for tile in row.tiles)
    return bool(spec.notes or spec.curves or valued)


def legend_bar(width: int) -> int:
    """Return the length of the ramp, given the width within the margins [pixels]."""
    return min(240, width // 4)


def verdict_lines(verdict: Sequence[str], width: int, scale: float) -> list[str]:
    """Return a verdict wrapped to a sheet of `width`."""
    style, room = VERDICT_STYLE.scaled(scale), width - 2 * PAGE_MARGIN
    return [line for text in verdict[1:] for line in wrap_text(text, style, max_width=room)]


def legend_lines(notes: Sequence[str], width: int, scale: float = 1.0) -> tuple[str, ...]:
    """Return notes joined and wrapped to a sheet of `width`; at least one line."""
    inner = width - 2 * PAGE_MARGIN
    room = int((inner - legend_bar(inner) - 120 * scale) / (scale * LEGEND_LETTER))
    room = min(max(room, 20), LEGEND_LETTERS)
    lines = [""]
    for note in notes:
        longer = f"{lines[-1]}   ·   {note}" if lines[-1] else note
        if len(longer) <= room:
            lines[-1] = longer
        else:
            lines += wrap(note, room)
    return tuple(lines if lines[0] or len(lines) == 1 else lines[1:])


def lay_out(spec: SheetPage) -> Layout:
    """Return the layout whose number of groups gives the aspect nearest to `BEST_ASPECT`."""
    widths = tuple(
        round(_column_aspect(spec.rows, column) * spec.tile_height)
        for column in range(len(spec.columns))
    )
    count = len(spec.rows)
    bare = [Layout(widths, spec.tile_height, g, -(-count // g), 0) for g in range(1, count + 1)]
    layouts = []
    for one in bare:
        notes = (wrapped_note(row, number, one) for number, row in enumerate(spec.rows, start=1))
        head_lines = 1 + max(map(len, notes), default=0)
        layouts.append(replace(one, head_height=_head_height(spec, one), head_lines=head_lines))
    # Of equal aspects, min keeps the first, with fewer groups.
    return min(layouts, key=lambda one: abs(np.log(one.width / one.height / BEST_ASPECT)))


def badge_width(number: int, scale: float) -> int:
    """Return the width of the box of a row's number [pixels]."""
    return max(text_width(str(number), CODE_STYLE.scaled(scale)) + 12, round(26 * scale))


def row_labels(row: SheetRow) -> list[tuple[str, TextStyle]]:
    """Return the labels beside a row's number, without its note."""
    labels = (
        (f"frame {row.frame}", CODE_STYLE),
        (row.timecode, CODE_STYLE),
        (row.spoken, TEXT_STYLE),
    )
    return [(label, style) for label, style in labels if label]


def wrapped_note(row: SheetRow, number: int, layout: Layout) -> list[str]:
    """Return the lines of a note that does not fit beside the row's labels; else none."""
    scale, style = layout.scale, DIM_STYLE.scaled(layout.scale)
    used = badge_width(number, scale) + BADGE_GAP + text_width(row.note, style)
    used += sum(text_width(text, one.scaled(scale)) + LABEL_GAP for text, one in row_labels(row))
    if not row.note or used <= layout.group_width:
        return []
    return wrap_text(row.note, style, max_width=layout.group_width)


def _head_height(spec: SheetPage, one: Layout) -> int:
    width, scale = one.width, one.scale
    head = PAGE_MARGIN + header_height(scale, facts=bool(spec.facts))
    head += round(scale * VERDICT_LINE) * len(verdict_lines(spec.verdict, width, scale))
    head += strip_height(len(spec.curves), scale) if spec.curves else 0
    if has_legend(spec):
        lines = len(legend_lines(spec.notes, width, scale))
        head += round(scale * (_LEGEND_HEIGHT + LEGEND_LINE * (lines - 1)))
    return head


def header_height(scale: float = 1.0, *, facts: bool = True) -> int:
    """Return the height of title, facts and the rule below, from the page margin."""
    return round(scale * (TITLE_HEIGHT + (FACTS_HEIGHT if facts else 0) + 10))


def _column_aspect(rows: Sequence[SheetRow], column: int) -> float:
    """Return the width over height of a column's widest picture, limited to 0.6 to 16:9."""
    shapes = [r.tiles[column].pixels for r in rows]
    aspects = [p.shape[1] / p.shape[0] for p in shapes if p is not None]
    return float(np.clip(max(aspects, default=1.0), 0.6, 16 / 9))
