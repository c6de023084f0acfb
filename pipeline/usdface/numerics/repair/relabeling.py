"""Detection and correction of swapped labels of two markers.

A swap is a state that begins and ends with a jump, during which each marker is at the other's
predicted position. From the evidence of each likely pair (see `swap_evidence`), the Viterbi
algorithm finds the most likely sequence of states over the take.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from usdface.core.arrays import (
    BoolArray,
    Float32Array,
    IntArray,
    RealArray,
    distances,
    extend_block,
    frame_blocks,
    runs,
)
from usdface.core.processes import map_threads
from usdface.numerics.repair.low_rank import LowRankModel
from usdface.numerics.repair.swap_evidence import (
    JUMP_LIMITS,
    TOGGLE_COST,
    Pair,
    jumps_between,
    likely_pairs,
    open_window,
    pair_directed_as,
    suspicious_pairs,
    weigh_swap,
)

_JUMP_MEDIAN_STEPS = 6.0
"""[of the median step] Larger steps between frames are jumps."""
_STEP_SAMPLE_FRAMES = 8192
_LONGEST_SWAP_SHARE = 0.5
"""[of the take] Longer swaps are taken for the true labels."""
_LEAST_GAIN = 20.0
"""[nats] Least evidence of a swap over its frames."""
_DULL_GAIN = -1.0
"""[nats] Frames with at most this evidence for a swap are dull."""
_DULL_FRAMES = 1 + int(2.0 * (TOGGLE_COST + JUMP_LIMITS[1]) / -_DULL_GAIN)
"""Number of consecutive dull frames whose evidence outweighs the cost of two changes of state."""


@dataclass(frozen=True)
class Swap:
    """Two markers with each other's label over a range of frames."""

    first: int
    second: int
    """`first`, `second`: Columns, ascending."""
    start: int
    stop: int
    """`start`, `stop`: Frame indices, the stop exclusive."""


def find_swaps(
    positions: RealArray, visible: BoolArray, *, model: LowRankModel, noise: float, neutral: int
) -> tuple[Swap, ...]:
    """Find the ranges of frames in which two markers have each other's label.

    Returns them by start; no marker is in two at the same time.

    Parameters
    ----------
    positions : (frames, markers, 3) float array
        [mm] Without head motion; anything where not visible.
    visible : (frames, markers) bool array
        Measured samples.
    model : LowRankModel
        Fitted to the same take, with its swaps.
    noise : float
        Standard deviation of a measured coordinate [mm].
    neutral : int
        Index of a frame whose labels are right, unless the pair is swapped for most of the take.
    """
    step_scale = _jump_scale(positions, visible, noise)
    pairs = likely_pairs(positions, visible, model, noise, step_scale)

    def hints_in(block: slice) -> BoolArray:
        before = slice(max(block.start - 1, 0), block.stop)
        window = open_window(positions[before], visible[before], model)
        return suspicious_pairs(pairs, window, step_scale=step_scale)

    # One frame suffices: of a swap to the end of a take, which the model may have fitted, only the
    # first jump hints.
    hints = np.any(map_threads(hints_in, frame_blocks(len(positions))), axis=0)
    suspects = [pair for pair, is_suspect in zip(pairs, hints, strict=True) if is_suspect]

    def swaps_of(pairs: list[Pair]) -> list[list[tuple[float, Swap]]]:
        weighed = _gather_evidence(pairs, positions, visible, model, step_scale)
        found = [[*_swaps_of(*each)] for each in zip(pairs, weighed, strict=True)]
        lengths = [sum(swap.stop - swap.start for _, swap in each) for each in found]
        return [each if n <= longest else [] for each, n in zip(found, lengths, strict=True)]

    longest = _LONGEST_SWAP_SHARE * len(positions)
    found = swaps_of(suspects)
    # The mean direction of a pair is the other way round after a long swap, or a long blink.
    doubted = [
        row
        for row, (pair, swaps) in enumerate(zip(suspects, found, strict=True))
        if any(swap.start <= neutral < swap.stop for _, swap in swaps)
        and visible[neutral, [pair.first, pair.second]].all()
    ]
    turned = [pair_directed_as(suspects[row], positions[neutral]) for row in doubted]
    for row, swaps in zip(doubted, swaps_of(turned), strict=True):
        found[row] = swaps or found[row]
    candidates = [each for swaps in found for each in swaps if each[0] >= _LEAST_GAIN]
    return _without_conflicts(candidates)


def jumps_onto_lost(positions: RealArray, visible: BoolArray, *, noise: float) -> BoolArray:
    """Return samples of markers that jumped to where another was lost: (frames, markers).

    Until the other is visible again, or a step as large, they may have its label. A model that is
    fitted to them predicts a marker at either place, and cannot tell which label is right.

    Parameters
    ----------
    positions : (frames, markers, 3) float array
        [mm] Without head motion; anything where not visible.
    visible : (frames, markers) bool array
    noise : float
        Standard deviation of a measured coordinate [mm].
    """
    scale = _jump_scale(positions, visible, noise)
    found = np.zeros(visible.shape, np.bool_)
    # A swap from the beginning ends with such a jump in the reverse direction of time.
    for points, seen, out in (
        (positions, visible, found),
        (positions[::-1], visible[::-1], found[::-1]),
    ):
        for frame, marker, other in jumps_between(points, seen, scale).tolist():
            if seen[frame, other]:
                continue
            rows = np.flatnonzero(seen[:, marker])
            steps = distances(points[rows[1:], marker], points[rows[:-1], marker])
            jump = int(np.searchsorted(rows, frame))
            back = rows[jump + 1 :][steps[jump:] > steps[jump - 1] / 2]
            again = frame + np.flatnonzero(seen[frame:, other])
            stop = min([len(seen), *back[:1], *again[:1]])
            out[frame:stop, marker] = seen[frame:stop, marker]
    return found


def apply_swaps(values: NDArray[np.generic], swaps: tuple[Swap, ...]) -> None:
    """Exchange the two columns of every swap in (frames, markers, ...) values, in place."""
    for swap in swaps:
        rows = slice(swap.start, swap.stop)
        first = values[rows, swap.first].copy()
        values[rows, swap.first] = values[rows, swap.second]
        values[rows, swap.second] = first


def likeliest_states(gain: RealArray, toggle: RealArray) -> BoolArray:
    """Return the sequence of two states with the largest total gain less the cost of changes.

    Parameters
    ----------
    gain : (frames,) float array
        Of state True over state False in each frame.
    toggle : (frames,) float array
        Cost of a change of state from the previous frame; may be negative.

    Notes
    -----
    Viterbi's algorithm on the difference d of the costs of True and False: with a cost p of a
    change, d becomes d limited to ±p (with the sign reversed for negative p), less the gain.
    """
    to_true = np.zeros(len(gain), bool)
    to_false = np.zeros(len(gain), bool)
    difference = np.inf  # the take begins in state False, or in True at the cost of one change
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


class _Evidence(NamedTuple):
    """Frames of a pair in or near a possible swap, their gains and costs of changes [nats]."""

    frames: IntArray
    gain: Float32Array
    toggle: Float32Array


def _gather_evidence(
    suspects: list[Pair],
    positions: RealArray,
    visible: BoolArray,
    model: LowRankModel,
    step_scale: float,
) -> list[_Evidence]:
    """Return the evidence of each suspect, without long runs of dull frames, which end a swap."""

    def weigh(block: slice) -> list[_Evidence]:
        around = extend_block(block, _DULL_FRAMES + 1, len(positions))
        start = around.start
        window = open_window(positions[around], visible[around], model)
        inner = np.arange(block.start, block.stop) - start
        parts = []
        for pair in suspects:
            gain, toggle = weigh_swap(pair, window, step_scale=step_scale)
            lively = np.concatenate([[0], np.cumsum((gain > _DULL_GAIN) | (toggle < 0))])
            low = np.maximum(inner - _DULL_FRAMES, min(start, 1))
            high = np.minimum(inner + _DULL_FRAMES, len(gain) - 1)
            near = inner[lively[high + 1] > lively[low]]
            parts.append(_Evidence(near + start, gain[near], toggle[near]))
        return parts

    weighed = map_threads(weigh, frame_blocks(len(positions)) if suspects else ())
    return [
        _Evidence(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))
        for parts in zip(*weighed, strict=True)
    ]


def _swaps_of(pair: Pair, found: _Evidence) -> Iterator[tuple[float, Swap]]:
    """Yield the most likely swaps of a pair, each with its total evidence [nats]."""
    breaks = np.flatnonzero(np.diff(found.frames) > 1) + 1
    for part in np.split(np.arange(len(found.frames)), breaks):
        gain, toggle = found.gain[part], found.toggle[part]
        for start, stop in runs(likeliest_states(gain, toggle)):
            worth = float(gain[start:stop].sum(dtype=np.float64)) - float(toggle[start])
            first = int(found.frames[part[start]])
            yield worth, Swap(pair.first, pair.second, first, first + stop - start)


def _jump_scale(positions: RealArray, visible: BoolArray, noise: float) -> float:
    """Return the smallest step between frames, per coordinate, that is a jump [mm]."""
    middle = len(positions) // 2
    half = _STEP_SAMPLE_FRAMES // 2
    stretch = slice(max(0, middle - half), middle + half)
    both = visible[stretch][1:] & visible[stretch][:-1]
    steps = np.abs(np.diff(positions[stretch], axis=0))[both]
    median = float(np.median(steps)) if steps.size else 0.0
    return max(_JUMP_MEDIAN_STEPS * median, 3.0 * noise, 1e-3)


def _without_conflicts(candidates: list[tuple[float, Swap]]) -> tuple[Swap, ...]:
    """Return the swaps with the largest evidence, of which none share a marker at the same time."""
    chosen: list[Swap] = []
    for _, swap in sorted(candidates, key=lambda candidate: -candidate[0]):
        clash = any(
            {swap.first, swap.second} & {other.first, other.second}
            and swap.start < other.stop
            and other.start < swap.stop
            for other in chosen
        )
        if not clash:
            chosen.append(swap)
    return tuple(sorted(chosen, key=lambda swap: (swap.start, swap.first)))
