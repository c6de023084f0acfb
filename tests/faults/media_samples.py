"""Small sound files of every kind of movie, sound and picture that is read."""

import re
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import av
import numpy as np
import OpenImageIO as oiio  # noqa: N813

from usdface.media.picture.image import write_image

WIDTH, HEIGHT, PICTURES, RATE = 64, 48, 12, 24
SOUND_RATE = 16_000

MOVIES = {
    "h264.mp4": ("libx264", "mp4", "yuv420p"),
    "mpeg4.mp4": ("mpeg4", "mp4", "yuv420p"),
    "vp9.webm": ("libvpx-vp9", "webm", "yuv420p"),
    "mjpeg.avi": ("mjpeg", "avi", "yuvj444p"),
    "mjpeg.mov": ("mjpeg", "mov", "yuvj444p"),
    "prores.mov": ("prores_ks", "mov", "yuv422p10le"),
}
SOUNDS = {
    "a.wav": ("pcm_s16le", "wav"),
    "a.aiff": ("pcm_s16be", "aiff"),
    "a.flac": ("flac", "flac"),
    "a.m4a": ("aac", "mp4"),
    "a.ogg": ("libopus", "ogg"),
}
STILLS = ("f.0001.png", "f.0001.jpg", "f.0001.tif", "f.0001.exr", "f.0001.dpx")
EVERY = (*MOVIES, *SOUNDS, *STILLS)


def picture() -> np.ndarray:
    """Return noise: every byte of it counts."""
    return np.random.default_rng(0).integers(0, 255, (HEIGHT, WIDTH, 3), dtype=np.uint8)


def has_encoder(name: str) -> bool:
    """Whether a sample can be made here."""
    kinds = {**MOVIES, **SOUNDS}
    return name not in kinds or kinds[name][0] in av.codecs_available


def readers_of(name: str) -> tuple[str, ...]:
    """Return who reads such a file; see `media_reader.READERS`."""
    if name in MOVIES:
        return ("movie", "sound", "join")
    return ("sound",) if name in SOUNDS else ("picture", "metadata", "movie")


def write_sample(folder: Path, name: str) -> Path:
    """Write one of `EVERY` whole."""
    path = folder / name
    if name in MOVIES:
        _write_movie(path, *MOVIES[name])
    elif name in SOUNDS:
        _write_sound(path, *SOUNDS[name])
    elif name.endswith(".dpx"):
        buffer = oiio.ImageBuf(oiio.ImageSpec(WIDTH, HEIGHT, 3, "uint16"))
        oiio.ImageBufAlgo.fill(buffer, (0.2, 0.4, 0.6))
        buffer.write(str(path))
    else:
        write_image(path, picture(), metadata={"a": 1})
    return path


def _write_movie(path: Path, codec: str, container: str, pixels: str) -> None:
    with av.open(str(path), "w", format=container) as movie:
        stream = movie.add_stream(codec, rate=RATE)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, pixels
        for number in range(PICTURES):
            shown = av.VideoFrame.from_ndarray(np.roll(picture(), number, 0), format="rgb24")
            movie.mux(stream.encode(shown.reformat(format=pixels)))
        movie.mux(stream.encode(None))


def _write_sound(path: Path, codec: str, container: str) -> None:
    tone = (0.5 * np.sin(np.arange(SOUND_RATE // 2) / 20)).astype(np.float32)
    with av.open(str(path), "w", format=container) as sound:
        stream = sound.add_stream(codec, rate=SOUND_RATE, layout="mono")
        size = stream.codec_context.frame_size or 1024
        packer = av.AudioResampler(stream.format, "mono", SOUND_RATE, frame_size=size)
        frame = av.AudioFrame.from_ndarray(tone[None], format="fltp", layout="mono")
        frame.sample_rate = SOUND_RATE
        for block in (*packer.resample(frame), *packer.resample(None)):
            sound.mux(stream.encode(block))
        sound.mux(stream.encode(None))


Size = Callable[[bytes, int, int], bytes]
"""Put another width and height into a header."""


def _put(content: bytes, at: int, new: bytes) -> bytes:
    return content[:at] + new + content[at + len(new) :]


def size_jpeg(content: bytes, width: int, height: int) -> bytes:
    """Also those that a movie is made of."""
    for found in re.finditer(rb"\xff\xc0\x00\x11\x08", content):
        content = _put(content, found.end(), struct.pack(">HH", height, width))
    return content


def size_png(content: bytes, width: int, height: int) -> bytes:
    """With the check sum that the new header has."""
    at = content.find(b"IHDR")
    content = _put(content, at + 4, struct.pack(">II", width, height))
    return _put(content, at + 17, struct.pack(">I", zlib.crc32(content[at : at + 17])))


def size_exr(content: bytes, width: int, height: int) -> bytes:
    """Of both windows, whose last pixel they name."""
    for name in (b"dataWindow\0box2i\0", b"displayWindow\0box2i\0"):
        at = content.find(name) + len(name) + 4
        content = _put(content, at, struct.pack("<iiii", 0, 0, width - 1, height - 1))
    return content


def size_tiff(content: bytes, width: int, height: int) -> bytes:
    """In the directory's entries for both."""
    order = "<" if content[:2] == b"II" else ">"
    (start,) = struct.unpack_from(f"{order}I", content, 4)
    (count,) = struct.unpack_from(f"{order}H", content, start)
    for at in range(start + 2, start + 2 + 12 * count, 12):
        (tag,) = struct.unpack_from(f"{order}H", content, at)
        if tag in (256, 257):
            value = width if tag == 256 else height
            content = _put(content, at, struct.pack(f"{order}HHII", tag, 4, 1, value))
    return content


def size_dpx(content: bytes, width: int, height: int) -> bytes:
    """In the order of bytes that its magic number tells."""
    order = ">" if content[:4] == b"SDPX" else "<"
    return _put(content, 772, struct.pack(f"{order}II", width, height))


def size_quicktime(content: bytes, width: int, height: int) -> bytes:
    """In the description of its samples."""
    table = content.find(b"stsd")
    found = re.compile(rb"avc1|mp4v|jpeg|ap[chn]{2}").search(content, table)
    assert found is not None
    return _put(content, found.start() + 28, struct.pack(">HH", width, height))


WAV_FIELDS = {"channels": (22, "<H"), "rate": (24, "<I"), "align": (32, "<H"), "bits": (34, "<H")}


def change_wav(content: bytes, **fields: int) -> bytes:
    """Put other numbers into a WAV file's header; `data` is the length it claims."""
    for name, value in fields.items():
        if name == "data":
            content = _put(content, content.find(b"data") + 4, struct.pack("<I", value))
        else:
            at, kind = WAV_FIELDS[name]
            content = _put(content, at, struct.pack(kind, value))
    return content
