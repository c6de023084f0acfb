"""Mapping from a movie's pictures to frames of the take, timecode and sound."""

import math
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from usdface.core.arrays import Float32Array, frame_blocks
from usdface.core.assets import Take
from usdface.core.errors import InputError
from usdface.core.rates import frames_of, timecode_of
from usdface.media.film.movie import SAMPLE_RATE
from usdface.media.film.sound import read_audio

_BLOCK_SAMPLES = 1 << 20

HIGHEST_RATE = 60
"""[pictures per second] Highest rate of review screens."""


@dataclass(frozen=True)
class MovieClock:
    """Rates and range of a movie."""

    rate: Fraction
    """Pictures per second."""
    take_rate: Fraction
    """Frames per second."""
    first_frame: int
    """Frame number of the first picture."""
    frame_count: int
    """Number of frames of the take."""

    @property
    def picture_count(self) -> int:
        """Number of pictures that start within the frames."""
        return max(math.ceil(self.frame_count * self.rate / self.take_rate), 1)

    def row(self, picture: int) -> int:
        """Return the row of the frame nearest to the start of a picture."""
        nearest = math.floor(picture * self.take_rate / self.rate + Fraction(1, 2))
        return min(nearest, self.frame_count - 1)

    def take_frame(self, picture: int) -> float:
        """Return the frame number at the start of a picture, which may lie between two frames."""
        return float(self.first_frame + picture * self.take_rate / self.rate)

    def timecode(self, take_start: str, take_first: int, picture: int = 0) -> str:
        """Return the timecode of a picture at the movie's rate.

        Empty if unknown, or if only one of the rates is over 1.001: their labels count other
        seconds, and differ by 3.6 s an hour.
        """
        counts_differ = (self.rate.denominator == 1001) != (self.take_rate.denominator == 1001)
        if counts_differ or not take_start:
            return ""
        frames = frames_of(take_start, self.take_rate) + self.first_frame - take_first
        try:
            drop = ";" in take_start and self.rate.denominator == 1001
            first = math.floor(frames / self.take_rate * self.rate)
            return timecode_of(first + picture, self.rate, drop=drop)
        except InputError:
            return ""  # timecode does not support the rate


def movie_rate(take: Take) -> Fraction:
    """Return the rate of a take's video, else of the take, halved until at most `HIGHEST_RATE`."""
    rate = take.video.rate if take.video is not None and take.video.rate is not None else take.rate
    while rate > HIGHEST_RATE:
        rate /= 2
    return rate


def take_sound(take: Take, clock: MovieClock, notes: list[str]) -> Float32Array | None:
    """Return the sound of a movie's pictures, mono at `SAMPLE_RATE`, padded with silence.

    That of the capture, else of the camera; a note is appended if it cannot be read.
    """
    start = take.seconds(clock.first_frame)
    count = round(float(clock.picture_count / clock.rate) * SAMPLE_RATE)
    recorded = recorded_sound(take, notes)
    if recorded is None:
        return None
    return sound_between(take, recorded, start, start + count / SAMPLE_RATE)


def recorded_sound(take: Take, notes: list[str], rate: int = SAMPLE_RATE) -> Float32Array | None:
    """Return the whole sound file of a take; see `take_sound`."""
    file = take.audio
    if file is None and take.video is not None and take.video.file.is_file():
        file = take.video.file
    try:
        return None if file is None else read_audio(file, rate=rate)
    except InputError as error:
        notes.append(f"no sound: {error}")
        return None


def sound_between(
    take: Take, recorded: Float32Array, first: float, last: float, rate: int = SAMPLE_RATE
) -> Float32Array:
    """Return a take's sound between two take times [s], padded with silence."""
    samples = np.zeros(round((last - first) * rate), np.float32)
    for block in frame_blocks(len(samples), frames=_BLOCK_SAMPLES):
        times = first + np.arange(block.start, block.stop) / rate
        if take.audio is None and take.video is not None:
            times = take.video.video_time(times)
        at = times * rate
        low, high = (max(int(end), 0) for end in (at[0], at[-1]))
        near = recorded[low : high + 2]
        if len(near):
            samples[block] = np.interp(at - low, np.arange(len(near)), near, left=0.0, right=0.0)
    return samples
