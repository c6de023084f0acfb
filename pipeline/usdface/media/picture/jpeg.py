"""Pictures as JPEG in memory, for pages."""

from fractions import Fraction

import av
import numpy as np

from usdface.core.arrays import ByteImage

QUALITY = 3
"""Of the encoder's scale, 2 the best and 31 the worst."""


def encode_jpeg(pixels: ByteImage, *, max_height: int = 1080) -> bytes:
    """Encode a picture.

    Parameters
    ----------
    pixels : (height, width, 3) uint8 array
        sRGB.
    max_height : int
        Taller pictures are made smaller.

    Returns
    -------
    bytes
    """
    height, width = pixels.shape[:2]
    scale = min(max_height / height, 1.0)
    codec = av.CodecContext.create("mjpeg", "w")
    codec.width, codec.height = max(round(width * scale), 1), max(round(height * scale), 1)
    codec.pix_fmt = "yuvj444p"
    codec.time_base = Fraction(1, 25)
    codec.qmin = codec.qmax = QUALITY
    frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(pixels), format="rgb24")
    frame = frame.reformat(
        codec.width,
        codec.height,
        "yuvj444p",
        dst_colorspace="ITU601",
        dst_color_range="JPEG",
    )
    return b"".join(bytes(packet) for packet in (*codec.encode(frame), *codec.encode(None)))
