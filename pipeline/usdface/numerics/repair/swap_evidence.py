"""Evidence per frame that two markers have each other's label.

Three kinds, all needed: positions against predictions from the other markers are too weak between
close neighbours, directions alone mistake a grimace for a swap, and jumps alone mistake noise next
to a gap for one.
"""

from dataclasses import dataclass, replace

import numpy as np

from usdface.core.arrays import (
    BoolArray,
    Float32Array,
    IntArray,
    RealArray,
    distances,
    frame_blocks,
    sample_frames,
)
from usdface.core.processes import map_threads
from usdface.numerics.repair.low_rank import LowRankModel, fill_and_predict

_NEIGHBOR_COUNT = 8
_SAMPLE_FRAMES = 4096
_LEAST_JUMP_SCALES = 4.0
"""[of the smallest jump] Least jump between markers that are not neighbours."""
_BLOCK_FRAMES = 64
"""[frames] Blocks whose extremes exclude a swap are not examined frame by frame."""
TOGGLE_COST = 12.0
"""[nats] Cost of a change of state without a jump: one in exp(12) = 160,000 frames by chance."""
_POSITION_LIMIT = 5.0
"""[nats] Largest evidence from the positions of one frame: residuals have heavy tails."""
_DIRECTION_WEIGHT = 8.0
"""[nats] Evidence from a reversed direction in one frame."""
JUMP_LIMITS = (-80.0, 60.0)
"""[nats] Limits of the contribution of jumps to the cost of a change."""
_ALONE_STRICTNESS = 4.0
"""Ratio of squared distances: if one marker alone is visible, it must lie twice as near to the
other's predicted position as to its own."""
_POSITION_HINT = 4.0
_JUMP_HINT = -20.0
"""[nats] Evidence in one frame above (below) which a pair is examined."""


@dataclass(frozen=True)
class Pair:
    """Two markers, and their constants over the take."""

    first: int
    second: int
    """`first`, `second`: Columns, ascending."""
    direction: Float32Array
    """(3,): vector from the first to the second in the mean face, over its squared length."""
    residual_variance: float
    """Of a coordinate about its prediction from all markers but the two [mm^2]."""
    mixing: Float32Array
    """(6, 6): maps the residuals of the two from their predictions by all other markers to those
    from their predictions by all markers but the two."""


@dataclass(frozen=True)
class Window:
    """Consecutive frames, shared by all pairs; each coordinate of a marker is contiguous."""

    positions: RealArray
    """(markers, 3, frames) [mm] Complete: gaps filled from the model."""
    offsets: RealArray
    """(markers, 3, frames): residuals from the prediction by all other markers [mm]."""
    seen: BoolArray
    """(markers, frames)"""


def open_window(positions: RealArray, visible: BoolArray, model: LowRankModel) -> Window:
    """Return consecutive frames with gaps filled, and residuals from their predictions."""
    complete, predicted = fill_and_predict(model, positions, visible)
    offsets = complete - predicted
    return Window(
        np.ascontiguousarray(complete.transpose(1, 2, 0)),
        np.ascontiguousarray(offsets.transpose(1, 2, 0)),
        np.ascontiguousarray(visible.T),
    )


def likely_pairs(
    positions: RealArray, visible: BoolArray, model: LowRankModel, noise: float, step_scale: float
) -> list[Pair]:
    """Return pairs that may be swapped, with the variance of their prediction residuals.

    Near neighbours, and markers of which one jumps to the last place of the other.
    """
    rest = model.mean.reshape(-1, 3)
    distances = np.linalg.norm(rest[:, None] - rest[None], axis=2)
    nearest = np.argsort(distances, axis=1)[:, 1 : _NEIGHBOR_COUNT + 1]
    pairs_of = [(a, b) for a, row in enumerate(nearest.tolist()) for b in row]
    pairs_of += jumps_between(positions, visible, step_scale)[:, 1:].tolist()
    chosen = sorted({(min(pair), max(pair)) for pair in pairs_of})
    rows = sample_frames(len(positions), _SAMPLE_FRAMES)
    window = open_window(positions[rows], visible[rows], model)
    pairs = []
    for first, second in chosen:
        mixing = _mixing(model, first, second)
        away = mixing @ window.offsets[[first, second]].reshape(6, -1)
        # The median of a squared normal variable is 0.455 times its variance.
        variance = max(float(np.median(away**2)) / 0.455, 2.0 * noise**2, 1e-4)
        pairs.append(Pair(first, second, _direction(rest, first, second), variance, mixing))
    return pairs


def jumps_between(positions: RealArray, visible: BoolArray, step_scale: float) -> IntArray:
    """Return frame, marker and other of each jump of a marker to another's last place: (jumps, 3).

    Parameters
    ----------
    positions : (frames, markers, 3) float array
        [mm] Anything where not visible.
    visible : (frames, markers) bool array
    step_scale : float
        Smallest step between frames, per coordinate, that is a jump [mm].
    """
    least = _LEAST_JUMP_SCALES * step_scale

    def find(block: slice) -> IntArray:
        first = max(block.start - 1, 0)
        points, seen = positions[first : block.stop], visible[first : block.stop]
        last = np.maximum.accumulate(np.where(seen, np.arange(len(seen))[:, None], -1), axis=0)
        before = np.take_along_axis(points, np.maximum(last, 0)[..., None], axis=0)[:-1]
        known = last[:-1] >= 0
        steps = distances(points[1:], before)
        frame, marker = np.nonzero((steps > least) & seen[1:] & known)
        away = np.where(
            known[frame], distances(points[frame + 1, marker][:, None], before[frame]), np.inf
        )
        near = away.min(axis=1, initial=np.inf) < np.minimum(least, steps[frame, marker] / 2)
        found = np.column_stack([frame + 1 + first, marker, away.argmin(axis=1)])
        return np.asarray(found[near], np.int64)

    return np.concatenate(map_threads(find, frame_blocks(len(positions))))


def pair_directed_as(pair: Pair, positions: RealArray) -> Pair:
    """Return a pair whose direction is that in one frame, (markers, 3) [mm]."""
    return replace(pair, direction=_direction(positions, pair.first, pair.second))


def _direction(positions: RealArray, first: int, second: int) -> Float32Array:
    between = positions[second].astype(np.float64) - positions[first]
    return np.asarray(between / max(float(between @ between), 1e-12), np.float32)


def suspicious_pairs(pairs: list[Pair], window: Window, *, step_scale: float) -> BoolArray:
    """Return whether any frame hints at a swap of each pair.

    Most pairs are excluded by bounds over blocks of frames: in a swap a residual is at least half
    of the distance of the two markers, and a jump needs a large step.
    """
    starts = np.arange(0, window.seen.shape[1], _BLOCK_FRAMES)
    high = np.maximum.reduceat(window.positions, starts, axis=2)
    low = np.minimum.reduceat(window.positions, starts, axis=2)
    middle, radius = (high + low) / 2, _length((high - low) / 2)
    off = np.maximum.reduceat(_length(window.offsets), starts, axis=1)
    steps = _steps(window).max(axis=1, initial=0.0)
    first = np.array([pair.first for pair in pairs])
    second = np.array([pair.second for pair in pairs])
    blocks = np.stack([pair.mixing for pair in pairs]).reshape(-1, 2, 3, 2, 3).swapaxes(2, 3)
    reach = np.sqrt(np.square(blocks).sum(axis=(3, 4)))[..., None]  # bounds the spectral norm
    away = np.maximum(
        reach[:, 0, 0] * off[first] + reach[:, 0, 1] * off[second],
        reach[:, 1, 0] * off[first] + reach[:, 1, 1] * off[second],
    )
    between = _length(middle[second] - middle[first]) - radius[first] - radius[second]
    displaced = (2.0 * away >= between).any(axis=1)
    jumped = np.maximum(steps[first], steps[second]) > -_JUMP_HINT * step_scale**2
    hints = np.zeros(len(pairs), np.bool_)
    for index in np.flatnonzero(displaced | jumped).tolist():
        pair = pairs[index]
        views = _views(pair, window)
        if displaced[index]:
            hints[index] = (_position_evidence(pair, views) > _POSITION_HINT).any()
        if jumped[index] and not hints[index]:
            hints[index] = (_jump_evidence(views, step_scale) < _JUMP_HINT).any()
    return hints


def weigh_swap(
    pair: Pair, window: Window, *, step_scale: float
) -> tuple[Float32Array, Float32Array]:
    """Return the gain of the swapped state and the cost of a change, per frame [nats]."""
    views = _views(pair, window)
    gain: RealArray = np.clip(_position_evidence(pair, views), -_POSITION_LIMIT, _POSITION_LIMIT)
    gain -= _DIRECTION_WEIGHT * np.clip(_direction_evidence(pair, views), -1.0, 1.0)
    toggle = TOGGLE_COST + np.clip(_jump_evidence(views, step_scale), *JUMP_LIMITS)
    return gain.astype(np.float32, copy=False), toggle.astype(np.float32, copy=False)


@dataclass(frozen=True)
class _Views:
    """A pair in a window: positions, and residuals from the predictions without the pair."""

    x: RealArray
    y: RealArray
    between: RealArray
    x_away: RealArray
    y_away: RealArray
    x_seen: BoolArray
    y_seen: BoolArray


def _views(pair: Pair, window: Window) -> _Views:
    x, y = window.positions[pair.first], window.positions[pair.second]
    away = pair.mixing @ window.offsets[[pair.first, pair.second]].reshape(6, -1)
    seen = window.seen
    return _Views(x, y, y - x, away[:3], away[3:], seen[pair.first], seen[pair.second])


def _position_evidence(pair: Pair, views: _Views) -> RealArray:
    """Return the squared distance to the own prediction less that to the other's, over variance."""
    square = _dot(views.between, views.between)
    x_along, y_along = _dot(views.x_away, views.between), _dot(views.y_away, views.between)
    # |x_away|^2 - |x_away + between|^2, and the same of y
    place: RealArray = 2.0 * np.minimum(-x_along, y_along) - square
    if not (views.x_seen.all() and views.y_seen.all()):
        x_square, y_square = _dot(views.x_away, views.x_away), _dot(views.y_away, views.y_away)
        x_alone = x_square - _ALONE_STRICTNESS * (y_square - 2.0 * y_along + square)
        y_alone = y_square - _ALONE_STRICTNESS * (x_square + 2.0 * x_along + square)
        place = _choose_seen(place, x_alone, y_alone, views.x_seen, views.y_seen)
    return place / np.float32(pair.residual_variance)


def _direction_evidence(pair: Pair, views: _Views) -> RealArray:
    """Return the direction of the pair projected on that at rest: 1 at rest, -1 if reversed."""
    return _choose_seen(
        pair.direction @ views.between,
        1.0 - 2.0 * (pair.direction @ views.x_away),
        1.0 + 2.0 * (pair.direction @ views.y_away),
        views.x_seen,
        views.y_seen,
    )


def _jump_evidence(views: _Views, step_scale: float) -> RealArray:
    """Return the squared step from the other marker less that from its own, over the scale."""
    x, y, x_seen, y_seen = views.x, views.y, views.x_seen, views.y_seen
    x_step, y_step = np.diff(x), np.diff(y)
    x_square, y_square = _dot(x_step, x_step), _dot(y_step, y_step)
    x_from_y, y_from_x = x[:, 1:] - y[:, :-1], y[:, 1:] - x[:, :-1]
    together = np.maximum(_dot(x_from_y, x_from_y) - x_square, _dot(y_from_x, y_from_x) - y_square)
    # Where one is hidden, only the offset between the predictions of the two is known.
    offset = (views.between + views.x_away - views.y_away)[:, 1:]
    length = _dot(offset, offset)
    x_alone = length - 2.0 * np.abs(_dot(x_step, offset))
    y_alone = length - 2.0 * np.abs(_dot(y_step, offset))
    jump = np.zeros(x.shape[1], x.dtype)
    jump[1:] = _choose_seen(
        together, x_alone, y_alone, x_seen[1:] & x_seen[:-1], y_seen[1:] & y_seen[:-1]
    )
    return jump / np.float32(step_scale**2)


def _choose_seen(
    together: RealArray,
    x_alone: RealArray,
    y_alone: RealArray,
    x_seen: BoolArray,
    y_seen: BoolArray,
) -> RealArray:
    """Choose the evidence by visibility: of both markers, one of them, or none (0)."""
    alone = np.where(x_seen, x_alone, np.where(y_seen, y_alone, np.float32(0.0)))
    return np.where(x_seen & y_seen, together, alone)


def _mixing(model: LowRankModel, first: int, second: int) -> Float32Array:
    # L (x - E[x | others but the pair]) = diag(L_xx, L_yy) (x - E[x | all others of each]), with L
    # the pair's block of the precision matrix.
    entries = np.r_[3 * first : 3 * first + 3, 3 * second : 3 * second + 3]
    block = model.precision_of(entries)
    diagonal = np.zeros((6, 6))
    diagonal[:3, :3], diagonal[3:, 3:] = block[:3, :3], block[3:, 3:]
    return np.linalg.solve(block, diagonal).astype(np.float32)


def _steps(window: Window) -> RealArray:
    """Return the squared step of each marker from the previous frame; 0 unless visible in both."""
    steps = np.diff(window.positions, axis=2)
    squares = np.einsum("mif,mif->mf", steps, steps)
    return squares * (window.seen[:, 1:] & window.seen[:, :-1])


def _length(vectors: RealArray) -> RealArray:
    """Return lengths over the second axis."""
    return np.sqrt(np.einsum("mif,mif->mf", vectors, vectors))


def _dot(one: RealArray, other: RealArray) -> RealArray:
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]
