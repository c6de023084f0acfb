"""Find the markers that move with the skull alone: those that keep their mutual distances."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from usdface.core.arrays import FloatArray, IntArray, sample_frames
from usdface.numerics.motion.noise import measurement_noise

_SAMPLE_FRAMES = 1500
_LEAST_MARKERS = 4
"""Three have no redundancy: one that is swapped could not be detected."""
_LOW, _HIGH = 5.0, 95.0
"""[percentile] Swapped samples and outliers fall outside."""
_PERCENTILES_TO_DEVIATION = 3.29
"""Distance of the two percentiles of a normal distribution, in standard deviations."""
_LARGEST_TURN = np.deg2rad(1.2)
"""Head rotation in error beyond which the mouth, 80 mm away, moves by more than 1.5 mm."""
_LEAST_SEEN = 0.5
_NEAR_BEST = 1.2
_SEEDS_AT_ONCE = 64
"""Sets grown side by side: 5 MB each of a thousand markers' moments."""


@dataclass(frozen=True)
class RigidMarkers:
    """A set of markers that moves as one body."""

    indices: tuple[int, ...]
    """Columns, ascending."""
    deviation_mm: float
    """Mean standard deviation of their mutual distances, measurement noise included [mm]."""
    rotation_error_deg: float
    """How far off the head's rotation may be by what is left of their own motion."""
    noise_mm: float = 0.0
    """Standard deviation of the measurement noise, per coordinate."""

    @property
    def residual_motion_mm(self) -> float:
        """What is left of the deviation, per marker, without the noise of a distance's two ends."""
        return float(np.sqrt(max(self.deviation_mm**2 / 2 - self.noise_mm**2, 0.0)))


def find_rigid_markers(positions: ArrayLike, visible: ArrayLike) -> RigidMarkers:
    """Find the markers from which the head's motion is best known.

    Sets are made in two ways. Markers are taken out of all one by one, always the one whose
    distances to the rest vary most; and from each marker on, a set grows by the one whose distances
    to it vary least: where most markers sit on skin, the first way takes the skull's markers out
    before that skin which moves as one. Each set promises an error of the head's rotation: the
    mutual motion that is left, and the measurement noise averaged over the set, over the set's
    extent across its longest direction. The largest set that comes near the smallest error is
    chosen: more markers outlast more gaps and swaps.

    Parameters
    ----------
    positions : (frames, markers, 3) array_like
        [mm]
    visible : (frames, markers) array_like of bool

    Raises
    ------
    ValueError
        If no set of four or more markers promises a rotation within 1.2 degrees.
    """
    points, seen = np.asarray(positions), np.asarray(visible, bool)
    noise = measurement_noise(points, seen)
    rows = sample_frames(len(points), _SAMPLE_FRAMES)
    usable = np.flatnonzero(seen.mean(axis=0) >= _LEAST_SEEN)
    sample = points[rows][:, usable].astype(np.float64)
    sample[~seen[rows][:, usable]] = np.nan
    deviations = _distance_deviations(sample)
    middle = np.nanmedian(sample, axis=0) if len(usable) else np.empty((0, 3))
    orders, promises = _judged_orders(deviations, middle, noise)
    least = float(promises.min(initial=np.inf))
    if not least <= _LARGEST_TURN:
        if not len(orders):
            closest = (
                f"only {len(usable)} of {seen.shape[1]} markers are seen in at least half of the "
                f"frames, {_LEAST_MARKERS} are needed"
            )
        elif np.isinf(least):
            closest = "too few are seen together in two frames or more"
        else:
            closest = (
                f"the best {_LEAST_MARKERS} or more would leave {np.rad2deg(least):.1f} degrees of "
                f"error in the head's rotation, {np.rad2deg(_LARGEST_TURN):.1f} are allowed"
            )
        raise ValueError(
            f"no set of markers keeps its mutual distances: {closest}; name the markers that sit "
            "on the skull (head band, temples, bridge of the nose)"
        )
    # Of sets equally large the one that promises less.
    count, error, order = max(
        (
            (int(near) + _LEAST_MARKERS, float(promise[near]), order)
            for order, promise in zip(orders, promises, strict=True)
            for near in np.flatnonzero(promise <= _NEAR_BEST * least)[-1:]
        ),
        key=lambda found: (found[0], -found[1]),
    )
    chosen = np.sort(order[:count])
    deviation = deviations[np.ix_(chosen, chosen)].sum() / (count * (count - 1))
    indices = tuple(usable[chosen].tolist())
    return RigidMarkers(indices, float(deviation), float(np.rad2deg(error)), noise)


def _judged_orders(
    deviations: FloatArray, middle: FloatArray, noise: float
) -> tuple[IntArray, FloatArray]:
    """Return orders of markers of which every beginning is a set worth judging, and what it is.

    Returns
    -------
    orders : (orders, markers) int array
    promises : (orders, markers - 3) float array
        Errors of the rotation [rad], promised by the first four of an order, five, and so on;
        infinite from markers on that were never seen together.
    """
    count = len(deviations)
    if count < _LEAST_MARKERS:
        return np.empty((0, count), np.int64), np.empty((0, 0))
    whole = _order_by_removal(deviations)
    beginning = np.tril(deviations[np.ix_(whole, whole)]).sum(axis=1)
    orders = [whole[None]]
    promises = [_promised_errors(whole[None], beginning[None], middle, noise)]
    for start in range(0, count, _SEEDS_AT_ONCE):
        grown, added = _grow_sets(deviations, np.arange(start, min(start + _SEEDS_AT_ONCE, count)))
        orders.append(grown)
        promises.append(_promised_errors(grown, added, middle, noise))
    return np.concatenate(orders), np.concatenate(promises)


def _order_by_removal(deviations: FloatArray) -> IntArray:
    """Take markers out, always the one whose distances vary most, and return the last one first."""
    apart = np.isinf(deviations)
    finite = np.where(apart, 0.0, deviations)
    total, never = finite.sum(axis=1), apart.sum(axis=1)
    left, taken = np.ones(len(deviations), bool), list[int]()
    while left.any():
        varying = np.where(never > 0, np.inf, total)
        taken.append(int(np.where(left, varying, -np.inf).argmax()))
        left[taken[-1]] = False
        total, never = total - finite[taken[-1]], never - apart[taken[-1]]
    return np.array(taken[::-1], np.int64)


def _grow_sets(deviations: FloatArray, seeds: IntArray) -> tuple[IntArray, FloatArray]:
    """Grow a set from each seed by the marker whose distances to it vary least.

    Returns
    -------
    orders : (seeds, markers) int array
    added : (seeds, markers) float array
        Sum of the deviations of each marker's distances to those before it.
    """
    rows = np.arange(len(seeds))
    orders = np.empty((len(seeds), len(deviations)), np.int64)
    added = np.zeros(orders.shape)
    orders[:, 0] = seeds
    total = deviations[seeds]
    total[rows, seeds] = np.inf
    for step in range(1, len(deviations)):
        nearest = total.argmin(axis=1)
        orders[:, step], added[:, step] = nearest, total[rows, nearest]
        total += deviations[nearest]
        total[rows, nearest] = np.inf
    return orders, added


def _promised_errors(
    orders: IntArray, added: FloatArray, middle: FloatArray, noise: float
) -> FloatArray:
    """Return the rotation's error [rad] promised by the first four of an order, five, and so on."""
    beginning = slice(_LEAST_MARKERS - 1, None)
    count = np.arange(1, orders.shape[1] + 1)[beginning]
    deviation = 2 * added.cumsum(axis=1)[:, beginning] / (count * (count - 1))
    residual_motion2 = np.maximum(
        deviation**2 - 2.0 * noise**2, 0.0
    )  # a distance has two ends' noise
    points = middle[orders] - middle.mean(axis=0)
    products = (points[..., :, None] * points[..., None, :]).cumsum(axis=1)[:, beginning]
    centres = points.cumsum(axis=1)[:, beginning] / count[:, None]
    spread = products / count[:, None, None] - centres[..., :, None] * centres[..., None, :]
    extent = np.sqrt(np.maximum(np.linalg.eigvalsh(spread)[..., 1], 0.0))
    errors: FloatArray = np.sqrt(residual_motion2 + noise**2 / count)
    return errors / np.maximum(extent, 1e-9)


def _distance_deviations(sample: FloatArray) -> FloatArray:
    """Return the robust standard deviation of every mutual distance; infinite when never seen."""
    frames, count = sample.shape[:2]
    deviations = np.zeros((count, count))
    tracks = np.ascontiguousarray(sample.transpose(1, 2, 0))
    for marker in range(count - 1):
        between = tracks[marker + 1 :] - tracks[marker]
        distances = np.sqrt(np.einsum("mif,mif->mf", between, between))
        distances.sort(axis=1)  # what is not known comes last
        known = frames - np.isnan(distances).sum(axis=1)
        low, high = (_sorted_percentile(distances, known, share) for share in (_LOW, _HIGH))
        spread = np.where(known >= 2, (high - low) / _PERCENTILES_TO_DEVIATION, np.inf)
        deviations[marker, marker + 1 :] = deviations[marker + 1 :, marker] = spread
    return deviations


def _sorted_percentile(values: FloatArray, known: IntArray, percent: float) -> FloatArray:
    """Return a percentile of the first `known` of each row of sorted values, (rows, n)."""
    at = np.maximum(known - 1, 0) * (percent / 100.0)
    below = at.astype(np.int64)
    above = np.minimum(below + 1, np.maximum(known - 1, 0))
    rows = np.arange(len(values))
    return np.asarray(
        values[rows, below] + (at - below) * (values[rows, above] - values[rows, below])
    )
