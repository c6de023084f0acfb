"""Chart of the space of principal components: takes, references, and explained variance.

Figure 3 of Deng et al. (2006) shows the first three axes in perspective; here each pair has a plot.
"""

from collections.abc import Sequence

import numpy as np

from usdface.core.arrays import ByteImage, FloatArray
from usdface.media.charts.axes import (
    add_axes,
    add_label,
    display_color,
    new_figure,
    plot_curve,
    plot_points,
    render,
)
from usdface.media.picture.color import BLUE, ORANGE
from usdface.media.picture.sheet import HEADER_HEIGHT, draw_header
from usdface.media.picture.sheet_layout import PAGE_MARGIN

_PAGE_WIDTH = 1600
_PLOT_WIDTH, _PLOT_HEIGHT = 640, 400
_ROW_HEIGHT = _PLOT_HEIGHT + 110
_ROOM_SHARE = 0.05
"""Margin around the range of a component, relative to it."""
_MOST_COMPONENTS = 20
"""Components in the variance plot; further ones are small in most takes."""


def draw_eigenspace(
    title: str,
    facts: Sequence[str],
    *,
    takes: FloatArray,
    references: FloatArray,
    shares: FloatArray,
) -> ByteImage:
    """Draw the first three components in pairs, and the cumulative variance.

    `takes`: (frames, dimensions), a sample of the takes' frames [mm]. `references`: (pairs,
    dimensions) [mm]. `shares`: (dimensions,), of the markers' variance [0-1].
    """
    top = PAGE_MARGIN + HEADER_HEIGHT + 30
    figure = new_figure(_PAGE_WIDTH, top + 2 * _ROW_HEIGHT + PAGE_MARGIN)
    second = _PAGE_WIDTH // 2
    places = [(0, top), (second, top), (0, top + _ROW_HEIGHT)]
    for (left, y), (one, other) in zip(places, ((0, 1), (0, 2), (1, 2)), strict=True):
        if other >= len(shares):
            continue
        axes = add_axes(
            figure,
            (left + 2 * PAGE_MARGIN, y, _PLOT_WIDTH, _PLOT_HEIGHT),
            caption=f"component {other + 1}",
            across=f"component {one + 1}, mm",
            up="mm",
        )
        both = np.concatenate([takes, references])
        axes.set_xlim(*_limits(both[:, one]))
        axes.set_ylim(*_limits(both[:, other]))
        axes.plot(
            takes[:, one],
            takes[:, other],
            ".",
            color=display_color(BLUE),
            markersize=3,
            alpha=0.6,
        )
        plot_points(axes, references[:, one], references[:, other], ORANGE)
        add_label(axes, "frames of the takes", (0, 1), shift=(10, -20), color=BLUE)
        add_label(axes, "references", (0, 1), shift=(10, -40), color=ORANGE)
    shown = min(len(shares), _MOST_COMPONENTS)
    percent = 100 * np.cumsum(shares)[:shown]
    axes = add_axes(
        figure,
        (second + 2 * PAGE_MARGIN, top + _ROW_HEIGHT, _PLOT_WIDTH, _PLOT_HEIGHT),
        caption="Variance",
        across="components",
        up="% of the markers' variance",
        whole=True,
    )
    axes.set_xlim(1.0, max(float(shown), 2.0))
    axes.set_ylim(min(float(np.floor(percent[0] / 10) * 10), 90.0), 100.0)
    plot_curve(axes, np.arange(1.0, shown + 1), percent, BLUE)
    plot_points(axes, np.arange(1.0, shown + 1), percent, BLUE)
    picture = render(figure)
    draw_header(picture, title, facts, margin=PAGE_MARGIN)
    return picture


def _limits(values: FloatArray) -> tuple[float, float]:
    low, high = float(values.min()), float(values.max())
    room = max(_ROOM_SHARE * (high - low), 1e-3)
    return low - room, high + room
