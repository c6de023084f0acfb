"""Writing of review movies: every frame a key frame, tagged colours, timecode."""

from collections.abc import Iterable, Iterator, Mapping
from fractions import Fraction
from itertools import chain
from pathlib import Path
from typing import Any

import av
import av.error
import numpy as np

from usdface.core.arrays import ByteImage, Float32Array
from usdface.core.errors import InputError
from usdface.core.replacing import replacing
from usdface.media.film.containers import metadata_of, open_media

_H264 = ("libx264", "libopenh264", "h264_videotoolbox", "h264_mf")
_OPTIONS = {
    # With a fixed quantiser, a picture does not depend on the chunk in which it is encoded.
    "libx264": {"qp": "19", "preset": "veryfast", "g": "1"},
    "libopenh264": {"g": "1", "b": "20M"},
    "libvpx-vp9": {"crf": "24", "b": "0", "cpu-used": "6", "row-mt": "1", "g": "1"},
    # Common to all encoders.
    "other": {"g": "1"},
}
MOVIE_FORMATS = {".mp4": "mp4", ".mov": "mov", ".mkv": "matroska", ".webm": "webm"}
_PROXY_OPTIONS = {
    # Without B-frames, a page seeks exactly.
    "libx264": {"crf": "26", "preset": "veryfast", "g": "15", "bf": "0"},
    "libvpx-vp9": {"crf": "34", "b": "0", "cpu-used": "6", "row-mt": "1", "g": "15"},
    "other": {"g": "15"},
}
_BT709_CODE = 1
_ENCODER_THREADS = 4
"""Fixed, because the encoded bytes depend on it; the default is one per core."""
SAMPLE_RATE = 48_000
"""[samples per second] Of the sound of movies."""
_AAC_BLOCK = 1024
"""Samples per AAC frame."""


def write_movie(
    path: Path,
    frames: Iterable[ByteImage],
    *,
    rate: Fraction,
    audio: Float32Array | None = None,
    proxy: bool = False,
) -> None:
    """Encode pictures and optional sound into a movie that replaces `path` atomically.

    H.264 if an encoder is available, else VP9. Pictures are padded to even sizes. `InputError` if
    the extension is unknown, there is no frame, sizes differ or the folder cannot be written; an
    existing file is then unchanged.

    Parameters
    ----------
    path : Path
        ``.mp4``, ``.mov``, ``.mkv`` or ``.webm``.
    frames : iterable of (height, width, 3) uint8 array
        sRGB, all of one size. Consumed one by one, so that a generator saves memory.
    rate : Fraction
        Frames per second.
    audio : (samples,) float array, optional
        Mono [-1 to 1] at `SAMPLE_RATE`, starting at the first frame.
    proxy : bool
        A third of the size, for a page: every fifteenth picture is a key frame, and a repeated
        array is not encoded again.
    """
    container_format = movie_format(path)
    pictures = iter(frames)
    first = next(pictures, None)
    if first is None:
        raise InputError(f"{path}: there is no frame to write; check the frame range")
    with replacing(path) as temporary:
        try:
            with av.open(str(temporary), "w", format=container_format) as container:
                _encode(
                    container,
                    _same_size(path, first, chain([first], pictures)),
                    size=(first.shape[0], first.shape[1]),
                    rate=Fraction(rate),
                    audio=audio,
                    proxy=proxy,
                )
        except (av.error.FFmpegError, OSError) as error:
            raise InputError(f"{path}: the movie cannot be encoded ({error})") from error


def movie_format(file: Path) -> str:
    """Return the container format for a movie's extension."""
    found = MOVIE_FORMATS.get(file.suffix.lower())
    if found is None:
        raise InputError(f"{file}: movies end in {', '.join(MOVIE_FORMATS)}; rename it")
    return found


def read_movie_comment(file: Path) -> str:
    """Return the comment that `join_movies` stored; empty if there is none."""
    with open_media(file) as container:
        return metadata_of(container).get("comment", "")


def video_encoder(container_format: str) -> str:
    """Return the encoder available for a container; raise `InputError` without H.264 and VP9."""
    names = ("libvpx-vp9",) if container_format == "webm" else (*_H264, "libvpx-vp9")
    for name in names:
        if name in av.codecs_available:
            return name
    raise InputError(f"PyAV here has none of {', '.join(names)}; install the av wheel from PyPI")


def _encode(
    container: Any,
    pictures: Iterator[ByteImage],
    *,
    size: tuple[int, int],
    rate: Fraction,
    audio: Float32Array | None,
    proxy: bool,
) -> None:
    encoder = video_encoder(container.format.name)
    options: Mapping[str, dict[str, str]] = _PROXY_OPTIONS if proxy else _OPTIONS
    video = container.add_stream(encoder, rate=rate, options=options.get(encoder, options["other"]))
    video.height, video.width = (each + each % 2 for each in size)
    video.pix_fmt = "yuv420p"
    context = video.codec_context
    context.time_base = 1 / rate
    context.thread_count = _ENCODER_THREADS
    # Tagged as BT.709, so that players do not convert the sRGB colours.
    context.color_primaries = context.color_trc = context.colorspace = _BT709_CODE
    context.color_range = 1  # limited, as players expect
    sound = None if audio is None else SoundTrack(container, audio)
    for number, picture in _changes(pictures) if proxy else enumerate(pictures):
        frame = av.VideoFrame.from_ndarray(_padded(picture), format="rgb24")
        # Threads of the converter are started for each picture, which takes longer than converting.
        frame = frame.reformat(
            format="yuv420p", dst_colorspace="ITU709", dst_color_range="MPEG", threads=1
        )
        frame.pts, frame.time_base = number, 1 / rate
        container.mux(video.encode(frame))
        if sound is not None:
            sound.encode_until(Fraction(number + 1) / rate)
    container.mux(video.encode())
    if sound is not None:
        sound.finish()


def _changes(pictures: Iterator[ByteImage]) -> Iterator[tuple[int, ByteImage]]:
    """Yield numbered pictures that are not the same array as the one before, and the last one."""
    shown: ByteImage | None = None
    number, held = -1, False
    for number, picture in enumerate(pictures):
        held = picture is shown
        if not held:
            shown = picture
            yield number, picture
    if held and shown is not None:
        yield number, shown


def _padded(picture: ByteImage) -> ByteImage:
    """Return a picture of even size."""
    rows, columns = picture.shape[0] % 2, picture.shape[1] % 2
    if rows or columns:
        picture = np.pad(picture, ((0, rows), (0, columns), (0, 0)), mode="edge")
    return np.ascontiguousarray(picture)


def _same_size(file: Path, first: ByteImage, pictures: Iterable[ByteImage]) -> Iterator[ByteImage]:
    """Yield the pictures; refuse one of another size or type than the first."""
    for number, picture in enumerate(pictures):
        if picture.shape != first.shape or picture.dtype != np.uint8 or picture.ndim != 3:
            raise InputError(
                f"{file}: picture {number} is {picture.shape} {picture.dtype}, the first is "
                f"{first.shape} {first.dtype}; every one must be (height, width, 3) uint8"
            )
        yield picture


class SoundTrack:
    """An audio stream of a container.

    `samples`: (samples,), mono [-1 to 1] at `SAMPLE_RATE`, starting at the first picture.
    """

    def __init__(self, container: Any, samples: Float32Array) -> None:
        codec = "libopus" if container.format.name == "webm" else "aac"
        self._container = container
        self._stream = container.add_stream(codec, rate=SAMPLE_RATE, layout="mono")
        self._samples = samples
        self._done = 0

    def encode_until(self, seconds: Fraction) -> None:
        """Encode all full blocks up to a time."""
        self._encode(min(int(seconds * SAMPLE_RATE), len(self._samples)), last=False)

    def finish(self) -> None:
        """Encode the remaining samples."""
        self._encode(len(self._samples), last=True)
        self._container.mux(self._stream.encode())

    def _encode(self, stop: int, *, last: bool) -> None:
        while self._done < stop and (last or stop - self._done >= _AAC_BLOCK):
            block = self._samples[self._done : min(self._done + _AAC_BLOCK, stop)]
            limited = np.clip(np.asarray(block, np.float32), -1, 1)
            frame = av.AudioFrame.from_ndarray(
                np.ascontiguousarray(limited[None]), format="fltp", layout="mono"
            )
            frame.sample_rate, frame.pts = SAMPLE_RATE, self._done
            frame.time_base = Fraction(1, SAMPLE_RATE)
            self._container.mux(self._stream.encode(frame))
            self._done += len(block)
