"""One picture from disk."""

from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio  # noqa: N813  # the name all its users know it by

from usdface.core.arrays import ByteImage
from usdface.core.errors import InputError

MOST_VALUES = 1 << 29
"""Of one picture, all channels: 16,384 by 8,192 pixels of four."""


def read_picture(path: Path) -> ByteImage:
    """Read a picture as (height, width, 3) bytes.

    Raises
    ------
    InputError
        If it cannot be read, is damaged, or is too large to be shown.
    """
    buffer = oiio.ImageBuf(str(path))
    if buffer.has_error:
        raise InputError(f"{path}: cannot be read as a picture ({reason_of(buffer)})")
    size = buffer.spec()
    if size.width * size.height * size.nchannels > MOST_VALUES:
        raise InputError(
            f"{path}: {size.width} × {size.height} with {size.nchannels} channels is too large to "
            "be shown; write it smaller"
        )
    pixels = buffer.get_pixels("uint8")
    if buffer.has_error or pixels is None or pixels.ndim != 3:  # what is missing would be black
        raise InputError(
            f"{path}: cannot be read as a picture ({reason_of(buffer)}): it may be cut short or "
            "damaged; copy or write it again"
        )
    channels = pixels[..., :3] if pixels.shape[2] >= 3 else np.repeat(pixels[..., :1], 3, axis=2)
    return np.ascontiguousarray(channels)


def reason_of(source: Any) -> str:
    """Return why OpenImageIO failed, which may quote a broken file's bytes.

    Asking is also what keeps the library from printing it.
    """
    try:
        said = str(source.geterror())
    except UnicodeDecodeError:
        return "its header holds bytes that are no text"
    return " ".join("".join(each if each.isprintable() else " " for each in said).split())
