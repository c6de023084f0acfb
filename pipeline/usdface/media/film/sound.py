"""Reading of the sound of a movie or sound file as mono samples."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import av
import numpy as np

from usdface.core.arrays import Float32Array
from usdface.core.errors import InputError
from usdface.media.film.containers import decoding, open_media, start_seconds

MAX_HOURS = 4
_MAX_GAP = 0.02  # gap in the time stamps above which silence is inserted [s]
_MAX_SILENCE = 600.0  # gap above which time stamps count as damaged [s]
_RATES = range(1000, 768_001)
"""[Hz] Lower rates hold no speech, and a small file would be hours long."""


def read_audio(path: Path, *, rate: int = 16000) -> Float32Array:
    """Read the sound of a file or a movie as mono samples, on the clock of its pictures [-1 to 1].

    The mean of all channels. Sample 0 is time 0 of the file: silence is inserted before sound that
    begins later than the picture, and in gaps of the recording.

    `rate`: samples per second to resample to.
    """
    with open_media(path) as container:
        stream = _sound_stream(path, container)
        buffer = bytearray()  # a list of blocks would be copied
        with decoding(path):
            for block in _blocks(path, container, stream, rate):
                buffer += block.data
    if not buffer:
        raise InputError(f"{path}: its sound is empty; record or export it again")
    samples = np.frombuffer(buffer, np.float32)
    if not np.isfinite(samples).all():  # of float formats
        raise InputError(f"{path}: its sound holds NaN or infinite samples; export it again")
    return samples


def _sound_stream(file: Path, container: Any) -> Any:
    if not container.streams.audio:
        raise InputError(f"{file}: holds no sound; give the sound file of the take")
    stream = container.streams.audio[0]
    context = stream.codec_context
    if context is None or context.sample_rate not in _RATES:
        kind = "an unknown codec" if context is None else f"{context.sample_rate} Hz"
        raise InputError(
            f"{file}: its sound is of {kind}, which is not read; export WAV at 48000 Hz"
        )
    return stream


def _blocks(file: Path, container: Any, stream: Any, rate: int) -> Iterator[Float32Array]:
    """Yield decoded sound, with silence in gaps of the time stamps."""
    start = start_seconds(container)
    # Channels are kept: FFmpeg's mix to one is louder than each, and leaves the fourth of six out.
    resampler = av.AudioResampler("flt", rate=rate)
    longest = MAX_HOURS * 3600 * rate
    count = 0
    for frame in container.decode(stream):
        if frame.time is not None:
            gap = round((frame.time - start) * rate) - count
            if gap > _MAX_SILENCE * rate:
                raise InputError(
                    f"{file}: after {count / rate:.3f} s its sound jumps to "
                    f"{frame.time - start:.0f} s; its time stamps are damaged: export it "
                    "again, or cut it to the take"
                )
            if gap > _MAX_GAP * rate and count + gap <= longest:
                yield np.zeros(gap, np.float32)
                count += gap
        for part in resampler.resample(frame):
            block = _mean_of_channels(part)
            yield block
            count += block.size
        if count > longest:
            raise InputError(f"{file}: longer than {MAX_HOURS} hours; cut it to the take")
    yield from map(_mean_of_channels, resampler.resample(None))


def _mean_of_channels(part: Any) -> Float32Array:
    return np.asarray(part.to_ndarray().reshape(part.samples, -1).mean(axis=1), np.float32)
