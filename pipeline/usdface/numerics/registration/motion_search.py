"""Placement of a cloud without anatomical labels on a face: search over pitch, scale and shift.

The plane of symmetry leaves pitch, scale, height and depth. A candidate's score is the share of the
markers' motion that the shapes explain at the nearest skin, the match of markers with landmarks,
and the plausibility of its size; none is enough alone. Explained motion alone prefers small faces;
iterative closest points alone end 14 to 30 mm off on recorded takes.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from usdface.core.arrays import FloatArray
from usdface.numerics.registration.cloud_alignment import Alignment
from usdface.numerics.registration.face_skin import TYPICAL_SIZE_MM, FaceSkin
from usdface.numerics.registration.landmark_matching import (
    FaceLandmarks,
    match_landmarks,
    refine_fit,
)
from usdface.numerics.registration.plane_fit import pitch_rotation
from usdface.numerics.registration.skin_placement import (
    MODEL_ERROR_SHARE,
    explained_share,
    solve_weights_at,
    to_character,
)

LANDMARK_VALUE = 0.4
"""Explained share per unit of `LandmarkMatch.score`. This and the costs below were chosen on
performers simulated on one rig and placed on another, among 0, 0.1 and 0.4, and checked on recorded
takes."""

SIZE_COST = 0.3
"""Explained share per unit of |log(height / usual height)|."""

_DISTANCE_COST = 1.5
"""Explained share per root mean square distance [of the face's size]."""

_PITCHES_DEGREES = (-30.0, -15.0, 0.0, 15.0, 30.0)
_SCALES = (0.75, 0.9, 1.05, 1.25)
"""[of the usual scale]"""

_HEIGHTS = (-0.6, -0.4, -0.2, 0.0, 0.2, 0.4, 0.6)
"""[of the face's size]"""

_CLIMBED_COUNT, _REFINED_COUNT = 8, 60
"""Best of the grid that are refined by pattern search, and by landmarks, which is faster."""
_MOST_FITS = 3
"""Candidates returned from either refinement."""
_SAME_MM = 2.0
"""Root mean square distance below which two fits are the same, on an adult's face."""

_SEARCH_PROPORTION_MM = 8.0
"""Standard deviation of a marker about a fit with one scale, on an adult's face."""

_USUAL_LEFT = 0.3
"""Share of a recorded take's motion that a rig's shapes leave unexplained at the right place."""

_FARTHEST_MM = 25.0
"""Distances from the skin are truncated here."""
_FINEST_DEGREES = 0.8
"""Step in pitch at which the pattern search ends."""
_MOST_FRAMES = 30


@dataclass(frozen=True)
class SearchedFit:
    """A candidate: heading of the levelled cloud, +Z (`yaw` 1) or -Z (-1), and its fit."""

    score: float
    yaw: float
    fit: Alignment

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
    """Return distinct candidates of either refinement, by score.

    Parameters
    ----------
    levelled : (markers, 3) float array
        At rest, its plane of symmetry at x = 0, looking along +Z or -Z [mm].
    motion : (frames, markers, 3) float array
        Displacements in that space [mm]; the first thirty frames are used.
    ranges : (shapes, 2) float array
    usual_scale : float
        From the performer to the face's frame; the search starts from it.
    """
    search = _Search(levelled, skin, motion[:_MOST_FRAMES], ranges, usual_scale, landmarks)
    grid = [
        np.array([yaw, pitch, scale, height * TYPICAL_SIZE_MM, 0.0])
        for yaw in (1.0, -1.0)
        for pitch in _PITCHES_DEGREES
        for scale in _SCALES
        for height in _HEIGHTS
    ]
    values = [search.score(x) for x in grid]
    best = np.argsort(values)[::-1]
    steps = np.array([0.0, 7.0, 0.07, 0.1 * TYPICAL_SIZE_MM, 0.06 * TYPICAL_SIZE_MM])
    climbed = [
        search.candidate(x[0], search.fit_of(x))
        for x in (
            _pattern_search(search.score, grid[i], values[i], steps) for i in best[:_CLIMBED_COUNT]
        )
    ]
    refined = []
    if landmarks.names:
        for i in best[:_REFINED_COUNT]:
            turned = levelled * [grid[i][0], 1.0, grid[i][0]]
            start = search.fit_of(grid[i])
            fit = refine_fit(turned, landmarks, start, centre_x=skin.sagittal_x)
            refined.append(search.candidate(grid[i][0], fit))
    return [*search.distinct(climbed), *search.distinct(refined)]


class _Search:
    """Scores of candidates, with search trees over the skin."""

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
        activity = skin.activity()
        share = activity / activity.sum()
        self._middle_y = float(share @ skin.positions[:, 1])
        self._tree, self._flat = KDTree(skin.positions), KDTree(skin.positions[:, :2])
        self._scores: dict[bytes, float] = {}

    def fit_of(self, x: FloatArray) -> Alignment:
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
        return Alignment(np.full(3, size), rotation, shift)

    def score(self, x: FloatArray) -> float:
        """Return the score at coordinates, to which a pattern search returns several times."""
        key = x.tobytes()
        if key not in self._scores:
            self._scores[key] = self.candidate(float(x[0]), self.fit_of(x)).score
        return self._scores[key]

    def candidate(self, yaw: float, fit: Alignment) -> SearchedFit:
        """Return a fit with its score."""
        skin, turn = self._skin, np.array([yaw, 1.0, yaw])
        placed = fit.apply(self._levelled * turn)
        away, near = map(np.asarray, self._tree.query(placed))
        paths = to_character(self._motion * turn, fit)
        weights = solve_weights_at(skin, near, paths, self._ranges)
        distance = np.sqrt(np.mean(np.minimum(away, _FARTHEST_MM) ** 2)) / TYPICAL_SIZE_MM
        matched = match_landmarks(placed, self._landmarks, proportion_mm=_SEARCH_PROPORTION_MM)
        score = (
            motion_value(explained_share(skin, near, paths, weights))
            - _DISTANCE_COST * float(distance)
            - size_cost(fit, self._usual_scale)
            + LANDMARK_VALUE * matched.score
        )
        return SearchedFit(score, float(yaw), fit)

    def distinct(self, candidates: list[SearchedFit]) -> list[SearchedFit]:
        """Return the best candidates that differ from each other, by score."""
        chosen: list[tuple[SearchedFit, FloatArray]] = []
        for candidate in sorted(candidates, key=lambda candidate: -candidate.score):
            places = candidate.fit.apply(self._levelled * candidate.turn)
            distances = [np.sqrt(((other - places) ** 2).sum(axis=1).mean()) for _, other in chosen]
            if min(distances, default=np.inf) > _SAME_MM:
                chosen.append((candidate, places))
        return [candidate for candidate, _ in chosen[:_MOST_FITS]]


def motion_value(share: float) -> float:
    """Return the score of an explained share: the negative logarithm of the unexplained one.

    Scaled to slope 1 at `_USUAL_LEFT`, so that the costs are shares of a usual take's motion.
    """
    unexplained = 1 - share + MODEL_ERROR_SHARE
    return -(_USUAL_LEFT + MODEL_ERROR_SHARE) * float(np.log(unexplained))


def size_cost(fit: Alignment, usual_scale: float) -> float:
    """Return the cost of an improbable height of the face, as an explained share."""
    return SIZE_COST * abs(float(np.log(fit.scale[1] / usual_scale)))


def _pattern_search(
    score: Callable[[FloatArray], float], x: FloatArray, value: float, steps: FloatArray
) -> FloatArray:
    """Maximise by coordinate steps, halved where none improves (Hooke and Jeeves 1961)."""
    while steps[1] > _FINEST_DEGREES:
        better = False
        for axis in range(1, len(x)):
            for sign in (1.0, -1.0):
                trial = x.copy()
                trial[axis] += sign * steps[axis]
                trial_value = score(trial)
                if trial_value > value:
                    x, value, better = trial, trial_value, True
                    break
        if not better:
            steps = steps / 2
    return x
