"""Axes on a page, drawn by matplotlib (Agg) in pixels.

Matplotlib is imported only when a figure is made, because its import is slow.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from usdface.core.arrays import ByteImage, FloatArray
from usdface.media.picture.canvas import space_rows
from usdface.media.picture.color import BRIGHT, DIM, FRAME, GRID, PAGE, PANEL, Color
from usdface.media.picture.text import east_asian_font_file

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.text import Annotation

LABEL_PIXELS = 14
CAPTION_PIXELS = 15
_PIXELS_PER_INCH = 72
"""Equal to points per inch, so that font sizes and line widths are in pixels."""
_TICK_STEPS = [1, 2, 5, 10]
_GAP_STEPS = 3.0
"""Step between samples, relative to the median step, above which a curve is interrupted."""


def new_figure(width: int, height: int) -> Figure:
    """Return an empty figure in the page colour, with its size in pixels."""
    from matplotlib.figure import Figure

    # matplotlib rounds down
    size = ((width + 1e-3) / _PIXELS_PER_INCH, (height + 1e-3) / _PIXELS_PER_INCH)
    return Figure(figsize=size, dpi=_PIXELS_PER_INCH, facecolor=display_color(PAGE))


def render(figure: Figure) -> ByteImage:
    """Draw a figure: (height, width, 3) uint8 array, sRGB."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    canvas: Any = FigureCanvasAgg(figure)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from font")  # drawn as a box
        canvas.draw()
    return np.ascontiguousarray(np.asarray(canvas.buffer_rgba())[..., :3])


def add_axes(
    figure: Figure,
    box: tuple[int, int, int, int],
    *,
    caption: str = "",
    across: str = "",
    up: str = "",
    whole: bool = False,
) -> Axes:
    """Add axes with a grid, a caption above and tick labels.

    `box`: x, y from the upper left corner, width and height [pixels]. `across`, `up`: labels of the
    axes, with unit. `whole`: ticks only at whole numbers across, such as frames.
    """
    from matplotlib.ticker import MaxNLocator, StrMethodFormatter

    x, y, width, height = box
    wide, tall = figure.bbox.width, figure.bbox.height
    axes = figure.add_axes(
        (x / wide, 1 - (y + height) / tall, width / wide, height / tall),
        facecolor=display_color(PANEL),
    )
    axes.grid(visible=True, color=display_color(GRID), linewidth=1, linestyle="-")
    axes.set_axisbelow(True)
    for spine in axes.spines.values():
        spine.set(color=display_color(FRAME), linewidth=1)
    axes.tick_params(length=0, pad=6, labelsize=LABEL_PIXELS, labelcolor=display_color(DIM))
    axes.tick_params(labelfontfamily="DejaVu Sans")
    nbins = max(width // 90, 1)
    axes.xaxis.set_major_locator(
        MaxNLocator(nbins, steps=_TICK_STEPS, integer=whole, min_n_ticks=1)
    )
    axes.yaxis.set_major_locator(MaxNLocator(max(height // 45, 2), steps=_TICK_STEPS))
    axes.ticklabel_format(style="plain", useOffset=False)
    if whole:
        axes.xaxis.set_major_formatter(StrMethodFormatter("{x:.0f}"))
    axes.margins(0)
    title = add_label(axes, caption, (0, 1), shift=(0, 10), color=BRIGHT, bold=True)
    if up:
        axes.annotate(
            up,
            (1 if caption else 0, 1),
            xycoords=(title if caption else "axes fraction", "axes fraction"),
            xytext=(16 if caption else 0, 10),
            textcoords="offset points",
            color=display_color(DIM),
            fontsize=LABEL_PIXELS,
            fontfamily=font_families(),
            parse_math=False,
        )
    add_label(axes, across, (1, 0), shift=(0, -38), anchor="right")
    return axes


def add_label(
    axes: Axes,
    text: str,
    at: tuple[float, float],
    *,
    shift: tuple[float, float] = (0, 0),
    color: Color = DIM,
    anchor: str = "left",
    bold: bool = False,
    ground: Color | None = None,
) -> Annotation:
    """Write a label on axes.

    Parameters
    ----------
    text : str
        One line; dollar signs are literal.
    at : (x, y)
        Shares of the axes' width and height, from the lower left [0-1].
    shift : (x, y)
        Offset from `at`, y upwards [pixels].
    anchor : {'left', 'center', 'right'}
    bold : bool
        For captions.
    ground : tuple of int, optional
        Colour of a box behind the label.
    """
    box = None
    if ground is not None:
        box = {"facecolor": display_color(ground), "edgecolor": "none", "pad": 4, "alpha": 0.9}
    return axes.annotate(
        text,
        at,
        xycoords="axes fraction",
        xytext=shift,
        textcoords="offset points",
        color=display_color(color),
        fontsize=CAPTION_PIXELS if bold else LABEL_PIXELS,
        fontweight="bold" if bold else "normal",
        fontfamily=font_families(),
        horizontalalignment=anchor,
        parse_math=False,
        bbox=box,
        zorder=6,
    )


def plot_curve(axes: Axes, values: FloatArray, heights: FloatArray, color: Color) -> None:
    """Draw a curve within the limits of the axes, which are set; a single sample is a dot.

    `values`: (n,), ascending. `heights`: (n,); NaN is skipped: regular gaps between samples are
    bridged, longer ones stay open.
    """
    left, right = axes.get_xlim()
    shown = np.isfinite(heights) & (values >= left) & (values <= right)
    values, heights = values[shown], heights[shown]
    if len(values) == 1:
        axes.plot(values, heights, "o", color=display_color(color), markersize=8)
        return
    if len(values) > 1:
        steps = np.diff(values)
        gaps = np.flatnonzero(steps > _GAP_STEPS * np.median(steps)) + 1
        values, heights = np.insert(values, gaps, np.nan), np.insert(heights, gaps, np.nan)
    columns = round(axes.bbox.width)
    if len(values) > 8 * columns:  # the lowest and the highest sample of each half pixel suffice
        edges = np.linspace(0, len(values), 2 * columns, endpoint=False).astype(np.int64)
        extremes = [np.fmin.reduceat(heights, edges), np.fmax.reduceat(heights, edges)]
        values, heights = np.repeat(values[edges], 2), np.stack(extremes, axis=1).ravel()
    axes.plot(values, heights, color=display_color(color), linewidth=2, solid_joinstyle="round")


def plot_points(
    axes: Axes, values: FloatArray, heights: FloatArray, color: Color, *, hollow: bool = False
) -> None:
    """Draw dots; those above or below the axes are drawn on the edge."""
    axes.plot(
        values,
        np.clip(heights, *axes.get_ylim()),
        "o",
        markersize=7,
        markeredgewidth=1.5,
        markeredgecolor=display_color(color),
        markerfacecolor="none" if hollow else display_color(color),
        clip_on=False,
        zorder=5,
    )


def label_ends(axes: Axes, labels: Sequence[tuple[str, float, Color]]) -> None:
    """Label curves to the right of the axes, whose limits are set, at their ends without overlap.

    `labels`: text, height of the curve's end in data coordinates, and colour of each.
    """
    low, high = axes.get_ylim()
    tall = round(axes.bbox.height)
    order = sorted(range(len(labels)), key=lambda index: labels[index][1])
    ends = np.array([(labels[index][1] - low) / (high - low) * tall for index in order])
    spacing = min(LABEL_PIXELS + 5.0, tall / max(len(labels), 1))
    rows = space_rows(ends, spacing=spacing, height=tall, margin=8)
    for index, row in zip(order, rows.tolist(), strict=True):
        text, _, color = labels[index]
        add_label(axes, text, (1, 0), shift=(10, row - 5), color=color)


def display_color(color: Color) -> tuple[float, float, float]:
    """Return a colour as shares of 1, for matplotlib."""
    return color[0] / 255, color[1] / 255, color[2] / 255


@lru_cache(maxsize=1)
def font_families() -> list[str]:
    """Return matplotlib's font, and if installed an East Asian one for letters it lacks."""
    from matplotlib import font_manager

    file = east_asian_font_file()
    if file is None:
        return ["DejaVu Sans"]
    font_manager.fontManager.addfont(str(file))
    name = font_manager.FontProperties(fname=str(file)).get_name()
    return ["DejaVu Sans", name]
