"""Place a performer's markers on a rig: by labels and landmarks, else by motion."""

from dataclasses import dataclass, replace

import numpy as np

from usdface.core.arrays import FloatArray, IntArray
from usdface.model.placement.known_places import marked_landmarks, places_by_labels, usual_scale
from usdface.model.placement.label_hints import are_image_landmarks, label_hint
from usdface.model.placement.marker_cloud import MarkerCloud
from usdface.model.placement.placement_candidates import (
    FEWEST_HINTS,
    PlacementCandidate,
    PlacementInputs,
    best_by_motion,
    candidate_by_labels,
    candidate_by_pins,
)
from usdface.model.placement.rig_landmarks import find_landmarks
from usdface.numerics.registration.face_skin import FaceSkin
from usdface.numerics.registration.skin_placement import KnownPlace
from usdface.numerics.registration.virtual_markers import VirtualMarkers, motion_by_rig
from usdface.numerics.rigid.pose_error import PoseErrors
from usdface.numerics.rigid.rigid_alignment import align_rigid_robust, remove_motion

FEWEST_PINS = 3
"""Fewest given places that determine an alignment."""

_MARKER_RADIUS_MM = 1.5
"""Radius of the smallest face markers in use."""

_PIN_SPREAD_MM = 0.5
"""Standard deviation of a place given by a person."""

_IMAGE_SKIN_SHARE = 0.01
"""Factor on the skin's precision for landmarks detected in images. Two hundred of them follow the
same detected surface: at full weight, the rows of both lids slide along the rig's, 8 mm apart on
the two sides of a symmetric face."""


_POSE_ROUNDS = 3
"""Placements of motion without errors of the takes' poses, as of a head band that slips: without
any rigid motion if they may be large, then without the errors that the placement so far tells."""

_LARGE_ERROR_MM = 1.0
"""Error of the poses that may have misplaced the markers, so that they do not tell it."""

_LEAST_GAIN = 0.01
"""Gain of the logarithm of the density, per degree of freedom, for which another round is worth its
seconds: less moves markers by less than a millimetre."""


@dataclass(frozen=True)
class MarkerPlacement:
    """Markers on a rig's skin."""

    virtual: VirtualMarkers
    """Points of the rig, with the transform of the performer's motion."""
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

    Errors of the takes' poses are removed from the motion; see `pose_error`.

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
    placement, samples = _place(cloud, skin, shapes, limits, pinned or {})
    if not len(cloud.motion):
        return placement
    errors = pose_errors_at(cloud, skin, placement.virtual, samples)
    for count in range(_POSE_ROUNDS):
        if not errors.possible_mm:
            break
        is_large = count == 0 and errors.possible_mm >= _LARGE_ERROR_MM
        removed = replace(errors, size_mm=errors.possible_mm)
        corrected = _without_rigid_motion(cloud) if is_large else without_errors(removed, cloud)
        other, samples = _place(corrected, skin, shapes, limits, pinned or {})
        found = pose_errors_at(cloud, skin, other.virtual, samples)
        if found.evidence >= errors.evidence + _LEAST_GAIN:
            gain = max(placement.overturned_gain, other.overturned_gain)
            placement, errors = replace(other, overturned_gain=gain), found
        elif not is_large:
            break
    return placement


def _without_rigid_motion(cloud: MarkerCloud) -> MarkerCloud:
    """Return a cloud whose moving markers, taken together, are at rest in every frame."""
    positions = cloud.neutral + cloud.motion
    moving = np.broadcast_to(~cloud.still, positions.shape[:2])
    rigid = align_rigid_robust(positions, cloud.neutral, visible=moving)
    motion = remove_motion(positions, rigid) - cloud.neutral
    return replace(cloud, motion=np.where(moving[:, :, None], motion, cloud.motion))


def without_errors(errors: PoseErrors, cloud: MarkerCloud) -> MarkerCloud:
    """Return a cloud whose motion has no errors of poses."""
    positions = cloud.neutral + cloud.motion
    corrected = errors.remove(positions, np.ones(positions.shape[:2], np.bool_))
    return replace(cloud, motion=corrected - cloud.neutral)


def pose_errors_at(
    cloud: MarkerCloud, skin: FaceSkin, virtual: VirtualMarkers, samples: IntArray
) -> PoseErrors:
    """Return the errors of the takes' poses, for markers at `samples` (markers,) of the skin."""
    positions = cloud.neutral + cloud.motion
    expressions = motion_by_rig(
        virtual,
        skin.from_frame(skin.deltas[:, samples]),
        cloud.neutral,
        rigid=np.flatnonzero(cloud.still).tolist(),
    )
    return expressions.find_errors(positions, np.ones(positions.shape[:2], np.bool_))


def _place(
    cloud: MarkerCloud,
    skin: FaceSkin,
    shapes: tuple[str, ...],
    limits: FloatArray,
    pinned: dict[int, FloatArray],
) -> tuple[MarkerPlacement, IntArray]:
    landmarks = find_landmarks(skin, shapes)
    pins = {m: skin.to_frame(np.asarray(at, float)) for m, at in pinned.items()}
    known = places_by_labels(cloud, landmarks, without=pins)
    given = [KnownPlace((marker,), at, _PIN_SPREAD_MM) for marker, at in pins.items()]
    inputs = PlacementInputs(
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
        named, inputs = True, replace(inputs, skin_share=_IMAGE_SKIN_SHARE)
    if named:
        candidate = candidate_by_labels(inputs)
    elif len(pins) >= FEWEST_PINS:
        candidate = candidate_by_pins(inputs)
    else:
        candidate = best_by_motion(inputs)
    samples = candidate.placement.samples.copy()
    if not are_image_landmarks(cloud.labels):
        _lift_above_lid_margins(inputs, landmarks, samples)
    for marker, at in pins.items():
        samples[marker] = ((skin.positions - at) ** 2).sum(axis=1).argmin()
    virtual = _virtual_markers(inputs, candidate, samples)
    return MarkerPlacement(virtual, named, candidate.overturned_gain), samples


def _lift_above_lid_margins(
    inputs: PlacementInputs, landmarks: dict[str, FloatArray], samples: IntArray
) -> None:
    """Move markers of upper lids that lie below the lid's margin above it."""
    for marker, label in enumerate(inputs.cloud.labels):
        hint = label_hint(label)
        if set(hint.landmarks) == {f"lid_crease_{hint.side}"} <= landmarks.keys():
            least = landmarks[f"lid_upper_{hint.side}"][1] + _MARKER_RADIUS_MM
            above = np.flatnonzero(inputs.skin.positions[:, 1] >= least)
            place = inputs.skin.positions[samples[marker]]
            away = ((inputs.skin.positions[above] - place) ** 2).sum(axis=1)
            samples[marker] = above[away.argmin()]


def _virtual_markers(
    inputs: PlacementInputs, candidate: PlacementCandidate, samples: IntArray
) -> VirtualMarkers:
    skin, fit = inputs.skin, candidate.placement.fit
    rotation = fit.rotation @ candidate.frame
    # The axes' scales are fitted to the places by least squares.
    turned = inputs.cloud.neutral @ rotation.T
    performer = turned - turned.mean(axis=0)
    places = skin.positions[samples]
    places = places - places.mean(axis=0)
    scale = (performer * places).sum(axis=0) / (performer**2).sum(axis=0)
    return VirtualMarkers(
        skin.corners[samples],
        skin.shares[samples],
        skin.unit * float(np.sqrt(max(scale[0] * scale[1], 1e-12))),
        skin.frame.T @ rotation,
    )
