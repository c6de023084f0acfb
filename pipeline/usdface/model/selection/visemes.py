"""The paper's own selection: a frame for each viseme and emotion, and the extremes of each emotion.

Deng et al. (2006), section 4: the middle frame of one segment for every viseme and expression,
picked by hand there and by typicality here, and ten extreme poses an expression.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import BoolArray, IntArray
from usdface.model.selection.features import Features, features_at
from usdface.numerics.regression.reference_design import design_k_centre


@dataclass(frozen=True)
class Segment:
    """One phone as it was spoken."""

    row: int
    """Its middle frame."""
    frames: int
    """How long it lasts."""
    viseme: str
    emotion: str


def viseme_frames(
    features: Features, segments: Sequence[Segment], *, candidates: BoolArray
) -> dict[tuple[str, str], int]:
    """Return the frame of the most typical segment for each emotion and viseme that is spoken.

    Typical is a segment at least as long as most, whose middle frame is nearest the median of all
    middle frames of its kind: the one a person would pick, for short ones are slurred into their
    neighbours. No frame serves twice.

    Parameters
    ----------
    features : (frames, d) float array
    candidates : (frames,) bool array
        Frames that may be chosen.

    Returns
    -------
    dict of (emotion, viseme) to int
    """
    kinds: dict[tuple[str, str], list[Segment]] = {}
    for segment in segments:
        if candidates[segment.row]:
            kinds.setdefault((segment.emotion, segment.viseme), []).append(segment)
    found: dict[tuple[str, str], int] = {}
    for kind, spoken in kinds.items():
        rows = np.array([segment.row for segment in spoken])
        lengths = np.array([segment.frames for segment in spoken])
        away = np.linalg.norm(features[rows] - np.median(features[rows], axis=0), axis=1)
        away[lengths < np.median(lengths)] += away.max() + 1.0
        taken = set(found.values())
        order = [int(rows[i]) for i in np.argsort(away, kind="stable")]
        free = [row for row in order if row not in taken]
        if free:
            found[kind] = free[0]
    return found


def extreme_frames(
    features: Features,
    emotion_of: Sequence[str],
    count: int,
    *,
    candidates: BoolArray,
    already: IntArray,
) -> dict[str, list[int]]:
    """Return frames of each emotion far from its ordinary faces, and from one another.

    Parameters
    ----------
    features : (frames, d) float array
    emotion_of : sequence of str
        Of each frame.
    count : int
        Frames an emotion; fewer, or none, where the emotion has no more that may be chosen.
    candidates : (frames,) bool array
    already : (n,) int array
        Frames chosen before, which are not chosen again.
    """
    emotions = np.array(emotion_of, dtype=object)
    taken = np.zeros(len(features), dtype=bool)
    taken[already] = True
    found: dict[str, list[int]] = {}
    for emotion in dict.fromkeys(emotions.tolist()):
        free = np.flatnonzero((emotions == emotion) & candidates & ~taken)
        before = np.flatnonzero((emotions == emotion) & taken)
        pool = np.concatenate([before, free])
        wanted = min(count, len(free))
        found[emotion] = []
        if wanted > 0:
            known = np.arange(len(before), dtype=np.int64)
            chosen = design_k_centre(features_at(features, pool), wanted, already=known).chosen
            found[emotion] = [int(row) for row in pool[chosen]]
    return found
