"""Tiles of a sheet: pictures scaled to fit, and empty tiles."""

import numpy as np
from PIL import Image

from usdface.core.arrays import ByteImage
from usdface.core.errors import InputError
from usdface.media.picture.canvas import new_picture
from usdface.media.picture.color import DIM, PANEL, Color
from usdface.media.picture.text import TextStyle, draw_text

_HATCH: Color = (37, 39, 44)


def fit_picture(
    picture: ByteImage, *, width: int, height: int, color: Color = (16, 17, 19)
) -> ByteImage:
    """Scale a picture to fit a box, with bars if the aspects differ.

    Parameters
    ----------
    picture : (h, w, 3) uint8 array
    width, height : int
        Of the box [pixels].
    color : tuple of int
        Of the bars.

    Returns
    -------
    (height, width, 3) uint8 array
    """
    given = np.asarray(picture)
    if given.dtype != np.uint8 or given.ndim != 3 or given.shape[2] != 3 or not given.size:
        raise InputError(f"a tile is (height, width, 3) uint8, got {given.shape} {given.dtype}")
    if given.shape[:2] == (height, width):
        return given
    scale = min(width / given.shape[1], height / given.shape[0])
    inner_width = min(max(round(given.shape[1] * scale), 1), width)
    inner_height = min(max(round(given.shape[0] * scale), 1), height)
    box = new_picture(width, height, color)
    left, top = (width - inner_width) // 2, (height - inner_height) // 2
    box[top : top + inner_height, left : left + inner_width] = scale_picture(
        given, inner_width, inner_height
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
