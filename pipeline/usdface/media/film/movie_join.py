"""Movies of the same kind put one after the other without decoding them."""

from collections.abc import Sequence
from contextlib import ExitStack
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import av.error

from usdface.core.arrays import Float32Array
from usdface.core.errors import InputError
from usdface.core.replacing import replacing
from usdface.media.film.containers import open_media, unreadable
from usdface.media.film.movie import movie_format
from usdface.media.film.movie_sound import SoundTrack


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
    """Write the pictures of several movies as one.

    Parameters
    ----------
    path : Path
        The movie to write.
    parts : sequence of Path
        Movies of `write_movie`, of one size, rate and encoder, in order. Their sound is left out.
    pictures : sequence of int, optional
        How many of each part's, from its first; all by default.
    audio, sample_rate, timecode, comment
        As for `write_movie`, of the whole.
    rate : Fraction, optional
        Pictures per second; as the first part states it by default, which some containers round.

    Returns
    -------
    int
        Number of pictures written.

    Raises
    ------
    InputError
        If a part is no movie, or parts differ in kind. An old file is left as it was.
    """
    if not parts:
        raise InputError(f"{path}: there is no part to join; give at least one")
    container_format = movie_format(path)
    with ExitStack() as open_files, replacing(path) as temporary:
        kinds = []
        for part in parts:
            source = open_files.enter_context(open_media(part))
            kinds.append(_kind(part, source))
            if kinds[-1] != kinds[0]:
                raise InputError(
                    f"{part}: is {_told(kinds[-1])} and {parts[0]} is {_told(kinds[0])}; make all "
                    "parts with the same options"
                )
            source.close()
        rate = kinds[0][3] if rate is None else rate
        count = 0
        try:
            with av.open(str(temporary), "w", format=container_format) as container:
                if timecode:
                    container.metadata["timecode"] = timecode
                if comment:
                    container.metadata["comment"] = comment
                stream: Any = None
                sound: SoundTrack | None = None
                for number, part in enumerate(parts):
                    end = None if pictures is None else count + pictures[number]
                    with open_media(part) as source:
                        given = source.streams.video[0]
                        if stream is None:
                            stream = container.add_stream_from_template(given)
                            stream.time_base = 1 / rate
                            if audio is not None:
                                sound = SoundTrack(container, audio, sample_rate)
                        for packet in source.demux(given):
                            if packet.size == 0 or count == end:
                                continue
                            # One packet is one picture, in order: counted, no rounding adds up.
                            packet.pts = packet.dts = count
                            packet.duration = 1
                            packet.time_base = 1 / rate
                            packet.stream = stream
                            container.mux(packet)
                            count += 1
                            if sound is not None:
                                sound.encode_until(Fraction(count) / rate)
                if sound is not None:
                    sound.finish()
        except (av.error.FFmpegError, OSError, ValueError) as error:
            told = f"{parts[0]} and those after it" if len(parts) > 1 else str(parts[0])
            raise InputError(
                f"{path}: {told} cannot be joined ({error}); make them anew"
            ) from error
    return count


def _kind(part: Path, source: Any) -> tuple[str, int, int, Fraction, bytes]:
    """Return what must be alike for packets to stand in one stream."""
    if not source.streams.video:
        raise InputError(f"{part}: holds no pictures; give parts that `usdface movie` made")
    stream = source.streams.video[0]
    context = stream.codec_context
    rate = stream.average_rate
    if context is None or not rate:
        told = "its pictures are packed in an unknown way" if context is None else "it has no rate"
        raise unreadable(part, ValueError(told))
    extra = bytes(context.extradata or b"")
    return str(context.name), int(context.width), int(context.height), Fraction(rate), extra


def _told(kind: tuple[str, int, int, Fraction, bytes]) -> str:
    name, width, height, rate, _ = kind
    return f"{name} {width} × {height} at {float(rate):g} frames per second"
