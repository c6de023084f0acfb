"""Place a performer's markers on a rig: by labels and landmarks, else by motion."""

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from usdface.core.arrays import FloatArray, IntArray
from usdface.model.placement.known_places import marked_landmarks, places_by_labels, usual_scale
from usdface.model.placement.label_hints import are_image_landmarks, label_hint
from usdface.model.placement.marker_cloud import MarkerCloud, middle_markers
from usdface.model.placement.rig_landmarks import find_landmarks
from usdface.numerics.registration.cloud_alignment import align_cloud, align_landmarks
from usdface.numerics.registration.face_skin import FaceSkin
from usdface.numerics.registration.landmark_matching import FaceLandmarks, match_landmarks
from usdface.numerics.registration.motion_correspondence import place_by_motion
from usdface.numerics.registration.motion_search import (
    LANDMARK_VALUE,
    SearchedFit,
    motion_value,
    search_by_motion,
    size_cost,
)
from usdface.numerics.registration.skin_placement import (
    TYPICAL_SIZE_MM,
    KnownPlace,
    PlaneFit,
    SkinPlacement,
    explained_share,
    fit_in_plane,
    place_on_skin,
    solve_weights_at,
    to_character,
)
from usdface.numerics.registration.virtual_markers import VirtualMarkers

FEWEST_HINTS = 6
"""Fewest markers whose labels name a landmark each for a placement by labels. Numbered labels
(``mouth_R1`` to ``mouth_R13``) name a region, which is less precise than motion."""

FEWEST_PINS = 3
"""Fewest given places that determine an alignment."""

_MARKER_RADIUS_MM = 1.5
"""Radius of the smallest face markers in use."""

_PIN_SPREAD_MM = 0.5
"""Standard deviation of a place given by a person."""

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

_IMAGE_SKIN_SHARE = 0.01
"""Factor on the skin's precision for landmarks detected in images. Two hundred of them follow the
same detected surface: at full weight, the rows of both lids slide along the rig's, 8 mm apart on
the two sides of a symmetric face."""

_DOUBTFUL_VALUE = 0.2
"""Value of the best candidate below which the cloud is searched upside down as well. Of recorded
and simulated takes, those that move most of the face reach it upright, and none upside down."""


@dataclass(frozen=True)
class MarkerPlacement:
    """Markers on a rig's skin."""

    samples: IntArray
    """(markers,): indices of skin samples."""
    virtual: VirtualMarkers
    """The same as points of the rig, with the transform of the performer's motion."""
    by_labels: bool
    """True if placed by labels and landmarks, False if by motion."""
    overturned_gain: float = 0.0
    """Gain of value if the cloud, placed by motion, is turned upside down; 0 if none.

    Of thirty upright pairs of take and rig, each lost 0.06 or more."""


def place_markers(
    cloud: MarkerCloud,
    skin: FaceSkin,
    shapes: tuple[str, ...],
    *,
    ranges: FloatArray | None = None,
    pinned: dict[int, FloatArray] | None = None,
) -> MarkerPlacement:
    """Return the position of each marker on a rig's skin.

    Parameters
    ----------
    shapes : tuple of str
        Names of the rig's shapes.
    ranges : (shapes, 2) float array, optional
        Limits of the weights; 0 to 1 by default.
    pinned : dict of int to (3,) float array, optional
        Places given by a person, in the rig's space [mm].

    Raises
    ------
    ValueError
        If neither labels, landmarks nor motion determine a placement.
    """
    limits = np.tile([0.0, 1.0], (len(shapes), 1)) if ranges is None else ranges
    unit = skin.size_mm / TYPICAL_SIZE_MM
    landmarks = find_landmarks(skin, shapes)
    pins = {m: np.asarray(at, float) @ skin.frame.T for m, at in (pinned or {}).items()}
    known = places_by_labels(cloud, landmarks, unit, without=pins)
    given = [KnownPlace((marker,), at, _PIN_SPREAD_MM * unit) for marker, at in pins.items()]
    scene = _Scene(
        cloud,
        skin,
        limits,
        [*known, *given],
        pins,
        usual_scale(cloud, skin, landmarks),
        marked_landmarks(skin, landmarks),
    )
    own = [cloud.labels[each.markers[0]] for each in known if len(each.markers) == 1]
    named = sum(not label[-1].isdigit() for label in own) >= FEWEST_HINTS
    if are_image_landmarks(cloud.labels) and len(known) >= FEWEST_HINTS:
        named, scene = True, replace(scene, skin_share=_IMAGE_SKIN_SHARE)
    if named:
        start = _by_labels(scene)
    elif len(pins) >= FEWEST_PINS:
        start = _by_pins(scene)
    else:
        start = _by_motion(scene)
    placement = start.placement
    samples = placement.samples
    if not are_image_landmarks(cloud.labels):
        samples = _above_lid_margins(scene, landmarks, samples)
    for marker, at in pins.items():
        samples[marker] = ((skin.positions - at) ** 2).sum(axis=1).argmin()
    virtual = _virtual_markers(scene, start, samples)
    return MarkerPlacement(samples, virtual, named, start.overturned_gain)


def _above_lid_margins(
    scene: "_Scene", landmarks: dict[str, FloatArray], samples: IntArray
) -> IntArray:
    """Move markers of upper lids that lie below the lid's margin above it."""
    lifted = samples.copy()
    radius = _MARKER_RADIUS_MM * scene.skin.size_mm / TYPICAL_SIZE_MM
    for marker, label in enumerate(scene.cloud.labels):
        hint = label_hint(label)
        if set(hint.landmarks) == {f"lid_crease_{hint.side}"} <= landmarks.keys():
            heights = scene.skin.positions[:, 1]
            above = np.flatnonzero(heights >= landmarks[f"lid_upper_{hint.side}"][1] + radius)
            place = scene.skin.positions[samples[marker]]
            away = ((scene.skin.positions[above] - place) ** 2).sum(axis=1)
            lifted[marker] = above[away.argmin()]
    return lifted


def _virtual_markers(scene: "_Scene", start: "_Start", samples: IntArray) -> VirtualMarkers:
    skin, fit = scene.skin, start.placement.fit
    rotation = fit.rotation @ start.frame
    away = fit.apply(start.levelled) - skin.positions[samples]
    return VirtualMarkers(
        skin.corners[samples],
        skin.shares[samples],
        _motion_scale(scene.cloud.neutral @ rotation.T, skin, samples),
        skin.frame.T @ rotation,
        np.linalg.norm(away, axis=1),
    )


@dataclass(frozen=True)
class _Scene:
    """A cloud, a skin, and known places.

    `usual_scale` is the expected size of the character relative to the performer; `features` are
    the rig's landmarks.
    """

    cloud: MarkerCloud
    skin: FaceSkin
    ranges: FloatArray
    landmarks: list[KnownPlace]
    pins: dict[int, FloatArray]
    usual_scale: float
    features: FaceLandmarks
    skin_share: float = 1.0
    """As of `place_on_skin`."""


@dataclass(frozen=True)
class _Start:
    """A placement, with the rotation and the rotated cloud to which it applies."""

    frame: FloatArray
    levelled: FloatArray
    placement: SkinPlacement
    overturned_gain: float = 0.0


def _settle(scene: _Scene, frame: FloatArray, levelled: FloatArray, fit: PlaneFit) -> _Start:
    cloud, images = scene.cloud, scene.skin_share < 1
    placement = place_on_skin(
        levelled,
        scene.skin,
        fit,
        landmarks=scene.landmarks,
        motion=None if cloud.motion is None or images else cloud.motion @ frame.T,
        ranges=scene.ranges,
        still=cloud.still,
        middle=middle_markers(cloud.labels),
        skin_share=scene.skin_share,
    )
    return _Start(frame, levelled, placement)


def _by_pins(scene: _Scene) -> _Start:
    """Start from a similarity transform fitted to given places."""
    rows = list(scene.pins)
    return _by_points(scene, scene.cloud.neutral[rows], np.array(list(scene.pins.values())))


def _by_points(scene: _Scene, points: FloatArray, targets: FloatArray) -> _Start:
    """Start from a similarity transform fitted to pairs of points."""
    found = align_landmarks(points, targets)
    fit = PlaneFit(found.rotation, found.scale, found.translation)
    return _settle(scene, np.eye(3), scene.cloud.neutral, fit)


def _by_labels(scene: _Scene) -> _Start:
    """Start from a transform fitted to landmarks named by labels and to given places."""
    targets = np.array([each.place for each in scene.landmarks])
    try:
        frame, levelled = scene.cloud.levelled()
    except ValueError:  # markers of one side
        return _by_points(scene, _middles(scene, scene.cloud.neutral), targets)
    centre = np.array([scene.skin.sagittal_x, 0.0, 0.0])
    middles = _middles(scene, levelled)
    spreads = np.array([each.spread_mm for each in scene.landmarks])
    # A given place is exact, but differing proportions keep the transform from reaching it.
    least = _PROPORTION_SPREAD_MM * scene.skin.size_mm / TYPICAL_SIZE_MM
    start = fit_in_plane(middles, targets - centre, np.maximum(spreads, least))
    fit = PlaneFit(start.rotation, start.scale, start.shift + centre)
    return _settle(scene, frame, levelled, fit)


def _middles(scene: _Scene, positions: FloatArray) -> FloatArray:
    """Return the mean position of the markers of each known place: (places, 3)."""
    return np.array([positions[list(each.markers)].mean(axis=0) for each in scene.landmarks])


def _by_motion(scene: _Scene) -> _Start:
    """Return the best candidate of closest points, labels, and a search in the plane of symmetry.

    Markers near landmarks are drawn to them, weighted by the probability of the match.
    """
    cloud, motion = scene.cloud, scene.cloud.motion
    if motion is None or not motion.any():
        return _by_shape(scene)
    try:
        frame, levelled = cloud.levelled()
    except ValueError:  # no symmetry, so no search in its plane
        return _by_shape(scene)
    starts = []
    with suppress(ValueError):  # no alignment ends upright
        starts.append(_by_shape(scene))
    count = len(starts)
    searched = _search(scene, levelled, motion @ frame.T)
    value = max(found.score for found in searched)
    gain = _overturned_gain(scene, levelled, motion @ frame.T, value)
    for found in searched:
        turned = levelled * found.turn
        starts.append(_drawn(scene, found.turn[:, None] * frame, turned, found.fit))
    if len(scene.landmarks) >= FEWEST_HINTS:
        starts.append(_by_labels(scene))
    values = [_value(scene, start, frame, levelled) for start in starts]
    first = int(np.argmax(values))
    if count and values[0] >= values[first] - _LEAST_GAIN:
        return replace(starts[0], overturned_gain=gain)
    turn = _turn_of(starts[first], frame)
    fit = _fit_to(scene, starts[first], levelled * turn)
    again = _drawn(scene, turn[:, None] * frame, levelled * turn, fit)
    best = again if _value(scene, again, frame, levelled) > values[first] else starts[first]
    return replace(best, overturned_gain=gain)


def _search(scene: _Scene, levelled: FloatArray, motion: FloatArray) -> list[SearchedFit]:
    return search_by_motion(
        levelled,
        scene.skin,
        motion,
        ranges=scene.ranges,
        usual_scale=scene.usual_scale,
        landmarks=scene.features,
    )


def _overturned_gain(
    scene: _Scene, levelled: FloatArray, motion: FloatArray, value: float
) -> float:
    """Return the gain of a cloud upside down over its best candidate, of the given value."""
    if value >= _DOUBTFUL_VALUE:
        return 0.0
    over = np.array([-1.0, -1.0, 1.0])
    best = max(found.score for found in _search(scene, levelled * over, motion * over))
    return max(best - value, 0.0)


def _drawn(scene: _Scene, frame: FloatArray, levelled: FloatArray, fit: PlaneFit) -> _Start:
    """Settle a fit with its markers drawn to landmarks nearby."""
    features = scene.features
    match = match_landmarks(fit.apply(levelled), features)
    spreads = features.spreads[match.landmarks] / np.sqrt(match.probability)
    places = features.places[match.landmarks]
    named = {marker for each in scene.landmarks for marker in each.markers}
    likely = [
        KnownPlace((marker,), place, float(spread))
        for marker, place, spread in zip(match.markers.tolist(), places, spreads, strict=True)
        if marker not in named
    ]
    return _settle(replace(scene, landmarks=likely + scene.landmarks), frame, levelled, fit)


def _turn_of(start: _Start, frame: FloatArray) -> FloatArray:
    """Return the factors (1 or -1 per axis) that turn the levelled cloud to a placement's yaw."""
    rotation = start.placement.fit.rotation @ start.frame @ frame.T
    yaw = 1.0 if rotation[0, 0] + rotation[2, 2] > 0 else -1.0
    return np.array([yaw, 1.0, yaw])


def _fit_to(scene: _Scene, start: _Start, turned: FloatArray) -> PlaneFit:
    """Fit the transform in the plane of symmetry to the settled positions."""
    centre = np.array([scene.skin.sagittal_x, 0.0, 0.0])
    spreads = np.full(len(turned), _WARPED_SPREAD_MM * scene.features.unit)
    found = fit_in_plane(turned, start.placement.warped - centre, spreads)
    return PlaneFit(found.rotation, found.scale, found.shift + centre)


def _value(scene: _Scene, start: _Start, frame: FloatArray, levelled: FloatArray) -> float:
    """Return the value of a placement: motion and landmarks, less the costs of warp and size.

    Roll and shift of the plane of symmetry count as warp.
    """
    placement, skin, motion = start.placement, scene.skin, scene.cloud.motion
    turned = levelled * _turn_of(start, frame)
    fit = _fit_to(scene, start, turned)
    places = fit.apply(turned)
    away = np.linalg.norm(placement.warped - places, axis=1)
    value = LANDMARK_VALUE * match_landmarks(places, scene.features).score
    value -= _WARP_COST * float(away.mean()) / skin.size_mm + size_cost(fit, scene.usual_scale)
    if scene.landmarks:
        misses = _middles(scene, placement.warped) - [each.place for each in scene.landmarks]
        spreads = np.array([each.spread_mm for each in scene.landmarks])
        value -= _LABEL_COST * float(((misses**2).sum(axis=1) / spreads**2).mean())
    if motion is not None:
        moved = to_character(motion @ start.frame.T, placement.fit)
        weights = solve_weights_at(skin, placement.samples, moved, scene.ranges)
        value += motion_value(explained_share(skin, placement.samples, moved, weights))
    return value


def _by_shape(scene: _Scene) -> _Start:
    """Place by iterative closest points, with the amplitude of motion as a fourth coordinate.

    Needs neither symmetry nor motion and fits proportions in every round: most accurate with many
    markers all over the face. With few markers it may slide to a wrong place.
    """
    cloud, skin = scene.cloud, scene.skin
    moved = None if cloud.motion is None else np.sqrt((cloud.motion**2).sum(axis=2)).mean(axis=0)
    found = align_cloud(
        cloud.neutral,
        skin.positions,
        activity=skin.activity(),
        areas=skin.areas,
        amplitude=moved,
    )
    placed = place_by_motion(
        cloud.neutral,
        skin.positions,
        found,
        skin_deltas=None if cloud.motion is None else skin.deltas,
        motion=cloud.motion,
        ranges=scene.ranges,
        pinned=scene.pins,
    )
    alignment = placed.alignment
    fit = PlaneFit(alignment.rotation, alignment.scale, alignment.translation)
    placement = SkinPlacement(placed.chosen, placed.warped, fit)
    return _Start(np.eye(3), cloud.neutral, placement)


def _motion_scale(turned: FloatArray, skin: FaceSkin, samples: IntArray) -> float:
    """Return sqrt(sx sy) of the axes' scales, fitted to the places by least squares."""
    performer = turned - turned.mean(axis=0)
    places = skin.positions[samples]
    places = places - places.mean(axis=0)
    scale = (performer * places).sum(axis=0) / (performer**2).sum(axis=0)
    return float(np.sqrt(max(scale[0] * scale[1], 1e-12)))
