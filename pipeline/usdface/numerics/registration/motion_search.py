"""Where a cloud without speaking labels lies on a face: a search scored by what motion explains.

The plane of symmetry leaves pitch, scale, height and depth. Each candidate is scored by the share
of the markers' motion that the shapes explain at the nearest skin, less the distance to the skin.
Closest points alone slide to wrong faces: they end 14 to 30 mm off on recorded takes.
"""

from collections.abc import Callable

import numpy as np
from scipy.spatial import KDTree

from usdface.core.arrays import FloatArray
from usdface.numerics.registration.face_skin import FaceSkin
from usdface.numerics.registration.skin_placement import (
    PlaneFit,
    explained_share,
    in_character,
    pitch_rotation,
)

_PITCHES_DEGREES = (-30.0, -15.0, 0.0, 15.0, 30.0)
_SCALES = (0.75, 0.9, 1.05, 1.25)
"""Times the usual scale."""

_HEIGHTS = (-0.6, -0.4, -0.2, 0.0, 0.2, 0.4, 0.6)
"""Of the face's size."""

_SEED_COUNT = 8
_MOST_FITS = 3
_DISTANCE_COST = 1.5
"""Explained share that a root mean square distance of the face's size costs."""

_FARTHEST_MM = 25.0
_FINEST_DEGREES = 0.8
_MOST_FRAMES = 30


def search_by_motion(
    levelled: FloatArray,
    skin: FaceSkin,
    motion: FloatArray,
    *,
    ranges: FloatArray,
    usual_scale: float,
) -> list[tuple[float, float, PlaneFit]]:
    """Return the best fits, best first: score, +1 or -1 for where the cloud looks, and the fit.

    Parameters
    ----------
    levelled : (markers, 3) float array
        At rest, its plane of symmetry at x = 0, looking along +Z or -Z [mm].
    motion : (frames, markers, 3) float array
        Displacements in that space [mm]; some thirty of the frames are used.
    ranges : (shapes, 2) float array
    usual_scale : float
        Character over performer, from which the search starts.
    """
    moved = motion[:_MOST_FRAMES]
    moved_size = np.sqrt((skin.deltas**2).sum(axis=(0, 2)))
    share = moved_size / moved_size.sum()
    middle = share @ skin.positions
    tree, flat = KDTree(skin.positions), KDTree(skin.positions[:, :2])

    def fit_of(x: FloatArray) -> PlaneFit:
        _, pitch, scale, height, depth = x
        rotation = pitch_rotation(np.deg2rad(pitch))
        size = scale * usual_scale
        placed = size * ((levelled * [x[0], 1.0, x[0]]) @ rotation.T)
        shift = np.array([skin.sagittal_x, middle[1] + height - np.median(placed[:, 1]), 0.0])
        placed += shift
        away, near = map(np.asarray, flat.query(placed[:, :2], k=4))
        foremost = skin.positions[near, 2].max(axis=1)
        over = away[:, 0] < 8 if (away[:, 0] < 8).any() else np.ones(len(placed), np.bool_)
        shift[2] = float(np.median((foremost - placed[:, 2])[over])) + depth
        return PlaneFit(rotation, np.full(3, size), shift)

    def score(x: FloatArray) -> float:
        fit, yaw = fit_of(x), np.array([x[0], 1.0, x[0]])
        away, near = map(np.asarray, tree.query(fit.apply(levelled * yaw)))
        share = explained_share(skin, near, in_character(moved * yaw, fit), ranges)
        distance = np.sqrt(np.mean(np.minimum(away, _FARTHEST_MM) ** 2))
        return share - _DISTANCE_COST * float(distance) / skin.size_mm

    grid = [
        np.array([yaw, pitch, scale, height * skin.size_mm, 0.0])
        for yaw in (1.0, -1.0)
        for pitch in _PITCHES_DEGREES
        for scale in _SCALES
        for height in _HEIGHTS
    ]
    values = [score(x) for x in grid]
    best = np.argsort(values)[::-1][:_SEED_COUNT]
    steps = np.array([0.0, 7.0, 0.07, 0.1 * skin.size_mm, 0.06 * skin.size_mm])
    found = sorted(
        (_pattern_search(score, grid[i], values[i], steps) for i in best), key=lambda each: -each[0]
    )
    kept: list[tuple[float, FloatArray]] = []
    for value, x in found:
        if all(np.abs((x - other) / [1, 4, 0.04, 4, 4]).max() > 1 for _, other in kept):
            kept.append((value, x))
    return [(value, float(x[0]), fit_of(x)) for value, x in kept[:_MOST_FITS]]


def _pattern_search(
    score: Callable[[FloatArray], float], x: FloatArray, value: float, steps: FloatArray
) -> tuple[float, FloatArray]:
    """Climb along the axes, halving the steps where none helps."""
    while steps[1] > _FINEST_DEGREES:
        better = False
        for axis in range(1, len(x)):
            for sign in (1.0, -1.0):
                tried = x.copy()
                tried[axis] += sign * steps[axis]
                reached = score(tried)
                if reached > value:
                    x, value, better = tried, reached, True
                    break
        if not better:
            steps = steps / 2
    return value, x
