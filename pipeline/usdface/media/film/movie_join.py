"""Concatenation of movies of the same kind without decoding."""

from collections.abc import Sequence
from fractions import Fraction
from itertools import repeat
from pathlib import Path
from typing import Any

import av
import av.error

from usdface.core.arrays import Float32Array
from usdface.core.errors import InputError
from usdface.core.replacing import replacing
from usdface.media.film.containers import open_media, unreadable
from usdface.media.film.movie import SoundTrack, movie_format


def join_movies(
    path: Path,
    parts: Sequence[Path],
    *,
    pictures: Sequence[int] | None = None,
    audio: Float32Array | None = None,
    sample_rate: int = 48000,
    rate: Fraction | None = None,
    timecode: str = "",
    comment: str = "",
) -> int:
    """Write the pictures of several movies as one; return their number.

    Parameters
    ----------
    path : Path
        The movie to write.
    parts : sequence of Path
        Movies of `write_movie`, of one size, rate and encoder, in order. Their sound is ignored.
    pictures : sequence of int, optional
        Number of pictures from the start of each part; default: all.
    audio, sample_rate
        Of the whole, as for `write_movie`.
    timecode : str
        SMPTE timecode of the first frame, ``HH:MM:SS:FF``, or ``;`` before FF for drop-frame.
    comment : str
        Stored in the file; see `read_movie_comment`.
    rate : Fraction, optional
        Pictures per second; default: as stated by the first part, which some containers round.

    Raises
    ------
    InputError
        If a part is not a movie, or parts differ in kind. An existing file is then unchanged.
    """
    if not parts:
        raise InputError(f"{path}: there is no part to join; give at least one")
    container_format = movie_format(path)
    stated_rate = _check_kinds(parts)
    with replacing(path) as temporary:
        try:
            with av.open(str(temporary), "w", format=container_format) as container:
                stated = {"timecode": timecode, "comment": comment}
                container.metadata.update({key: text for key, text in stated.items() if text})
                joined = _Joined(container, stated_rate if rate is None else rate)
                counts = repeat(None) if pictures is None else pictures
                for part, count in zip(parts, counts, strict=False):
                    joined.add(part, count, audio, sample_rate)
                joined.finish()
        except (av.error.FFmpegError, OSError, ValueError) as error:
            which = f"{parts[0]} and those after it" if len(parts) > 1 else str(parts[0])
            raise InputError(
                f"{path}: {which} cannot be joined ({error}); make them anew"
            ) from error
    return joined.count


class _Joined:
    """A movie to which packets of others are copied, numbered from 0."""

    def __init__(self, container: Any, rate: Fraction) -> None:
        self.count = 0
        self._container = container
        self._rate = rate
        self._stream: Any = None
        self._sound: SoundTrack | None = None

    def add(
        self, part: Path, most: int | None, audio: Float32Array | None, sample_rate: int
    ) -> None:
        """Copy the pictures of a part, at most `most`; the first part defines the streams."""
        end = None if most is None else self.count + most
        with open_media(part) as source:
            video = source.streams.video[0]
            if self._stream is None:
                self._begin(video, audio, sample_rate)
            for packet in source.demux(video):
                if packet.size and self.count != end:
                    # One packet is one picture: counting avoids the accumulation of rounding.
                    packet.pts = packet.dts = self.count
                    packet.duration = 1
                    packet.time_base = 1 / self._rate
                    packet.stream = self._stream
                    self._container.mux(packet)
                    self.count += 1
                    if self._sound is not None:
                        self._sound.encode_until(Fraction(self.count) / self._rate)

    def _begin(self, template: Any, audio: Float32Array | None, sample_rate: int) -> None:
        self._stream = self._container.add_stream_from_template(template)
        self._stream.time_base = 1 / self._rate
        if audio is not None:
            self._sound = SoundTrack(self._container, audio, sample_rate)

    def finish(self) -> None:
        """Write the rest of the sound."""
        if self._sound is not None:
            self._sound.finish()


def _check_kinds(parts: Sequence[Path]) -> Fraction:
    """Refuse parts of different kinds; return the rate stated by the first."""
    kinds = []
    for part in parts:
        with open_media(part) as source:
            kinds.append(_kind(part, source))
        if kinds[-1] != kinds[0]:
            raise InputError(
                f"{part}: is {_description(kinds[-1])} and {parts[0]} is "
                f"{_description(kinds[0])}; make all parts with the same options"
            )
    return kinds[0][3]


def _kind(part: Path, source: Any) -> tuple[str, int, int, Fraction, bytes]:
    """Return codec, size, rate and codec data, which must be equal within one stream."""
    if not source.streams.video:
        raise InputError(f"{part}: holds no pictures; give parts that `usdface movie` made")
    stream = source.streams.video[0]
    context = stream.codec_context
    rate = stream.average_rate
    if context is None or not rate:
        reason = "its codec is unknown" if context is None else "it has no rate"
        raise unreadable(part, ValueError(reason))
    extra = bytes(context.extradata or b"")
    return str(context.name), int(context.width), int(context.height), Fraction(rate), extra


def _description(kind: tuple[str, int, int, Fraction, bytes]) -> str:
    name, width, height, rate, _ = kind
    return f"{name} {width} × {height} at {float(rate):g} frames per second"
