"""Where a cloud without speaking labels lies on a face: a search over pitch, size and place.

The plane of symmetry leaves pitch, scale, height and depth. Each candidate is scored by the share
of the markers' motion that the shapes explain at the nearest skin, by how well markers match the
landmarks at which people put them, and by its size; none of the three is enough. Explained motion
alone prefers small faces. Closest points slide to wrong ones, 14 to 30 mm off on recorded takes.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from usdface.core.arrays import FloatArray
from usdface.numerics.registration.face_skin import FaceSkin
from usdface.numerics.registration.landmark_matching import (
    FaceLandmarks,
    match_landmarks,
    refine_fit,
)
from usdface.numerics.registration.skin_placement import (
    MODEL_ERROR_SHARE,
    PlaneFit,
    explained_share,
    in_character,
    pitch_rotation,
    solve_weights_at,
)

LANDMARK_VALUE = 0.4
"""Explained share that one unit of `LandmarkMatch.score` is worth. As the costs below, chosen on
performers made of one rig and placed on another, among 0, 0.1 and 0.4, with recorded takes in
view."""

SIZE_COST = 0.3
"""Explained share that a face e times too high or too low costs."""

_DISTANCE_COST = 1.5
"""Explained share that a root mean square distance of the face's size costs."""

_PITCHES_DEGREES = (-30.0, -15.0, 0.0, 15.0, 30.0)
_SCALES = (0.75, 0.9, 1.05, 1.25)
"""Times the usual scale."""

_HEIGHTS = (-0.6, -0.4, -0.2, 0.0, 0.2, 0.4, 0.6)
"""Of the face's size."""

_CLIMBED_COUNT, _REFINED_COUNT = 8, 60
"""Of the grid's best: those that climb, and those fitted to landmarks, which is fast."""
_MOST_FITS = 3
"""Of either kind."""
_SAME_MM = 2.0
"""Root mean square distance between two fits of a cloud that are one, on an adult's face."""

_SEARCH_PROPORTION_MM = 8.0
"""Standard deviation of a marker about a fit with one scale, on an adult's face."""

_USUAL_LEFT = 0.3
"""Share of a recorded take's motion that a rig's shapes leave unexplained at the right place."""

_FARTHEST_MM = 25.0
_FINEST_DEGREES = 0.8
_MOST_FRAMES = 30


@dataclass(frozen=True)
class SearchedFit:
    """A candidate: the levelled cloud looks along +Z (`yaw` 1) or -Z (-1), and is fitted there."""

    score: float
    yaw: float
    fit: PlaneFit

    @property
    def turn(self) -> FloatArray:
        """Return the factors that turn the levelled cloud to +Z."""
        return np.array([self.yaw, 1.0, self.yaw])


def search_by_motion(
    levelled: FloatArray,
    skin: FaceSkin,
    motion: FloatArray,
    *,
    ranges: FloatArray,
    usual_scale: float,
    landmarks: FaceLandmarks,
) -> list[SearchedFit]:
    """Return candidates that differ, the best of each kind first.

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
    scene = _Search(levelled, skin, motion[:_MOST_FRAMES], ranges, usual_scale, landmarks)
    grid = [
        np.array([yaw, pitch, scale, height * skin.size_mm, 0.0])
        for yaw in (1.0, -1.0)
        for pitch in _PITCHES_DEGREES
        for scale in _SCALES
        for height in _HEIGHTS
    ]
    values = [scene.score(x) for x in grid]
    best = np.argsort(values)[::-1]
    steps = np.array([0.0, 7.0, 0.07, 0.1 * skin.size_mm, 0.06 * skin.size_mm])
    climbed = [
        scene.candidate(x[0], scene.fit_of(x))
        for x in (
            _pattern_search(scene.score, grid[i], values[i], steps) for i in best[:_CLIMBED_COUNT]
        )
    ]
    refined = []
    if landmarks.names:
        for i in best[:_REFINED_COUNT]:
            turned = levelled * [grid[i][0], 1.0, grid[i][0]]
            start = scene.fit_of(grid[i])
            fit = refine_fit(turned, landmarks, start, centre_x=skin.sagittal_x)
            refined.append(scene.candidate(grid[i][0], fit))
    return [*scene.distinct(climbed), *scene.distinct(refined)]


class _Search:
    """Scores of fits, with what finds neighbours on the skin."""

    def __init__(
        self,
        levelled: FloatArray,
        skin: FaceSkin,
        motion: FloatArray,
        ranges: FloatArray,
        usual_scale: float,
        landmarks: FaceLandmarks,
    ) -> None:
        self._levelled, self._skin, self._motion, self._ranges = levelled, skin, motion, ranges
        self._usual_scale, self._landmarks = usual_scale, landmarks
        share = skin.activity() / skin.activity().sum()
        self._middle_y = float(share @ skin.positions[:, 1])
        self._tree, self._flat = KDTree(skin.positions), KDTree(skin.positions[:, :2])

    def fit_of(self, x: FloatArray) -> PlaneFit:
        """Return the fit with these coordinates: yaw, pitch, scale, height, depth."""
        yaw, pitch, scale, height, depth = x
        skin, rotation = self._skin, pitch_rotation(np.deg2rad(pitch))
        size = scale * self._usual_scale
        placed = size * ((self._levelled * [yaw, 1.0, yaw]) @ rotation.T)
        lift = self._middle_y + height - np.median(placed[:, 1])
        shift = np.array([skin.sagittal_x, lift, 0.0])
        placed += shift
        away, near = map(np.asarray, self._flat.query(placed[:, :2], k=4))
        foremost = skin.positions[near, 2].max(axis=1)
        over = away[:, 0] < 8 if (away[:, 0] < 8).any() else np.ones(len(placed), np.bool_)
        shift[2] = float(np.median((foremost - placed[:, 2])[over])) + depth
        return PlaneFit(rotation, np.full(3, size), shift)

    def score(self, x: FloatArray) -> float:
        return self.candidate(float(x[0]), self.fit_of(x)).score

    def candidate(self, yaw: float, fit: PlaneFit) -> SearchedFit:
        """Return a fit with its score."""
        skin, turn = self._skin, np.array([yaw, 1.0, yaw])
        placed = fit.apply(self._levelled * turn)
        away, near = map(np.asarray, self._tree.query(placed))
        paths = in_character(self._motion * turn, fit)
        weights = solve_weights_at(skin, near, paths, self._ranges)
        distance = np.sqrt(np.mean(np.minimum(away, _FARTHEST_MM) ** 2)) / skin.size_mm
        matched = match_landmarks(placed, self._landmarks, proportion_mm=_SEARCH_PROPORTION_MM)
        score = (
            motion_value(explained_share(skin, near, paths, weights))
            - _DISTANCE_COST * float(distance)
            - size_cost(fit, self._usual_scale)
            + LANDMARK_VALUE * matched.score
        )
        return SearchedFit(score, float(yaw), fit)

    def distinct(self, found: list[SearchedFit]) -> list[SearchedFit]:
        """Return the best of the fits that differ."""
        kept: list[SearchedFit] = []
        for each in sorted(found, key=lambda each: -each.score):
            places = each.fit.apply(self._levelled * each.turn)
            if all(
                np.sqrt(
                    ((other.fit.apply(self._levelled * other.turn) - places) ** 2).sum(1).mean()
                )
                > _SAME_MM * self._landmarks.unit
                for other in kept
            ):
                kept.append(each)
        return kept[:_MOST_FITS]


def motion_value(share: float) -> float:
    """Return what an explained share is worth: the logarithm of what it leaves unexplained.

    Its slope is 1 where `_USUAL_LEFT` is left, so that the costs are shares of a usual take's
    motion; where nearly all is explained, small differences tell more.
    """
    left = 1 - share + MODEL_ERROR_SHARE
    return -(_USUAL_LEFT + MODEL_ERROR_SHARE) * float(np.log(left))


def size_cost(fit: PlaneFit, usual_scale: float) -> float:
    """Return the explained share that an unlikely height of the face costs."""
    return SIZE_COST * abs(float(np.log(fit.scale[1] / usual_scale)))


def _pattern_search(
    score: Callable[[FloatArray], float], x: FloatArray, value: float, steps: FloatArray
) -> FloatArray:
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
    return x
