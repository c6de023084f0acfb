"""A take's frames a block at a time: what is worked out frame by frame takes no memory of a take.

What a frame becomes must not depend on where blocks begin: what looks at frames beside it is given
them, too.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

_BLOCK_FRAMES = 2048
"""Arrays of a hundred markers stay near the processor's cache."""


def frame_blocks(count: int, *, frames: int | None = None, at_least: int = 1) -> Iterator[slice]:
    """Yield the frames of a take in blocks of `frames`, by default `_BLOCK_FRAMES`."""
    size = max(_BLOCK_FRAMES if frames is None else frames, at_least)
    for start in range(0, count, size):
        yield slice(start, min(start + size, count))


def widened(block: slice, frames: int, count: int) -> slice:
    """Return a block with so many frames more on both sides, as far as the take goes."""
    return slice(max(block.start - frames, 0), min(block.stop + frames, count))


def sample_frames(count: int, most: int) -> NDArray[np.int64]:
    """Return at most so many frames, spread evenly over the take."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).astype(np.int64))
