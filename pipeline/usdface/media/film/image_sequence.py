"""Numbered pictures on disk, with the interface of a movie."""

import re
from fractions import Fraction
from pathlib import Path

import numpy as np

from usdface.core.arrays import ByteImage
from usdface.core.errors import InputError
from usdface.media.film.timed_frames import OpenVideo
from usdface.media.picture.image import read_picture

PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".exr", ".dpx")
_NUMBERED = re.compile(r"^(.*?)(\d+)(\.[^.]+)$")


class ImageSequence(OpenVideo):
    """Pictures whose names differ in their number only; a missing one repeats the one before.

    `first`: any picture of the sequence. `rate`: pictures per second.
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
        self._files = [numbers[number] for number in order]
        self.path = self._files[0]
        self.rate = rate
        self.tolerance = 1e-6
        self.times = (np.array(order) - order[0]) / float(rate)
        self.duration = float(self.times[-1] + 1 / rate)
        self.timecode = ""

    def frame(self, index: int) -> ByteImage:
        """Read a picture by its index."""
        return read_picture(self._files[index])
