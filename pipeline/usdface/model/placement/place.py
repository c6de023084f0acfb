"""Place a performer's markers on a rig: by labels and landmarks, else by motion."""

from collections.abc import Collection
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from usdface.core.arrays import FloatArray, IntArray
from usdface.model.placement.label_hints import label_hint, landmark_spread_mm
from usdface.model.placement.marker_cloud import MarkerCloud, middle_markers
from usdface.model.placement.rig_landmarks import find_landmarks
from usdface.numerics.registration.cloud_alignment import align_cloud, align_landmarks
from usdface.numerics.registration.face_skin import FaceSkin
from usdface.numerics.registration.landmark_matching import FaceLandmarks, match_landmarks
from usdface.numerics.registration.motion_correspondence import place_by_motion
from usdface.numerics.registration.motion_search import (
    LANDMARK_VALUE,
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
    in_character,
    place_on_skin,
    solve_weights_at,
)
from usdface.numerics.registration.virtual_markers import VirtualMarkers

FEWEST_HINTS = 6
"""Labels of one marker each with a landmark on the rig, from which a placement by labels starts.
Numbered ones (``mouth_R1`` to ``mouth_R13``) name a part of the face, and motion says more."""

FEWEST_PINS = 3
"""Points from which an alignment follows."""

_MARKER_RADIUS_MM = 1.5
"""Of the smallest face markers in use, 3 mm wide."""

_PIN_SPREAD_MM = 0.5
_PROPORTION_SPREAD_MM = 4.0
"""Standard deviation of a marker about the similarity that suits the others: as narrow as the
narrowest of labels'."""

_WARPED_SPREAD_MM = 6.0
"""Standard deviation of a warped marker about its landmark-free fit: what proportions leave."""

_WARP_COST = 0.3
"""Explained share that a mean warp of the face's size costs, between candidates of the search."""

_LEAST_GAIN = 0.03
"""Value by which another placement must be better than closest points': they fit proportions in
every round, and are nearer where many markers cover the face."""

_ACTIVE_SHARE = 0.1
"""Of the largest displacement: skin that moves less is not where markers are put."""

_EYES_TO_MOUTH_MM = 70.0
"""From the line of the eyes to that of the mouth, on an adult, give or take 5 mm."""

_OTHER_UNIT = 2.2
"""Factor between two guesses of the scale beyond which the markers are not in millimetres."""


@dataclass(frozen=True)
class MarkerPlacement:
    """Markers on a rig's skin."""

    samples: IntArray
    """(markers,): of the skin."""
    virtual: VirtualMarkers
    """The same as points of the rig, with the map from the performer's motion to the rig's."""
    by_labels: bool
    """Whether labels and landmarks placed the cloud, or motion alone."""


def place_markers(
    cloud: MarkerCloud,
    skin: FaceSkin,
    shapes: tuple[str, ...],
    *,
    ranges: FloatArray | None = None,
    pinned: dict[int, FloatArray] | None = None,
) -> MarkerPlacement:
    """Find where on a rig's skin each marker sits.

    Parameters
    ----------
    shapes : tuple of str
        Names of the rig's shapes.
    ranges : (shapes, 2) float array, optional
        Limits of the weights; 0 to 1 by default.
    pinned : dict of int to (3,) float array, optional
        Places that a person gave, in the rig's space [mm].

    Raises
    ------
    ValueError
        If neither labels, landmarks nor motion say where the markers belong.
    """
    limits = np.tile([0.0, 1.0], (len(shapes), 1)) if ranges is None else ranges
    unit = skin.size_mm / TYPICAL_SIZE_MM
    landmarks = find_landmarks(skin, shapes)
    pins = {m: np.asarray(at, float) @ skin.frame.T for m, at in (pinned or {}).items()}
    known = named_places(cloud, landmarks, unit, without=pins)
    given = [KnownPlace((marker,), at, _PIN_SPREAD_MM * unit) for marker, at in pins.items()]
    scene = _Scene(
        cloud,
        skin,
        limits,
        [*known, *given],
        pins,
        _usual_scale(cloud, skin, landmarks),
        face_landmarks(skin, landmarks),
    )
    own = [cloud.labels[each.markers[0]] for each in known if len(each.markers) == 1]
    named = sum(not label[-1].isdigit() for label in own) >= FEWEST_HINTS
    if named:
        start = _by_labels(scene)
    elif len(pins) >= FEWEST_PINS:
        start = _by_pins(scene)
    else:
        start = _by_motion(scene)
    placement = start.placement
    samples = _above_lid_margins(scene, landmarks, placement.samples)
    for marker, at in pins.items():
        samples[marker] = ((skin.positions - at) ** 2).sum(axis=1).argmin()
    virtual = _virtual_markers(scene, start, samples)
    return MarkerPlacement(samples, virtual, named)


def _above_lid_margins(
    scene: "_Scene", landmarks: dict[str, FloatArray], samples: IntArray
) -> IntArray:
    """Lift markers of upper lids above the lid's margin: below are the lashes, and the eye."""
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
    """A cloud, a skin, and the places that labels or people gave.

    `usual_scale` is the guess of character over performer; `features` are the rig's landmarks.
    """

    cloud: MarkerCloud
    skin: FaceSkin
    ranges: FloatArray
    landmarks: list[KnownPlace]
    pins: dict[int, FloatArray]
    usual_scale: float
    features: FaceLandmarks


@dataclass(frozen=True)
class _Start:
    """A placement, and the rotation and cloud that it was found in."""

    frame: FloatArray
    levelled: FloatArray
    placement: SkinPlacement


def named_places(
    cloud: MarkerCloud,
    landmarks: dict[str, FloatArray],
    unit: float,
    *,
    without: Collection[int] = (),
) -> list[KnownPlace]:
    """Return the places of the markers whose labels name landmarks that are known.

    Of markers with the same landmarks (``brow_L1`` to ``brow_L5``) the middle is meant, and it is
    as uncertain as they lie apart.

    Parameters
    ----------
    unit : float
        Size of the rig's face over an adult's.
    without : collection of int
        Markers whose places are known better.
    """
    groups: dict[tuple[str, ...], list[int]] = {}
    spreads = {}
    for marker, label in enumerate(cloud.labels):
        hint = label_hint(label)
        if hint.landmarks and marker not in without and set(hint.landmarks) <= landmarks.keys():
            groups.setdefault(hint.landmarks, []).append(marker)
            spreads[hint.landmarks] = hint.spread_mm
    places = []
    for names, markers in groups.items():
        apart = np.sqrt(cloud.neutral[markers].var(axis=0).sum())
        mean = np.mean([landmarks[name] for name in names], axis=0)
        spread = float(np.hypot(spreads[names], apart)) * unit
        places.append(KnownPlace(tuple(markers), mean, spread))
    return places


def _settle(scene: _Scene, frame: FloatArray, levelled: FloatArray, fit: PlaneFit) -> _Start:
    cloud = scene.cloud
    placement = place_on_skin(
        levelled,
        scene.skin,
        fit,
        landmarks=scene.landmarks,
        motion=None if cloud.motion is None else cloud.motion @ frame.T,
        ranges=scene.ranges,
        still=cloud.still,
        middle=middle_markers(cloud.labels),
    )
    return _Start(frame, levelled, placement)


def _by_pins(scene: _Scene) -> _Start:
    """Start from the similarity of the places that a person gave."""
    rows = list(scene.pins)
    found = align_landmarks(scene.cloud.neutral[rows], np.array(list(scene.pins.values())))
    fit = PlaneFit(found.rotation, found.scale, found.translation)
    return _settle(scene, np.eye(3), scene.cloud.neutral, fit)


def _by_labels(scene: _Scene) -> _Start:
    """Start from the landmarks that labels name, and from given places."""
    frame, levelled = scene.cloud.levelled()
    centre = np.array([scene.skin.sagittal_x, 0.0, 0.0])
    middles = np.array([levelled[list(each.markers)].mean(axis=0) for each in scene.landmarks])
    targets = np.array([each.place for each in scene.landmarks])
    spreads = np.array([each.spread_mm for each in scene.landmarks])
    # A given place is exact, but not where a similarity takes its marker.
    least = _PROPORTION_SPREAD_MM * scene.skin.size_mm / TYPICAL_SIZE_MM
    start = fit_in_plane(middles, targets - centre, np.maximum(spreads, least))
    fit = PlaneFit(start.rotation, start.scale, start.shift + centre)
    return _settle(scene, frame, levelled, fit)


def _by_motion(scene: _Scene) -> _Start:
    """Settle where motion and landmarks agree, by a search of the plane and by closest points.

    Markers that may sit at landmarks are drawn to them, as likely as that is.
    """
    cloud, skin, motion = scene.cloud, scene.skin, scene.cloud.motion
    if motion is None or not motion.any():
        return _by_shape(scene)
    try:
        frame, levelled = cloud.levelled()
    except ValueError:  # no symmetry: what closest points find is all there is
        return _by_shape(scene)
    starts = []
    with suppress(ValueError):  # nothing ends upright
        starts.append(_by_shape(scene))
    count = len(starts)
    for found in search_by_motion(
        levelled,
        skin,
        motion @ frame.T,
        ranges=scene.ranges,
        usual_scale=scene.usual_scale,
        landmarks=scene.features,
    ):
        turned = levelled * found.turn
        starts.append(_drawn(scene, found.turn[:, None] * frame, turned, found.fit))
    values = [_value(scene, start, frame, levelled) for start in starts]
    first = int(np.argmax(values))
    if count and values[0] >= values[first] - _LEAST_GAIN:
        return starts[0]
    turn = _turn_of(starts[first], frame)
    fit = _fit_to(scene, starts[first], levelled * turn)
    again = _drawn(scene, turn[:, None] * frame, levelled * turn, fit)
    return again if _value(scene, again, frame, levelled) > values[first] else starts[first]


def _drawn(scene: _Scene, frame: FloatArray, levelled: FloatArray, fit: PlaneFit) -> _Start:
    """Settle a fit, its markers drawn to the landmarks at which they may sit."""
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
    """Return the factors that turn the levelled cloud to where a placement looks."""
    rotation = start.placement.fit.rotation @ start.frame @ frame.T
    yaw = 1.0 if rotation[0, 0] + rotation[2, 2] > 0 else -1.0
    return np.array([yaw, 1.0, yaw])


def _fit_to(scene: _Scene, start: _Start, turned: FloatArray) -> PlaneFit:
    """Fit the cloud's proportions to where it was settled, in the plane of symmetry."""
    centre = np.array([scene.skin.sagittal_x, 0.0, 0.0])
    spreads = np.full(len(turned), _WARPED_SPREAD_MM * scene.features.unit)
    found = fit_in_plane(turned, start.placement.warped - centre, spreads)
    return PlaneFit(found.rotation, found.scale, found.shift + centre)


def _value(scene: _Scene, start: _Start, frame: FloatArray, levelled: FloatArray) -> float:
    """Return what motion and landmarks say for a placement, less the costs of warp and size.

    What a placement rolls or shifts the plane of symmetry is a part of its warp.
    """
    placement, skin, motion = start.placement, scene.skin, scene.cloud.motion
    turned = levelled * _turn_of(start, frame)
    fit = _fit_to(scene, start, turned)
    places = fit.apply(turned)
    away = np.linalg.norm(placement.warped - places, axis=1)
    value = LANDMARK_VALUE * match_landmarks(places, scene.features).score
    value -= _WARP_COST * float(away.mean()) / skin.size_mm + size_cost(fit, scene.usual_scale)
    if motion is not None:
        moved = in_character(motion @ start.frame.T, placement.fit)
        weights = solve_weights_at(skin, placement.samples, moved, scene.ranges)
        value += motion_value(explained_share(skin, placement.samples, moved, weights))
    return value


def _by_shape(scene: _Scene) -> _Start:
    """Place by closest points, with how far each marker moves as a fourth coordinate.

    Needs neither symmetry nor motion, and fits proportions in every round: nearest where many
    markers cover the whole face. With few it slides, up to a face in the wrong place.
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


def face_landmarks(skin: FaceSkin, landmarks: dict[str, FloatArray]) -> FaceLandmarks:
    """Return the landmarks at which people put markers."""
    names = tuple(name for name in landmarks if landmark_spread_mm(name))
    unit, activity = skin.size_mm / TYPICAL_SIZE_MM, skin.activity()
    return FaceLandmarks(
        names,
        np.array([landmarks[name] for name in names]).reshape(-1, 3),
        np.array([landmark_spread_mm(name) for name in names]) * unit,
        float(skin.areas[activity > _ACTIVE_SHARE * activity.max()].sum()),
        unit,
    )


def _usual_scale(cloud: MarkerCloud, skin: FaceSkin, landmarks: dict[str, FloatArray]) -> float:
    """Guess character over performer: adults' faces are alike, else captures cover what moves."""
    share = skin.activity() / skin.activity().sum()
    moving = np.sqrt((share @ (skin.positions - share @ skin.positions) ** 2).sum())
    spread = np.sqrt(cloud.neutral.var(axis=0).sum())
    covering = float(moving / max(spread, 1e-9))
    if not {"mouth_middle", "lid_upper_L", "lid_lower_L"} <= landmarks.keys():
        return covering
    eyes = (landmarks["lid_upper_L"] + landmarks["lid_lower_L"])[1] / 2
    adult = float(eyes - landmarks["mouth_middle"][1]) / _EYES_TO_MOUTH_MM
    return adult if 1 / _OTHER_UNIT < covering / adult < _OTHER_UNIT else covering


def _motion_scale(turned: FloatArray, skin: FaceSkin, samples: IntArray) -> float:
    """Return sqrt(sx sy), the axes' scales by least squares on the places."""
    performer = turned - turned.mean(axis=0)
    places = skin.positions[samples]
    places = places - places.mean(axis=0)
    scale = (performer * places).sum(axis=0) / (performer**2).sum(axis=0)
    return float(np.sqrt(max(scale[0] * scale[1], 1e-12)))
