"""A performance's errors as one picture: over time by region, between the lips, shape by shape."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import ByteImage, FloatArray
from usdface.core.errors import InputError
from usdface.media.charts.plot import Plot
from usdface.media.picture.canvas import Color, fill_box, new_picture
from usdface.media.picture.color import bytes_from_linear, heat_ramp
from usdface.media.picture.error_strip import ErrorCurve, draw_error_strip, strip_height
from usdface.media.picture.palette import FIRST, PAGE, SECOND
from usdface.media.picture.sheet import draw_header, draw_legend, round_range
from usdface.media.picture.text import TextStyle, draw_text

WIDTH = 1800
MARGIN = 36
HEAD = 112
LEGEND = 44
LIPS_HEIGHT = 180
ROW = 24
COLUMNS = 3
MOST_SHAPES = 90

_LANE: Color = (33, 35, 39)
_BIAS: Color = (244, 245, 247)
_HEAD = TextStyle(size=18, color=(222, 224, 228), weight="bold")
_NAME = TextStyle(size=14, color=(196, 200, 206))
_NUMBER = TextStyle(size=13, color=(196, 200, 206), weight="mono")
_NOTE = TextStyle(size=14, color=(152, 157, 166))


@dataclass(frozen=True)
class ShapeBar:
    """One shape's error.

    Attributes
    ----------
    name : str
    rmse, bias : float
        Root mean square and mean error of its weight.
    surface_mm : float
        What that error alone does to the surface, root mean square [mm].
    """

    name: str
    rmse: float
    bias: float
    surface_mm: float


@dataclass(frozen=True)
class EvaluationPage:
    """What the picture shows.

    Attributes
    ----------
    title : str
    facts : tuple of str
    curves : tuple of ErrorCurve
        The whole face first, then its regions [mm].
    first_frame : int
        Frame number of each curve's first value.
    worst : tuple of int
        Frames to mark.
    lips_truth, lips_solved : (frames,) float array or None
        The distance between the lips [mm]; NaN at frames that were not compared.
    shapes : tuple of ShapeBar
        In the order to show.
    """

    title: str
    facts: tuple[str, ...]
    curves: tuple[ErrorCurve, ...]
    first_frame: int
    worst: tuple[int, ...] = ()
    lips_truth: FloatArray | None = None
    lips_solved: FloatArray | None = None
    shapes: tuple[ShapeBar, ...] = ()


def draw_evaluation(page: EvaluationPage) -> ByteImage:
    """Draw the picture: (height, width, 3) uint8 array, sRGB.

    Raises
    ------
    InputError
        If there is no curve.
    """
    if not page.curves:
        raise InputError(f"{page.title}: no error curve to draw")
    shown = page.shapes[:MOST_SHAPES]
    rows = -(-len(shown) // COLUMNS)
    lips = page.lips_truth is not None and page.lips_solved is not None
    height = HEAD + strip_height(len(page.curves)) + LEGEND + MARGIN
    height += (LIPS_HEIGHT + 100 if lips else 0) + (rows * ROW + 70 if rows else 0)
    picture = new_picture(WIDTH, height, PAGE)
    inner = WIDTH - 2 * MARGIN
    high = round_range(np.concatenate([curve.values for curve in page.curves]))
    y = draw_header(picture, page.title, page.facts, x=MARGIN, y=MARGIN - 8, width=inner)
    draw_error_strip(
        picture,
        page.curves,
        x=MARGIN,
        y=y,
        width=inner,
        first_frame=page.first_frame,
        high=high,
        marks=[(frame, str(frame)) for frame in page.worst],
    )
    y += strip_height(len(page.curves))
    note = "RMS distance of the surface from what it should be; numbers mark the worst frames"
    draw_legend(picture, (note,), x=MARGIN, y=y, width=inner, high=high, unit="mm")
    y += LEGEND
    if page.lips_truth is not None and page.lips_solved is not None:
        _draw_lips(picture, page.lips_truth, page.lips_solved, page.first_frame, y=y)
        y += LIPS_HEIGHT + 100
    if shown:
        _draw_shapes(picture, shown, y=y, hidden=len(page.shapes) - len(shown))
    return picture


def _draw_lips(
    picture: ByteImage, truth: FloatArray, solved: FloatArray, first_frame: int, *, y: int
) -> None:
    """Draw both distances over the frames: where the orange lies above, the mouth stays open."""
    frames = np.arange(first_frame, first_frame + len(truth), dtype=np.float64)
    both = np.concatenate([truth, solved])
    both = both[np.isfinite(both)]
    low, top = min(float(both.min()), 0.0), max(float(both.max()), 1.0)
    plot = Plot(
        picture,
        MARGIN + 112,
        y + 28,
        WIDTH - 2 * MARGIN - 112,
        LIPS_HEIGHT,
        float(first_frame) - 0.5,
        float(first_frame + len(truth)) - 0.5,
        low - 0.05 * (top - low),
        top + 0.05 * (top - low),
    )
    plot.draw_axes("distance of the lips", across="frame", up="mm", whole=True)
    plot.draw_curve(frames, truth, FIRST)
    plot.draw_curve(frames, solved, SECOND)
    x = plot.x + 330
    for label, color in (("as it should be", FIRST), ("this performance", SECOND)):
        fill_box(picture, x, y + 10, 18, 4, color)
        x += 26 + draw_text(picture, label, x=x + 26, y=y + 2, style=_NOTE) + 28


def _draw_shapes(picture: ByteImage, shapes: Sequence[ShapeBar], *, y: int, hidden: int) -> None:
    draw_text(picture, "shape by shape", x=MARGIN, y=y, style=_HEAD)
    note = "bar: error of the weight; colour: what it does to the surface; tick: its mean error"
    if hidden:
        note += f"; {hidden} more shapes err less"
    draw_text(picture, note, x=MARGIN + 160, y=y + 3, style=_NOTE)
    y += 36
    rows = -(-len(shapes) // COLUMNS)
    column_width = (WIDTH - 2 * MARGIN) // COLUMNS
    left, right = 170, 150
    length = column_width - left - right
    longest = max(max(shape.rmse for shape in shapes), 1e-9)
    high = max(max(shape.surface_mm for shape in shapes), 1e-9)
    colors = bytes_from_linear(heat_ramp([shape.surface_mm for shape in shapes], high=high))
    for number, shape in enumerate(shapes):
        x = MARGIN + number // rows * column_width
        top = y + number % rows * ROW
        draw_text(picture, shape.name, x=x, y=top, style=_NAME, max_width=left - 10)
        fill_box(picture, x + left, top + 3, length, ROW - 10, _LANE)
        size = round(shape.rmse / longest * length)
        red, green, blue = (int(value) for value in colors[number])
        fill_box(picture, x + left, top + 3, max(size, 1), ROW - 10, (red, green, blue))
        tick = round(min(abs(shape.bias) / longest, 1.0) * length)
        fill_box(picture, x + left + tick, top + 1, 2, ROW - 6, _BIAS)
        told = f"{shape.rmse:.3f} {shape.bias:+.3f}"
        draw_text(picture, told, x=x + left + length + 8, y=top + 1, style=_NUMBER)
