"""Concatenation of movies of the same kind without decoding."""

from collections.abc import Iterable, Sequence
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
    rate: Fraction,
    pictures: Sequence[int] | None = None,
    audio: Float32Array | None = None,
    timecode: str = "",
    comment: str = "",
) -> None:
    """Write the pictures of several movies as one.

    `InputError` if a part is not a movie, or parts differ in kind; an existing file is then
    unchanged.

    Parameters
    ----------
    path : Path
        The movie to write.
    parts : sequence of Path
        Movies of `write_movie`, of one size, rate and encoder, in order. Their sound is ignored.
    rate : Fraction
        Pictures per second, which some containers round.
    pictures : sequence of int, optional
        Number of pictures from the start of each part; default: all.
    audio : (samples,) float array, optional
        Of the whole, as for `write_movie`.
    timecode : str
        SMPTE timecode of the first frame, ``HH:MM:SS:FF``, or ``;`` before FF for drop-frame.
    comment : str
        Stored in the file; see `read_movie_comment`.
    """
    container_format = movie_format(path)
    _check_kinds(parts)
    with replacing(path) as temporary:
        try:
            with av.open(str(temporary), "w", format=container_format) as container:
                stated = {"timecode": timecode, "comment": comment}
                container.metadata.update({key: text for key, text in stated.items() if text})
                counts = repeat(None) if pictures is None else pictures
                _copy(parts, counts, container, rate, audio)
        except (av.error.FFmpegError, OSError, ValueError) as error:
            which = f"{parts[0]} and those after it" if len(parts) > 1 else str(parts[0])
            raise InputError(
                f"{path}: {which} cannot be joined ({error}); make them anew, or free the "
                "disk if it is full"
            ) from error


def _copy(
    parts: Sequence[Path],
    counts: Iterable[int | None],
    container: Any,
    rate: Fraction,
    audio: Float32Array | None,
) -> None:
    """Copy the packets of parts, at most a count of each, numbered from 0."""
    number, stream, sound = 0, None, None
    for part, most in zip(parts, counts, strict=False):
        end = None if most is None else number + most
        with open_media(part) as source:
            video = source.streams.video[0]
            if stream is None:
                stream = container.add_stream_from_template(video)
                stream.time_base = 1 / rate
                if audio is not None:
                    sound = SoundTrack(container, audio)
            for packet in source.demux(video):
                if not packet.size or number == end:
                    continue
                # One packet is one picture: counting avoids the accumulation of rounding.
                packet.pts = packet.dts = number
                packet.duration, packet.time_base = 1, 1 / rate
                packet.stream = stream
                container.mux(packet)
                number += 1
                if sound is not None:
                    sound.encode_until(Fraction(number) / rate)
    if sound is not None:
        sound.finish()


def _check_kinds(parts: Sequence[Path]) -> None:
    """Refuse parts of different kinds."""
    kinds = []
    for part in parts:
        with open_media(part) as source:
            kinds.append(_kind(part, source))
        if kinds[-1] != kinds[0]:
            raise InputError(
                f"{part}: is {_description(kinds[-1])} and {parts[0]} is "
                f"{_description(kinds[0])}; make all parts with the same options"
            )


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
