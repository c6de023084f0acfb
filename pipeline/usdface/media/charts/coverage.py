"""Chart of coverage: over the takes, by number of references, and the frames to tune next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from usdface.core.arrays import ByteImage, FloatArray
from usdface.media.charts.axes import (
    add_axes,
    add_label,
    new_figure,
    plot_curve,
    plot_points,
    render,
)
from usdface.media.picture.canvas import fill_box
from usdface.media.picture.color import BLUE, BRIGHT, DIM, ORANGE, RULE, SOFT, TEXT
from usdface.media.picture.error_strip import (
    LABEL_WIDTH,
    ErrorCurve,
    ErrorStrip,
    draw_error_strip,
    strip_height,
)
from usdface.media.picture.sheet import HEADER_HEIGHT, draw_header, draw_legend
from usdface.media.picture.sheet_layout import PAGE_MARGIN
from usdface.media.picture.text import TextStyle, draw_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_PAGE_WIDTH = 1600
_LEGEND_HEIGHT = 46
_TAKES_HEIGHT = 30
_PLOT_HEIGHT = 300
_TABLE_WIDTH = 560
_TABLE_COLUMNS = (("take", 0), ("frame", 200), ("coverage", 275), ("mean, once tuned", 415))
_ROW_HEIGHT = 26
WORST_PERCENT = 50.0
"""1 - coverage at the top of a lane [%]."""

_CAPTION_STYLE = TextStyle(size=18, color=BRIGHT, weight="bold")
_TEXT_STYLE = TextStyle(size=16, color=SOFT)
_NUMBER_STYLE = TextStyle(size=16, color=TEXT, weight="mono")
_DIM_STYLE = TextStyle(size=16, color=DIM)


@dataclass(frozen=True)
class NextFrame:
    """A frame to tune: the one with the least coverage."""

    take: str
    """Its name."""
    frame: int
    """Frame number in the take."""
    coverage: float
    """By the present references [0-1]."""
    mean_then: float
    """Mean coverage of the takes after it and the frames before it are tuned [0-1]."""


@dataclass(frozen=True)
class CoveragePage:
    """Content of the chart."""

    title: str
    facts: tuple[str, ...]
    lanes: tuple[ErrorCurve, ...]
    """1 - coverage of the face and its parts, per frame over all takes [%]."""
    takes: tuple[tuple[str, int], ...]
    """Name and number of frames of each take, in order."""
    first_frame: int
    """Frame number of the first frame, used if there is one take."""
    marks: tuple[int, ...]
    """References, as indices into the frames of all takes."""
    growth: FloatArray
    """(pairs + 1,): coverage with 0, 1, 2 ... pairs [0-1]."""
    next_frames: tuple[NextFrame, ...] = ()
    """Each has the least coverage after those before it are tuned."""


def draw_coverage(page: CoveragePage) -> ByteImage:
    """Draw the coverage over time, by number of references, and the frames to tune next."""
    strips = strip_height(len(page.lanes))
    takes = _TAKES_HEIGHT if len(page.takes) > 1 else 0
    body = max(_PLOT_HEIGHT + 70, 60 + _ROW_HEIGHT * len(page.next_frames))
    top = PAGE_MARGIN + HEADER_HEIGHT + _LEGEND_HEIGHT
    figure = new_figure(_PAGE_WIDTH, top + takes + strips + body + PAGE_MARGIN)
    _draw_growth(figure, page, y=top + takes + strips + 34)
    picture = render(figure)
    y = draw_header(picture, page.title, page.facts, margin=PAGE_MARGIN)
    inner = _PAGE_WIDTH - 2 * PAGE_MARGIN
    note = "1 − coverage   ·   white marks: references"
    draw_legend(picture, (note,), x=PAGE_MARGIN, y=y, width=inner, high=f"{WORST_PERCENT:g}%")
    y += _LEGEND_HEIGHT
    first = page.first_frame if len(page.takes) == 1 else 0
    marks = tuple((first + mark, "") for mark in page.marks)
    strip = ErrorStrip(page.lanes, first, WORST_PERCENT, marks, unit="%")
    # The strip has room for labels above its lanes; these marks have no labels.
    lanes_top = y + takes - 20
    draw_error_strip(picture, strip, x=PAGE_MARGIN, y=lanes_top, width=inner)
    if takes:
        _draw_takes(picture, page.takes, y=y - 20, height=takes + strips - 30)
    table_left = _PAGE_WIDTH - PAGE_MARGIN - _TABLE_WIDTH
    _draw_table(picture, page.next_frames, x=table_left, y=lanes_top + strips + 28)
    return picture


def _draw_takes(
    picture: ByteImage, takes: Sequence[tuple[str, int]], *, y: int, height: int
) -> None:
    """Write the takes' names above the lanes, with a line at the start of each."""
    left = PAGE_MARGIN + LABEL_WIDTH
    across = _PAGE_WIDTH - PAGE_MARGIN - left
    total = sum(count for _, count in takes)
    at = 0
    for name, count in takes:
        x = left + at * across // total
        room = max(count * across // total - 8, 0)
        fill_box(picture, x, y + 4, 1, height, DIM, cover=0.8)
        draw_text(picture, name, x=x + 6, y=y + 4, style=_DIM_STYLE, max_width=room)
        at += count


def _draw_growth(figure: Figure, page: CoveragePage, *, y: int) -> None:
    pairs = len(page.growth) - 1
    further = np.array([page.growth[-1], *(each.mean_then for each in page.next_frames)])
    width = _PAGE_WIDTH - 2 * PAGE_MARGIN - _TABLE_WIDTH - 110
    axes = add_axes(
        figure,
        (PAGE_MARGIN + 50, y, width, _PLOT_HEIGHT),
        caption="Coverage",
        across="references",
        up="mean over the takes [%]",
        whole=True,
    )
    right = float(pairs + len(page.next_frames) + 1)
    axes.set_xlim(0.0, right)
    axes.set_ylim(0.0, 101.0)
    plot_curve(axes, np.arange(pairs + 1.0), 100 * page.growth, BLUE)
    if page.next_frames:
        numbers = pairs + np.arange(len(further), dtype=float)
        plot_curve(axes, numbers, 100 * further, ORANGE)
        plot_points(axes, numbers[1:], 100 * further[1:], ORANGE, hollow=True)
    plot_points(axes, np.array([float(pairs)]), 100 * page.growth[-1:], BLUE)
    now = f"{page.growth[-1]:.1%} with {pairs}"
    at = (pairs / right, float(page.growth[-1]) / 1.01)
    anchor = "right" if at[0] > 0.3 else "left"
    add_label(axes, now, at, shift=(-8, -24), color=BLUE, anchor=anchor, bold=True)


def _draw_table(picture: ByteImage, frames: Sequence[NextFrame], *, x: int, y: int) -> None:
    caption = "Tune next, in this order: the frames with the least coverage"
    draw_text(picture, caption, x=x, y=y, style=_CAPTION_STYLE, max_width=_TABLE_WIDTH)
    if not frames:
        none = "every frame that may be chosen is a reference"
        draw_text(picture, none, x=x, y=y + 34, style=_TEXT_STYLE)
        return
    for label, at in _TABLE_COLUMNS:
        draw_text(picture, label, x=x + at, y=y + 30, style=_DIM_STYLE)
    fill_box(picture, x, y + 53, _TABLE_WIDTH, 1, RULE)
    for number, each in enumerate(frames):
        top = y + 58 + _ROW_HEIGHT * number
        draw_text(picture, each.take, x=x, y=top, style=_TEXT_STYLE, max_width=190)
        cells = (str(each.frame), f"{each.coverage:.0%}", f"{each.mean_then:.1%}")
        for cell, (_, at) in zip(cells, _TABLE_COLUMNS[1:], strict=True):
            draw_text(picture, cell, x=x + at, y=top, style=_NUMBER_STYLE)
