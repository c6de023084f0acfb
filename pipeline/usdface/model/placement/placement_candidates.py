"""Candidate placements of a cloud on a skin, by labels, given places and motion; and the best."""

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from usdface.core.arrays import FloatArray
from usdface.model.placement.marker_cloud import MarkerCloud, middle_markers
from usdface.numerics.registration.cloud_alignment import Alignment, align_cloud, align_landmarks
from usdface.numerics.registration.face_skin import TYPICAL_SIZE_MM, FaceSkin
from usdface.numerics.registration.landmark_matching import FaceLandmarks, match_landmarks
from usdface.numerics.registration.motion_correspondence import place_by_motion
from usdface.numerics.registration.motion_search import (
    LANDMARK_VALUE,
    SearchedFit,
    motion_value,
    search_by_motion,
    size_cost,
)
from usdface.numerics.registration.plane_fit import fit_in_plane
from usdface.numerics.registration.skin_placement import (
    KnownPlace,
    SkinPlacement,
    explained_share,
    place_on_skin,
    solve_weights_at,
    to_character,
)

FEWEST_HINTS = 6
"""Fewest markers whose labels name a landmark each for a placement by labels. Numbered labels
(``mouth_R1`` to ``mouth_R13``) name a region, which is less precise than motion."""

_PROPORTION_SPREAD_MM = 4.0
"""Standard deviation of a marker about the transform fitted to all; that of the most precise
label."""

_WARPED_SPREAD_MM = 6.0
"""Standard deviation of a warped marker about the fit without warp: differing proportions."""

_WARP_COST = 0.3
"""Reduction of a candidate's value, per mean warp in units of the face's size."""

_LABEL_COST = 0.03
"""Reduction of a candidate's value, per mean squared distance of labelled parts from their
landmarks in standard deviations: it decides where shapes explain little of the motion."""

_LEAST_GAIN = 0.03
"""Difference of value above which another candidate replaces that of closest points, which fit
proportions in every round and are more accurate with dense markers."""

_DOUBTFUL_VALUE = 0.2
"""Value of the best candidate below which the cloud is searched upside down as well. Of recorded
and simulated takes, those that move most of the face reach it upright, and none upside down."""


@dataclass(frozen=True)
class PlacementInputs:
    """What the placements of a cloud on a skin are made from."""

    cloud: MarkerCloud
    skin: FaceSkin
    ranges: FloatArray
    """(shapes, 2): of the weights."""
    landmarks: list[KnownPlace]
    """Of labelled markers, and places given by a person."""
    pins: dict[int, FloatArray]
    """(3,) each: the places given by a person, by marker [mm]."""
    usual_scale: float
    """Expected scale from the performer to the face's frame."""
    features: FaceLandmarks
    """The rig's landmarks, for markers without a label."""
    skin_share: float = 1.0
    """As of `place_on_skin`."""


@dataclass(frozen=True)
class PlacementCandidate:
    """A placement, with the rotation of the cloud to which it applies."""

    frame: FloatArray
    placement: SkinPlacement
    overturned_gain: float = 0.0


def _settle(
    inputs: PlacementInputs, frame: FloatArray, levelled: FloatArray, fit: Alignment
) -> PlacementCandidate:
    cloud, images = inputs.cloud, inputs.skin_share < 1
    motion = cloud.motion[:0] if images else cloud.motion
    placement = place_on_skin(
        levelled,
        inputs.skin,
        fit,
        landmarks=inputs.landmarks,
        motion=motion @ frame.T,
        ranges=inputs.ranges,
        still=cloud.still,
        middle=middle_markers(cloud.labels),
        skin_share=inputs.skin_share,
    )
    return PlacementCandidate(frame, placement)


def candidate_by_pins(inputs: PlacementInputs) -> PlacementCandidate:
    """Place from a similarity transform fitted to given places."""
    rows = list(inputs.pins)
    return _by_points(inputs, inputs.cloud.neutral[rows], np.array(list(inputs.pins.values())))


def _by_points(
    inputs: PlacementInputs, points: FloatArray, targets: FloatArray
) -> PlacementCandidate:
    """Place from a similarity transform fitted to pairs of points."""
    fit = align_landmarks(points, targets)
    return _settle(inputs, np.eye(3), inputs.cloud.neutral, fit)


def candidate_by_labels(inputs: PlacementInputs) -> PlacementCandidate:
    """Place from a transform fitted to landmarks named by labels and to given places."""
    targets = np.array([each.place for each in inputs.landmarks])
    try:
        frame, levelled = inputs.cloud.levelled()
    except ValueError:  # markers of one side
        return _by_points(inputs, _middles(inputs, inputs.cloud.neutral), targets)
    middles = _middles(inputs, levelled)
    spreads = np.array([each.spread_mm for each in inputs.landmarks])
    # A given place is exact, but differing proportions keep the transform from reaching it.
    fit = fit_in_plane(
        middles,
        targets,
        np.maximum(spreads, _PROPORTION_SPREAD_MM),
        centre_x=inputs.skin.sagittal_x,
    )
    return _settle(inputs, frame, levelled, fit)


def _middles(inputs: PlacementInputs, positions: FloatArray) -> FloatArray:
    """Return the mean position of the markers of each known place: (places, 3)."""
    return np.array([positions[list(each.markers)].mean(axis=0) for each in inputs.landmarks])


def best_by_motion(inputs: PlacementInputs) -> PlacementCandidate:
    """Return the best candidate of closest points, labels, and a search in the plane of symmetry.

    Markers near landmarks are drawn to them, weighted by the probability of the match.
    """
    cloud, motion = inputs.cloud, inputs.cloud.motion
    if not motion.any():
        return _by_shape(inputs)
    try:
        frame, levelled = cloud.levelled()
    except ValueError:  # no symmetry, so no search in its plane
        has_labels = len(inputs.landmarks) >= FEWEST_HINTS
        return candidate_by_labels(inputs) if has_labels else _by_shape(inputs)
    candidates = []
    with suppress(ValueError):  # no alignment ends upright
        candidates.append(_by_shape(inputs))
    count = len(candidates)
    searched = _search(inputs, levelled, motion @ frame.T)
    value = max(found.score for found in searched)
    gain = 0.0
    if value < _DOUBTFUL_VALUE:  # does the cloud fit better upside down?
        over = np.array([-1.0, -1.0, 1.0])
        overturned = _search(inputs, levelled * over, motion @ frame.T * over)
        gain = max(max(found.score for found in overturned) - value, 0.0)
    for found in searched:
        turned = levelled * found.turn
        candidates.append(_drawn(inputs, found.turn[:, None] * frame, turned, found.fit))
    if len(inputs.landmarks) >= FEWEST_HINTS:
        candidates.append(candidate_by_labels(inputs))
    values = [_value(inputs, candidate, frame, levelled) for candidate in candidates]
    first = int(np.argmax(values))
    if count and values[0] >= values[first] - _LEAST_GAIN:
        return replace(candidates[0], overturned_gain=gain)
    turn = _turn_of(candidates[first], frame)
    fit = _fit_to(inputs, candidates[first], levelled * turn)
    again = _drawn(inputs, turn[:, None] * frame, levelled * turn, fit)
    best = again if _value(inputs, again, frame, levelled) > values[first] else candidates[first]
    return replace(best, overturned_gain=gain)


def _search(inputs: PlacementInputs, levelled: FloatArray, motion: FloatArray) -> list[SearchedFit]:
    return search_by_motion(
        levelled,
        inputs.skin,
        motion,
        ranges=inputs.ranges,
        usual_scale=inputs.usual_scale,
        landmarks=inputs.features,
    )


def _drawn(
    inputs: PlacementInputs, frame: FloatArray, levelled: FloatArray, fit: Alignment
) -> PlacementCandidate:
    """Settle a fit with its markers drawn to landmarks nearby."""
    features = inputs.features
    match = match_landmarks(fit.apply(levelled), features)
    spreads = features.spreads[match.landmarks] / np.sqrt(match.probability)
    places = features.places[match.landmarks]
    named = {marker for each in inputs.landmarks for marker in each.markers}
    likely = [
        KnownPlace((marker,), place, float(spread))
        for marker, place, spread in zip(match.markers.tolist(), places, spreads, strict=True)
        if marker not in named
    ]
    return _settle(replace(inputs, landmarks=likely + inputs.landmarks), frame, levelled, fit)


def _turn_of(candidate: PlacementCandidate, frame: FloatArray) -> FloatArray:
    """Return the factors (1 or -1 per axis) that turn the levelled cloud to a placement's yaw."""
    rotation = candidate.placement.fit.rotation @ candidate.frame @ frame.T
    yaw = 1.0 if rotation[0, 0] + rotation[2, 2] > 0 else -1.0
    return np.array([yaw, 1.0, yaw])


def _fit_to(
    inputs: PlacementInputs, candidate: PlacementCandidate, turned: FloatArray
) -> Alignment:
    """Fit the transform in the plane of symmetry to the settled positions."""
    spreads = np.full(len(turned), _WARPED_SPREAD_MM)
    warped = candidate.placement.warped
    return fit_in_plane(turned, warped, spreads, centre_x=inputs.skin.sagittal_x)


def _value(
    inputs: PlacementInputs, candidate: PlacementCandidate, frame: FloatArray, levelled: FloatArray
) -> float:
    """Return the value of a placement: motion and landmarks, less the costs of warp and size.

    Roll and shift of the plane of symmetry count as warp.
    """
    placement, skin, motion = candidate.placement, inputs.skin, inputs.cloud.motion
    turned = levelled * _turn_of(candidate, frame)
    fit = _fit_to(inputs, candidate, turned)
    places = fit.apply(turned)
    away = np.linalg.norm(placement.warped - places, axis=1)
    value = LANDMARK_VALUE * match_landmarks(places, inputs.features).score
    value -= _WARP_COST * float(away.mean()) / TYPICAL_SIZE_MM + size_cost(fit, inputs.usual_scale)
    if inputs.landmarks:
        misses = _middles(inputs, placement.warped) - [each.place for each in inputs.landmarks]
        spreads = np.array([each.spread_mm for each in inputs.landmarks])
        value -= _LABEL_COST * float(((misses**2).sum(axis=1) / spreads**2).mean())
    moved = to_character(motion @ candidate.frame.T, placement.fit)
    weights = solve_weights_at(skin, placement.samples, moved, inputs.ranges)
    return value + motion_value(explained_share(skin, placement.samples, moved, weights))


def _by_shape(inputs: PlacementInputs) -> PlacementCandidate:
    """Place by iterative closest points, with the amplitude of motion as a fourth coordinate.

    Needs neither symmetry nor motion and fits proportions in every round: most accurate with many
    markers all over the face. With few markers it may slide to a wrong place.
    """
    cloud, skin = inputs.cloud, inputs.skin
    found = align_cloud(
        cloud.neutral,
        skin.positions,
        activity=skin.activity(),
        areas=skin.areas,
        amplitude=np.linalg.norm(cloud.motion, axis=2).sum(axis=0),
    )
    placement = place_by_motion(
        cloud.neutral,
        skin.positions,
        found,
        skin_deltas=skin.deltas,
        motion=cloud.motion,
        ranges=inputs.ranges,
        pinned=inputs.pins,
    )
    return PlacementCandidate(np.eye(3), placement)
