"""What goes on a contact sheet, and how large everything on it is."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from textwrap import wrap

import numpy as np

from usdface.core.arrays import ByteImage, FloatArray
from usdface.core.errors import InputError
from usdface.media.picture.color import BRIGHT, DIM, SOFT, TEXT
from usdface.media.picture.error_strip import ErrorCurve, strip_height
from usdface.media.picture.text import TextStyle, text_width, wrap_text

BEST_ASPECT = 1.5
"""Width over height that fills a screen and a landscape page alike."""

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
"""On a sheet shown so wide the smallest letters are so high [pixels]: they are still read."""

_SMALLEST_STYLE = 16
VERDICT_STYLE = TextStyle(size=23, color=BRIGHT, weight="bold")
VERDICT_LINE = 30
VERDICT_SCALE = 0.78
"""Of charts, where a verdict has one line."""
CODE_STYLE = TextStyle(size=17, color=TEXT, weight="mono")
TEXT_STYLE = TextStyle(size=17, color=SOFT)
DIM_STYLE = TextStyle(size=17, color=DIM)
BADGE_GAP, LABEL_GAP = 12, 20

LEGEND_LETTERS = 110  # of one line of notes; more go to lines of their own
LEGEND_LETTER = 8  # [pixels] the width of one, about
LEAST_WIDTH = 800  # for the title and the strip above a few small tiles
TITLE_HEIGHT = 60
FACTS_HEIGHT = 34


@dataclass(frozen=True)
class Tile:
    """One picture of a row."""

    pixels: ByteImage | None
    """(h, w, 3): sRGB, of any size. None leaves the tile empty, with `caption` in it as the
    reason."""
    caption: str = ""
    """Written below it."""
    value: float | None = None
    """Its error, in the sheet's unit; written below it beside its colour on the ramp."""


@dataclass(frozen=True)
class SheetRow:
    """One frame of the take."""

    frame: int
    timecode: str
    """Empty when unknown."""
    tiles: tuple[Tile, ...]
    """One for each column."""
    note: str = ""
    """Why this frame is shown, if there is a reason."""
    said: str = ""
    """What is said there: phone, viseme, emotion; empty when unknown."""


@dataclass(frozen=True)
class SheetPage:
    """All that is on a sheet."""

    title: str
    """The shot or the performance."""
    columns: tuple[str, ...]
    """Heads of the columns."""
    rows: tuple[SheetRow, ...]
    """In the order to read them."""
    verdict: tuple[str, ...] = ()
    """``'good'``, ``'check'`` or ``'bad'``, and lines that say why and what to do; or none."""
    facts: tuple[str, ...] = ()
    """Take, performer, mapping … one line, set apart by dots."""
    curves: tuple[ErrorCurve, ...] = ()
    """Errors over the whole take; none leaves the strip out."""
    first_frame: int = 0
    """Frame number of each curve's first value."""
    notes: tuple[str, ...] = ()
    """Legend: what marks and colours mean, where the numbers come from."""
    unit: str = "mm"
    """Of all errors."""
    high: float | None = None
    """Error in the ramp's last colour; chosen from the curves and rows when None."""
    tile_height: int = 320
    """[pixels]"""
    comparable: bool = True
    """Whether values of a row measure one thing, so that the smallest is the best."""
    groups: int | None = None
    """How many blocks of rows stand side by side; None lets the sheet's shape decide."""


@dataclass(frozen=True)
class Layout:
    """Sizes of a sheet [pixels]."""

    column_widths: tuple[int, ...]
    tile_height: int
    groups: int
    rows_per_group: int
    head_height: int
    head_lines: int = 1
    """Above the tiles of a row."""

    @property
    def scale(self) -> float:
        """Of letters and what holds them: a wide sheet is shown smaller."""
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
        """From one row's head to the next one's."""
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


def check_sheet(spec: SheetPage) -> None:
    """Refuse a sheet that cannot be laid out."""
    if not spec.rows or not spec.columns:
        raise InputError("a sheet needs rows and columns; select at least one frame")
    for row in spec.rows:
        if len(row.tiles) != len(spec.columns):
            raise InputError(
                f"row of frame {row.frame} has {len(row.tiles)} tiles and the sheet "
                f"{len(spec.columns)} columns; give one tile for each column"
            )
    if not 48 <= spec.tile_height <= 4096:
        raise InputError(f"tiles of {spec.tile_height} pixels; choose 48 to 4096")


def all_errors(spec: SheetPage) -> FloatArray:
    """Return every error on the sheet, those of the strips included."""
    shown = [t.value for row in spec.rows for t in row.tiles if t.value is not None]
    curves = [curve.values for curve in spec.curves]
    return np.concatenate([np.array(shown, float), *curves])


def has_legend(spec: SheetPage) -> bool:
    """Whether there is anything to explain."""
    return bool(spec.notes or len(all_errors(spec)))


def legend_bar(width: int) -> int:
    """Return how long the ramp is on a sheet so wide within its margins [pixels]."""
    return min(240, width // 4)


def verdict_lines(verdict: Sequence[str], width: int, scale: float) -> list[str]:
    """Return a verdict on as many lines as it needs on a sheet so wide."""
    style, room = VERDICT_STYLE.scaled(scale), width - 2 * PAGE_MARGIN
    return [line for text in verdict[1:] for line in wrap_text(text, style, max_width=room)]


def legend_lines(notes: Sequence[str], width: int, scale: float = 1.0) -> tuple[str, ...]:
    """Return notes on as many lines as they need to be read on a sheet so wide; at least one."""
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
    """Find the sizes; of all ways to stand rows side by side, the one nearest `BEST_ASPECT`."""
    widths = tuple(
        round(_column_aspect(spec.rows, column) * spec.tile_height)
        for column in range(len(spec.columns))
    )
    count = len(spec.rows)
    choices = [spec.groups] if spec.groups else range(1, count + 1)
    bare = [Layout(widths, spec.tile_height, g, -(-count // g), 0) for g in choices]
    layouts = [
        replace(one, head_height=_head_height(spec, one), head_lines=_head_lines(spec, one))
        for one in bare
    ]
    # Of two equal shapes the one with fewer groups reads better; min keeps the first.
    return min(layouts, key=lambda one: abs(np.log(one.width / one.height / BEST_ASPECT)))


def badge_width(number: int, scale: float) -> int:
    """Return how wide the box of a row's number is."""
    return max(text_width(str(number), CODE_STYLE.scaled(scale)) + 12, round(26 * scale))


def row_labels(row: SheetRow) -> list[tuple[str, TextStyle]]:
    """Return what stands beside a row's number, but for its note."""
    labels = (
        (f"frame {row.frame}", CODE_STYLE),
        (row.timecode, CODE_STYLE),
        (row.said, TEXT_STYLE),
    )
    return [(label, style) for label, style in labels if label]


def wrapped_note(row: SheetRow, number: int, layout: Layout) -> list[str]:
    """Return the lines of a note that has no room beside the row's labels; none where it has."""
    scale, style = layout.scale, DIM_STYLE.scaled(layout.scale)
    used = badge_width(number, scale) + BADGE_GAP + text_width(row.note, style)
    used += sum(text_width(text, one.scaled(scale)) + LABEL_GAP for text, one in row_labels(row))
    if not row.note or used <= layout.group_width:
        return []
    return wrap_text(row.note, style, max_width=layout.group_width)


def _head_lines(spec: SheetPage, one: Layout) -> int:
    wrapped = (wrapped_note(row, number, one) for number, row in enumerate(spec.rows, start=1))
    return 1 + max(map(len, wrapped), default=0)


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
    """Return the height of title, facts and the rule below them, from a page's margin on."""
    return round(scale * (TITLE_HEIGHT + (FACTS_HEIGHT if facts else 0) + 10))


def _column_aspect(rows: Sequence[SheetRow], column: int) -> float:
    """Return the width over height of a column: that of its widest picture, within reason."""
    shapes = [r.tiles[column].pixels for r in rows]
    aspects = [p.shape[1] / p.shape[0] for p in shapes if p is not None]
    return float(np.clip(max(aspects, default=1.0), 0.6, 16 / 9))
