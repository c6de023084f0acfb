"""Log-log plot as SVG, with line names next to the lines."""

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from usdface.media.picture.canvas import space_rows

WIDTH, HEIGHT = 860, 520
_BOX = (0.093, 0.123, 0.593, 0.769)
_LABEL_PIXELS = 19
COLORS = ("#0072b2", "#d55e00", "#009e73", "#9b4f96", "#b8860b", "#4d4d4d", "#c2185b", "#2e8bc0")
"""Distinguishable with most colour vision deficiencies."""

_SVG_OPTIONS: Any = {
    "svg.fonttype": "none",
    "svg.hashsalt": "usdface",
    "font.size": 14,
    "font.sans-serif": ["DejaVu Sans"],
}
"""Text is stored as text, and the file is reproducible."""


@dataclass(frozen=True)
class Line:
    """Measured points, and two end points of the fitted line."""

    label: str
    color: str
    sizes: Sequence[float]
    seconds: Sequence[float]
    fitted: tuple[float, float]


def log_plot(title: str, across: str, lines: Sequence[Line]) -> str:
    """Return an SVG plot of processor seconds over size."""
    figure = Figure(figsize=(WIDTH / 72, HEIGHT / 72), dpi=72)
    stream = io.StringIO()
    with matplotlib.rc_context(_SVG_OPTIONS):
        axes = figure.add_axes(_BOX, xscale="log", yscale="log")
        axes.set_title(title, loc="left", fontsize=17, fontweight="bold", pad=18)
        axes.set_xlabel(across)
        axes.set_ylabel("seconds of the processor")
        for line in lines:
            ends = line.sizes[0], line.sizes[-1]
            axes.plot(ends, line.fitted, color=line.color, linewidth=2)
            axes.plot(line.sizes, line.seconds, "o", color=line.color, markersize=8)
        axes.grid(color="#dddddd")
        axes.set_axisbelow(True)
        for axis in (axes.xaxis, axes.yaxis):
            low, high = np.log10(axis.get_view_interval())
            # Label ticks within a decade if it is wide.
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high - low < 2.2 else (1.0,)))
            axis.set_minor_formatter(NullFormatter())
            axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.12g}"))
        _draw_slope_one(axes)
        _label_ends(axes, lines)
        FigureCanvasSVG(figure).print_svg(stream, metadata={"Date": None})
    return stream.getvalue()


def _draw_slope_one(axes: Axes) -> None:
    """Draw a line of slope 1 from the lower left."""
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    rise = min(right / left, high / low)
    axes.plot((left, left * rise), (low, low * rise), ":", color="#999999", zorder=1)
    at = left * rise**0.15, low * rise**0.15
    axes.annotate("linear", at, (10, -13), textcoords="offset points", color="#777777")
    axes.set_xlim(left, right)
    axes.set_ylim(low, high)


def _label_ends(axes: Axes, lines: Sequence[Line]) -> None:
    """Write the names at the right, each connected to its line."""
    tall = axes.bbox.height
    low, high = axes.get_ylim()
    order = sorted(lines, key=lambda line: line.fitted[1])
    shares = [np.log(line.fitted[1] / low) / np.log(high / low) for line in order]
    ends = tall * np.array(shares)
    rows = space_rows(ends, spacing=_LABEL_PIXELS, height=tall, margin=6)
    for line, row in zip(order, rows.tolist(), strict=True):
        axes.annotate(
            line.label,
            (line.sizes[-1], line.fitted[1]),
            (1 + 16 / axes.bbox.width, row / tall),
            textcoords="axes fraction",
            color=line.color,
            verticalalignment="center",
            parse_math=False,
            arrowprops={"arrowstyle": "-", "color": line.color, "alpha": 0.45, "shrinkA": 2},
        )
