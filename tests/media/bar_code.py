"""Pictures that carry their own number, and movies of them: what a reader must give back."""

from fractions import Fraction
from pathlib import Path

import av
import numpy as np

WIDTH, HEIGHT, BITS = 320, 180, 10


def draw_number(number: int) -> np.ndarray:
    picture = np.full((HEIGHT, WIDTH, 3), 60, np.uint8)
    picture[:, : WIDTH // 2, 0] = 90
    for bit in range(BITS):
        if number >> bit & 1:
            picture[20:60, 10 + 30 * bit : 30 + 30 * bit] = 255
    return picture


def read_number(picture: np.ndarray) -> int:
    return sum(int(picture[40, 20 + 30 * bit].mean() > 150) << bit for bit in range(BITS))


def write_numbered(
    path: Path, stamps: list[int], *, base: Fraction, rate: Fraction, movflags: str = ""
) -> None:
    """Long groups of pictures and B-frames: the case that seeking by rate gets wrong."""
    with av.open(str(path), "w", options={"movflags": movflags} if movflags else {}) as container:
        options = {"g": "60", "bf": "2", "preset": "ultrafast"}
        stream = container.add_stream("libx264", rate=rate, options=options)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        stream.codec_context.time_base = base
        for number, stamp in enumerate(stamps):
            frame = av.VideoFrame.from_ndarray(draw_number(number), format="rgb24")
            frame.pts, frame.time_base = stamp, base
            container.mux(stream.encode(frame))
        container.mux(stream.encode())


def turn_in_header(path: Path) -> None:
    """Patch the track's display matrix, as a phone held upright writes it: 90 degrees clockwise."""
    data = bytearray(path.read_bytes())
    # tkhd version 0: 4 size, 4 name, 4 flags, 5 × 4 times and id, 8 reserved, 8 layer … volume.
    at = data.index(b"tkhd") + 4 + 40
    one, unit = 1 << 16, 1 << 30
    matrix = [0, one, 0, -one, 0, 0, HEIGHT << 16, 0, unit]
    data[at : at + 36] = b"".join(v.to_bytes(4, "big", signed=True) for v in matrix)
    path.write_bytes(bytes(data))
