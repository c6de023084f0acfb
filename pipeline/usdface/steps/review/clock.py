"""Which frame of a take each picture of a movie shows, and the sound on that clock."""

import math
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from usdface.core.arrays import Float32Array
from usdface.core.assets import Take
from usdface.core.errors import InputError
from usdface.core.rates import frames_of, timecode_of
from usdface.media.film.sound import read_audio

HIGHEST_RATE = 60
"""[pictures per second] More no review screen shows."""


@dataclass(frozen=True)
class MovieClock:
    """The pictures of a movie beside the frames of its take."""

    rate: Fraction
    take_rate: Fraction
    """`rate`, `take_rate`: Pictures, and frames, per second."""
    first_frame: int
    """Frame number that the first picture shows."""
    frame_count: int
    """Frames that the movie spans."""

    @property
    def picture_count(self) -> int:
        """Pictures that begin while the frames last."""
        return max(math.ceil(self.frame_count * self.rate / self.take_rate), 1)

    def row(self, picture: int) -> int:
        """Return the row of the frame seen nearest the moment a picture begins."""
        nearest = math.floor(picture * self.take_rate / self.rate + Fraction(1, 2))
        return min(nearest, self.frame_count - 1)

    def timecode(self, take_start: str, take_first: int, picture: int = 0) -> str:
        """Return the label of a picture at the movie's own rate; empty where unknown."""
        if not take_start:
            return ""
        frames = frames_of(take_start, self.take_rate) + self.first_frame - take_first
        try:
            drop = ";" in take_start and self.rate.denominator == 1001
            first = math.floor(frames / self.take_rate * self.rate)
            return timecode_of(first + picture, self.rate, drop=drop)
        except InputError:
            return ""  # a rate that timecode has no labels for


def movie_rate(take: Take) -> Fraction:
    """Return the rate of a take's video, else its own, halved until a screen can show it."""
    rate = take.video.rate if take.video is not None and take.video.rate is not None else take.rate
    while rate > HIGHEST_RATE:
        rate /= 2
    return rate


SAMPLE_RATE = 48000


def take_sound(take: Take, clock: MovieClock, notes: list[str]) -> Float32Array | None:
    """Return the sound that belongs to a movie's pictures: the capture's own, else the camera's.

    Parameters
    ----------
    notes : list of str
        What could not be had is added here.

    Returns
    -------
    (samples,) float32 array or None
        Mono at `SAMPLE_RATE`, as long as the pictures; silent where there is none.
    """
    start = (clock.first_frame - take.first_frame) / float(take.rate)
    count = round(float(clock.picture_count / clock.rate) * SAMPLE_RATE)
    recorded = recorded_sound(take, notes)
    if recorded is None:
        return None
    return sound_between(take, recorded, start, start + count / SAMPLE_RATE)


def recorded_sound(take: Take, notes: list[str], rate: int = SAMPLE_RATE) -> Float32Array | None:
    """Return the whole sound of a take, on its file's own clock; see `take_sound`."""
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
    """Return a take's sound between two moments [s] of the take, silent where there is none."""
    moments = first + np.arange(round((last - first) * rate)) / rate
    if take.audio is None and take.video is not None:
        moments = take.video.video_time(moments)
    at = moments * rate
    samples = np.interp(at, np.arange(len(recorded)), recorded, left=0.0, right=0.0)
    return samples.astype(np.float32)
