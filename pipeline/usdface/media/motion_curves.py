"""Curves of controls before and after, and of errors of several methods: sheets to judge motion."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from usdface.assets import FloatArray
from usdface.errors import InputError
from usdface.media.canvas import Color, fill_box, new_picture
from usdface.media.color import ByteImage
from usdface.media.plot import Plot
from usdface.media.sheet import draw_header
from usdface.media.text import TextStyle, draw_text

WIDTH = 1800
MARGIN = 36
HEAD = 150
PANEL_HEIGHT = 170
PANEL_GAP = 74
LEFT = 76

_PAGE: Color = (22, 23, 26)
_BEFORE: Color = (120, 140, 166)
_AFTER: Color = (255, 178, 92)
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
class Span:
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
    """Return a panel for each of the controls that change most, each over its own range.

    Parameters
    ----------
    names : sequence of str
    before, after : (frames, controls) float arrays
    count : int
    """
    span = np.maximum(np.ptp(before, axis=0), np.ptp(after, axis=0))
    change = np.abs(after - before).max(axis=0)
    # Weights are judged by what they do, angles and lengths by their own span.
    order = np.argsort(-np.minimum(change, change / np.maximum(span, 1e-9)), kind="stable")
    chosen = [int(index) for index in order[:count] if change[index] > 1e-6]
    return tuple(
        Panel(
            names[index],
            "",
            (
                Curve("before", before[:, index], _BEFORE),
                Curve("after", after[:, index], _AFTER),
            ),
        )
        for index in chosen
    )


def draw_motion_curves(
    title: str,
    facts: tuple[str, ...],
    panels: Sequence[Panel],
    *,
    first_frame: int,
    spans: Sequence[Span] = (),
    from_zero: bool = False,
) -> ByteImage:
    """Draw panels below each other: (height, width, 3) uint8 array, sRGB.

    Parameters
    ----------
    title : str
    facts : tuple of str
    panels : sequence of Panel
    first_frame : int
        Frame number of each curve's first value.
    spans : sequence of Span
        Shaded in every panel, named in the first.
    from_zero : bool
        Let every panel start at 0: for errors.

    Raises
    ------
    InputError
        If there is no panel.
    """
    if not panels:
        raise InputError(f"{title}: nothing changes, so there is no curve to draw")
    height = HEAD + len(panels) * (PANEL_HEIGHT + PANEL_GAP) + MARGIN
    picture = new_picture(WIDTH, height, _PAGE)
    y = draw_header(picture, title, facts, x=MARGIN, y=MARGIN - 8, width=WIDTH - 2 * MARGIN)
    _draw_legend(picture, panels[0].curves, y=y + 2)
    for number, panel in enumerate(panels):
        top = HEAD + number * (PANEL_HEIGHT + PANEL_GAP)
        _draw_panel(picture, panel, first_frame, spans, top, from_zero, number)
    return picture


def _draw_panel(
    picture: ByteImage,
    panel: Panel,
    first_frame: int,
    spans: Sequence[Span],
    top: int,
    from_zero: bool,
    number: int,
) -> None:
    values = np.concatenate([curve.values for curve in panel.curves])
    values = values[np.isfinite(values)]
    low = 0.0 if from_zero else float(values.min())
    high = max(float(values.max()), low + 1e-6)
    room = 0.06 * (high - low)
    count = len(panel.curves[0].values)
    plot = Plot(
        picture,
        MARGIN + LEFT,
        top + 28,
        WIDTH - 2 * MARGIN - LEFT,
        PANEL_HEIGHT,
        float(first_frame) - 0.5,
        float(first_frame + count) - 0.5,
        low - (0.0 if from_zero else room),
        high + room,
    )
    plot.draw_axes(panel.caption, across="frame", up=panel.unit)
    for span in spans:
        left, right = plot.column(span.first_frame - 0.5), plot.column(span.last_frame + 0.5)
        x, width = round(left), max(round(right - left), 2)
        fill_box(picture, x, plot.y + 1, width, plot.height - 2, _SPAN, cover=0.45)
        if not number:
            draw_text(picture, span.label, x=x + 5, y=plot.y + 4, style=_SPAN_LABEL, max_width=160)
    frames = np.arange(first_frame, first_frame + count, dtype=np.float64)
    for curve in panel.curves:
        plot.draw_curve(frames, curve.values, curve.color)


def _draw_legend(picture: ByteImage, curves: Sequence[Curve], *, y: int) -> None:
    x = MARGIN + LEFT
    for curve in curves:
        fill_box(picture, x, y + 8, 20, 4, curve.color)
        x += 28 + draw_text(picture, curve.label, x=x + 28, y=y, style=_NOTE) + 30
