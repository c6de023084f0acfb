"""Array types, blocks and runs of frames, columns by name."""

from collections.abc import Hashable, Iterable, Iterator, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]
RealArray = NDArray[np.floating]
"""Single or double precision; results have that of the argument."""
ComplexArray = NDArray[np.complex64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
ByteImage = NDArray[np.uint8]
"""(height, width, 3), sRGB."""
Arrays = dict[str, FloatArray]
"""By name, as assets store them."""

Label = TypeVar("Label", bound=Hashable)
Real = TypeVar("Real", bound=np.floating)

MAD_TO_DEVIATION = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation, 1 / Φ⁻¹(3/4)."""

_BLOCK_FRAMES = 2048
"""[frames] Arrays of a hundred markers in so many frames fit in the cache."""


def index_of(labels: Iterable[Label]) -> dict[Label, int]:
    """Return the index of each label, the last of equal ones."""
    return {label: index for index, label in enumerate(labels)}


def columns_by_name(
    values: NDArray[np.floating], names: Sequence[str], wanted: Sequence[str]
) -> FloatArray:
    """Return columns in the order of other names; 0 for missing ones.

    `values`: (rows, names), single or double precision.
    """
    column = index_of(names)
    present = [index for index, name in enumerate(wanted) if name in column]
    out = np.zeros((len(values), len(wanted)))
    out[:, present] = values[:, [column[wanted[index]] for index in present]]
    return out


ROUNDING_SHARE = 1e-9
"""Relative difference up to which results are equal: the rounding of a million terms is 2e-10."""

_EQUAL_SHARE = 1e-6
"""[of the largest distance] A smaller distance is rounding error of squares that cancel."""

_LEAST_SINGLE = np.float32(1e-9)


def single_precision(values: NDArray[np.floating]) -> Float32Array:
    """Return values as float32, with magnitudes below 1e-9 as 0.

    Their products may be denormal (below 1e-38), which is ten times slower, and they are
    meaningless in millimetres or weights.
    """
    single = values.astype(np.float32)
    single[np.abs(single) < _LEAST_SINGLE] = 0
    return single


def row_lengths(rows: NDArray[np.floating]) -> Any:
    """Return the length of each row, (..., k) to (..., 1), of their type.

    Three times as fast as `numpy.linalg.norm` for short rows.
    """
    return np.sqrt(np.einsum("...i,...i->...", rows, rows))[..., None]


def distances(one: NDArray[np.floating], other: NDArray[np.floating]) -> Any:
    """Return the distances of points, (..., k) to (...), of their type."""
    return row_lengths(one - other)[..., 0]


def rms_radius(points: FloatArray, weights: FloatArray | None = None) -> float:
    """Return the root mean square distance of points, (n, 3), from their mean; both weighted."""
    squared = ((points - np.average(points, axis=0, weights=weights)) ** 2).sum(axis=1)
    return float(np.sqrt(np.average(squared, weights=weights)))


def relative_distances(rows: FloatArray) -> FloatArray:
    """Return distances between all rows, over the median between rows that differ: (rows, rows)."""
    product = rows @ rows.T
    squares = np.diag(product)
    away = np.sqrt(np.maximum(squares[:, None] + squares - 2 * product, 0.0))
    between = away[np.triu_indices(len(rows), 1)]
    differing = between[between > _EQUAL_SHARE * away.max()]
    return np.asarray(away / (np.median(differing) if len(differing) else 1.0))


def nearest_distances(between: FloatArray) -> FloatArray:
    """Return the distance of each place to the nearest at another position; infinite if none is.

    `between`: (places, places), 0 between those at one position.
    """
    return np.asarray(np.where(between > 0, between, np.inf).min(axis=1))


def medians_where(values: RealArray, mask: BoolArray) -> FloatArray:
    """Return the median of each column over the rows of a mask; 0 where it has none."""
    columns = zip(values.T, mask.T, strict=True)
    return np.array([np.median(column[ok]) if ok.any() else 0.0 for column, ok in columns], float)


def median_places(positions: RealArray, seen: BoolArray) -> FloatArray:
    """Return the median place of each marker over the frames in which it is seen: (markers, 3)."""
    tracks = zip(np.swapaxes(positions, 0, 1), seen.T, strict=True)
    places = [np.median(track[ok].astype(np.float64), axis=0) for track, ok in tracks]
    return np.array(places).reshape(-1, 3)


def first_largest(values: FloatArray) -> int:
    """Return the index of the largest value, the first of those equal within rounding.

    So that choices are the same on all processors.
    """
    top = values.max()
    return int((values >= top - ROUNDING_SHARE * abs(top)).argmax())


def first_smallest(values: FloatArray) -> IntArray:
    """Return the row of the smallest value of each column, by the rule of `first_largest`."""
    least = values.min(axis=0)
    return np.asarray((values <= least + ROUNDING_SHARE * np.abs(least)).argmax(axis=0), np.int64)


def hold_last_seen(positions: NDArray[np.floating], seen: BoolArray) -> None:
    """Fill samples that are not visible by the previous visible one, else by the first; in place.

    Parameters
    ----------
    positions : (frames, markers, 3) array
        Markers that are never visible are unchanged.
    seen : (frames, markers) bool array
    """
    frames = np.arange(len(seen))
    for marker in np.flatnonzero(~seen.all(axis=0) & seen.any(axis=0)):
        known = seen[:, marker]
        latest = np.maximum.accumulate(np.where(known, frames, -1))
        latest[latest < 0] = int(np.argmax(known))
        positions[~known, marker] = positions[latest[~known], marker]


def equal_rows(rows: BoolArray | FloatArray) -> list[IntArray]:
    """Return the groups of equal rows, as indices in ascending order.

    Frames with the same markers seen, for one, share a matrix.
    """
    if not len(rows):
        return []
    if (rows == rows[0]).all():
        return [np.arange(len(rows))]
    keys: NDArray[Any]
    if rows.dtype == np.bool_:
        keys = np.packbits(rows.astype(np.bool_, copy=False), axis=1)
    else:
        keys = rows + 0.0  # -0 becomes 0, which it is equal to
    groups: dict[bytes, list[int]] = {}
    for index, key in enumerate(keys):
        groups.setdefault(key.tobytes(), []).append(index)
    return [np.array(group) for group in groups.values()]


def smoothstep(values: NDArray[Real], low: float = 0.0, high: float = 1.0) -> NDArray[Real]:
    """Return ``t^2 (3 - 2 t)``, with t from 0 at `low` to 1 at `high`; falling if low > high."""
    t = np.clip((values - low) / (high - low), 0, 1)
    return np.asarray(t * t * (3 - 2 * t), values.dtype)


def coordinates_of(points: IntArray) -> IntArray:
    """Return the indices of the three coordinates of points, (n,) to (3 n,), in flat arrays."""
    return np.asarray((3 * points[:, None] + np.arange(3)).ravel())


def runs(mask: BoolArray) -> list[tuple[int, int]]:
    """Return the runs of True as (start, stop), the stop exclusive."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [(int(start), int(stop)) for start, stop in edges.reshape(-1, 2)]


def spaced_rows(order: IntArray, spacing: int) -> Iterator[int]:
    """Yield rows in an order of preference, none nearer than `spacing` to one before."""
    free = np.ones(int(order.max(initial=0)) + 1, np.bool_)
    for row in order.tolist():
        if free[row]:
            free[max(row - spacing + 1, 0) : row + spacing] = False
            yield row


def frame_blocks(count: int, *, frames: int | None = None, at_least: int = 1) -> Iterator[slice]:
    """Yield the frames of a take in blocks, which bounds the memory of intermediate arrays.

    Results must not depend on the blocks: filters use extended blocks (`extend_block`).

    Parameters
    ----------
    frames : int, optional
        Per block; by default 2048.
    at_least : int
        Lower limit of `frames`.
    """
    size = max(_BLOCK_FRAMES if frames is None else frames, at_least)
    for start in range(0, count, size):
        yield slice(start, min(start + size, count))


def extend_block(block: slice, frames: int, count: int) -> slice:
    """Return a block extended by a number of frames on both sides, within the take."""
    return slice(max(block.start - frames, 0), min(block.stop + frames, count))


def sample_frames(count: int, most: int) -> IntArray:
    """Return at most `most` evenly spaced indices of `count` frames or other rows."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).astype(np.int64))
