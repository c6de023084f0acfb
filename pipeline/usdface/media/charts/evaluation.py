"""Chart of a performance's errors: over time by region, lip distance, and by shape."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from usdface.core.arrays import ByteImage, FloatArray
from usdface.media.charts.axes import (
    add_axes,
    add_label,
    display_color,
    new_figure,
    plot_curve,
    render,
)
from usdface.media.picture.color import (
    BLUE,
    BRIGHT,
    DIM,
    KEYS_RANGE_MM,
    LANE,
    ORANGE,
    SOFT,
    bytes_from_linear,
    heat_ramp,
)
from usdface.media.picture.error_strip import (
    LABEL_WIDTH,
    ErrorCurve,
    ErrorStrip,
    draw_error_strip,
    strip_height,
)
from usdface.media.picture.sheet import HEADER_HEIGHT, draw_header, draw_legend, draw_verdict
from usdface.media.picture.sheet_layout import PAGE_MARGIN, VERDICT_SCALE
from usdface.media.picture.text import TextStyle, draw_text, shortened

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PAGE_WIDTH = 1800
_LEGEND_HEIGHT = 44
VERDICT_HEIGHT = 34
LIPS_HEIGHT = 180
_ROW_HEIGHT = 24
COLUMN_COUNT = 3
MOST_SHAPES = 90
NAME_WIDTH = 170
_NUMBERS_WIDTH = 150

_CAPTION_STYLE = TextStyle(size=18, color=BRIGHT, weight="bold")
_NAME_STYLE = TextStyle(size=16)
_NOTE_STYLE = TextStyle(size=16, color=DIM)


@dataclass(frozen=True)
class ShapeBar:
    """One shape's error."""

    name: str
    """As on the rig."""
    rmse: float
    bias: float
    """`rmse`, `bias`: root mean square and mean error of its weight."""
    surface_mm: float
    """Root mean square displacement of the surface by this shape's error [mm]."""


@dataclass(frozen=True)
class EvaluationPage:
    """Content of the chart."""

    title: str
    verdict: tuple[str, str]
    """``'good'``, ``'check'`` or ``'bad'``, and the sentence."""
    facts: tuple[str, ...]
    curves: tuple[ErrorCurve, ...]
    """The whole face first, then its regions [mm]."""
    first_frame: int
    """Frame number of each curve's first value."""
    worst: tuple[int, ...] = ()
    """Frames to mark."""
    lips: tuple[FloatArray, FloatArray] | None = None
    """Distance of the lips by the keys and by the solve, (frames,) each [mm]; NaN at frames that
    were not compared."""
    shapes: tuple[ShapeBar, ...] = ()
    """In the order to show."""


def draw_evaluation(page: EvaluationPage) -> ByteImage:
    """Return the chart: (height, width, 3) uint8 array, sRGB."""
    shapes = page.shapes[:MOST_SHAPES]
    rows = -(-len(shapes) // COLUMN_COUNT)
    strips = strip_height(len(page.curves))
    lips_top = PAGE_MARGIN + HEADER_HEIGHT + VERDICT_HEIGHT + strips + _LEGEND_HEIGHT
    shapes_top = lips_top
    if page.lips is not None:
        shapes_top += LIPS_HEIGHT + 100
    bottom = shapes_top + (rows * _ROW_HEIGHT + 70 if rows else 0)
    figure = new_figure(PAGE_WIDTH, bottom)
    if page.lips is not None:
        _draw_lips(figure, *page.lips, page.first_frame, y=lips_top + 28)
    if shapes:
        _draw_shapes(figure, shapes, y=shapes_top + 36)
    picture = render(figure)

    inner = PAGE_WIDTH - 2 * PAGE_MARGIN
    high = KEYS_RANGE_MM
    y = draw_header(picture, page.title, page.facts, margin=PAGE_MARGIN)
    draw_verdict(picture, page.verdict, x=PAGE_MARGIN, y=y - 4, scale=VERDICT_SCALE)
    y += VERDICT_HEIGHT
    marks = tuple((frame, str(frame)) for frame in page.worst)
    strip = ErrorStrip(page.curves, page.first_frame, high, marks)
    draw_error_strip(picture, strip, x=PAGE_MARGIN, y=y, width=inner)
    y += strips
    note = (
        "RMS distance of the skin from the keys, without gaze and tongue; numbers mark the worst "
        "frames"
    )
    draw_legend(picture, (note,), x=PAGE_MARGIN, y=y, width=inner, high=f"{high:g} mm")
    if shapes:
        _write_shape_caption(picture, y=shapes_top, hidden=len(page.shapes) - len(shapes))
    return picture


def _draw_lips(
    figure: Figure, keys: FloatArray, solve: FloatArray, first_frame: int, *, y: int
) -> None:
    """Draw both distances over the frames; the solve above the keys is a mouth left open."""
    frames = np.arange(first_frame, first_frame + len(keys), dtype=np.float64)
    both = np.concatenate([keys, solve])
    both = both[np.isfinite(both)]
    low, high = min(float(both.min()), 0.0), max(float(both.max()), 1.0)
    left = PAGE_MARGIN + LABEL_WIDTH
    box = (left, y, PAGE_WIDTH - PAGE_MARGIN - left, LIPS_HEIGHT)
    caption = "Distance of the lips"
    axes = add_axes(figure, box, caption=caption, across="frame", up="mm", whole=True)
    axes.set_xlim(first_frame - 0.5, first_frame + len(keys) - 0.5)
    axes.set_ylim(low - 0.05 * (high - low), high + 0.05 * (high - low))
    plot_curve(axes, frames, keys, BLUE)
    plot_curve(axes, frames, solve, ORANGE)
    for label, color, across in (("keys", BLUE, 260), ("solve", ORANGE, 320)):
        add_label(axes, label, (0, 1), shift=(across, 10), color=color, bold=True)


def _write_shape_caption(picture: ByteImage, *, y: int, hidden: int) -> None:
    x = PAGE_MARGIN + 16
    x += draw_text(picture, "Shape by shape", x=PAGE_MARGIN, y=y, style=_CAPTION_STYLE)
    note = "bar: RMS error of the weight; colour: its error on the surface; tick: its mean error"
    if hidden:
        note += f"; {hidden} more shapes err less"
    draw_text(picture, note, x=x, y=y + 2, style=_NOTE_STYLE)


def _draw_shapes(figure: Figure, shapes: Sequence[ShapeBar], *, y: int) -> None:
    rows = -(-len(shapes) // COLUMN_COUNT)
    pitch = (PAGE_WIDTH - 2 * PAGE_MARGIN) // COLUMN_COUNT
    longest = max(max(shape.rmse for shape in shapes), 1e-9)
    for column in range(COLUMN_COUNT):
        listed = shapes[column * rows : (column + 1) * rows]
        x = PAGE_MARGIN + column * pitch + NAME_WIDTH
        box = (x, y, pitch - NAME_WIDTH - _NUMBERS_WIDTH, rows * _ROW_HEIGHT)
        axes = add_axes(figure, box)
        axes.set_axis_off()
        axes.set_xlim(0, longest)
        axes.set_ylim(rows - 0.5, -0.5)
        places = np.arange(len(listed))
        heat = heat_ramp([bar.surface_mm for bar in listed], high=KEYS_RANGE_MM)
        colors = bytes_from_linear(heat) / 255
        thick = 14 / _ROW_HEIGHT
        axes.barh(places, longest, thick, color=display_color(LANE))
        axes.barh(places, [bar.rmse for bar in listed], thick, color=colors)
        ticks = np.minimum(np.abs([bar.bias for bar in listed]), longest)
        half = 9 / _ROW_HEIGHT
        axes.vlines(ticks, places - half, places + half, color=display_color(BRIGHT), linewidth=2)
        for place, bar in zip(places.tolist(), listed, strict=True):
            middle = 1 - (place + 0.5) / rows
            name = shortened(bar.name, _NAME_STYLE, max_width=NAME_WIDTH - 12)
            add_label(axes, name, (0, middle), shift=(-NAME_WIDTH, -5), color=SOFT)
            numbers = f"{bar.rmse:.3f}   {bar.bias:+.3f}".replace("-", "−")  # as wide as a plus
            add_label(axes, numbers, (1, middle), shift=(10, -5), color=SOFT)
