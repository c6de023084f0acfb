"""Correspondence between markers and samples of skin, from shape and from motion.

Lips, lids and nostrils are a few millimetres apart and move in opposite directions, so that motion
distinguishes them where shape cannot. Expectation-maximisation: solve the shapes' weights from the
markers at their current places, compare each marker's path with those of the nearby skin under
these weights, place the marker again, and regularise by a smooth warp.
"""

import numpy as np
from scipy.spatial.distance import cdist

from usdface.core.arrays import Float32Array, FloatArray, rms_radius
from usdface.numerics.registration.cloud_alignment import Alignment, align_pairs
from usdface.numerics.registration.skin_placement import (
    SkinPlacement,
    likelihood_moments,
    path_misfit,
)
from usdface.numerics.solve.bounded_least_squares import solve_bounded_least_squares

_SEARCH_RADII = (0.22, 0.20, 0.17, 0.14, 0.12, 0.10, 0.09, 0.08, 0.07, 0.06, 0.05, 0.05)
"""[of the face's size] Standard deviation of a marker about its warped place, round by round."""
_WARP_SIZE = 0.10
"""[of the face's size] Standard deviation of the warp."""
_WARP_LENGTH = 0.6
"""[of the face's size] Length scale of the warp."""
_LEAST_DEVIATION = 0.02
"""[of the face's size] Least standard deviation of a marker's place, by motion or by a person. An
exact warp of pins a millimetre apart, whose distance on the performer is another one, moves the
other markers by centimetres."""
_SHAPE_DEVIATION = 0.2
"""[of the face's size] Standard deviation of a marker's place by shape alone."""
_HALF_WEIGHT_SIZE = 0.25
"""[of the face's size] Residual of a marker that weighs half (Cauchy)."""
_EVIDENCE_SAMPLES = 6.0
"""Effective number of independent samples of a path, whose frames are correlated."""
_MODEL_ERROR = 0.04
"""[of a path's energy] Left unexplained by correct placements too."""
_WEIGHT_RIDGE = 25.0
"""[mm^2] (1.5 mm of noise / typical weight of 0.3)^2."""


def place_by_motion(
    cloud: FloatArray,
    skin: FloatArray,
    alignment: Alignment,
    *,
    skin_deltas: Float32Array,
    motion: FloatArray,
    ranges: FloatArray,
    pinned: dict[int, FloatArray],
) -> SkinPlacement:
    """Place each marker on a skin sample.

    Parameters
    ----------
    cloud : (markers, 3) float array
        The performer's neutral face.
    skin : (samples, 3) float array
    alignment : Alignment
        Initial guess, accurate to about a tenth of the face's size.
    skin_deltas : (shapes, samples, 3) float array
        Displacements of the skin by each shape at 1.
    motion : (frames, markers, 3) float array
        Displacements from `cloud`, in the performer's space; without frames, shape alone counts.
    ranges : (shapes, 2) float array
        Limits of the shapes' weights.
    pinned : dict of int to (3,) float array
        Known places of markers.
    """
    size = rms_radius(skin)
    warped = alignment.apply(cloud)
    for radius in _SEARCH_RADII:
        away = cdist(warped, skin, "sqeuclidean") / (2 * (radius * size) ** 2)
        chosen = away.argmin(axis=1)
        target, variance = skin[chosen], np.full(len(cloud), (_SHAPE_DEVIATION * size) ** 2)
        if len(motion):
            paths = alignment.apply_to_motion(motion)
            weights = solve_bounded_least_squares(
                skin_deltas[:, chosen].reshape(len(ranges), -1).T,
                paths.reshape(len(paths), -1),
                lower=ranges[:, 0],
                upper=ranges[:, 1],
                ridge=_WEIGHT_RIDGE,
            )
            misfit = path_misfit(skin_deltas, weights, paths)
            cost = away + _EVIDENCE_SAMPLES / 2 * np.log(misfit + _MODEL_ERROR)
            chosen = cost.argmin(axis=1)
            moved_to, moved_variance = likelihood_moments(away, cost, skin, largest_share=0.9)
            moved_variance += (_LEAST_DEVIATION * size) ** 2
            target = (target / variance[:, None] + moved_to / moved_variance[:, None]) / (
                1 / variance + 1 / moved_variance
            )[:, None]
            variance = 1 / (1 / variance + 1 / moved_variance)
        for marker, place in pinned.items():
            chosen[marker] = ((skin - place) ** 2).sum(axis=1).argmin()
            target[marker], variance[marker] = place, (_LEAST_DEVIATION * size) ** 2
        squared = ((alignment.apply(cloud) - target) ** 2).sum(axis=1)
        robust = 1 + squared / (_HALF_WEIGHT_SIZE * size) ** 2
        weight = 1 / (variance + (_WARP_SIZE * size) ** 2) / robust
        alignment = align_pairs(cloud, target, weight=weight)
        warped = _warp(alignment.apply(cloud), target, variance, size)
    return SkinPlacement(chosen, warped, alignment)


def _warp(start: FloatArray, target: FloatArray, variance: FloatArray, size: float) -> FloatArray:
    """Move points towards targets by the posterior mean of a Gaussian process over the cloud."""
    distance = cdist(start, start) / (_WARP_LENGTH * size)
    kernel = (_WARP_SIZE * size) ** 2 * np.exp(-0.5 * distance**2)
    pull = np.linalg.solve(kernel + np.diag(variance), target - start)
    return start + kernel @ pull
