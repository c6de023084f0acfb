"""Find the markers that move with the skull alone: those that keep their mutual distances."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from usdface.numerics.repair.noise import measurement_noise

_SAMPLE_FRAMES = 1500
_LEAST_MARKERS = 4
"""Three have no redundancy: one that is swapped cannot be told."""
_LOW, _HIGH = 5.0, 95.0
"""[percentile] Swapped or stray samples fall outside."""
_PERCENTILES_TO_DEVIATION = 3.29
"""Distance of the two percentiles of a normal distribution, in standard deviations."""
_LARGEST_TURN = np.deg2rad(1.2)
"""Head rotation in error beyond which the mouth, 80 mm away, moves by more than 1.5 mm."""
_LEAST_SEEN = 0.5
_NEAR_BEST = 1.2


@dataclass(frozen=True)
class RigidMarkers:
    """A set of markers that moves as one body.

    Attributes
    ----------
    indices : tuple of int
        Columns, ascending.
    deviation_mm : float
        Mean standard deviation of their mutual distances, measurement noise included [mm].
    rotation_error_deg : float
        How far off the head's rotation may be by what is left of their own motion.
    """

    indices: tuple[int, ...]
    deviation_mm: float
    rotation_error_deg: float


def find_rigid_markers(positions: ArrayLike, visible: ArrayLike) -> RigidMarkers:
    """Find the markers from which the head's motion is best known.

    Markers are taken out one by one, always the one whose distances to the rest vary most. Of the
    nested sets each promises an error of the head's rotation: the mutual motion that is left, and
    the measurement noise averaged over the set, over the set's extent across its longest
    direction. The largest set that comes near the smallest error is chosen: more markers outlast
    more gaps and swaps.

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
    rows = np.unique(np.linspace(0, len(points) - 1, _SAMPLE_FRAMES).astype(np.int64))
    usable = np.flatnonzero(seen.mean(axis=0) >= _LEAST_SEEN)
    sample = points[rows][:, usable].astype(np.float64)
    sample[~seen[rows][:, usable]] = np.nan
    deviations = _distance_deviations(sample)
    middle = np.nanmedian(sample, axis=0) if len(usable) else np.empty((0, 3))
    nested: list[RigidMarkers] = []
    kept = list(range(len(usable)))
    while len(kept) >= _LEAST_MARKERS:
        mutual = deviations[np.ix_(kept, kept)]
        nested.append(_judge(mutual, middle[kept], usable[kept], noise))
        kept.pop(int(np.argmax(mutual.mean(axis=1))))
    least = min((found.rotation_error_deg for found in nested), default=np.inf)
    if not np.deg2rad(least) <= _LARGEST_TURN:
        closest = (
            f"the best {_LEAST_MARKERS} or more would leave {least:.1f} degrees"
            if nested
            else f"only {len(usable)} are seen in at least half of the frames"
        )
        raise ValueError(
            f"no set of markers keeps its mutual distances: {closest} of error in the head's "
            f"rotation, {np.rad2deg(_LARGEST_TURN):.1f} are allowed; name the markers that sit on "
            "the skull (head band, temples, bridge of the nose)"
        )
    return next(found for found in nested if found.rotation_error_deg <= _NEAR_BEST * least)


def _judge(
    mutual: NDArray[np.float64],
    middle: NDArray[np.float64],
    columns: NDArray[np.int64],
    noise: float,
) -> RigidMarkers:
    """Return a set with the error it promises."""
    count = len(columns)
    deviation = float(mutual.sum() / (count * (count - 1)))
    own_motion2 = max(deviation**2 - 2.0 * noise**2, 0.0)  # a distance has the noise of two ends
    extent = np.linalg.svd(middle - middle.mean(axis=0), compute_uv=False)[1] / np.sqrt(count)
    error = np.sqrt(own_motion2 + noise**2 / count) / max(float(extent), 1e-9)
    return RigidMarkers(
        tuple(int(column) for column in columns), deviation, float(np.rad2deg(error))
    )


def _distance_deviations(sample: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the robust standard deviation of every mutual distance; infinite when never seen."""
    count = sample.shape[1]
    deviations = np.zeros((count, count))
    for marker in range(count - 1):
        distances = np.linalg.norm(sample[:, marker + 1 :] - sample[:, marker, None], axis=2)
        together = np.isfinite(distances).sum(axis=0) >= 2
        spread = np.full(distances.shape[1], np.inf)
        low, high = np.nanpercentile(distances[:, together], (_LOW, _HIGH), axis=0)
        spread[together] = (high - low) / _PERCENTILES_TO_DEVIATION
        deviations[marker, marker + 1 :] = deviations[marker + 1 :, marker] = spread
    return deviations
