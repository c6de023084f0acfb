"""Ends of sequences in the lids: outside of blinks, so that none is played in part."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.ndimage import grey_opening

from usdface.core.arrays import BoolArray, FloatArray, IntArray, runs
from usdface.numerics.motion.laplacian_warp import Insertion

LONGEST_BLINK_SECONDS = 0.5

_LEAST_PEAK = 0.3
"""Least weight of a blink above that before and after it."""

_LEAST_CLOSING = 0.05
"""Weight above which a blink has begun."""


def keep_blinks(
    motion: FloatArray, insertions: Sequence[Insertion], lids: IntArray, *, rate: float, blend: int
) -> list[Insertion]:
    """Return sequences with the motion's lids at each end that is inside of a blink.

    A blink of the motion is then played whole, and one of the sequence not at all. Within the
    sequence, after the blinks, the lids pass from one to the other over `blend` frames. If there is
    no place for that in this half of the sequence, the end stays as it is.

    Parameters
    ----------
    motion : (frames, controls) float array
    lids : (n,) int array
        Controls that are shapes of the lids.
    rate : float
        Frames per second.
    """
    performed = motion[:, lids]
    blinking, kept = blink_frames(performed, rate), []
    for each in insertions:
        keys, own = each.keys.copy(), performed[each.start : each.stop]
        busy = blinking[each.start : each.stop] | blink_frames(keys[:, lids], rate)
        share = _shares(busy, min(blend, len(keys) // 4))
        changed = np.flatnonzero(share < 1)
        keys[np.ix_(changed, lids)] += ((1 - share[:, None]) * (own - keys[:, lids]))[changed]
        kept.append(replace(each, keys=keys))
    return kept


def blink_frames(weights: FloatArray, rate: float) -> BoolArray:
    """Return the frames inside of a blink of any shape: (frames,).

    A blink is a rise that does not last, the difference to a morphological opening.

    Parameters
    ----------
    weights : (frames, shapes) float array
        Of the shapes of the lids.
    rate : float
        Frames per second.
    """
    if not weights.size:
        return np.zeros(len(weights), np.bool_)
    longest = round(LONGEST_BLINK_SECONDS * rate) + 1
    heights = (weights - grey_opening(weights, size=(longest, 1))).max(axis=1)
    inside = heights > _LEAST_CLOSING
    for start, stop in runs(inside):
        inside[start:stop] = heights[start:stop].max() >= _LEAST_PEAK
    return np.asarray(inside)


def _shares(blinking: BoolArray, fade: int) -> FloatArray:
    """Return the share of a sequence in the lids: (frames,), 1 but at ends inside of a blink."""
    shares = np.ones(len(blinking))
    rise = np.arange(1, fade + 1) / (fade + 1.0)
    for busy, share in ((blinking, shares), (blinking[::-1], shares[::-1])):
        starts = range(len(busy) // 2 - fade + 1 if busy[0] and fade else 0)
        start = next((at for at in starts if not busy[at : at + fade].any()), None)
        if start is not None:
            share[:start] = 0.0
            share[start : start + fade] = rise**2 * (3 - 2 * rise)
    return shares
