"""Fit any picture into the box a sheet has for it, or say that there is none."""

from functools import lru_cache

import numpy as np
from scipy import sparse

from usdface.core.arrays import ByteImage
from usdface.core.errors import InputError
from usdface.media.face.mesh_topology import Sparse
from usdface.media.picture.canvas import Color, new_picture
from usdface.media.picture.text import TextStyle, draw_text

_EMPTY: Color = (31, 33, 37)
_HATCH: Color = (37, 39, 44)


def fit_picture(
    picture: ByteImage, *, width: int, height: int, color: Color = (16, 17, 19)
) -> ByteImage:
    """Scale a picture to fit a box as a whole, with bars where shapes differ.

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

    Raises
    ------
    InputError
        If the picture is not made of bytes or is empty.
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
    box[top : top + inner_height, left : left + inner_width] = _scaled(
        given, inner_width, inner_height
    )
    return box


def empty_tile(width: int, height: int, message: str) -> ByteImage:
    """Return a hatched tile that says why there is nothing in it."""
    rows, columns = np.mgrid[:height, :width]
    tile = new_picture(width, height, _EMPTY)
    tile[(rows + columns) % 12 < 3] = _HATCH
    style = TextStyle(size=15, color=(150, 154, 162))
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


def _scaled(picture: ByteImage, width: int, height: int) -> ByteImage:
    """Resample rows, then columns; OpenImageIO's resize takes ten times as long for a tile."""
    if picture.shape[:2] == (height, width):
        return picture
    rows, columns, _ = picture.shape
    down = _lanczos(rows, height) @ picture.reshape(rows, -1).astype(np.float32)
    turned = down.reshape(height, columns, 3).transpose(1, 0, 2).reshape(columns, -1)
    across = (_lanczos(columns, width) @ turned).reshape(width, height, 3).transpose(1, 0, 2)
    return np.asarray(np.clip(across + 0.5, 0, 255), np.uint8)


@lru_cache(maxsize=32)
def _lanczos(given: int, wanted: int) -> Sparse:
    """Return the (wanted, given) weights of a three-lobed Lanczos filter, wide enough to shrink."""
    scale = max(given / wanted, 1.0)
    centers = (np.arange(wanted) + 0.5) * given / wanted
    reach = int(np.ceil(3 * scale))
    taps = np.floor(centers).astype(np.int64)[:, None] + np.arange(-reach, reach + 1)
    distance = (taps + 0.5 - centers[:, None]) / scale
    weights = np.where(np.abs(distance) < 3, np.sinc(distance) * np.sinc(distance / 3), 0.0)
    weights /= weights.sum(axis=1, keepdims=True)
    rows = np.broadcast_to(np.arange(wanted)[:, None], taps.shape)
    inside = np.clip(taps, 0, given - 1)
    return sparse.csr_array(
        (weights.ravel().astype(np.float32), (rows.ravel(), inside.ravel())), shape=(wanted, given)
    )
