"""Read the exact frame that a movie shows at a given time.

Players and OpenCV count frames or trust the rate; a phone's variable rate, B-frames and edit lists
make both wrong. Here every time stamp is read first, and a frame is the one that carries its own.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, Self

import av
import av.error
import numpy as np

from usdface.core.arrays import ByteImage, FloatArray, IntArray
from usdface.core.errors import InputError
from usdface.media.film.containers import (
    MAX_PIXELS,
    open_media,
    start_seconds,
    unreadable,
    words_of,
)
from usdface.media.film.movie import write_movie
from usdface.media.film.sound import read_audio

__all__ = ["MAX_FRAMES", "MAX_PIXELS", "VideoReader", "read_audio", "write_movie"]

MAX_FRAMES = 5_000_000
"""23 hours at 60 frames a second: more is a broken index, not a take."""

_MISSING_SHARE = 0.02  # of the frames a header promises that may be absent


@dataclass(frozen=True)
class _Index:
    """Every frame of a stream, in the order it is shown."""

    stamps: IntArray
    keys: IntArray
    last_duration: int


class VideoReader:
    """A movie whose frames are found by time; use it in a ``with`` block.

    Attributes
    ----------
    rate : Fraction or None
        Frames per second; None where frames are not evenly spaced.
    times : (frames,) float array
        When each frame appears [s]; zero is where players start the file, sound included.
    duration : float
        When the last frame goes [s].
    width, height : int
        As shown: rotated, with square pixels [pixels].
    timecode : str
        The SMPTE start time the file carries; empty without one.
    focal_length : float or None
        Of the lens, as phones state it [mm of a 35 mm camera].
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        self._container = open_media(self.path)
        try:
            self._prepare()
        except BaseException:
            self._container.close()
            raise

    def _prepare(self) -> None:
        streams = self._container.streams.video
        if not streams:
            raise InputError(f"{self.path}: holds no picture; give the movie, not its sound")
        stream = streams[0]
        self._stream = stream
        if stream.codec_context is None:
            raise InputError(
                f"{self.path}: its pictures are packed in a way that nothing here unpacks; export "
                "H.264 or ProRes"
            )
        width, height = stream.codec_context.width, stream.codec_context.height
        if not 0 < width * height <= MAX_PIXELS:
            raise InputError(
                f"{self.path}: pictures of {width} × {height} pixels; at most {MAX_PIXELS} pixels "
                "are read: export a smaller movie"
            )
        stream.thread_type = "AUTO"
        # A picture says its size again, and may say another than the header.
        stream.codec_context.options = {"max_pixels": str(MAX_PIXELS)}
        self._index = _table_of_contents(stream, self.path) or _read_index(
            self._container, stream, self.path
        )
        base = Fraction(stream.time_base)
        self._tick = float(base)
        start = start_seconds(self._container)
        self.times: FloatArray = np.asarray(self._index.stamps * float(base) - start, np.float64)
        self.duration = float(self.times[-1] + self._index.last_duration * float(base))
        self.rate = _even_rate(self._index.stamps, base, stream.average_rate)
        self.timecode = _timecode(self._container)
        self.focal_length = _focal_length(self._container)
        self._decoded: Iterator[Any] | None = None
        self._position: int | None = None
        self._shown: tuple[int, ByteImage] | None = None
        self.height, self.width = self.frame(0).shape[:2]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Let go of the file."""
        self._decoded = None
        self._container.close()

    def index_at(self, seconds: float) -> int | None:
        """Return the index in `times` of the frame on screen, None before and after the movie."""
        # Half a tick: containers round time stamps, some to whole milliseconds.
        moment = seconds + self._tick / 2
        if not self.times[0] <= moment < self.duration + self._tick / 2:
            return None
        return int(np.searchsorted(self.times, moment, side="right")) - 1

    def frame_at(self, seconds: float) -> ByteImage | None:
        """Return the frame on screen at a time, None before and after the movie.

        Parameters
        ----------
        seconds : float
            On the clock of `times` [s].

        Returns
        -------
        (height, width, 3) uint8 array or None
            sRGB, upright.
        """
        index = self.index_at(seconds)
        return None if index is None else self.frame(index)

    def frame(self, index: int) -> ByteImage:
        """Return one frame by its index in `times`."""
        if not 0 <= index < len(self.times):
            raise InputError(f"{self.path}: has {len(self.times)} frames, there is no {index}")
        if self._shown is None or self._shown[0] != index:
            seconds = float(self.times[index])
            decoded = self._decode(int(self._index.stamps[index]), seconds)
            try:
                self._shown = (index, _upright(decoded))
            except (av.error.FFmpegError, OSError, ValueError) as error:
                raise unreadable(self.path, error, where=f" at {seconds:.3f} s") from error
        return self._shown[1]

    def _decode(self, stamp: int, seconds: float) -> Any:
        """Decode forward to the frame with this time stamp, from the key frame before it."""
        keys = self._index.keys
        key = int(keys[max(int(np.searchsorted(keys, stamp, side="right")) - 1, 0)])
        try:
            position = self._position
            if (
                self._decoded is None
                or position is None
                or not self._is_ahead(position, key, stamp)
            ):
                self._container.seek(key, stream=self._stream, backward=True)
                self._decoded = self._container.decode(self._stream)
            for frame in self._decoded:
                shown = frame.pts if frame.pts is not None else frame.dts
                self._position = shown
                if shown is not None and shown >= stamp:
                    if shown == stamp:
                        return frame
                    break
        except (av.error.FFmpegError, OSError, ValueError) as error:
            self._decoded = None
            raise unreadable(self.path, error, where=f" at {seconds:.3f} s") from error
        self._decoded = None
        raise InputError(
            f"{self.path}: the frame at {seconds:.3f} s cannot be decoded; the file may be damaged "
            "there: copy or export it again"
        )

    def _is_ahead(self, position: int, key: int, stamp: int) -> bool:
        """Return whether decoding on from a position leads to a frame, past no more than needed.

        Seeking to a key frame that comes next anyway would throw away what decoders have ahead.
        """
        stamps = self._index.stamps
        after = min(int(np.searchsorted(stamps, position, side="right")), len(stamps) - 1)
        return position < stamp and key <= int(stamps[after])


def _table_of_contents(stream: Any, path: Path) -> _Index | None:
    """Take time stamps from the file's own table, where that is sure to be right.

    It tells decoding times. Where every frame stands alone (ProRes, DNxHD, MJPEG) these are the
    times of showing, and tens of gigabytes need not be read to learn them.
    """
    entries = getattr(stream, "index_entries", None)  # not in every PyAV
    if not stream.codec.intra_only or entries is None or len(entries) < max(stream.frames, 2):
        return None
    if len(entries) > MAX_FRAMES:
        return None
    shown = [entry for entry in entries if not entry.is_discard]
    stamps = np.array([entry.timestamp for entry in shown], np.int64)
    steps = np.diff(stamps)
    last = shown[-1] if shown else None
    whole = last is not None and last.pos + last.size <= path.stat().st_size
    if not whole or not len(steps) or steps.min() <= 0:
        return None
    return _Index(stamps=stamps, keys=stamps, last_duration=int(np.median(steps)))


def _read_index(container: Any, stream: Any, path: Path) -> _Index:
    """Read the time stamps of all packets, without decoding any."""
    stamps, keys = list[int](), list[int]()
    count = 0
    last = (-1, 0)
    try:
        for packet in container.demux(stream):
            stamp = packet.pts if packet.pts is not None else packet.dts
            if stamp is None or not packet.size:
                continue
            count += 1
            if count > MAX_FRAMES:
                raise InputError(f"{path}: more than {MAX_FRAMES} frames; cut the movie")
            if packet.is_keyframe:
                keys.append(stamp)
            if not packet.is_discard:
                stamps.append(stamp)
                last = max(last, (stamp, packet.duration or 0))
    except (av.error.FFmpegError, OSError, ValueError) as error:
        raise unreadable(path, error) from error
    if not stamps or not keys:
        raise InputError(f"{path}: not one whole frame is in the file; copy or export it again")
    if count < stream.frames * (1 - _MISSING_SHARE):
        raise InputError(
            f"{path}: promises {stream.frames} frames and holds {count}: it is cut short; copy it "
            "again"
        )
    shown = np.unique(np.array(stamps, np.int64))
    steps = np.diff(shown)
    duration = last[1] or (int(np.median(steps)) if len(steps) else 1)
    return _Index(stamps=shown, keys=np.unique(np.array(keys, np.int64)), last_duration=duration)


def _even_rate(stamps: IntArray, base: Fraction, stated: Fraction | None) -> Fraction | None:
    """Return the stated rate if every stamp lies on its grid, to one tick of rounding."""
    if not stated or len(stamps) < 2:
        return None if not stated else Fraction(stated)
    rate = Fraction(stated)
    expected = np.arange(len(stamps)) * float(1 / (rate * base))
    drift = stamps - stamps[0] - expected
    return rate if np.abs(drift).max() <= 1.5 else None


def _upright(frame: Any) -> ByteImage:
    """Convert to sRGB bytes, with square pixels, the way up that the camera was held."""
    options: dict[str, Any] = {"format": "rgb24"}
    if int(frame.colorspace) == 2 and frame.height >= 720:
        # Unspecified: players assume BT.709 from HD on, the converter BT.601.
        options["src_colorspace"] = "ITU709"
    aspect = frame.sample_aspect_ratio if hasattr(frame, "sample_aspect_ratio") else None
    if aspect and aspect != 1 and Fraction(1, 4) < aspect < 4:
        options["width"] = max(int(frame.width * aspect + Fraction(1, 2)), 1)
    pixels = frame.reformat(**options).to_ndarray()
    turns = round((frame.rotation or 0) / 90) % 4
    return np.ascontiguousarray(np.rot90(pixels, turns))


def _timecode(container: Any) -> str:
    for holder in (container, *container.streams):
        said = words_of(holder).get("timecode")  # Matroska shouts
        if said:
            return said
    return ""


_FOCAL_LENGTHS = (8.0, 2000.0)
"""[mm] Of lenses, from fisheye to the longest."""


def _focal_length(container: Any) -> float | None:
    """Return what phones write of their lens, in whichever of their manners."""
    for holder in (container, *container.streams):
        for key, value in words_of(holder).items():
            if "focal_length" in key and "35mm" in key:
                try:
                    stated = float(value)
                except ValueError:
                    continue
                if _FOCAL_LENGTHS[0] <= stated <= _FOCAL_LENGTHS[1]:
                    return stated
    return None
