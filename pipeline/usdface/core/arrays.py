"""Array types by element, as every signature names them; frames in runs, columns by name."""

from collections.abc import Hashable, Iterable, Iterator, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]
RealArray = NDArray[np.floating]
"""Single or double precision: the result has the precision of the argument."""
ComplexArray = NDArray[np.complex64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
ByteImage = NDArray[np.uint8]
"""(height, width, 3), sRGB."""

Label = TypeVar("Label", bound=Hashable)

MAD_TO_DEVIATION = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation, 1 / Φ⁻¹(3/4)."""

_BLOCK_FRAMES = 2048
"""[frames] Arrays of a hundred markers in so many frames stay near the processor's cache."""


def index_of(labels: Iterable[Label]) -> dict[Label, int]:
    """Return where each label stands in a list; of equal ones, the last."""
    return {label: index for index, label in enumerate(labels)}


def columns_by_name(
    values: NDArray[np.floating], names: Sequence[str], wanted: Sequence[str]
) -> FloatArray:
    """Return columns in the order of other names; 0 for those that are not there.

    Parameters
    ----------
    values : (rows, names) float array
        In single precision too, as samples in layers are.
    """
    column = index_of(names)
    there = [index for index, name in enumerate(wanted) if name in column]
    out = np.zeros((len(values), len(wanted)))
    out[:, there] = values[:, [column[wanted[index]] for index in there]]
    return out


ROUNDING_SHARE = 1e-9
"""Results that differ by less, as a share, are equal: sums of a million terms round to 2e-10."""

_LEAST_SINGLE = np.float32(1e-9)


def single_precision(values: NDArray[np.floating]) -> Float32Array:
    """Return values as float32, those nearer to 0 than 1e-9 as 0.

    In products they would end below what float32 holds in full (1e-38), on which processors work
    ten times slower, and in millimetres or weights they mean nothing.
    """
    single = values.astype(np.float32)
    single[np.abs(single) < _LEAST_SINGLE] = 0
    return single


def row_lengths(rows: NDArray[np.floating]) -> Any:
    """Return the length of each row, (n, k) to (n, 1), of their type.

    A third of the time of `numpy.linalg.norm`, which sums short rows one by one.
    """
    return np.sqrt(np.einsum("ij,ij->i", rows, rows))[:, None]


def first_largest(values: FloatArray) -> int:
    """Return where the largest value is; of those that differ by rounding alone, the first.

    A choice that hung on the last bit would differ between processors.
    """
    top = values.max()
    return int((values >= top - ROUNDING_SHARE * abs(top)).argmax())


def first_smallest(values: FloatArray) -> IntArray:
    """Return for each column the row of the smallest value, by the rule of `first_largest`."""
    least = values.min(axis=0)
    return np.asarray((values <= least + ROUNDING_SHARE * np.abs(least)).argmax(axis=0), np.int64)


def hold_last_seen(positions: NDArray[np.floating], seen: BoolArray) -> None:
    """Give unseen samples the last seen position, or before the first sighting that one; in place.

    Parameters
    ----------
    positions : (frames, markers, 3) array
        Markers that are never seen stay as they are.
    seen : (frames, markers) bool array
    """
    frames = np.arange(len(seen))
    for marker in np.flatnonzero(~seen.all(axis=0) & seen.any(axis=0)):
        known = seen[:, marker]
        latest = np.maximum.accumulate(np.where(known, frames, -1))
        latest[latest < 0] = int(np.argmax(known))
        positions[~known, marker] = positions[latest[~known], marker]


def runs(mask: BoolArray) -> list[tuple[int, int]]:
    """Return the stretches where `mask` is True as (start, stop), the stop left out."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [(int(start), int(stop)) for start, stop in edges.reshape(-1, 2)]


def longest_run(mask: BoolArray) -> int:
    """Return the length of the longest run of True."""
    return max((stop - start for start, stop in runs(mask)), default=0)


def frame_blocks(count: int, *, frames: int | None = None, at_least: int = 1) -> Iterator[slice]:
    """Yield the frames of a take in blocks, so that intermediate arrays need no take's memory.

    What a frame becomes must not depend on where blocks begin: what looks at neighbouring frames is
    given them by `widened`.

    Parameters
    ----------
    frames : int, optional
        Frames of a block; by default 2048.
    at_least : int
        Frames that a block has even where `frames` is less.
    """
    size = max(_BLOCK_FRAMES if frames is None else frames, at_least)
    for start in range(0, count, size):
        yield slice(start, min(start + size, count))


def widened(block: slice, frames: int, count: int) -> slice:
    """Return a block with so many frames more on both sides, as far as the take goes."""
    return slice(max(block.start - frames, 0), min(block.stop + frames, count))


def sample_frames(count: int, most: int) -> IntArray:
    """Return at most so many indices, spread evenly over the frames of a take or other rows."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).astype(np.int64))
