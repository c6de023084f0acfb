"""Motion of markers relative to the skull, and head orientation, without labels."""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import (
    BoolArray,
    Float32Array,
    FloatArray,
    IntArray,
    rms_radius,
    sample_frames,
)
from usdface.numerics.rigid.rigid_alignment import align_rigid_robust, remove_motion

_FLAT_RATIO = 0.75
"""Largest ratio of a cloud's smallest to its middle standard deviation for a face, which is flatter
than a head with a cap."""
_MAIN_RATIO = 1.5
"""Least ratio of the two largest variances of motion for which a main direction is defined."""
_ARTICULATED_SHARE = 0.12
"""Non-rigid motion over the cloud's radius, RMS, above which the markers are not one head: a face
that opens its jaw has at most 0.07, a walking body at least 0.25."""
_SPEED_FRAMES = 500
_SPEED_SECONDS = 1 / 60
"""Time over which a speed is measured: noise of 0.2 mm is then 17 mm/s, and a lid takes 0.1 s."""


@dataclass(frozen=True)
class SkinMotion:
    """Motion relative to the skull, at evenly spaced frames of a take."""

    speeds: FloatArray
    """(n,): of all markers and frames, over one lag or, if it is less, the displacement over three:
    an outlier, which returns at once, has none [mm/s]."""
    rotations: FloatArray
    """(frames, 3, 3): of the head, from the pose of the reference frame."""
    depth: FloatArray
    main: FloatArray
    """`depth`, `main`: (3,): in that pose, the directions of least extent and of most motion;
    zero if not distinct."""
    articulated: bool
    """Whether the markers move too much to be those of one head."""

    @classmethod
    def of(
        cls, positions: Float32Array, usable: BoolArray, rows: IntArray, rate: float
    ) -> "SkinMotion":
        """Measure the motion, relative to a robust rigid alignment."""
        steps = max(1, round(rate * _SPEED_SECONDS)) * np.arange(-1, 3)
        starts = rows[np.isin(rows[:, None] + steps, rows).all(axis=1)]
        if not len(starts):
            starts, steps = rows, np.zeros(4, np.int64)
        starts = starts[sample_frames(len(starts), _SPEED_FRAMES)]
        picked = (starts + steps[:, None]).ravel()
        sample, seen = positions[picked].astype(np.float64), usable[picked]
        reference = sample[int(seen.sum(axis=1).argmax())]
        alignment = align_rigid_robust(sample, reference, visible=seen)
        seen &= alignment.determined[:, None]
        known = seen.any(axis=0)
        if not known.any():  # all on one line in every frame
            return cls(np.zeros(0), alignment.rotations, np.zeros(3), np.zeros(3), False)
        still, seen = np.asarray(remove_motion(sample, alignment))[:, known], seen[:, known]
        lag = int(steps[2])
        four = still.reshape(len(steps), len(starts), -1, 3)
        step, span = (np.linalg.norm(four[b] - four[a], axis=2) for a, b in ((1, 2), (0, 3)))
        all_seen = seen.reshape(four.shape[:3]).all(axis=0)
        speeds = np.minimum(step, span)[all_seen] * (rate / lag if lag else 0.0)
        middle = np.nanmedian(np.where(seen[..., None], still, np.nan), axis=0)
        away = (still - middle)[seen]
        return cls(
            speeds,
            alignment.rotations,
            _flattest(middle),
            _main_axis(away),
            float(np.sqrt((away**2).sum(axis=1).mean())) > _ARTICULATED_SHARE * rms_radius(middle),
        )

    def height(self, axis: FloatArray) -> float:
        """Return the RMS vertical component of a direction of the head over the take [0-1]."""
        return float(np.sqrt(np.mean((self.rotations @ axis)[:, 1] ** 2)))


def _flattest(cloud: FloatArray) -> FloatArray:
    _, spread, axes = np.linalg.svd(cloud - cloud.mean(axis=0), full_matrices=False)
    if len(spread) < 3 or spread[2] >= _FLAT_RATIO * spread[1]:
        return np.zeros(3)
    return np.asarray(axes[2])


def _main_axis(away: FloatArray) -> FloatArray:
    variances, axes = np.linalg.eigh(away.T @ away)
    if variances[2] <= _MAIN_RATIO * variances[1]:
        return np.zeros(3)
    return np.asarray(axes[:, 2])
