"""One picture from disk."""

from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813  # the name all its users know it by

from usdface.errors import InputError
from usdface.media.color import ByteImage

MOST_VALUES = 1 << 29
"""Of one picture, all channels: 16,384 by 8,192 pixels of four."""


def read_picture(path: Path) -> ByteImage:
    """Read a picture as (height, width, 3) bytes.

    Raises
    ------
    InputError
        If it cannot be read, or is too large to be shown.
    """
    buffer = oiio.ImageBuf(str(path))
    if buffer.has_error:
        raise InputError(f"{path}: cannot be read as a picture ({buffer.geterror()})")
    size = buffer.spec()
    if size.width * size.height * size.nchannels > MOST_VALUES:
        raise InputError(
            f"{path}: {size.width} × {size.height} with {size.nchannels} channels is too large to "
            "be shown; write it smaller"
        )
    pixels = buffer.get_pixels("uint8")
    if pixels is None or pixels.ndim != 3:
        raise InputError(f"{path}: cannot be read as a picture")
    channels = pixels[..., :3] if pixels.shape[2] >= 3 else np.repeat(pixels[..., :1], 3, axis=2)
    return np.ascontiguousarray(channels)
