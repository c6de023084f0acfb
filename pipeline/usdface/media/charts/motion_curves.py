"""Charts of controls before and after a change, and of the errors of several methods."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from usdface.core.arrays import ByteImage, FloatArray
from usdface.core.errors import InputError
from usdface.media.charts.axes import (
    LABEL_PIXELS,
    add_axes,
    add_label,
    display_color,
    label_ends,
    new_figure,
    plot_curve,
    render,
)
from usdface.media.picture.color import BLUE, ORANGE, Color
from usdface.media.picture.sheet import HEADER_HEIGHT, draw_header
from usdface.media.picture.sheet_layout import PAGE_MARGIN
from usdface.media.picture.text import TextStyle, shortened, text_width

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FIGURE_WIDTH = 1800
_PANELS_TOP = PAGE_MARGIN + HEADER_HEIGHT + 6
PANEL_HEIGHT = 170
_PANEL_GAP = 74
_AXIS_WIDTH = 76
MOST_WINDOWS = 4
SAME_CHANGE_CORRELATION = 0.995
"""Correlation of changes above which two controls, such as left and right, are drawn once."""
MOST_PANELS = 8
CONTEXT_FRAMES = 40
"""Frames shown before and after each span."""

_SPAN_COLOR: Color = (58, 66, 84)
_SPAN_LABEL_COLOR: Color = (180, 196, 228)
_LABEL_STYLE = TextStyle(size=16)


@dataclass(frozen=True)
class FrameSpan:
    """An interval to shade: an inserted sequence."""

    first_frame: int
    last_frame: int
    """`first_frame`, `last_frame`: inclusive."""
    label: str
    """Of the sequence."""


@dataclass(frozen=True)
class Curve:
    """One line of a panel."""

    label: str
    """Written at its end."""
    values: FloatArray
    """(frames,): NaN is skipped."""
    color: Color
    """sRGB bytes."""


@dataclass(frozen=True)
class Panel:
    """One plot: curves over the same frames."""

    caption: str
    unit: str
    """`caption`, `unit`: written above the plot."""
    curves: tuple[Curve, ...]
    """The last is drawn on top."""


def before_and_after(
    names: Sequence[str], before: FloatArray, after: FloatArray
) -> tuple[Panel, ...]:
    """Return panels of the `MOST_PANELS` controls that change most, from (frames, controls).

    Of controls with the same change (`SAME_CHANGE_CORRELATION`), one has a panel.
    """
    change = after - before
    span = np.maximum(np.ptp(before, axis=0), np.ptp(after, axis=0))
    # Changes are absolute for weights, and relative to their range for angles and lengths.
    size = np.minimum(np.abs(change).max(axis=0), np.abs(change).max(axis=0) / (span + 1e-9))
    unit = change / np.maximum(np.linalg.norm(change, axis=0), 1e-12)
    chosen: list[int] = []
    for index in np.argsort(-size, kind="stable").tolist():
        if len(chosen) == MOST_PANELS or size[index] < 1e-6:
            break
        if all(abs(unit[:, index] @ unit[:, other]) < SAME_CHANGE_CORRELATION for other in chosen):
            chosen.append(index)
    return tuple(
        Panel(
            names[index],
            "",
            (Curve("before", before[:, index], BLUE), Curve("after", after[:, index], ORANGE)),
        )
        for index in chosen
    )


def windows_around(
    spans: Sequence[FrameSpan], *, first_frame: int, last_frame: int
) -> tuple[tuple[int, int], ...]:
    """Return the frame ranges of the first `MOST_WINDOWS` spans, with `CONTEXT_FRAMES`."""
    return tuple(
        (
            max(span.first_frame - CONTEXT_FRAMES, first_frame),
            min(span.last_frame + CONTEXT_FRAMES, last_frame),
        )
        for span in spans[:MOST_WINDOWS]
    )


def draw_motion_curves(
    title: str,
    facts: tuple[str, ...],
    panels: Sequence[Panel],
    *,
    first_frame: int,
    step: int = 1,
    windows: Sequence[tuple[int, int]] = (),
    spans: Sequence[FrameSpan] = (),
    from_zero: bool = False,
) -> ByteImage:
    """Draw panels below each other, windows side by side: (height, width, 3) uint8 array, sRGB.

    Parameters
    ----------
    title, facts, panels
        From the top; at least one panel.
    first_frame, step : int
        Frame number of each curve's first value, and frames between values.
    windows : sequence of (first, last) frame
        Ranges to show; default: all frames.
    spans : sequence of FrameSpan
        Shaded in every panel, labelled in the first row.
    from_zero : bool
        Whether every panel starts at 0, for errors.
    """
    if not panels:
        raise InputError(f"{title}: nothing changes, so there is no curve to draw")
    count = len(panels[0].curves[0].values)
    frames = first_frame + step * np.arange(count, dtype=np.float64)
    shown = tuple(windows) or ((first_frame, int(frames[-1])),)
    height = _PANELS_TOP + len(panels) * (PANEL_HEIGHT + _PANEL_GAP) + PAGE_MARGIN
    figure = new_figure(FIGURE_WIDTH, height)
    names = {curve.label for panel in panels for curve in panel.curves}
    end = max(text_width(name, _LABEL_STYLE) for name in names) + 12
    pitch = (FIGURE_WIDTH - 2 * PAGE_MARGIN - end) // len(shown)
    for row, panel in enumerate(panels):
        for column, window in enumerate(shown):
            x = PAGE_MARGIN + _AXIS_WIDTH + column * pitch
            y = _PANELS_TOP + row * (PANEL_HEIGHT + _PANEL_GAP) + 28
            axes = add_axes(
                figure,
                (x, y, pitch - _AXIS_WIDTH, PANEL_HEIGHT),
                caption="" if column else panel.caption,
                across="frame",
                up="" if column else panel.unit,
                whole=True,
            )
            _draw_panel(axes, panel, frames, window, from_zero=from_zero)
            _shade(axes, spans, named=not row)
        _label_curves(axes, panel, frames)
    picture = render(figure)
    draw_header(picture, title, facts, margin=PAGE_MARGIN)
    return picture


def _draw_panel(
    axes: Axes, panel: Panel, frames: FloatArray, window: tuple[int, int], *, from_zero: bool
) -> None:
    values = np.concatenate([curve.values for curve in panel.curves])
    values = values[np.isfinite(values)]
    low = 0.0 if from_zero else float(values.min())
    high = max(float(values.max()), low + 1e-6)
    room = 0.06 * (high - low)
    axes.set_xlim(window[0] - 0.5, window[1] + 0.5)
    axes.set_ylim(low - room, high + room)  # keeps a curve at 0 off the edge
    for curve in panel.curves:
        plot_curve(axes, frames, curve.values, curve.color)


def _shade(axes: Axes, spans: Sequence[FrameSpan], *, named: bool) -> None:
    """Shade spans; if `named`, write their labels on a background that covers curves."""
    low, high = axes.get_xlim()
    for span in spans:
        left, right = max(span.first_frame - 0.5, low), min(span.last_frame + 0.5, high)
        if left >= right:
            continue
        axes.axvspan(left, right, color=display_color(_SPAN_COLOR), alpha=0.45, zorder=0.5)
        if named:
            share = (left - low) / (high - low)
            room = round((right - left) / (high - low) * axes.bbox.width)
            label = shortened(span.label, _LABEL_STYLE, max_width=max(room - 12, 60))
            shift = (5.0, -LABEL_PIXELS - 3.0)
            color = _SPAN_LABEL_COLOR
            add_label(axes, label, (share, 1), shift=shift, color=color, ground=_SPAN_COLOR)


def _label_curves(axes: Axes, panel: Panel, frames: FloatArray) -> None:
    """Label the curves at the end of the last window."""
    inside = frames <= axes.get_xlim()[1]
    ends = []
    for curve in panel.curves:
        known = curve.values[inside & np.isfinite(curve.values)]
        if len(known):
            ends.append((curve.label, float(known[-1]), curve.color))
    label_ends(axes, ends)
