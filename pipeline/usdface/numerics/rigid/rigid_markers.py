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


@dataclass(frozen=True)
class RigidMarkers:
    """A set of markers that moves as one body."""

    indices: tuple[int, ...]
    """Columns, ascending."""
    deviation_mm: float
    """Mean standard deviation of their mutual distances, measurement noise included [mm]."""
    rotation_error_deg: float
    """How far off the head's rotation may be by what is left of their own motion."""


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
    orders = [] if len(usable) < _LEAST_MARKERS else _orders(deviations)
    promises = [_promised_errors(deviations, middle, order, noise) for order in orders]
    least = min((float(promise.min()) for promise in promises), default=np.inf)
    if not least <= _LARGEST_TURN:
        if not promises:
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
    return RigidMarkers(tuple(usable[chosen].tolist()), float(deviation), float(np.rad2deg(error)))


def _orders(deviations: FloatArray) -> list[IntArray]:
    """Return orders of markers of which every beginning is a set worth judging."""
    count = len(deviations)
    left, taken = list(range(count)), list[int]()
    while left:
        mutual = deviations[np.ix_(left, left)]
        taken.append(left.pop(int(np.argmax(mutual.mean(axis=1)))))
    orders = [np.array(taken[::-1], np.int64)]
    for seed in range(count):
        grown, total = [seed], deviations[seed].copy()
        total[seed] = np.inf
        while np.isfinite(total).any():
            grown.append(int(np.argmin(total)))
            total += deviations[grown[-1]]
            total[grown[-1]] = np.inf
        if len(grown) >= _LEAST_MARKERS:
            orders.append(np.array(grown, np.int64))
    return orders


def _promised_errors(
    deviations: FloatArray,
    middle: FloatArray,
    order: IntArray,
    noise: float,
) -> FloatArray:
    """Return the rotation's error [rad] promised by the first four of an order, five, and so on."""
    count = np.arange(1, len(order) + 1)[_LEAST_MARKERS - 1 :]
    pairs = np.tril(deviations[np.ix_(order, order)]).sum(axis=1).cumsum()[_LEAST_MARKERS - 1 :]
    deviation = 2 * pairs / (count * (count - 1))
    residual_motion2 = np.maximum(
        deviation**2 - 2.0 * noise**2, 0.0
    )  # a distance has two ends' noise
    points = middle[order] - middle[order].mean(axis=0)
    products = (points[:, :, None] * points[:, None, :]).cumsum(axis=0)[_LEAST_MARKERS - 1 :]
    centres = points.cumsum(axis=0)[_LEAST_MARKERS - 1 :] / count[:, None]
    spread = products / count[:, None, None] - centres[:, :, None] * centres[:, None, :]
    extent = np.sqrt(np.maximum(np.linalg.eigvalsh(spread)[:, 1], 0.0))
    errors: FloatArray = np.sqrt(residual_motion2 + noise**2 / count)
    return errors / np.maximum(extent, 1e-9)


def _distance_deviations(sample: FloatArray) -> FloatArray:
    """Return the robust standard deviation of every mutual distance; infinite when never seen."""
    count = sample.shape[1]
    deviations = np.zeros((count, count))
    for marker in range(count - 1):
        distances = np.linalg.norm(sample[:, marker + 1 :] - sample[:, marker, None], axis=2)
        together = np.isfinite(distances).sum(axis=0) >= 2
        spread = np.full(distances.shape[1], np.inf)
        if together.any():
            low, high = np.nanpercentile(distances[:, together], (_LOW, _HIGH), axis=0)
            spread[together] = (high - low) / _PERCENTILES_TO_DEVIATION
        deviations[marker, marker + 1 :] = deviations[marker + 1 :, marker] = spread
    return deviations
