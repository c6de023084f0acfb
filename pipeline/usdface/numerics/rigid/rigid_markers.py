"""Find the markers that move with the skull alone: those that keep their mutual distances."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from usdface.core.arrays import FloatArray, IntArray, frame_blocks, sample_frames
from usdface.numerics.motion.noise import measurement_noise

_SAMPLE_FRAMES = 1500
_LEAST_MARKERS = 4
"""With three, a swapped one cannot be detected."""
_LOW, _HIGH = 5.0, 95.0
"""[percentile] Swapped samples and outliers are outside."""
_PERCENTILES_TO_DEVIATION = 3.29
"""Distance of the two percentiles of a normal distribution, in standard deviations."""
_CERTAIN_TURN, _LARGEST_TURN = np.deg2rad(2.0), np.deg2rad(8.0)
"""Errors of the head's rotation up to which a set is rigid, and beyond which the markers are not on
a face. The first moves the mouth, at 80 mm, by 3 mm, of which mapping removes most by the rig."""
_LEAST_SEEN = 0.5
"""[of the frames] In which a marker must be visible."""
_NEAR_BEST = 1.2
"""Ratio to the smallest error up to which a larger set is preferred."""
_SEEDS_AT_ONCE = 64
"""Sets grown in one batch: 5 MB each for a thousand markers."""


@dataclass(frozen=True)
class RigidMarkers:
    """A set of markers that moves as one rigid body."""

    indices: tuple[int, ...]
    """Columns, ascending."""
    deviation_mm: float
    """Mean standard deviation of their mutual distances, measurement noise included [mm]."""
    noise_mm: float = 0.0
    """Standard deviation of the measurement noise, per coordinate."""
    rotation_error: float = 0.0
    """Expected error of the head's rotation [rad]."""

    @property
    def is_rigid(self) -> bool:
        """Whether the set tells the head's rotation to 2 degrees."""
        return self.rotation_error <= _CERTAIN_TURN

    @property
    def residual_motion_mm(self) -> float:
        """Standard deviation of the motion per marker, without the measurement noise [mm]."""
        return float(np.sqrt(max(self.deviation_mm**2 / 2 - self.noise_mm**2, 0.0)))


def find_rigid_markers(positions: ArrayLike, visible: ArrayLike) -> RigidMarkers:
    """Find the set of markers that determines the head's motion best.

    Candidates come from backward elimination, which removes the marker whose distances to the
    others vary most, and from forward selection, which starts at each marker and adds the one whose
    distances to the set vary least: where most markers are on skin, elimination removes the skull's
    markers first. The expected error of a set's rotation is the root of its squared residual motion
    and averaged noise, over its extent across its longest axis. Of the sets near the smallest
    error, the largest is chosen, as it is the most robust to gaps and swaps.

    Parameters
    ----------
    positions : (frames, markers, 3) array_like
        [mm]
    visible : (frames, markers) array_like of bool

    Raises
    ------
    ValueError
        If there is no set of four or more markers, or the expected error of each exceeds 8
        degrees.
    """
    points, seen = np.asarray(positions), np.asarray(visible, bool)
    noise = measurement_noise(points, seen)
    rows = sample_frames(len(points), _SAMPLE_FRAMES)
    usable = np.flatnonzero(seen.mean(axis=0) >= _LEAST_SEEN)
    sample = points[rows][:, usable].astype(np.float64)
    sample[~seen[rows][:, usable]] = np.nan
    deviations = _distance_deviations(sample)
    middle = np.nanmedian(sample, axis=0) if len(usable) else np.empty((0, 3))
    orders, errors = _candidate_orders(deviations, middle, noise)
    least = float(errors.min(initial=np.inf))
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
    # Of equally large sets the one with the smaller error.
    count, error, order = max(
        (
            (int(near) + _LEAST_MARKERS, float(row[near]), order)
            for order, row in zip(orders, errors, strict=True)
            for near in np.flatnonzero(row <= _NEAR_BEST * least)[-1:]
        ),
        key=lambda candidate: (candidate[0], -candidate[1]),
    )
    chosen = np.sort(order[:count])
    deviation = deviations[np.ix_(chosen, chosen)].sum() / (count * (count - 1))
    indices = tuple(usable[chosen].tolist())
    return RigidMarkers(indices, float(deviation), noise, error)


def _candidate_orders(
    deviations: FloatArray, middle: FloatArray, noise: float
) -> tuple[IntArray, FloatArray]:
    """Return orders of markers whose prefixes are candidate sets, and the sets' errors.

    Returns
    -------
    orders : (orders, markers) int array
    errors : (orders, markers - 3) float array
        Expected errors of the rotation [rad] of the first four of an order, five, and so on;
        infinite for markers that are never visible together.
    """
    count = len(deviations)
    if count < _LEAST_MARKERS:
        return np.empty((0, count), np.int64), np.empty((0, 0))
    eliminated = _eliminate(deviations)
    added = np.tril(deviations[np.ix_(eliminated, eliminated)]).sum(axis=1)
    orders = [eliminated[None]]
    errors = [_rotation_errors(eliminated[None], added[None], middle, noise)]
    for seeds in frame_blocks(count, frames=_SEEDS_AT_ONCE):
        selected, added = _select_forward(deviations, np.arange(count)[seeds])
        orders.append(selected)
        errors.append(_rotation_errors(selected, added, middle, noise))
    return np.concatenate(orders), np.concatenate(errors)


def _eliminate(deviations: FloatArray) -> IntArray:
    """Return the markers by backward elimination, the last to be removed first."""
    infinite = np.isinf(deviations)
    finite = np.where(infinite, 0.0, deviations)
    total, never = finite.sum(axis=1), infinite.sum(axis=1)
    remaining, removed = np.ones(len(deviations), bool), list[int]()
    while remaining.any():
        varying = np.where(never > 0, np.inf, total)
        removed.append(int(np.where(remaining, varying, -np.inf).argmax()))
        remaining[removed[-1]] = False
        total, never = total - finite[removed[-1]], never - infinite[removed[-1]]
    return np.array(removed[::-1], np.int64)


def _select_forward(deviations: FloatArray, seeds: IntArray) -> tuple[IntArray, FloatArray]:
    """Add to each seed the marker whose distances to the set vary least, and so on.

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


def _rotation_errors(
    orders: IntArray, added: FloatArray, middle: FloatArray, noise: float
) -> FloatArray:
    """Return the rotation's error [rad] expected of the first four of an order, five, and so on."""
    large = slice(_LEAST_MARKERS - 1, None)
    count = np.arange(1, orders.shape[1] + 1)[large]
    deviation = 2 * added.cumsum(axis=1)[:, large] / (count * (count - 1))
    # A distance has the noise of both ends.
    residual_motion2 = np.maximum(deviation**2 - 2.0 * noise**2, 0.0)
    points = middle[orders] - middle.mean(axis=0)
    products = (points[..., :, None] * points[..., None, :]).cumsum(axis=1)[:, large]
    centres = points.cumsum(axis=1)[:, large] / count[:, None]
    spread = products / count[:, None, None] - centres[..., :, None] * centres[..., None, :]
    extent = np.sqrt(np.maximum(np.linalg.eigvalsh(spread)[..., 1], 0.0))
    errors: FloatArray = np.sqrt(residual_motion2 + noise**2 / count)
    return errors / np.maximum(extent, 1e-9)


def _distance_deviations(sample: FloatArray) -> FloatArray:
    """Return the robust standard deviation of all mutual distances; infinite if never visible."""
    frames, count = sample.shape[:2]
    deviations = np.zeros((count, count))
    tracks = np.ascontiguousarray(sample.transpose(1, 2, 0))
    for marker in range(count - 1):
        between = tracks[marker + 1 :] - tracks[marker]
        distances = np.sqrt(np.einsum("mif,mif->mf", between, between))
        distances.sort(axis=1)  # NaN last
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
    return values[rows, below] + (at - below) * (values[rows, above] - values[rows, below])
