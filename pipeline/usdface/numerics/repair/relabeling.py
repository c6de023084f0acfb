"""Labels that have changed places between two neighbouring markers, found and put back.

A swap is a state that lasts: it begins and ends with a jump and in between both markers lie where
the other should be. Three evidences are weighed for every pair of neighbours, and the likeliest
course of states over the whole take is found by the Viterbi algorithm. All three are needed: the
prediction from the other markers alone is too weak between close neighbours, direction alone
mistakes a grimace for a swap, jumps alone mistake noise beside a gap for one.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from usdface.numerics.repair.gaps import runs
from usdface.numerics.repair.low_rank import LowRankModel
from usdface.numerics.repair.noise import measurement_noise

_NEIGHBORS = 8
_CHUNK_FRAMES = 4096
_TOGGLE_COST = 12.0
"""[nats] A change of state without any jump: once in 160,000 frames by chance."""
_PLACE_LIMIT = 5.0
"""[nats] Most that one frame's places can say: residuals have heavy tails."""
_DIRECTION_WEIGHT = 8.0
"""[nats] What one frame's direction says when it is fully the other way round."""
_JUMP_LIMITS = (-80.0, 60.0)
_JUMP_STEPS = 6.0
"""Usual steps between frames that make a jump."""
_ALONE_STRICTNESS = 4.0
"""A marker seen alone must lie twice as near to the other's place as to its own."""
_PLACE_HINT = 4.0
_JUMP_HINT = -20.0
_HINTS_NEEDED = 2
_LONGEST_SHARE = 0.5
"""Labels swapped for more than half of the take would be the labels."""
_LEAST_GAIN = 20.0
"""[nats] Evidence a single swap must gather over all its frames."""

FloatArray = NDArray[np.floating]


@dataclass(frozen=True)
class Swap:
    """Two markers that carry each other's label for a while.

    Attributes
    ----------
    first, second : int
        Columns, ascending.
    start, stop : int
        Frame indices, the stop left out.
    """

    first: int
    second: int
    start: int
    stop: int


@dataclass(frozen=True)
class _Pair:
    """What tells a pair's swaps: fixed over the take."""

    first: int
    second: int
    direction: NDArray[np.float64]
    place_variance: float


@dataclass(frozen=True)
class _Evidence:
    """One pair over some frames: gain of being swapped, cost of changing state, in nats."""

    gain: NDArray[np.float64]
    toggle: NDArray[np.float64]
    hints: int


def find_swaps(
    positions: FloatArray, visible: NDArray[np.bool_], *, model: LowRankModel
) -> tuple[Swap, ...]:
    """Find the stretches in which two neighbouring markers carry each other's label.

    Parameters
    ----------
    positions : (frames, markers, 3) float array
        [mm] Without head motion and complete: gaps filled from the model.
    visible : (frames, markers) bool array
        What was measured; filled samples are no evidence.
    model : LowRankModel
        Learned from the same take, swaps in it.

    Returns
    -------
    tuple of Swap
        By start; no marker is in two at once.
    """
    noise = measurement_noise(positions, visible)
    step_scale = _jump_scale(positions, visible, noise)
    pairs = _neighbor_pairs(positions, model, noise)
    hints = np.zeros(len(pairs), np.int64)
    for chunk in _chunks(len(positions)):
        hints += [e.hints for e in _gather(pairs, positions, visible, model, chunk, step_scale)]
    suspects = [pair for pair, count in zip(pairs, hints, strict=True) if count >= _HINTS_NEEDED]
    gains = np.empty((len(suspects), len(positions)), np.float32)
    toggles = np.empty_like(gains)
    for chunk in _chunks(len(positions)):
        found = _gather(suspects, positions, visible, model, chunk, step_scale)
        for row, evidence in enumerate(found):
            gains[row, chunk], toggles[row, chunk] = evidence.gain, evidence.toggle
    candidates: list[tuple[float, Swap]] = []
    for pair, gain, toggle in zip(suspects, gains, toggles, strict=True):
        states = likeliest_states(gain, toggle)
        if states.mean() > _LONGEST_SHARE:
            continue
        for start, stop in runs(states):
            worth = float(gain[start:stop].sum(dtype=np.float64)) - float(toggle[start])
            if worth >= _LEAST_GAIN:
                candidates.append((worth, Swap(pair.first, pair.second, start, stop)))
    return _without_conflicts(candidates)


def apply_swaps(values: NDArray[np.generic], swaps: tuple[Swap, ...]) -> None:
    """Exchange the two columns of every swap over its frames, in place.

    Parameters
    ----------
    values : (frames, markers, ...) array
    swaps : tuple of Swap
    """
    for swap in swaps:
        rows = slice(swap.start, swap.stop)
        first = values[rows, swap.first].copy()
        values[rows, swap.first] = values[rows, swap.second]
        values[rows, swap.second] = first


def likeliest_states(gain: NDArray[np.floating], toggle: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Return the course of two states with the largest total gain less the cost of changes.

    Parameters
    ----------
    gain : (frames,) float array
        Of state True over state False in each frame.
    toggle : (frames,) float array
        Cost of being in another state than in the frame before; may be negative.

    Notes
    -----
    Viterbi's algorithm. Two states need only the difference of their costs: with d the cost of
    True less that of False, a change costs p either way, so that d becomes d limited to ±p (the
    sign turned when p is negative), less the gain.
    """
    to_true = np.zeros(len(gain), bool)
    to_false = np.zeros(len(gain), bool)
    difference = np.inf  # the first frame may begin in either state, at the cost of one change
    rows = zip(gain.tolist(), toggle.tolist(), strict=True)
    for frame, (g, p) in enumerate(rows):
        if frame == 0:
            difference = max(p, 0.0) - g
            continue
        false_from_true = difference + p < 0
        true_from_false = difference > p
        to_false[frame], to_true[frame] = false_from_true, true_from_false
        cost_false = difference + p if false_from_true else 0.0
        cost_true = p if true_from_false else difference
        difference = cost_true - cost_false - g
    states = np.zeros(len(gain), bool)
    state = bool(difference < 0)
    for frame in range(len(gain) - 1, -1, -1):
        states[frame] = state
        if to_true[frame] if state else to_false[frame]:
            state = not state
    return states


def _neighbor_pairs(positions: FloatArray, model: LowRankModel, noise: float) -> list[_Pair]:
    """Return every pair of near neighbours, with how well the other markers predict it."""
    rest = model.mean.reshape(-1, 3)
    distances = np.linalg.norm(rest[:, None] - rest[None], axis=2)
    nearest = np.argsort(distances, axis=1)[:, 1 : _NEIGHBORS + 1]
    chosen = sorted({(min(a, b), max(a, b)) for a, row in enumerate(nearest.tolist()) for b in row})
    sample = positions[np.unique(np.linspace(0, len(positions) - 1, _CHUNK_FRAMES).astype(int))]
    pull = _pull(model, sample)
    pairs = []
    for first, second in chosen:
        away = _pair_offsets(model, pull, first, second)
        # The median of squares of a normal variable is 0.455 of its variance.
        variance = max(float(np.median(away**2)) / 0.455, 2.0 * noise**2, 1e-4)
        pairs.append(_Pair(first, second, rest[second] - rest[first], variance))
    return pairs


def _gather(
    pairs: list[_Pair],
    positions: FloatArray,
    visible: NDArray[np.bool_],
    model: LowRankModel,
    chunk: slice,
    step_scale: float,
) -> list[_Evidence]:
    """Return the evidence of every pair over one chunk of frames."""
    before = max(chunk.start - 1, 0)
    lead = chunk.start - before
    window = positions[before : chunk.stop].astype(np.float64)
    seen = visible[before : chunk.stop]
    pull = _pull(model, window)
    evidence = []
    for pair in pairs:
        x, y = window[:, pair.first], window[:, pair.second]
        x_seen, y_seen = seen[:, pair.first], seen[:, pair.second]
        away = _pair_offsets(model, pull, pair.first, pair.second)
        x_away, y_away = away[:, :3], away[:, 3:]
        between = y - x
        apart = between + x_away - y_away  # between the places where the two should be
        place = (
            _weigh(
                np.minimum(
                    _square(x_away) - _square(x_away + between),
                    _square(y_away) - _square(y_away - between),
                ),
                _square(x_away) - _ALONE_STRICTNESS * _square(x_away - apart),
                _square(y_away) - _ALONE_STRICTNESS * _square(y_away + apart),
                x_seen,
                y_seen,
            )
            / pair.place_variance
        )
        direction = pair.direction / max(float(pair.direction @ pair.direction), 1e-12)
        along = _weigh(  # 1 when each lies on its own side, -1 when on the other's
            between @ direction,
            1.0 - 2.0 * x_away @ direction,
            1.0 + 2.0 * y_away @ direction,
            x_seen,
            y_seen,
        )
        gain = np.clip(place, -_PLACE_LIMIT, _PLACE_LIMIT)
        gain -= _DIRECTION_WEIGHT * np.clip(along, -1.0, 1.0)
        jump = np.zeros(len(window))
        jump[1:] = (
            _weigh(
                np.maximum(_jump_evidence(x, y), _jump_evidence(y, x)),
                _jump_alone(x, apart),
                _jump_alone(y, apart),
                x_seen[1:] & x_seen[:-1],
                y_seen[1:] & y_seen[:-1],
            )
            / step_scale**2
        )
        toggle = _TOGGLE_COST + np.clip(jump, *_JUMP_LIMITS)
        hints = int((place[lead:] > _PLACE_HINT).sum()) + int((jump[lead:] < _JUMP_HINT).sum())
        evidence.append(_Evidence(gain[lead:], toggle[lead:], hints))
    return evidence


def _weigh(
    together: NDArray[np.float64],
    x_alone: NDArray[np.float64],
    y_alone: NDArray[np.float64],
    x_seen: NDArray[np.bool_],
    y_seen: NDArray[np.bool_],
) -> NDArray[np.float64]:
    """Choose what is known: both markers, one against where the other should be, or nothing."""
    alone = np.where(x_seen, x_alone, np.where(y_seen, y_alone, 0.0))
    return np.asarray(np.where(x_seen & y_seen, together, alone))


def _square(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(np.einsum("fi,fi->f", vectors, vectors))


def _jump_evidence(track: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return by how much a step is shorter when it began at the other marker; negative then."""
    return _square(track[1:] - other[:-1]) - _square(np.diff(track, axis=0))


def _jump_alone(track: NDArray[np.float64], apart: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the same where the other marker is hidden and only its place is known."""
    step = np.diff(track, axis=0)
    one_way, other_way = _square(step - apart[1:]), _square(step + apart[1:])
    return np.minimum(one_way, other_way) - _square(step)


def _pull(model: LowRankModel, frames: FloatArray) -> NDArray[np.float64]:
    flat = frames.reshape(len(frames), -1).astype(np.float64)
    return np.asarray((flat - model.mean) @ model.precision)


def _pair_offsets(
    model: LowRankModel, pull: NDArray[np.float64], first: int, second: int
) -> NDArray[np.float64]:
    """Return how far a pair lies from where all other markers put it, (frames, 6)."""
    entries = np.r_[3 * first : 3 * first + 3, 3 * second : 3 * second + 3]
    own = np.linalg.inv(model.precision[np.ix_(entries, entries)])
    return np.asarray(pull[:, entries] @ own)  # x - E[x | others], from the precision matrix


def _jump_scale(positions: FloatArray, visible: NDArray[np.bool_], noise: float) -> float:
    """Return the size of a step between frames, per coordinate, that begins to be a jump."""
    middle = len(positions) // 2
    stretch = slice(max(0, middle - 4 * _CHUNK_FRAMES), middle + 4 * _CHUNK_FRAMES)
    both = visible[stretch][1:] & visible[stretch][:-1]
    steps = np.abs(np.diff(positions[stretch], axis=0))[both]
    usual = float(np.median(steps)) if steps.size else 0.0
    return max(_JUMP_STEPS * usual, 3.0 * noise, 1e-3)


def _chunks(count: int) -> list[slice]:
    return [slice(at, min(at + _CHUNK_FRAMES, count)) for at in range(0, count, _CHUNK_FRAMES)]


def _without_conflicts(candidates: list[tuple[float, Swap]]) -> tuple[Swap, ...]:
    """Keep the best supported swaps; a marker can take part in only one at a time."""
    kept: list[Swap] = []
    for _, swap in sorted(candidates, key=lambda candidate: -candidate[0]):
        clash = any(
            {swap.first, swap.second} & {other.first, other.second}
            and swap.start < other.stop
            and other.start < swap.stop
            for other in kept
        )
        if not clash:
            kept.append(swap)
    return tuple(sorted(kept, key=lambda swap: (swap.start, swap.first)))
