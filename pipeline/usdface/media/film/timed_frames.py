"""The common interface of movies and of pictures with numbers: frames by time."""

from fractions import Fraction
from pathlib import Path
from typing import Self

import numpy as np

from usdface.core.arrays import ByteImage, FloatArray


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
