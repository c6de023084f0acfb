"""Errors over a whole take as coloured columns, with the frames of a sheet marked."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import ByteImage, FloatArray
from usdface.media.picture.canvas import Color, fill_box
from usdface.media.picture.color import bytes_from_linear, heat_ramp
from usdface.media.picture.text import TextStyle, draw_text, text_width

LANE_HEIGHT = 52
_GAP = 6
_LABEL_WIDTH = 112
_MARK_HEIGHT = 26
_AXIS_HEIGHT = 30

_LANE: Color = (33, 35, 39)
_MARK: Color = (236, 238, 242)
_LABEL = TextStyle(size=18, color=(196, 200, 206))
_NUMBER = TextStyle(size=16, color=(236, 238, 242), weight="mono")
_AXIS = TextStyle(size=15, color=(132, 137, 146), weight="mono")


@dataclass(frozen=True)
class ErrorCurve:
    """One method's error on every frame of a take.

    Attributes
    ----------
    label : str
    values : (frames,) float array
        NaN where there is none.
    high, unit : float, str or None
        Of a figure that is no error, such as a doubt of 0 to 1; as the sheet's errors by default.
    """

    label: str
    values: FloatArray
    high: float | None = None
    unit: str | None = None


def strip_height(curve_count: int) -> int:
    """Return how much room the strips take [pixels]."""
    return _MARK_HEIGHT + curve_count * (LANE_HEIGHT + _GAP) + _AXIS_HEIGHT


def draw_error_strip(
    page: ByteImage,
    curves: Sequence[ErrorCurve],
    *,
    x: int,
    y: int,
    width: int,
    first_frame: int,
    high: float,
    marks: Sequence[tuple[int, str]] = (),
    unit: str = "mm",
) -> None:
    """Draw one lane per curve above a frame axis.

    A column shows the largest error of the frames it stands for, so that no peak is lost.

    Parameters
    ----------
    page : (height, width, 3) uint8 array
        Changed in place.
    curves : sequence of ErrorCurve
    x, y, width : int
        Upper left corner and width [pixels].
    first_frame : int
        Frame number of each curve's first value.
    high : float
        Error at the top of a lane, in the ramp's last colour.
    marks : sequence of (frame, label)
        Frames to mark.
    unit : str
    """
    left, inner = x + _LABEL_WIDTH, width - _LABEL_WIDTH
    count = max((len(curve.values) for curve in curves), default=0)
    if not count or inner < 2:
        return
    top = y + _MARK_HEIGHT
    for row, curve in enumerate(curves):
        lane = top + row * (LANE_HEIGHT + _GAP)
        draw_text(page, curve.label, x=x, y=lane + 2, style=_LABEL, max_width=_LABEL_WIDTH - 10)
        finite = curve.values[np.isfinite(curve.values)]
        if len(finite):
            mean = f"{finite.mean():.2f} {unit if curve.unit is None else curve.unit}"
            draw_text(page, mean, x=x, y=lane + 26, style=_AXIS, max_width=_LABEL_WIDTH - 8)
        most = high if curve.high is None else curve.high
        _draw_lane(page, curve.values, left, lane, inner, count=count, high=most)

    bottom = top + len(curves) * (LANE_HEIGHT + _GAP) - _GAP
    taken = -(10**9)
    for frame, label in sorted(marks):
        at = left + int((frame - first_frame + 0.5) / count * inner)
        if not left <= at < left + inner:
            continue
        fill_box(page, at, top - 4, 1, bottom - top + 8, _MARK, cover=0.75)
        half = text_width(label, _NUMBER) // 2
        if at - half > taken + 3:
            draw_text(page, label, x=at, y=y + 2, style=_NUMBER, anchor="middle")
            taken = at + half
    draw_frame_axis(page, left, bottom + 4, inner, first_frame=first_frame, count=count)


def _draw_lane(
    page: ByteImage,
    values: FloatArray,
    left: int,
    top: int,
    width: int,
    *,
    count: int,
    high: float,
) -> None:
    fill_box(page, left, top, width, LANE_HEIGHT, _LANE)
    error = _column_maxima(values, width, count=count)
    known = np.isfinite(error)
    tall = np.where(known, np.clip(np.nan_to_num(error) / high, 0.03, 1) * LANE_HEIGHT, 0)
    colors = bytes_from_linear(heat_ramp(np.nan_to_num(error), high=high))
    depth = LANE_HEIGHT - np.arange(LANE_HEIGHT)[:, None]
    filled = depth <= np.round(tall)[None, :]
    area = page[top : top + LANE_HEIGHT, left : left + width]
    area[filled] = np.broadcast_to(colors, area.shape)[filled]


def _column_maxima(values: FloatArray, width: int, *, count: int) -> FloatArray:
    """Return the largest error of the frames under each column; NaN where all are unknown."""
    first = np.arange(width) * count // width
    last = np.maximum((np.arange(width) + 1) * count // width, first + 1)
    padded = np.full(count + 1, -np.inf)
    padded[: len(values)] = np.where(np.isfinite(values), values, -np.inf)
    bounds = np.stack([first, last], axis=1).ravel()
    maxima = np.maximum.reduceat(padded, bounds)[::2]
    return np.where(np.isfinite(maxima), maxima, np.nan)


def draw_frame_axis(
    page: ByteImage, left: int, top: int, width: int, *, first_frame: int, count: int
) -> None:
    """Write round frame numbers below the lanes."""
    wanted = max(width // 160, 1)
    raw = max(count / wanted, 1)
    magnitude = 10 ** int(np.floor(np.log10(raw)))
    step = next(m * magnitude for m in (1, 2, 5, 10) if m * magnitude >= raw)
    start = -(-first_frame // step) * step
    for frame in range(start, first_frame + count, step):
        at = left + int((frame - first_frame + 0.5) / count * width)
        fill_box(page, at, top, 1, 4, _AXIS.color)
        if at + 24 < left + width:
            draw_text(page, str(frame), x=at + 4, y=top, style=_AXIS)
