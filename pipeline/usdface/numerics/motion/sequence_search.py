"""Where a motion holds a sequence: Song et al. (2011), section 5.2, eq. 10.

The paper sums the distances of all frames and channels, so that its threshold of 1.0 means another
thing for every length and every rig. Here the mean over frames is compared, of distances per root
of channels: a threshold of 0.1 is "a tenth of a weight off, in the mean", whatever the sequence.

Most of a long motion is ruled out without looking at frames: by the triangle inequality a sum of
distances is at least the length of the sum of differences, and running sums give that for all
starts at once, for the whole sequence and then for its parts.

Without a threshold a match must be nearer than half of what the mean face, held still, reaches.
"""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import FloatArray, IntArray

PAPER_DELTA = 1.0
"""Of eq. 10, as the paper has it for its own source of 33 shapes and its own sequence."""

_MATCH_SHARE = 0.5
"""[of `mean_face_distance`] Default threshold."""

_PART_COUNTS = (1, 4, 16)
"""Into which a sequence is cut, one pass after the other."""
_BLOCK_STARTS = 1 << 15
"""Looked at together: bounds the memory."""
_ROUNDING_SLACK = 1e-9
"""Rounding of running sums, far above what they have: a true match is never ruled out."""


@dataclass(frozen=True)
class Matches:
    """Where a sequence was found."""

    starts: IntArray
    """(k,): indices, ascending."""
    distances: FloatArray
    """(k,): mean over frames of the root mean square difference over channels."""
    threshold: float
    """Distance that was allowed."""


def mean_face_distance(sequence: FloatArray) -> float:
    """Return the distance of a sequence from its own mean face, held still."""
    off = np.linalg.norm(sequence - sequence.mean(axis=0), axis=1)
    return float(off.mean() / np.sqrt(sequence.shape[1]))


def sequence_distances(motion: FloatArray, sequence: FloatArray, starts: IntArray) -> FloatArray:
    """Return the distance of a motion from a sequence at some starts (eq. 10, normalised).

    Parameters
    ----------
    motion : (frames, channels) float array
    sequence : (m, channels) float array
    starts : (k,) int array
    """
    total = np.zeros(len(starts))
    for offset, wanted in enumerate(sequence):
        total += _lengths(motion[starts + offset] - wanted)
    distances: FloatArray = total / (len(sequence) * np.sqrt(sequence.shape[1]))
    return distances


def starts_within(motion: FloatArray, sequence: FloatArray, *, threshold: float) -> Matches:
    """Return every start at which a motion is within a threshold of a sequence (the paper's F_st).

    Parameters
    ----------
    motion : (frames, channels) float array
    sequence : (m, channels) float array
    threshold : float
        Mean distance per frame and root channel.
    """
    if motion.ndim != 2 or sequence.ndim != 2 or motion.shape[1] != sequence.shape[1]:
        raise ValueError(f"{motion.shape} motion and {sequence.shape} sequence differ in channels")
    if not 0 < len(sequence) <= len(motion):
        raise ValueError(f"a sequence of {len(sequence)} frames in a motion of {len(motion)}")
    if not threshold >= 0:
        raise ValueError(f"the threshold must be at least 0, got {threshold}")
    limit = threshold * len(sequence) * np.sqrt(sequence.shape[1])
    count = len(motion) - len(sequence) + 1
    starts, distances = [], []
    for first in range(0, count, _BLOCK_STARTS):
        stop = min(first + _BLOCK_STARTS, count)
        part = motion[first : stop + len(sequence) - 1]
        left = _abandon(part, sequence, _rule_out(part, sequence, limit), limit)
        near = sequence_distances(part, sequence, left)
        starts.append(left[near <= threshold] + first)
        distances.append(near[near <= threshold])
    return Matches(np.concatenate(starts), np.concatenate(distances), threshold)


def find_sequence(
    motion: FloatArray, sequence: FloatArray, *, threshold: float | None = None
) -> Matches:
    """Return where a motion holds a sequence, each place once.

    Parameters
    ----------
    motion : (frames, channels) float array
    sequence : (m, channels) float array
    threshold : float, optional
        See `starts_within`; by default `_MATCH_SHARE` times `mean_face_distance`.

    Raises
    ------
    ValueError
        As `starts_within`, and if the sequence stands still, so that any still face is like it.
    """
    if threshold is None:
        threshold = _MATCH_SHARE * mean_face_distance(sequence)
        if threshold == 0.0:
            raise ValueError("the sequence stands still, so any face at rest matches it")
    found = starts_within(motion, sequence, threshold=threshold)
    starts = merge_starts(found.starts, len(sequence))
    distances = sequence_distances(motion, sequence, starts)
    for index in np.flatnonzero(distances > threshold).tolist():
        # Between two matches the average may be none: then the nearest match stands for them.
        nearest = int(np.abs(found.starts - starts[index]).argmin())
        starts[index], distances[index] = found.starts[nearest], found.distances[nearest]
    return _drop_overlapping(Matches(starts, distances, threshold), len(sequence))


def find_published(motion: FloatArray, sequence: FloatArray, *, delta: float) -> Matches:
    """Return where a motion holds a sequence as printed: sums of distances, averages of starts.

    Parameters
    ----------
    motion : (frames, channels) float array
    sequence : (m, channels) float array
    delta : float
        Largest sum over the sequence's frames of distances over all channels.
    """
    threshold = delta / (len(sequence) * np.sqrt(sequence.shape[1]))
    found = starts_within(motion, sequence, threshold=threshold)
    starts = merge_starts(found.starts, len(sequence))
    return Matches(starts, sequence_distances(motion, sequence, starts), threshold)


def best_match(motion: FloatArray, sequence: FloatArray) -> Matches:
    """Return the one start at which a motion is nearest to a sequence, however far that is."""
    sample = np.arange(0, len(motion) - len(sequence) + 1, max(len(sequence) // 8, 1))
    reached = float(sequence_distances(motion, sequence, sample).min())
    found = starts_within(motion, sequence, threshold=reached)
    best = int(found.distances.argmin())
    return Matches(found.starts[[best]], found.distances[[best]], reached)


def merge_starts(starts: IntArray, length: int) -> IntArray:
    """Return one start for those that lie within one interval of the first: their average.

    As published: a sequence that begins slowly is like the motion at several frames in a row.
    """
    merged: list[int] = []
    position = 0
    while position < len(starts):
        stop = int(np.searchsorted(starts, starts[position] + length))
        merged.append(round(float(starts[position:stop].mean())))
        position = stop
    return np.array(merged, dtype=np.int64)


def _drop_overlapping(found: Matches, length: int) -> Matches:
    """Of averages that still overlap keep the nearer."""
    chosen: list[int] = []
    for index in np.argsort(found.distances, kind="stable").tolist():
        if all(abs(found.starts[index] - found.starts[other]) >= length for other in chosen):
            chosen.append(index)
    order = sorted(chosen)
    return Matches(found.starts[order], found.distances[order], found.threshold)


def _rule_out(motion: FloatArray, sequence: FloatArray, limit: float) -> IntArray:
    """Return the starts that sums over parts of the sequence cannot rule out."""
    sums = np.concatenate([np.zeros((1, motion.shape[1])), np.cumsum(motion, axis=0)])
    left: IntArray = np.arange(len(motion) - len(sequence) + 1)
    slack = _ROUNDING_SLACK * (1.0 + float(np.abs(sums).max()))
    for parts in _PART_COUNTS:
        edges = np.unique(np.linspace(0, len(sequence), min(parts, len(sequence)) + 1).astype(int))
        least = np.zeros(len(left))
        for start, stop in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
            wanted = sequence[start:stop].sum(axis=0)
            if parts == 1:  # all starts: slices, not copies
                there = sums[stop : stop + len(left)] - sums[start : start + len(left)]
            else:
                there = sums[left + stop] - sums[left + start]
            least += _lengths(there - wanted)
        left = left[least <= limit + slack]
    return left


def _abandon(motion: FloatArray, sequence: FloatArray, left: IntArray, limit: float) -> IntArray:
    """Drop starts as soon as the frames seen are too far, those furthest from the mean first."""
    order = np.argsort(-_lengths(sequence - sequence.mean(axis=0)))
    total = np.zeros(len(left))
    slack = _ROUNDING_SLACK * (1.0 + limit)
    for offset in order.tolist():
        if not len(left):
            break
        total += _lengths(motion[left + offset] - sequence[offset])
        near = total <= limit + slack
        left, total = left[near], total[near]
    return left


def _lengths(vectors: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(np.einsum("nc,nc->n", vectors, vectors)))
