"""How well references cover takes, as one picture: where, how it grew, what would fill holes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import ByteImage, FloatArray
from usdface.core.errors import InputError
from usdface.media.charts.plot import Plot
from usdface.media.picture.canvas import Color, draw_line, fill_box, new_picture
from usdface.media.picture.error_strip import ErrorCurve, draw_error_strip, strip_height
from usdface.media.picture.palette import FIRST, PAGE, SECOND
from usdface.media.picture.sheet import draw_header, draw_legend
from usdface.media.picture.text import TextStyle, draw_text

WIDTH = 1600
MARGIN = 36
HEAD = 112
LEGEND = 46
TAKES = 30
PLOT_HEIGHT = 300
LIST_WIDTH = 560
ROW = 26
WORST = 50.0
"""[%] At the top of a lane: with half a face a guess, nothing is known of it."""

_BOUND: Color = (132, 137, 146)
_HEAD = TextStyle(size=18, color=(222, 224, 228), weight="bold")
_TEXT = TextStyle(size=16, color=(196, 200, 206))
_CODE = TextStyle(size=16, color=(222, 225, 230), weight="mono")
_DIM = TextStyle(size=15, color=(152, 157, 166))


@dataclass(frozen=True)
class Hole:
    """A frame that the references say little about.

    Attributes
    ----------
    take : str
    frame : int
    covered : float
        Share of its motion that they determine [0-1].
    share : float
        Coverage of the takes if it and those before it were tuned [0-1].
    """

    take: str
    frame: int
    covered: float
    share: float


@dataclass(frozen=True)
class CoveragePage:
    """What the picture shows.

    Attributes
    ----------
    title : str
    facts : tuple of str
    lanes : tuple of ErrorCurve
        What is not covered, frame by frame over all takes, of the face and its parts [%].
    takes : tuple of (str, int)
        Name and number of frames of each take, in order.
    first_frame : int
        Frame number of the first frame, where there is one take.
    marks : tuple of int
        Where among the frames of all takes the references are.
    growth : (pairs + 1,) float array
        Coverage with 0, 1, 2 ... pairs [0-1].
    holes : tuple of Hole
        The frames to tune next: each the deepest hole once those before are tuned.
    """

    title: str
    facts: tuple[str, ...]
    lanes: tuple[ErrorCurve, ...]
    takes: tuple[tuple[str, int], ...]
    first_frame: int
    marks: tuple[int, ...]
    growth: FloatArray
    holes: tuple[Hole, ...] = ()


def draw_coverage(page: CoveragePage) -> ByteImage:
    """Draw where references leave holes, how coverage grew, and the frames that would help next.

    Returns
    -------
    (height, width, 3) uint8 array
        sRGB.

    Raises
    ------
    InputError
        If there is nothing to draw.
    """
    if not page.lanes or not len(page.growth):
        raise InputError("coverage to draw needs at least one lane and a curve")
    strips = strip_height(len(page.lanes))
    body = max(PLOT_HEIGHT + 70, 60 + ROW * len(page.holes))
    takes = TAKES if len(page.takes) > 1 else 0
    picture = new_picture(WIDTH, HEAD + LEGEND + takes + strips + body + MARGIN, PAGE)
    inner = WIDTH - 2 * MARGIN
    y = draw_header(picture, page.title, page.facts, x=MARGIN, y=MARGIN - 8, width=inner)
    notes = (
        "share of a face's motion that the references do not determine",
        "white marks: references",
    )
    draw_legend(picture, ("   ·   ".join(notes),), x=MARGIN, y=y, width=inner, high=WORST, unit="%")
    y += LEGEND
    first = page.first_frame if len(page.takes) == 1 else 0
    lanes_top = y + takes - 20  # the strip leaves room for numbers above, which marks have none of
    draw_error_strip(
        picture,
        page.lanes,
        x=MARGIN,
        y=lanes_top,
        width=inner,
        first_frame=first,
        high=WORST,
        marks=[(first + mark, "") for mark in page.marks],
        unit="%",
    )
    if takes:
        _draw_takes(picture, page.takes, y=y - 20, height=takes + strips - 30, width=inner)
    y = lanes_top + strips + 20
    _draw_growth(picture, page, x=MARGIN + 50, y=y + 34, width=inner - LIST_WIDTH - 110)
    _draw_holes(picture, page.holes, x=WIDTH - MARGIN - LIST_WIDTH, y=y + 8)
    return picture


def _draw_takes(
    picture: ByteImage, takes: Sequence[tuple[str, int]], *, y: int, height: int, width: int
) -> None:
    """Name the takes above the lanes, with a line where one ends."""
    left, across = MARGIN + 112, width - 112  # where the strip's lanes begin
    total = sum(count for _, count in takes)
    at = 0
    for name, count in takes:
        x = left + at * across // total
        wide = max(count * across // total - 8, 0)
        fill_box(picture, x, y + 4, 1, height, _BOUND, cover=0.8)
        draw_text(picture, name, x=x + 6, y=y + 4, style=_DIM, max_width=wide)
        at += count


def _draw_growth(picture: ByteImage, page: CoveragePage, *, x: int, y: int, width: int) -> None:
    pairs = len(page.growth) - 1
    further = np.array([page.growth[-1], *(hole.share for hole in page.holes)])
    low = float(np.floor(min(page.growth[min(1, pairs)], 0.9) * 10) * 10)
    plot = Plot(
        picture, x, y, width, PLOT_HEIGHT, 0.0, float(pairs + len(page.holes) + 1), low, 101.0
    )
    plot.draw_axes(
        "Coverage", across="references", up="% of the motion, mean over the takes", whole=True
    )
    plot.draw_curve(np.arange(pairs + 1.0), 100 * page.growth, FIRST)
    if page.holes:
        numbers = pairs + np.arange(len(further), dtype=float)
        plot.draw_curve(numbers, 100 * further, SECOND)
        plot.draw_points(numbers[1:], 100 * further[1:], SECOND, hollow=True)
    plot.draw_points(np.array([float(pairs)]), 100 * page.growth[-1:], FIRST)
    now = f"{page.growth[-1]:.1%} with {pairs}"
    column, row = plot.column(pairs), plot.row(100 * float(page.growth[-1]))
    style = TextStyle(size=16, color=FIRST, weight="bold")
    draw_text(picture, now, x=round(column) - 12, y=round(row) + 14, style=style, anchor="right")


def _draw_holes(picture: ByteImage, holes: Sequence[Hole], *, x: int, y: int) -> None:
    draw_text(
        picture,
        "To tune next: each the deepest hole once those above are tuned",
        x=x,
        y=y,
        style=_HEAD,
    )
    if not holes:
        draw_text(
            picture, "every frame that may be chosen is a reference", x=x, y=y + 34, style=_TEXT
        )
        return
    heads = (("take", 0), ("frame", 250), ("covered now", 340), ("then all", 470))
    for label, at in heads:
        draw_text(picture, label, x=x + at, y=y + 30, style=_DIM)
    draw_line(picture, (x, y + 53), (x + LIST_WIDTH, y + 53), (58, 61, 67), thickness=1.0)
    for number, hole in enumerate(holes):
        top = y + 58 + ROW * number
        draw_text(picture, hole.take, x=x, y=top, style=_TEXT, max_width=235)
        draw_text(picture, f"{hole.frame}", x=x + 250, y=top, style=_CODE)
        draw_text(picture, f"{hole.covered:.0%}", x=x + 340, y=top, style=_CODE)
        draw_text(picture, f"{hole.share:.1%}", x=x + 470, y=top, style=_CODE)
