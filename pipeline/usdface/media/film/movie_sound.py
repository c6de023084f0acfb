"""The sound of a movie, encoded beside its pictures so that the two stay interleaved."""

from fractions import Fraction
from typing import Any

import av
import numpy as np

from usdface.core.arrays import Float32Array

_BLOCK = 1024
"""Samples that AAC takes at a time."""


class SoundTrack:
    """One row of samples on its way into a container.

    Parameters
    ----------
    container : av.container.OutputContainer
    samples : (samples,) float32 array
        Mono [-1 to 1], from the first picture on.
    sample_rate : int
    """

    def __init__(self, container: Any, samples: Float32Array, sample_rate: int) -> None:
        codec = "libopus" if container.format.name == "webm" else "aac"
        self._container = container
        self._stream = container.add_stream(codec, rate=sample_rate, layout="mono")
        self._samples = samples
        self._rate = sample_rate
        self._done = 0

    def encode_until(self, seconds: Fraction) -> None:
        """Encode the whole blocks that begin before a moment."""
        self._encode(min(int(seconds * self._rate), len(self._samples)), last=False)

    def finish(self) -> None:
        """Encode what is left."""
        self._encode(len(self._samples), last=True)
        self._container.mux(self._stream.encode())

    def _encode(self, stop: int, *, last: bool) -> None:
        while self._done < stop and (last or stop - self._done >= _BLOCK):
            block = self._samples[self._done : min(self._done + _BLOCK, stop)]
            limited = np.clip(np.asarray(block, np.float32), -1, 1)
            frame = av.AudioFrame.from_ndarray(
                np.ascontiguousarray(limited[None]), format="fltp", layout="mono"
            )
            frame.sample_rate, frame.pts = self._rate, self._done
            frame.time_base = Fraction(1, self._rate)
            self._container.mux(self._stream.encode(frame))
            self._done += len(block)
