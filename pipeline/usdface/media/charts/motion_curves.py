"""Curves of controls before and after, and of errors of several methods: sheets to judge motion."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import ByteImage, FloatArray
from usdface.core.errors import InputError
from usdface.media.charts.plot import Plot
from usdface.media.picture.canvas import Color, fill_box, new_picture
from usdface.media.picture.palette import FIRST, PAGE, SECOND
from usdface.media.picture.sheet import draw_header
from usdface.media.picture.text import TextStyle, draw_text, shortened, text_width

WIDTH = 1800
MARGIN = 36
HEAD = 184
PANEL_HEIGHT = 170
PANEL_GAP = 74
LEFT = 76
MOST_WINDOWS = 4
ALIKE = 0.995
"""Correlation of their changes beyond which two controls, left and right, are drawn once."""

_SPAN: Color = (58, 66, 84)
_NOTE = TextStyle(size=15, color=(152, 157, 166))
_SPAN_LABEL = TextStyle(size=14, color=(160, 178, 212))
PALETTE: tuple[Color, ...] = (
    (255, 178, 92),
    (120, 200, 255),
    (140, 214, 132),
    (236, 132, 152),
    (188, 160, 246),
    (220, 216, 120),
    (152, 157, 166),
)


@dataclass(frozen=True)
class FrameSpan:
    """An interval to shade: a sequence that was put in.

    Attributes
    ----------
    first_frame, last_frame : int
    label : str
    """

    first_frame: int
    last_frame: int
    label: str


@dataclass(frozen=True)
class Curve:
    """One line of a panel.

    Attributes
    ----------
    label : str
    values : (frames,) float array
    color : tuple of int
    """

    label: str
    values: FloatArray
    color: Color


@dataclass(frozen=True)
class Panel:
    """One plot: curves over the same frames.

    Attributes
    ----------
    caption, unit : str
    curves : tuple of Curve
        The last is drawn on top.
    """

    caption: str
    unit: str
    curves: tuple[Curve, ...]


def before_and_after(
    names: Sequence[str], before: FloatArray, after: FloatArray, *, count: int = 8
) -> tuple[Panel, ...]:
    """Return a panel for each of the controls that change most, those that change alike once.

    Parameters
    ----------
    names : sequence of str
    before, after : (frames, controls) float arrays
    count : int
    """
    change = after - before
    span = np.maximum(np.ptp(before, axis=0), np.ptp(after, axis=0))
    # Weights are judged by what they do, angles and lengths by their own span.
    size = np.minimum(np.abs(change).max(axis=0), np.abs(change).max(axis=0) / (span + 1e-9))
    unit = change / np.maximum(np.linalg.norm(change, axis=0), 1e-12)
    chosen: list[int] = []
    for index in np.argsort(-size, kind="stable").tolist():
        if len(chosen) == count or size[index] < 1e-6:
            break
        if all(abs(unit[:, index] @ unit[:, other]) < ALIKE for other in chosen):
            chosen.append(index)
    return tuple(
        Panel(
            names[index],
            "",
            (
                Curve("before", before[:, index], FIRST),
                Curve("after", after[:, index], SECOND),
            ),
        )
        for index in chosen
    )


def windows_around(
    spans: Sequence[FrameSpan], *, first_frame: int, last_frame: int, context: int = 40
) -> tuple[tuple[int, int], ...]:
    """Return the stretches to look at: each span with some context, at most `MOST_WINDOWS`."""
    return tuple(
        (max(span.first_frame - context, first_frame), min(span.last_frame + context, last_frame))
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
    title : str
    facts : tuple of str
    panels : sequence of Panel
    first_frame, step : int
        Frame number of each curve's first value, and frames from one value to the next.
    windows : sequence of (first, last) frame
        What to show of the curves; all by default.
    spans : sequence of Span
        Shaded in every panel, named in the first row.
    from_zero : bool
        Let every panel start at 0: for errors.

    Raises
    ------
    InputError
        If there is no panel.
    """
    if not panels:
        raise InputError(f"{title}: nothing changes, so there is no curve to draw")
    count = len(panels[0].curves[0].values)
    frames = first_frame + step * np.arange(count, dtype=np.float64)
    shown = tuple(windows) or ((first_frame, int(frames[-1])),)
    height = HEAD + len(panels) * (PANEL_HEIGHT + PANEL_GAP) + MARGIN
    picture = new_picture(WIDTH, height, PAGE)
    y = draw_header(picture, title, facts, x=MARGIN, y=MARGIN - 8, width=WIDTH - 2 * MARGIN)
    _draw_legend(picture, panels[0].curves, y=y - 6)
    pitch = (WIDTH - 2 * MARGIN) // len(shown)
    for row, panel in enumerate(panels):
        for column, (first, last) in enumerate(shown):
            plot = _plot(
                picture,
                panel,
                (first, last),
                x=MARGIN + LEFT + column * pitch,
                y=HEAD + row * (PANEL_HEIGHT + PANEL_GAP) + 28,
                width=pitch - LEFT,
                from_zero=from_zero,
            )
            plot.draw_axes(
                panel.caption if not column else "", across="frame", up=panel.unit, whole=True
            )
            inside = [
                span for span in spans if span.last_frame >= first and span.first_frame <= last
            ]
            _shade(plot, inside)
            for curve in panel.curves:
                plot.draw_curve(frames, curve.values, curve.color)
            if not row:
                _name(plot, inside)
    return picture


def _plot(
    picture: ByteImage,
    panel: Panel,
    window: tuple[int, int],
    *,
    x: int,
    y: int,
    width: int,
    from_zero: bool,
) -> Plot:
    values = np.concatenate([curve.values for curve in panel.curves])
    values = values[np.isfinite(values)]
    low = 0.0 if from_zero else float(values.min())
    high = max(float(values.max()), low + 1e-6)
    room = 0.06 * (high - low)
    left, right = window[0] - 0.5, window[1] + 0.5
    bottom = low - (0.0 if from_zero else room)
    return Plot(picture, x, y, width, PANEL_HEIGHT, left, right, bottom, high + room)


def _shade(plot: Plot, spans: Sequence[FrameSpan]) -> None:
    for span in spans:
        left, width = _extent(plot, span)
        fill_box(plot.picture, left, plot.y + 1, width, plot.height - 2, _SPAN, cover=0.45)


def _name(plot: Plot, spans: Sequence[FrameSpan]) -> None:
    """Write what the spans are called, on a ground of their own: curves pass there."""
    for span in spans:
        left, width = _extent(plot, span)
        label = shortened(span.label, _SPAN_LABEL, max_width=max(width - 10, 60))
        ground = text_width(label, _SPAN_LABEL) + 10
        fill_box(plot.picture, left, plot.y + 1, ground, _SPAN_LABEL.size + 8, _SPAN, cover=0.9)
        draw_text(plot.picture, label, x=left + 5, y=plot.y + 4, style=_SPAN_LABEL)


def _extent(plot: Plot, span: FrameSpan) -> tuple[int, int]:
    """Return where a span begins in a plot, and how wide it is [pixels]."""
    left = max(round(plot.column(span.first_frame - 0.5)), plot.x + 1)
    right = min(round(plot.column(span.last_frame + 0.5)), plot.x + plot.width - 1)
    return left, max(right - left, 2)


def _draw_legend(picture: ByteImage, curves: Sequence[Curve], *, y: int) -> None:
    x = MARGIN + LEFT
    for curve in curves:
        fill_box(picture, x, y + 8, 20, 4, curve.color)
        x += 28 + draw_text(picture, curve.label, x=x + 28, y=y, style=_NOTE) + 30
