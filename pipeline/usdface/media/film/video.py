"""Reading of the exact frame that a movie shows at a given time.

Counting frames or trusting the stated rate fails with variable rates of phones, B-frames and edit
lists. Here all time stamps are read first, and frames are identified by their time stamps.
`open_video` opens movies, and pictures with numbers.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from usdface.core.arrays import ByteImage, IntArray
from usdface.core.assets import Take
from usdface.core.errors import InputError
from usdface.media.film.containers import (
    MAX_PIXELS,
    decoding,
    metadata_of,
    open_media,
    start_seconds,
)
from usdface.media.film.timed_frames import PICTURE_SUFFIXES, ImageSequence, OpenVideo

MAX_FRAMES = 5_000_000
"""23 hours at 60 frames per second; more is a damaged index."""

_MISSING_SHARE = 0.02  # share of the header's frame count that may be missing


@dataclass(frozen=True)
class _Index:
    """Time stamps of the frames of a stream, in display order."""

    stamps: IntArray
    keys: IntArray
    last_duration: int


class VideoReader(OpenVideo):
    """A movie; `width` and `height` are as displayed: rotated, with square pixels [pixels].

    `focal_length`, which phones state, is in mm of the 35 mm equivalent, or None.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
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
                f"{self.path}: there is no decoder for its pictures; export H.264 or ProRes"
            )
        width, height = stream.codec_context.width, stream.codec_context.height
        if not 0 < width * height <= MAX_PIXELS:
            raise InputError(
                f"{self.path}: pictures of {width} × {height} pixels; at most {MAX_PIXELS} pixels "
                "are read: export a smaller movie"
            )
        stream.thread_type = "AUTO"
        # Pictures state their size again, which may differ from the header's.
        stream.codec_context.options = {"max_pixels": str(MAX_PIXELS)}
        self._index = _table_of_contents(stream, self.path) or _read_index(
            self._container, stream, self.path
        )
        base = Fraction(stream.time_base)
        self.tolerance = float(base) / 2  # half a tick, to which containers round time stamps
        start = start_seconds(self._container)
        self.times = np.asarray(self._index.stamps * float(base) - start, np.float64)
        self.duration = float(self.times[-1] + self._index.last_duration * float(base))
        self.rate = _even_rate(self._index.stamps, base, stream.average_rate)
        self.timecode = _timecode(self._container)
        self.focal_length = _focal_length(self._container)
        self._decoded: Iterator[Any] | None = None
        self._position: int | None = None
        self._shown: tuple[int, ByteImage] | None = None
        self.height, self.width = self.frame(0).shape[:2]

    def close(self) -> None:
        """Close the file."""
        self._decoded = None
        self._container.close()

    def frame(self, index: int) -> ByteImage:
        """Decode a frame by its index."""
        if not 0 <= index < len(self.times):
            raise InputError(f"{self.path}: has {len(self.times)} frames, there is no {index}")
        if self._shown is None or self._shown[0] != index:
            seconds = float(self.times[index])
            with decoding(self.path, where=f" at {seconds:.3f} s"):
                decoded = self._decode(int(self._index.stamps[index]), seconds)
                self._shown = (index, _upright(decoded, self._stream.sample_aspect_ratio))
        return self._shown[1]

    def _decode(self, stamp: int, seconds: float) -> Any:
        """Decode the frame with a time stamp, from the key frame before it or the last position."""
        keys = self._index.keys
        key = int(keys[max(int(np.searchsorted(keys, stamp, side="right")) - 1, 0)])
        frames = self._decoded
        if frames is None or not self._is_ahead(key, stamp):
            self._container.seek(key, stream=self._stream, backward=True)
            frames = self._container.decode(self._stream)
        self._decoded = None  # after an error, decoding begins at a key frame
        for frame in frames:
            shown = frame.pts if frame.pts is not None else frame.dts
            self._position = shown
            if shown is not None and shown >= stamp:
                if shown == stamp:
                    self._decoded = frames
                    return frame
                break
        raise InputError(
            f"{self.path}: the frame at {seconds:.3f} s cannot be decoded; the file may be damaged "
            "there: copy or export it again"
        )

    def _is_ahead(self, key: int, stamp: int) -> bool:
        """Return whether decoding on from the last frame is no longer than from the key frame.

        Seeking to a key frame that is next anyway would discard frames that are decoded ahead.
        """
        stamps, position = self._index.stamps, self._position
        if position is None:
            return False
        after = min(int(np.searchsorted(stamps, position, side="right")), len(stamps) - 1)
        return position < stamp and key <= int(stamps[after])


def _table_of_contents(stream: Any, path: Path) -> _Index | None:
    """Return the index stored in the file, for codecs with key frames only; else None.

    It holds decoding times, which equal display times for ProRes, DNxHD and MJPEG; files of tens of
    gigabytes then need not be read.
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
    """Read the time stamps of all packets, without decoding."""
    stamps, keys = list[int](), list[int]()
    count = 0
    last = (-1, 0)
    with decoding(path):
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
    """Return the stated rate if all time stamps agree within rounding, else None."""
    if not stated or len(stamps) < 2:
        return None if not stated else Fraction(stated)
    rate = Fraction(stated)
    expected = np.arange(len(stamps)) * float(1 / (rate * base))
    drift = stamps - stamps[0] - expected
    return rate if np.abs(drift).max() <= 1.5 else None


def _upright(frame: Any, aspect: Fraction | None) -> ByteImage:
    """Convert to sRGB bytes, upright and with square pixels; `aspect`: of the frame's pixels."""
    options: dict[str, Any] = {"format": "rgb24", "threads": 1}  # see `media.film.movie`
    if int(frame.colorspace) == 2 and frame.height >= 720:
        # Unspecified: players assume BT.709 for HD, the converter BT.601.
        options["src_colorspace"] = "ITU709"
    if aspect and aspect != 1 and Fraction(1, 4) < aspect < 4:
        options["width"] = max(int(frame.width * aspect + Fraction(1, 2)), 1)
    pixels = frame.reformat(**options).to_ndarray()
    turns = round((frame.rotation or 0) / 90) % 4
    return np.ascontiguousarray(np.rot90(pixels, turns))


def _timecode(container: Any) -> str:
    for holder in (container, *container.streams):
        if timecode := metadata_of(holder).get("timecode"):
            return timecode
    return ""


_FOCAL_LENGTHS = (8.0, 2000.0)
"""Plausible focal lengths, from fisheye to telephoto [mm]."""


def _focal_length(container: Any) -> float | None:
    """Return the 35 mm equivalent focal length that phones write under various keys, or None."""
    for holder in (container, *container.streams):
        for key, value in metadata_of(holder).items():
            if "focal_length" in key and "35mm" in key:
                try:
                    stated = float(value)
                except ValueError:
                    continue
                if _FOCAL_LENGTHS[0] <= stated <= _FOCAL_LENGTHS[1]:
                    return stated
    return None


def open_video(path: Path, rate: Fraction | None = None) -> OpenVideo:
    """Open a movie, or the sequence that a picture belongs to.

    `InputError` if it is neither, or a sequence without a rate.
    """
    if path.suffix.lower() not in PICTURE_SUFFIXES:
        return VideoReader(path)
    if rate is None or rate <= 0:
        raise InputError(f"{path}: pictures do not state their rate; give it with --video-rate")
    return ImageSequence(path, rate)


def picture_at_frame(
    take: Take | None, video: OpenVideo | None, frame: float
) -> tuple[ByteImage | None, str]:
    """Return the picture of a take's video at a frame of the take, or None and the reason."""
    if take is None or take.video is None or video is None:
        return None, "no video"
    try:
        picture = video.frame_at(take.video_seconds(frame))
    except InputError:
        return None, "cannot be decoded"
    return picture, "" if picture is not None else "no video here"
