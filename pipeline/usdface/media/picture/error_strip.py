"""Strips of errors over a take as coloured columns, with marked frames."""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import ByteImage, FloatArray
from usdface.media.picture.canvas import fill_box
from usdface.media.picture.color import BRIGHT, DIM, LANE, SOFT, bytes_from_linear, heat_ramp
from usdface.media.picture.text import TextStyle, draw_text, text_width

LANE_HEIGHT = 52
LABEL_WIDTH = 180
_LANE_GAP = 6
_MARK_HEIGHT = 26
_AXIS_HEIGHT = 30

_LABEL_STYLE = TextStyle(size=18, color=SOFT)
_NUMBER_STYLE = TextStyle(size=16, color=BRIGHT, weight="mono")
_AXIS_STYLE = TextStyle(size=16, color=DIM, weight="mono")


@dataclass(frozen=True)
class ErrorCurve:
    """An error over the frames of a take."""

    label: str
    """Written to the left of its lane."""
    values: FloatArray
    """(frames,): NaN where unknown."""
    high: float | None = None
    """Error at the top of its lane; default: that of the strip."""
    unit: str | None = None
    """Default: that of the strip."""


@dataclass(frozen=True)
class ErrorStrip:
    """Lanes of curves above a frame axis."""

    curves: tuple[ErrorCurve, ...]
    """From the top."""
    first_frame: int
    """Frame number of each curve's first value."""
    high: float
    """Error at the top of a lane, in the ramp's last colour."""
    marks: tuple[tuple[int, str], ...] = ()
    """tuple of (frame, label): frames to mark."""
    unit: str = "mm"
    """Unit of curves that name none."""
    scale: float = 1.0
    """Scale of labels and lanes."""


def strip_height(curve_count: int, scale: float = 1.0) -> int:
    """Return the height of a strip [pixels]."""
    lanes = curve_count * round(scale * (LANE_HEIGHT + _LANE_GAP))
    return round(scale * _MARK_HEIGHT) + lanes + round(scale * _AXIS_HEIGHT)


def draw_error_strip(page: ByteImage, strip: ErrorStrip, *, x: int, y: int, width: int) -> None:
    """Draw a strip at its upper left corner; a column shows the largest error of its frames."""
    size = strip.scale
    left = x + round(size * LABEL_WIDTH)
    inner = width - round(size * LABEL_WIDTH)
    count = max((len(curve.values) for curve in strip.curves), default=0)
    if not count or inner < 2:
        return
    label_style, number_style, axis_style = (
        style.scaled(size) for style in (_LABEL_STYLE, _NUMBER_STYLE, _AXIS_STYLE)
    )
    top, step = y + round(size * _MARK_HEIGHT), round(size * (LANE_HEIGHT + _LANE_GAP))
    room = round(size * (LABEL_WIDTH - 8))
    for row, curve in enumerate(strip.curves):
        lane = top + row * step
        draw_text(page, curve.label, x=x, y=lane + 2, style=label_style, max_width=room)
        finite = curve.values[np.isfinite(curve.values)]
        if len(finite):
            unit = curve.unit or strip.unit
            mean = f"{finite.mean():.0f}%" if unit == "%" else f"{finite.mean():.2f} {unit}"
            below = lane + round(size * 26)
            draw_text(page, mean, x=x, y=below, style=axis_style, max_width=room)
        area = page[lane : lane + round(size * LANE_HEIGHT), left : left + inner]
        _draw_lane(area, curve.values, count, curve.high or strip.high)
    bottom = top + len(strip.curves) * step - round(size * _LANE_GAP)
    last_end = -(10**9)
    for frame, label in sorted(strip.marks):
        at = left + int((frame - strip.first_frame + 0.5) / count * inner)
        if not left <= at < left + inner:
            continue
        fill_box(page, at, top - 4, 1, bottom - top + 8, BRIGHT, cover=0.75)
        half = text_width(label, number_style) // 2
        if at - half > last_end + 3:
            draw_text(page, label, x=at, y=y + 2, style=number_style, anchor="middle")
            last_end = at + half
    _draw_frame_axis(
        page, left, bottom + 4, inner, first_frame=strip.first_frame, count=count, scale=size
    )


def _draw_lane(area: ByteImage, values: FloatArray, count: int, high: float) -> None:
    height, width = area.shape[:2]
    area[:] = LANE
    # The largest error of the frames of each column; not finite if all are unknown.
    first = np.arange(width) * count // width
    last = np.maximum((np.arange(width) + 1) * count // width, first + 1)
    padded = np.full(count + 1, -np.inf)
    padded[: len(values)] = np.where(np.isfinite(values), values, -np.inf)
    bounds = np.stack([first, last], axis=1).ravel()
    maxima = np.maximum.reduceat(padded, bounds)[::2]
    known = np.isfinite(maxima)
    error = np.where(known, maxima, 0.0)
    tall = np.where(known, np.clip(error / high, 0.03, 1) * height, 0)
    colors = bytes_from_linear(heat_ramp(error, high=high))
    depth = height - np.arange(height)[:, None]
    filled = depth <= np.round(tall)[None, :]
    area[filled] = np.broadcast_to(colors, area.shape)[filled]


def _draw_frame_axis(
    page: ByteImage,
    left: int,
    top: int,
    width: int,
    *,
    first_frame: int,
    count: int,
    scale: float,
) -> None:
    """Draw ticks at round frame numbers."""
    style = _AXIS_STYLE.scaled(scale)
    wanted = max(round(width / (160 * scale)), 1)
    raw = max(count / wanted, 1)
    magnitude = 10 ** int(np.floor(np.log10(raw)))
    step = next(m * magnitude for m in (1, 2, 5, 10) if m * magnitude >= raw)
    start = -(-first_frame // step) * step
    for frame in range(start, first_frame + count, step):
        at = left + int((frame - first_frame + 0.5) / count * width)
        fill_box(page, at, top, 1, 4, DIM)
        if at + 24 * scale < left + width:
            draw_text(page, str(frame), x=at + 4, y=top, style=style)
