"""Scaling of a performer's motion by region, from shapes that every performer reaches in full.

A blink closes the eyes of the performer and of the character. If their lids travel 6 and 10 mm, one
scale for the whole head leaves the character's eyes half open.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from usdface.core.arrays import BoolArray, FloatArray
from usdface.numerics.solve.blendshape_equation import solve_weights

_PEAK_QUANTILE = 0.99  # of the weights over time
_SHOWN_SHARE = 0.3  # [of the range] least peak of a shape that the take contains
_GAINS = (0.5, 2.5)
_MOST_ROUNDS = 3
_CLOSE_SHARE = 0.02  # [of the range] distance from the top that counts as reached
_NEAR_SHARE = 0.5  # [of a peak] least weight of frames that are solved again
_CARRIED_SHARE = 0.2  # [of a shape's largest displacement] least of a marker that it scales
_STILL_SHARE = 0.02  # [of a shape's largest displacement] least of a marker that follows it
_MARKED_SHARE = 0.5  # [of the surface's displacement] least of a marker on the moving part
_COMMON_VARIANCE = 0.95  # share of the variance of the other markers in the components removed
_ALONE_SHARE = 0.25  # [of a shape's peak] largest of the others, at rest at that time: a wink
FULL_SHARE = 1 / _GAINS[1]  # [of the range] least peak that the largest gain makes full


@dataclass(frozen=True)
class ShapeEvidence:
    """Whether markers observe some shapes, and whether a take contains these."""

    marked: BoolArray
    """(n,): whether markers on the shape move at least half as far as the surface."""
    independent_peaks: FloatArray
    """(n,): weight at peaks, of the motion that the rest of the face does not predict: about 0 for
    a marker in the fold of a lid, which follows the brow."""
    alone: BoolArray
    """(n,): whether the other marked shapes are near rest at this one's peaks, as in a wink."""
    labelled: BoolArray | None = None
    """(n,): whether a label names a marker on the shape; unmarked, that marker is in a fold."""
    nearness: FloatArray | float = 1.0
    """(n,): displacement of the markers over that of the surface, at most 1, a factor of the
    peaks."""

    @property
    def shown(self) -> bool:
        """Whether the marked shapes reach `FULL_SHARE` at peaks: their mean, or one alone.

        A single lid that reaches it while the other follows by less does not count: on recorded
        takes without blinks, one marker sits lower than the other, which may be in the fold. A
        fold follows the brow on both sides, so that the peak of a wink counts without `nearness`.
        """
        if not self.marked.any():
            return False
        wink = self.alone & self.marked & (self.independent_peaks >= FULL_SHARE * self.nearness)
        return bool(self.mean_peak >= FULL_SHARE or wink.any())

    @property
    def mean_peak(self) -> float:
        """Mean of the peaks of shapes with a marker, by its place or its label."""
        counted = self.marked if self.labelled is None else self.marked | self.labelled
        return float(self.independent_peaks[counted].mean())


def shape_evidence(
    deltas: ArrayLike,
    motion: ArrayLike,
    shapes: Sequence[int],
    *,
    surface_mm: ArrayLike,
    marker_trust: ArrayLike | None = None,
) -> ShapeEvidence:
    """Measure the peaks of some shapes in a take, without the motion that the whole face shares.

    The weight of a shape is the projection of its markers' motion, less its linear regression on
    the principal components of the markers that none of the shapes moves.

    Parameters
    ----------
    shapes : sequence of int
        Such as both blinks.
    surface_mm : (shapes,) array
        `effective_size` of the shapes on the surface.
    """
    D, m = np.asarray(deltas, float), np.asarray(motion, float)
    trusted = np.ones(D.shape[1], bool) if marker_trust is None else np.asarray(marker_trust) > 0
    carried, m = D[list(shapes)][:, trusted], m[:, trusted]
    reach = np.linalg.norm(carried, axis=2)
    extent = np.maximum(np.asarray(surface_mm, float), 1e-9)
    nearness = np.minimum(effective_size(carried) / extent, 1.0)
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
        own[:, row] = (left - np.median(left)) * nearness[row]
        peaks[row] = np.quantile(own[:, row], _PEAK_QUANTILE)
    marked = nearness >= _MARKED_SHARE
    return ShapeEvidence(marked, peaks, _alone(own, peaks, marked), nearness=nearness)


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
    """Return energy-weighted root mean square displacements: (shapes, points, 3) to (shapes,).

    The number of points that a shape does not move does not matter.
    """
    energy = (np.asarray(deltas, float) ** 2).sum(axis=2)
    return np.asarray(np.sqrt((energy**2).sum(axis=1) / np.maximum(energy.sum(axis=1), 1e-12)))


def _common_motion(motion: FloatArray) -> FloatArray:
    """Return a constant and principal components over time: (frames, components + 1)."""
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

    A marker's share of a shape's gain is the squared ratio of its displacement by that shape to its
    largest by any shape. Returns (markers,), factors of the motion for `solve_weights`.

    Parameters
    ----------
    deltas : (shapes, markers, 3) array
        At the virtual markers [mm].
    motion : (frames, markers, 3) array
        A take with several full peaks of each shape, in the character's space [mm].
    shapes : sequence of int
        Such as both blinks. Shapes that the take does not contain have no effect.
    ranges, visible, marker_trust, ridge
        As in `solve_weights`.
    """
    D, m = np.asarray(deltas, float), np.asarray(motion, float)
    limits = np.tile([0.0, 1.0], (len(D), 1)) if ranges is None else np.asarray(ranges, float)
    reach = np.linalg.norm(D, axis=2)
    share = (reach / np.maximum(reach.max(axis=0), 1e-9)) ** 2
    share[reach < _CARRIED_SHARE * reach.max(axis=1, keepdims=True)] = 0
    chosen = list(shapes)
    gain, weights = np.ones(D.shape[1]), np.zeros((len(m), len(chosen)))
    near = np.ones(len(m), bool)
    for _ in range(_MOST_ROUNDS if len(shapes) else 0):
        weights[near] = solve_weights(
            D,
            m[near] * gain[:, None],
            ranges=limits,
            visible=None if visible is None else np.asarray(visible)[near],
            marker_trust=marker_trust,
            ridge=ridge,
        ).weights[:, chosen]
        reached, top = np.quantile(weights, _PEAK_QUANTILE, axis=0), limits[chosen, 1]
        short = (reached > _SHOWN_SHARE * top) & (reached < (1 - _CLOSE_SHARE) * top)
        if not short.any():
            break
        for index in np.flatnonzero(short):
            gain *= 1 + (top[index] / reached[index] - 1) * share[chosen[index]]
        gain = np.clip(gain, *_GAINS)
        near[:] = (weights[:, short] > _NEAR_SHARE * reached[short]).any(axis=1)
    return gain
