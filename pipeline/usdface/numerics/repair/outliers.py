"""Outliers of marker tracks, such as reflections and other markers' labels.

`find_outliers` compares each marker with its prediction from the others. `find_lost` looks for
markers that left the face, `find_spikes` for jumps away and back in single tracks, before a model
is fitted: the model would fit them as directions of the face's motion.
"""

from itertools import pairwise

import numpy as np

from usdface.core.arrays import (
    BoolArray,
    FloatArray,
    RealArray,
    distances,
    extend_block,
    frame_blocks,
    medians_where,
    row_lengths,
    runs,
    sample_frames,
)
from usdface.core.processes import map_threads
from usdface.numerics.repair.low_rank import LowRankModel, fill_and_predict

_LIMIT_MEDIANS = 4.5
"""Medians of the distance from the prediction; exceeded by one in 4e9 isotropic normal errors."""
_LIMIT_NOISE_DEVIATIONS = 5.0
_LEAST_LIMIT_MM = 1.0
"""Smaller errors are not repaired."""
_JUMP_SHARE = 0.5
"""[of the limit] Least jump at the start and end of an outlier; skin does not jump."""
_FAR_LIMITS = 2.0
"""Distance in limits above which one jump is enough, or gaps on both sides."""
USUAL_RATE = 60.0
"""Frames per second."""

_LID_CLOSES_SECONDS = 0.078
_SUDDEN_SHARE = 1 / 3
"""[of the farthest distance] The largest jump of an outlier exceeds it; at low rates, it exceeds
the largest step of a lid that closes along half a cosine, as no other marker predicts a wink."""
_MOST_LIMITS = 1000.0
"""Distances in limits are truncated here, within the range of float16."""
_LONGEST_SHARE = 0.2
"""[of the take] Longer deviations are markers that slipped."""
_LIMIT_SAMPLE_FRAMES = 8192
_JUMP_REACH_FRAMES = 2
"""Frames on either side of a step that `_jump_sizes` uses."""
_MOST_PER_FRAME = 8
"""Outliers sought per frame."""

_LOST_RADII = 4.0
"""Distance from its place at rest beyond which a marker is off the face even if it comes back, in
median distances of the markers from their centre: about 30 cm. Skin moves by less than one."""
_NEIGHBOR_COUNT = 8
_LEAST_FALL_MM = 30.0
"""Displacement of a fallen marker relative to the second most similar neighbour. Skin reaches 19 mm
in recordings, and 25 mm with all shapes of three rigs at random; where markers are sparse, less
than their spacing."""
_FALLEN_SHARE = 0.9
"""[of its samples from the fall on] Least share beyond that, as a fallen marker swings."""
_MOST_FALLEN_SHARE = 0.25
"""[of the markers] If more move so far, it is no face, as in captures of bodies."""
_PLACE_REACH_FRAMES = 2
"""Frames on either side of the neutral one: the place at rest is their median, without outliers."""

_JUMP_MEDIAN_STEPS = 12.0
_JUMP_NOISE_DEVIATIONS = 8.0
"""A step larger than both is a jump."""
_LONGEST_SPIKE_FRAMES = 150
_RETURN_COSINE = -0.5
"""Largest cosine between a jump and the jump back."""
_SPIKE_MOST_SHARE = 0.3
"""[of its samples] Spikes of a marker with more of them are taken for its motion."""
_USUAL_STEP_FRAMES = 20_000


def find_outliers(
    positions: RealArray,
    visible: BoolArray,
    *,
    model: LowRankModel,
    noise: FloatArray,
    rate: float = USUAL_RATE,
) -> BoolArray:
    """Find samples far from their prediction by the other markers that start or end with a jump.

    An outlier also distorts the prediction of its neighbours, so samples are removed one at a time,
    the farthest of a frame first. Returns (frames, markers).

    Parameters
    ----------
    positions : (frames, markers, 3) float array
        [mm] Without head motion; anything where not visible.
    visible : (frames, markers) bool array
    model : LowRankModel
        Fitted to the same take.
    noise : (markers,) float array
        Standard deviation of the measurement noise per coordinate [mm].
    rate : float
        Frames per second.
    """
    closing = np.sin(np.pi / 2 * min(1 / (_LID_CLOSES_SECONDS * rate), 1.0))
    sudden_share = max(_SUDDEN_SHARE, float(closing))
    count = len(positions)
    limits = _limits(positions, visible, model, noise)
    distant = np.zeros(visible.shape, bool)
    excess, jumps = (np.zeros(visible.shape, np.float16) for _ in range(2))  # in limits

    def compare(block: slice) -> None:
        around = extend_block(block, _JUMP_REACH_FRAMES, count)
        inner = slice(block.start - around.start, block.stop - around.start)
        points, seen = positions[around], visible[around]
        complete, predicted = fill_and_predict(model, points, seen)
        offsets = complete - predicted
        beyond = _beyond_limits(points, seen, predicted, model, limits)
        distant[block] = beyond[inner]
        for marker in np.flatnonzero(beyond.any(axis=0)):
            limit = limits[marker]
            distance = distances(points[:, marker], predicted[:, marker])
            excess[block, marker] = np.minimum(distance[inner] / limit, _MOST_LIMITS)
            jump = np.minimum(_jump_sizes(points[:, marker]), _jump_sizes(offsets[:, marker]))
            steps = slice(inner.start, min(inner.stop, len(jump)))
            size = np.minimum(jump[steps] / limit, _MOST_LIMITS)
            jumps[block.start : block.start + len(size), marker] = size

    map_threads(compare, frame_blocks(count))
    outliers = np.zeros_like(distant)
    any_seen = np.asarray(visible.any(axis=1))
    for marker in np.flatnonzero(distant.any(axis=0)):
        outliers[:, marker] = _between_jumps(
            distant[:, marker],
            excess[:, marker],
            jumps[:, marker],
            visible[:, marker],
            any_seen,
            sudden_share,
        )
    return outliers


def _beyond_limits(
    points: RealArray,
    seen: BoolArray,
    predicted: RealArray,
    model: LowRankModel,
    limits: FloatArray,
) -> BoolArray:
    """Return the samples beyond their limit; `predicted` is updated without them."""
    trusted = seen.copy()
    active = np.arange(len(points))
    for _ in range(_MOST_PER_FRAME):
        excess = distances(points[active], predicted[active]) / limits
        excess[~trusted[active]] = 0.0
        worst = excess.argmax(axis=1)
        beyond = excess[np.arange(len(active)), worst] > 1.0
        active = active[beyond]
        if not active.size:
            break
        trusted[active, worst[beyond]] = False
        predicted[active] = fill_and_predict(model, points[active], trusted[active])[1]
    return seen & ~trusted


def _limits(
    positions: RealArray, visible: BoolArray, model: LowRankModel, noise: FloatArray
) -> FloatArray:
    """Return the largest distance of each marker from its prediction that is no outlier [mm]."""
    rows = sample_frames(len(positions), _LIMIT_SAMPLE_FRAMES)
    seen = visible[rows]
    complete, predicted = fill_and_predict(model, positions[rows], seen)
    limits = _LIMIT_MEDIANS * medians_where(distances(complete, predicted), seen)
    return np.maximum(limits, np.maximum(_LIMIT_NOISE_DEVIATIONS * noise, _LEAST_LIMIT_MM))


def _between_jumps(
    distant: BoolArray,
    excess: RealArray,
    jumps: RealArray,
    seen: BoolArray,
    any_seen: BoolArray,
    sudden_share: float,
) -> BoolArray:
    """Return the distant stretches of a marker that start or end with a jump.

    Parameters
    ----------
    distant, seen : (frames,) bool arrays
    any_seen : (frames,) bool array
        Whether any marker is seen: a dropped frame tells nothing of one marker.
    excess, jumps : (frames,) arrays
        Distance from the prediction, and jump to the next frame [limits].
    sudden_share : float
        Least ratio of the largest jump to the farthest distance.
    """
    outliers = np.zeros_like(distant)
    tracked = seen[1:] & seen[:-1]
    gaps = any_seen[1:] & any_seen[:-1] & ~tracked
    for start, stop in runs(distant):
        if stop - start > _LONGEST_SHARE * len(seen):
            continue
        farthest = excess[start:stop].max()
        ends = [edge - 1 for edge in (start, stop) if 0 < edge < len(seen)]
        sudden = jumps[max(start - 1, 0) : stop].max() > sudden_share * farthest
        jump = [bool(tracked[edge] and sudden and jumps[edge] > _JUMP_SHARE) for edge in ends]
        jump_or_gaps = any(jump) or bool(gaps[ends].all())
        outliers[start:stop] = (len(ends) == 2 and all(jump)) or (
            farthest > _FAR_LIMITS and jump_or_gaps
        )
    return outliers


def _jump_sizes(track: RealArray) -> RealArray:
    """Return each step's size, at most its difference from a neighbouring step [mm].

    Fast skin accelerates over several frames, a jump starts from rest.
    """
    steps = np.diff(track, axis=0, prepend=track[:1], append=track[-1:])
    change = np.linalg.norm(np.diff(steps, axis=0), axis=1)
    size = np.linalg.norm(steps[1:-1], axis=1)
    return np.minimum(size, np.maximum(change[:-1], change[1:]))


def find_lost(positions: RealArray, visible: BoolArray, *, neutral: int) -> BoolArray:
    """Return the samples of markers that left the face: (frames, markers) bool array.

    A marker has left for good if it is farther from its neighbours than skin stretches, up to the
    end of the take, or from its start if it fell before the neutral frame; for a time, if it is
    farther from its place at rest than the face is wide. Frames of moving away and back included.

    Parameters
    ----------
    positions : (frames, markers, 3) float array
        [mm] Without head motion.
    visible : (frames, markers) bool array
    neutral : int
        Index of a frame with the markers at rest; others are compared with their median position.
    """
    around = slice(max(neutral - _PLACE_REACH_FRAMES, 0), neutral + _PLACE_REACH_FRAMES + 1)
    places = np.array(
        [
            np.median(track[around][seen[around]] if seen[neutral] else track[seen], axis=0)
            for track, seen in zip(np.swapaxes(positions, 0, 1), visible.T, strict=True)
        ]
    )
    away = np.where(visible, distances(positions, places), 0.0)
    rest = places[visible[neutral]]
    far = _LOST_RADII * float(np.median(distances(rest, np.median(rest, axis=0))))
    lost = (away > far) | _left_neighbors(positions, visible, places, away)
    for marker, track in enumerate(away.T):
        for start, stop in runs(lost[:, marker]):
            while start > 0 and track[start - 1] < track[start]:
                start -= 1
            while stop < len(track) and track[stop] < track[stop - 1]:
                stop += 1
            lost[start:stop, marker] = True
    return lost & visible


def _left_neighbors(
    positions: RealArray, visible: BoolArray, places: RealArray, away: RealArray
) -> BoolArray:
    """Return the samples of markers that have left their neighbours for good: (frames, markers).

    Parameters
    ----------
    places : (markers, 3) float array
        At rest [mm].
    away : (frames, markers) float array
        Distance from the place at rest [mm]; 0 where not visible.
    """
    apart = distances(places[:, None], places)
    np.fill_diagonal(apart, np.inf)
    limit = max(_LEAST_FALL_MM, float(np.median(apart.min(axis=1))))
    near = np.argsort(apart, axis=1, kind="stable")[:, :_NEIGHBOR_COUNT]
    fallen = np.zeros_like(visible)
    for marker in np.flatnonzero((away > limit).any(axis=0)):
        rows, others = np.flatnonzero(away[:, marker] > limit), near[marker]
        moved = positions[rows[:, None], others] - places[others]
        apart_mm = distances(positions[rows, marker, None] - places[marker], moved)
        apart_mm[~visible[rows[:, None], others]] = np.inf
        nearest = np.sort(apart_mm, axis=1)[:, :2].max(axis=1)
        fallen[rows, marker] = np.isfinite(nearest) & (nearest > limit)
    _leave_swaps(fallen, positions, places)
    if fallen.any(axis=0).mean() > _MOST_FALLEN_SHARE:
        return np.zeros_like(fallen)
    for marker in np.flatnonzero(fallen.any(axis=0)):
        frames = np.flatnonzero(visible[:, marker])
        track = fallen[frames, marker]
        counts = np.arange(1, len(track) + 1)
        gone = np.zeros_like(track)
        for side in (slice(None), slice(None, None, -1)):  # from the start on, and to the end
            share = np.cumsum(track[side]) / counts
            ends = np.flatnonzero((share >= _FALLEN_SHARE) & track[side])
            gone[side][: ends[-1] + 1 if len(ends) else 0] = True
        fallen[frames, marker] = gone
    return fallen


def _leave_swaps(fallen: BoolArray, positions: RealArray, places: RealArray) -> None:
    """Clear samples, in place, of two markers at each other's places, as with swapped labels."""
    for frame in np.flatnonzero(fallen.sum(axis=1) > 1):
        markers = np.flatnonzero(fallen[frame])
        nearest = distances(positions[frame, markers, None], places[markers]).argmin(axis=1)
        swapped = (nearest[nearest] == np.arange(len(markers))) & (nearest != nearest[nearest])
        fallen[frame, markers[swapped]] = False


def find_spikes(positions: RealArray, visible: BoolArray, *, noise: FloatArray) -> BoolArray:
    """Return the samples between a jump and the next jump back: (frames, markers) bool array.

    Parameters
    ----------
    positions : (frames, markers, 3) float array
        [mm] Without head motion.
    visible : (frames, markers) bool array
        Jumps across a gap start at the last sample before it.
    noise : (markers,) float array
        Standard deviation of the measurement noise per coordinate [mm].
    """
    spikes = np.zeros_like(visible)
    for marker, seen in enumerate(visible.T):
        frames = np.flatnonzero(seen)
        if len(frames) < 4:
            continue
        steps = np.diff(positions[frames, marker].T.astype(np.float64)).T
        sizes = row_lengths(steps)[:, 0]
        median = float(np.median(sizes[:_USUAL_STEP_FRAMES]))
        jumps = sizes > max(
            _JUMP_MEDIAN_STEPS * median, _JUMP_NOISE_DEVIATIONS * float(noise[marker]), 1e-6
        )
        # Jumps in consecutive steps are one jump: their sum.
        joined = [(start, stop, steps[start:stop].sum(axis=0)) for start, stop in runs(jumps)]
        track = np.zeros(len(seen), bool)
        for (_, leave, out), (back, _, home) in pairwise(joined):
            lengths = float(np.linalg.norm(out) * np.linalg.norm(home))
            short = frames[back] - frames[leave] < _LONGEST_SPIKE_FRAMES
            if out @ home < _RETURN_COSINE * lengths and short:
                track[frames[leave] : frames[back] + 1] = True
        if (track & seen).sum() <= _SPIKE_MOST_SHARE * len(frames):
            spikes[:, marker] = track & seen
    return spikes
