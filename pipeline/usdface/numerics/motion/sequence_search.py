"""Occurrences of a sequence in a motion: Song et al. (2011), section 5.2, eq. 10.

The paper sums distances over frames and channels, so that its threshold of 1.0 depends on the
length and the rig. Here the threshold applies to the mean over frames of the root mean square
difference over channels, in the unit of a weight.

By the triangle inequality a sum of distances is at least the norm of the sum of differences.
Cumulative sums give this lower bound for all starts, for the whole sequence and then for its parts,
and exclude most of a long motion.
"""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import FloatArray, IntArray, distances

PAPER_DELTA = 1.0
"""Threshold of eq. 10 in the paper, for its source of 33 shapes and its sequence."""

_MATCH_SHARE = 0.5
"""[of `mean_face_distance`] Default threshold."""

_PART_COUNTS = (1, 4, 16)
"""Numbers of parts of a sequence, pass by pass."""
_BLOCK_STARTS = 1 << 15
"""Starts per block, which bounds the memory."""
_ROUNDING_SLACK = 1e-9
"""Relative, far above the rounding of cumulative sums: no match is excluded."""


@dataclass(frozen=True)
class Matches:
    """Occurrences of a sequence."""

    starts: IntArray
    """(k,): indices, ascending."""
    distances: FloatArray
    """(k,): mean over frames of the root mean square difference over channels."""
    threshold: float
    """Largest distance of a match."""


def mean_face_distance(sequence: FloatArray) -> float:
    """Return the distance of a sequence from its mean face."""
    deviation = np.linalg.norm(sequence - sequence.mean(axis=0), axis=1)
    return float(deviation.mean() / np.sqrt(sequence.shape[1]))


def sequence_distances(motion: FloatArray, sequence: FloatArray, starts: IntArray) -> FloatArray:
    """Return the normalised distances of eq. 10 between a motion and a sequence at some starts.

    Of motion (frames, channels) and sequence (m, channels): (starts,).
    """
    total = np.zeros(len(starts))
    for offset, row in enumerate(sequence):
        total += distances(motion[starts + offset], row)
    return np.asarray(total / (len(sequence) * np.sqrt(sequence.shape[1])))


def starts_within(motion: FloatArray, sequence: FloatArray, *, threshold: float) -> Matches:
    """Return all starts whose distance is within a threshold (the paper's F_st).

    Parameters
    ----------
    motion : (frames, channels) float array
    sequence : (m, channels) float array
    threshold : float
        See `Matches.distances`.
    """
    if motion.ndim != 2 or sequence.ndim != 2 or motion.shape[1] != sequence.shape[1]:
        raise ValueError(f"{motion.shape} motion and {sequence.shape} sequence differ in channels")
    if not 0 < len(sequence) <= len(motion):
        raise ValueError(f"a sequence of {len(sequence)} frames in a motion of {len(motion)}")
    if not threshold >= 0:
        raise ValueError(f"the threshold must be at least 0, got {threshold}")
    limit = threshold * len(sequence) * np.sqrt(sequence.shape[1])
    count = len(motion) - len(sequence) + 1
    starts, found = [], []
    for first in range(0, count, _BLOCK_STARTS):
        stop = min(first + _BLOCK_STARTS, count)
        part = motion[first : stop + len(sequence) - 1]
        candidates = _bounded_starts(part, sequence, limit)
        near = sequence_distances(part, sequence, candidates)
        starts.append(candidates[near <= threshold] + first)
        found.append(near[near <= threshold])
    return Matches(np.concatenate(starts), np.concatenate(found), threshold)


def find_sequence(
    motion: FloatArray, sequence: FloatArray, *, threshold: float | None = None
) -> Matches:
    """Return the occurrences of a sequence in a motion, the nearest of those that overlap.

    Parameters
    ----------
    motion : (frames, channels) float array
    sequence : (m, channels) float array
    threshold : float, optional
        See `Matches.distances`; by default half of `mean_face_distance`.

    Raises
    ------
    ValueError
        As `starts_within`, and if the sequence has no motion.
    """
    if threshold is None:
        threshold = _MATCH_SHARE * mean_face_distance(sequence)
        if threshold == 0.0:
            raise ValueError("the sequence stands still, so any face at rest matches it")
    return _drop_overlapping(starts_within(motion, sequence, threshold=threshold), len(sequence))


def find_published(motion: FloatArray, sequence: FloatArray, *, delta: float) -> Matches:
    """Return the occurrences of a sequence by the paper's own threshold and averages of starts.

    Parameters
    ----------
    motion : (frames, channels) float array
    sequence : (m, channels) float array
    delta : float
        Largest sum over the sequence's frames of distances over all channels.
    """
    threshold = delta / (len(sequence) * np.sqrt(sequence.shape[1]))
    matches = starts_within(motion, sequence, threshold=threshold)
    starts = merge_starts(matches.starts, len(sequence))
    return Matches(starts, sequence_distances(motion, sequence, starts), threshold)


def best_match(motion: FloatArray, sequence: FloatArray) -> Matches:
    """Return the start with the smallest distance, whatever that is."""
    sample = np.arange(0, len(motion) - len(sequence) + 1, max(len(sequence) // 8, 1))
    bound = float(sequence_distances(motion, sequence, sample).min())
    matches = starts_within(motion, sequence, threshold=bound)
    best = int(matches.distances.argmin())
    return Matches(matches.starts[[best]], matches.distances[[best]], bound)


def merge_starts(starts: IntArray, length: int) -> IntArray:
    """Return the average of all starts within one length of the first, and so on, as published."""
    merged: list[int] = []
    position = 0
    while position < len(starts):
        stop = int(np.searchsorted(starts, starts[position] + length))
        merged.append(round(float(starts[position:stop].mean())))
        position = stop
    return np.array(merged, dtype=np.int64)


def _drop_overlapping(matches: Matches, length: int) -> Matches:
    """Return the nearest of matches that overlap."""
    chosen: list[int] = []
    free = np.ones(int(matches.starts.max(initial=0)) + 1, dtype=np.bool_)
    for index in np.argsort(matches.distances, kind="stable").tolist():
        start = int(matches.starts[index])
        if free[start]:
            chosen.append(index)
            free[max(start - length + 1, 0) : start + length] = False
    order = sorted(chosen)
    return Matches(matches.starts[order], matches.distances[order], matches.threshold)


def _bounded_starts(motion: FloatArray, sequence: FloatArray, limit: float) -> IntArray:
    """Return the starts whose lower bounds, by sums over parts of the sequence, meet the limit."""
    sums = np.concatenate([np.zeros((1, motion.shape[1])), np.cumsum(motion, axis=0)])
    starts: IntArray = np.arange(len(motion) - len(sequence) + 1)
    slack = _ROUNDING_SLACK * (1.0 + float(np.abs(sums).max()))
    for parts in _PART_COUNTS:
        edges = np.unique(np.linspace(0, len(sequence), min(parts, len(sequence)) + 1).astype(int))
        bound = np.zeros(len(starts))
        for first, stop in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
            if parts == 1:  # all starts: slices, not copies
                part_sum = sums[stop : stop + len(starts)] - sums[first : first + len(starts)]
            else:
                part_sum = sums[starts + stop] - sums[starts + first]
            bound += distances(part_sum, sequence[first:stop].sum(axis=0))
        starts = starts[bound <= limit + slack]
    return starts
