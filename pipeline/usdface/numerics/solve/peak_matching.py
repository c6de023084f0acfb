"""Scale a performer's motion region by region, by what every performer does in full.

A blink closes the eye, on the performer and on the character. Lids that travel six millimetres
on one face and ten on the other need a scale of their own: one for the whole head leaves the
character's eyes half open.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from usdface.core.arrays import BoolArray, FloatArray
from usdface.numerics.solve.blendshape_equation import solve_weights

_PEAK_QUANTILE = 0.99  # of the weights over time: a peak that lasts, not a single frame
_SHOWN_SHARE = 0.3  # [of the range] below, the take does not show the shape
_GAINS = (0.5, 2.5)
_MOST_ROUNDS = 3
_CLOSE_SHARE = 0.02  # [of the range] of the top that counts as reached
_NEAR_SHARE = 0.5  # [of a peak] frames below it do not become one when the gain grows
_CARRIED_SHARE = 0.2  # [of a shape's largest displacement] markers below get no gain from it
_STILL_SHARE = 0.02  # [of a shape's largest displacement] markers below do not follow it
_MARKED_SHARE = 0.5  # [of the surface's displacement] half of it: the marker sits on what moves
_COMMON_VARIANCE = 0.95  # of other markers: drops what they share of small motions, such as blinks
_ALONE_SHARE = 0.25  # [of a shape's peak] others below it at that time are at rest: a wink
FULL_SHARE = 1 / _GAINS[1]  # [of the range] a peak below it the largest gain would not make full


@dataclass(frozen=True)
class ShapeEvidence:
    """Whether markers can tell of shapes, and whether a take shows these."""

    marked: BoolArray
    """(n,): markers sit on what the shape moves: they go at least half as far as the surface
    does."""
    own_peaks: FloatArray
    """(n,): weight at peaks, by the part of the markers' motion that the rest of the face does not
    predict. A lid's marker that sits in the fold follows the brow and has none."""
    alone: BoolArray
    """(n,): the other marked shapes are near rest at this one's peaks, as in a wink."""

    @property
    def shown(self) -> bool:
        """Whether the marked shapes reach `FULL_SHARE` at peaks: their mean, or one alone.

        A single lid that reaches it while the other follows by less is no evidence: on recorded
        takes without blinks, one marker sits lower than the other.
        """
        peaks = self.own_peaks[self.marked]
        if not len(peaks):
            return False
        wink = self.alone[self.marked] & (peaks >= FULL_SHARE)
        return bool(peaks.mean() >= FULL_SHARE or wink.any())


def shape_evidence(
    deltas: ArrayLike,
    motion: ArrayLike,
    shapes: Sequence[int],
    *,
    surface_mm: ArrayLike,
    marker_trust: ArrayLike | None = None,
) -> ShapeEvidence:
    """Measure how much of some shapes is in a take, apart from what all of the face does.

    The motion of the markers that a shape carries is taken along the shape; what a line through the
    principal components of the markers that no such shape moves predicts of it is taken away.

    Parameters
    ----------
    shapes : sequence of int
        Such as both blinks.
    surface_mm : (shapes,) array
        How far each of the shapes moves the surface at 1, as `effective_size` measures it.
    """
    D, m = np.asarray(deltas, float), np.asarray(motion, float)
    trusted = np.ones(D.shape[1], bool) if marker_trust is None else np.asarray(marker_trust) > 0
    carried, m = D[list(shapes)][:, trusted], m[:, trusted]
    reach = np.linalg.norm(carried, axis=2)
    extent = np.maximum(np.asarray(surface_mm, float), 1e-9)
    nearness = effective_size(carried) / extent
    largest = max(float(reach.max(initial=0.0)), 1e-9)
    common = _common_motion(m[:, (reach < _STILL_SHARE * largest).all(axis=0)])
    peaks, own = np.zeros(len(carried)), np.zeros((len(m), len(carried)))
    for row, shape in enumerate(carried):
        markers = reach[row] >= max(_CARRIED_SHARE * reach[row].max(initial=0.0), 1e-9)
        along = shape[markers].ravel()
        if not markers.any():
            continue
        weight = m[:, markers].reshape(len(m), -1) @ along / (along @ along)
        left = weight - common @ np.linalg.lstsq(common, weight)[0]
        own[:, row] = (left - np.median(left)) * min(nearness[row], 1.0)
        peaks[row] = np.quantile(own[:, row], _PEAK_QUANTILE)
    marked = nearness >= _MARKED_SHARE
    return ShapeEvidence(marked, peaks, _alone(own, peaks, marked))


def _alone(own: FloatArray, peaks: FloatArray, marked: BoolArray) -> BoolArray:
    """Return which shapes peak while the other marked ones are near rest: (shapes,)."""
    alone = np.zeros(len(peaks), bool)
    for row in np.flatnonzero(marked):
        others = marked & (np.arange(len(peaks)) != row)
        if others.any() and peaks[row] > 0:
            at_peaks = own[own[:, row] >= peaks[row]].mean(axis=0)
            alone[row] = at_peaks[others].max() < _ALONE_SHARE * at_peaks[row]
    return alone


def effective_size(deltas: ArrayLike) -> FloatArray:
    """Return how far shapes move what they move, (shapes, points, 3) to (shapes,) in their unit.

    The root mean square of the displacements, each counted by its energy: points that a shape does
    not move do not count, however many.
    """
    energy = (np.asarray(deltas, float) ** 2).sum(axis=2)
    return np.asarray(np.sqrt((energy**2).sum(axis=1) / np.maximum(energy.sum(axis=1), 1e-12)))


def _common_motion(motion: FloatArray) -> FloatArray:
    """Return principal components over time, and a constant: (frames, components + 1)."""
    flat = motion.reshape(len(motion), -1)
    over_time, size, _ = np.linalg.svd(flat - flat.mean(axis=0), full_matrices=False)
    share = np.cumsum(size**2) / max(float((size**2).sum()), 1e-12)
    count = int(np.searchsorted(share, _COMMON_VARIANCE)) + 1
    return np.column_stack([np.ones(len(flat)), over_time[:, :count]])


def match_peaks(
    deltas: ArrayLike,
    motion: ArrayLike,
    shapes: Sequence[int],
    *,
    ranges: ArrayLike | None = None,
    visible: ArrayLike | None = None,
    marker_trust: ArrayLike | None = None,
    ridge: float = 10.0,
) -> FloatArray:
    """Return one gain per marker, so that given shapes reach the top of their range in a take.

    A marker takes the gain in proportion to how much of what it can do is that shape's: a lid
    marker wholly, a brow marker hardly.

    Parameters
    ----------
    deltas : (shapes, markers, 3) array
        At the virtual markers [mm].
    motion : (frames, markers, 3) array
        A take that shows each shape in full several times, in the character's space [mm].
    shapes : sequence of int
        Such as both blinks. One that the take does not show changes nothing.
    ranges, visible, marker_trust, ridge
        As in `solve_weights`.

    Returns
    -------
    (markers,) float array
        Multiply the motion by it, before `solve_weights`.
    """
    D, m = np.asarray(deltas, float), np.asarray(motion, float)
    wrong = [shape for shape in shapes if not 0 <= shape < len(D)]
    if wrong:
        raise ValueError(f"there is no shape {wrong[0]}; there are {len(D)}")
    limits = np.tile([0.0, 1.0], (len(D), 1)) if ranges is None else np.asarray(ranges, float)
    reach = np.linalg.norm(D, axis=2)
    share = (reach / np.maximum(reach.max(axis=0), 1e-9)) ** 2
    share[reach < _CARRIED_SHARE * reach.max(axis=1, keepdims=True)] = 0
    gain, weights = np.ones(D.shape[1]), np.zeros((len(m), len(D)))
    near = np.ones(len(m), bool)
    for _ in range(_MOST_ROUNDS if len(shapes) else 0):
        weights[near] = solve_weights(
            D,
            m[near] * gain[:, None],
            method="bounded",
            ranges=limits,
            visible=None if visible is None else np.asarray(visible)[near],
            marker_trust=marker_trust,
            ridge=ridge,
        ).weights
        reached = np.quantile(weights, _PEAK_QUANTILE, axis=0)
        top = limits[:, 1]
        low, high = _SHOWN_SHARE * top, (1 - _CLOSE_SHARE) * top
        short = [shape for shape in shapes if low[shape] < reached[shape] < high[shape]]
        if not short:
            break
        for shape in short:
            gain *= 1 + (top[shape] / reached[shape] - 1) * share[shape]
        gain = np.clip(gain, *_GAINS)
        near[:] = (weights[:, short] > _NEAR_SHARE * reached[short]).any(axis=1)
    return gain
