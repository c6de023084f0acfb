"""Occurrences of a sequence in a motion: Song et al. (2011), section 5.2, eq. 10.

The paper sums distances over frames and channels, so that its threshold of 1.0 depends on the
length and the rig. Here the threshold applies to the mean over frames of the root mean square
difference over channels, in the unit of a weight.
"""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import FloatArray, IntArray, distances, frame_blocks, spaced_rows

PAPER_DELTA = 1.0
"""Threshold of eq. 10 in the paper, for its source of 33 shapes and its sequence."""

_MATCH_SHARE = 0.5
"""[of `mean_face_distance`] Default threshold."""

_BLOCK_STARTS = 1 << 13
"""Starts compared at a time: their rows fit in the cache."""


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
    moved = sequence - sequence[0]  # exactly 0 if the sequence stands still
    deviation = np.linalg.norm(moved - moved.mean(axis=0), axis=1)
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
    distances = _all_distances(motion, sequence)
    starts = np.flatnonzero(distances <= threshold)
    return Matches(starts, distances[starts], threshold)


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
        If the sequence has no motion.
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
    distances = _all_distances(motion, sequence)
    best = distances.argmin(axis=0, keepdims=True)
    return Matches(best, distances[best], float(distances[best[0]]))


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
    nearest_first = matches.starts[np.argsort(matches.distances, kind="stable")]
    apart = np.isin(matches.starts, list(spaced_rows(nearest_first, length)))
    return Matches(matches.starts[apart], matches.distances[apart], matches.threshold)


def _all_distances(motion: FloatArray, sequence: FloatArray) -> FloatArray:
    """Return the distance at every start: (frames - m + 1,)."""
    starts = np.arange(len(motion) - len(sequence) + 1)
    blocks = frame_blocks(len(starts), frames=_BLOCK_STARTS)
    return np.concatenate([sequence_distances(motion, sequence, starts[each]) for each in blocks])
