"""Drawing of boxes, antialiased dots and lines, spacing of labels, and tiles of sheets."""

import numpy as np
from numpy.typing import ArrayLike
from PIL import Image

from usdface.core.arrays import ByteImage, Float32Array, FloatArray
from usdface.media.picture.color import DIM, PANEL, Color, mix_color
from usdface.media.picture.text import TextStyle, draw_text


def new_picture(width: int, height: int, color: Color) -> ByteImage:
    """Return a picture of one colour."""
    row = np.full((1, width, 3), color, np.uint8)
    return np.repeat(row, height, axis=0)  # faster than one fill


def fill_box(
    picture: ByteImage, x: int, y: int, width: int, height: int, color: Color, *, cover: float = 1.0
) -> None:
    """Fill a rectangle in place, clipped to the picture; `cover` is the opacity."""
    rows, columns = slice(max(y, 0), max(y + height, 0)), slice(max(x, 0), max(x + width, 0))
    mix_color(picture[rows, columns], cover, color)


def outline_box(picture: ByteImage, x: int, y: int, width: int, height: int, color: Color) -> None:
    """Draw the one-pixel border just inside a rectangle."""
    fill_box(picture, x, y, width, 1, color)
    fill_box(picture, x, y + height - 1, width, 1, color)
    fill_box(picture, x, y, 1, height, color)
    fill_box(picture, x + width - 1, y, 1, height, color)


def draw_dot(
    picture: ByteImage, x: float, y: float, radius: float, color: Color, *, hollow: bool = False
) -> None:
    """Draw a disc, or a ring a quarter of its radius thick, with subpixel position."""
    window, columns, rows = _window(picture, x - radius, y - radius, x + radius, y + radius)
    distance = np.hypot(columns - x, rows - y)
    cover = np.clip(radius + 0.5 - distance, 0, 1)
    if hollow:
        cover = np.minimum(cover, np.clip(distance - (radius * 0.75 - 1.0), 0, 1))
    mix_color(window, cover, color)


def draw_line(
    picture: ByteImage, start: ArrayLike, end: ArrayLike, color: Color, *, thickness: float = 1.5
) -> None:
    """Draw a straight line between two (x, y) with round ends."""
    (x0, y0), (x1, y1) = np.asarray(start, float), np.asarray(end, float)
    window, columns, rows = _window(
        picture,
        min(x0, x1) - thickness,
        min(y0, y1) - thickness,
        max(x0, x1) + thickness,
        max(y0, y1) + thickness,
    )
    along = np.array([x1 - x0, y1 - y0])
    length = max(float(along @ along), 1e-9)
    at = np.clip(((columns - x0) * along[0] + (rows - y0) * along[1]) / length, 0, 1)
    distance = np.hypot(columns - x0 - at * along[0], rows - y0 - at * along[1])
    mix_color(window, np.clip(thickness / 2 + 0.5 - distance, 0, 1), color)


def space_rows(
    rows: FloatArray, *, spacing: float, height: float, margin: float = 0.0
) -> FloatArray:
    """Return rows of labels with a minimum spacing, nearest to the desired ones: (n,) [pixels].

    `rows`: the desired ones, (n,), ascending. `height`, `margin`: of the picture, and free space at
    its ends.
    """
    if not len(rows):
        return rows
    from scipy.optimize import isotonic_regression  # imported late: it takes half a second

    steps = spacing * np.arange(len(rows))
    first = isotonic_regression(np.clip(rows, margin, height - margin) - steps).x
    highest = height - margin - steps[-1]
    return np.asarray(np.clip(first, margin, max(highest, margin)) + steps)


def _window(
    picture: ByteImage, left: float, top: float, right: float, bottom: float
) -> tuple[ByteImage, Float32Array, Float32Array]:
    """Return a view of a rectangle of the picture, and the centres of its columns and rows."""
    height, width = picture.shape[:2]
    x0, x1 = (int(np.clip(v, 0, width)) for v in (np.floor(left) - 1, np.ceil(right) + 2))
    y0, y1 = (int(np.clip(v, 0, height)) for v in (np.floor(top) - 1, np.ceil(bottom) + 2))
    columns = np.arange(x0, x1, dtype=np.float32)[None, :] + np.float32(0.5)
    rows = np.arange(y0, y1, dtype=np.float32)[:, None] + np.float32(0.5)
    return picture[y0:y1, x0:x1], columns, rows


_HATCH: Color = (37, 39, 44)


def fit_picture(
    picture: ByteImage, *, width: int, height: int, color: Color = (16, 17, 19)
) -> ByteImage:
    """Scale a picture to fit a box of a width and height [pixels], with bars if aspects differ.

    `color`: of the bars.
    """
    if picture.shape[:2] == (height, width):
        return picture
    scale = min(width / picture.shape[1], height / picture.shape[0])
    inner_width = min(max(round(picture.shape[1] * scale), 1), width)
    inner_height = min(max(round(picture.shape[0] * scale), 1), height)
    box = new_picture(width, height, color)
    left, top = (width - inner_width) // 2, (height - inner_height) // 2
    box[top : top + inner_height, left : left + inner_width] = scale_picture(
        picture, inner_width, inner_height
    )
    return box


def empty_tile(width: int, height: int, message: str) -> ByteImage:
    """Return a hatched tile with a message."""
    rows, columns = np.mgrid[:height, :width]
    tile = new_picture(width, height, PANEL)
    tile[(rows + columns) % 12 < 3] = _HATCH
    style = TextStyle(size=16, color=DIM)
    draw_text(
        tile,
        message,
        x=width // 2,
        y=height // 2 - 10,
        style=style,
        anchor="middle",
        max_width=width - 16,
    )
    return tile


def scale_picture(picture: ByteImage, width: int, height: int) -> ByteImage:
    """Resample a picture with an antialiased three-lobed Lanczos filter."""
    if picture.shape[:2] == (height, width):
        return picture
    image = Image.fromarray(picture).resize((width, height), Image.Resampling.LANCZOS)
    return np.array(image)
