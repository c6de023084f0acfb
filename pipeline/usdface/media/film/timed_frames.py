"""Frames by time: the common interface of movies and of numbered pictures, and the latter."""

import re
from fractions import Fraction
from pathlib import Path
from typing import Self

import numpy as np

from usdface.core.arrays import ByteImage, FloatArray
from usdface.core.errors import InputError
from usdface.media.picture.image import read_picture

PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".exr", ".dpx")
_NUMBERED = re.compile(r"^(.*?)(\d+)(\.[^.]+)$")


class OpenVideo:
    """Frames by time; a context manager.

    Attributes
    ----------
    path : Path
        The movie, or the first picture.
    rate : Fraction or None
        Frames per second; None for variable rates.
    times : (frames,) float array
        Start of each frame [s]; 0 is where players start the file, including its sound.
    duration : float
        End of the last frame [s].
    tolerance : float
        Largest error of `times` by rounding [s].
    timecode : str
        SMPTE start time; empty if not stated.
    """

    path: Path
    rate: Fraction | None
    times: FloatArray
    duration: float
    tolerance: float
    timecode: str

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file, if one is open."""

    def index_at(self, seconds: float) -> int | None:
        """Return the index in `times` of the frame at a time, None before and after the video."""
        moment = seconds + self.tolerance
        if not self.times[0] <= moment < self.duration + self.tolerance:
            return None
        return int(np.searchsorted(self.times, moment, side="right")) - 1

    def frame(self, index: int) -> ByteImage:
        """Return one frame by its index in `times`: (height, width, 3) sRGB, upright."""
        raise NotImplementedError

    def frame_at(self, seconds: float) -> ByteImage | None:
        """Return the frame at a time on the clock of `times`, None before and after the video."""
        index = self.index_at(seconds)
        return None if index is None else self.frame(index)


class ImageSequence(OpenVideo):
    """Pictures whose names differ in their number only; a missing one repeats the one before.

    `first`: any picture of the sequence. `rate`: pictures per second. `files`: all pictures.
    """

    def __init__(self, first: Path, rate: Fraction) -> None:
        match = _NUMBERED.match(first.name)
        if match is None:
            raise InputError(
                f"{first}: one picture of a sequence needs a number in its name, as shot.1001.png"
            )
        if not first.is_file():
            raise InputError(f"{first}: no such file; check the path")
        numbers = {}
        # Of 7 and 0007, the last remains: that with as many digits as the picture given.
        beside = sorted(path.name for path in first.parent.iterdir())
        for name in sorted(beside, key=lambda name: len(name) == len(first.name)):
            other = _NUMBERED.match(name)
            if other and (other[1], other[3]) == (match[1], match[3]):
                numbers[int(other[2])] = first.with_name(name)
        order = sorted(numbers)
        self.files = [numbers[number] for number in order]
        self.path = self.files[0]
        self.rate = rate
        self.tolerance = 1e-6
        self.times = (np.array(order) - order[0]) / float(rate)
        self.duration = float(self.times[-1] + 1 / rate)
        self.timecode = ""

    def frame(self, index: int) -> ByteImage:
        """Read a picture by its index."""
        return read_picture(self.files[index])
