"""Known before the search: places of labelled markers, the rig's landmarks, the expected size."""

from collections.abc import Collection

import numpy as np

from usdface.core.arrays import FloatArray, rms_radius
from usdface.model.placement.label_hints import are_image_landmarks, label_hint, landmark_spread_mm
from usdface.model.placement.marker_cloud import MarkerCloud
from usdface.numerics.registration.face_skin import FaceSkin
from usdface.numerics.registration.landmark_matching import FaceLandmarks
from usdface.numerics.registration.skin_placement import KnownPlace

_ACTIVE_SHARE = 0.1
"""Share of the largest displacement below which skin carries no markers."""

_EYES_TO_MOUTH_MM = 70.0
"""Height of the eyes above the mouth of an adult; standard deviation about 5 mm."""

_OTHER_UNIT = 2.2
"""Ratio of two estimates of the scale beyond which the markers are not in millimetres."""

_IMAGE_LANDMARKS: dict[str, tuple[float, tuple[str, ...], tuple[int, ...], tuple[int, ...]]] = {
    "eye_inner_": (4.0, ("eye_inner_{}1",), (39,), (42,)),
    "eye_outer_": (4.0, ("eye_outer_{}1",), (36,), (45,)),
    "lid_upper_": (4.0, ("lid_upper_{}4",), (37, 38), (43, 44)),
    "lid_lower_": (4.0, ("lid_lower_{}4",), (40, 41), (46, 47)),
    "mouth_": (4.0, ("mouth_corner_{}1", "mouth_corner_{}2"), (48, 60), (54, 64)),
    "brow_inner_": (9.0, ("brow_inner_{}1", "brow_inner_{}2"), (21,), (22,)),
    "brow_outer_": (9.0, ("brow_outer_{}1", "brow_outer_{}3"), (17, 18), (25, 26)),
    "nose_tip": (4.0, ("nose_2", "nose_tip_1"), (30,), ()),
    "nose_bridge": (6.0, ("nose_bridge_1",), (27,), ()),
    "mouth_middle": (4.0, ("lip_upper_4", "lip_lower_1"), (62, 66), ()),
    "chin": (6.0, ("chin_2", "chin_3"), (), ()),
}
"""Landmarks of a rig that are detected in images as well: standard deviation [mm] of detection,
definition and proportions together, names by `track`, and numbers in OpenFace's tables, of the
right side or the midline and of the left side. The rig's brows are where shapes move most, their
middle half a brow from its own; OpenFace's chin is the lowest point, the rig's the foremost."""


def _places_of_images(
    cloud: MarkerCloud, landmarks: dict[str, FloatArray], without: Collection[int]
) -> list[KnownPlace]:
    """Return the places of landmarks detected in images; see `places_by_labels`."""
    column = {label: row for row, label in enumerate(cloud.labels) if row not in without}
    of_openface = "landmark_68" not in cloud.labels  # else numbers of another model
    places = []
    for stem, (spread, names, right, left) in _IMAGE_LANDMARKS.items():
        for side, numbers in (("R", right), ("L", left)) if left else (("", right),):
            labels = [name.format(side) for name in names]
            labels += [f"landmark_{number}" for number in numbers if of_openface]
            markers = tuple(column[label] for label in labels if label in column)
            if markers and stem + side in landmarks:
                place = landmarks[stem + side]
                places.append(KnownPlace(markers, place, spread, stem + side))
    return places


def places_by_labels(
    cloud: MarkerCloud, landmarks: dict[str, FloatArray], *, without: Collection[int] = ()
) -> list[KnownPlace]:
    """Return the places of markers whose labels name landmarks of the rig.

    Markers with the same landmarks (``brow_L1`` to ``brow_L5``) are one place, that of their mean;
    its variance includes theirs.

    `without`: markers to leave out.
    """
    if are_image_landmarks(cloud.labels):
        return _places_of_images(cloud, landmarks, without)
    groups: dict[tuple[str, ...], list[int]] = {}
    spreads = {}
    for marker, label in enumerate(cloud.labels):
        hint = label_hint(label)
        if hint.landmarks and marker not in without and set(hint.landmarks) <= landmarks.keys():
            groups.setdefault(hint.landmarks, []).append(marker)
            spreads[hint.landmarks] = hint.spread_mm
    places = []
    for names, markers in groups.items():
        scatter = rms_radius(cloud.neutral[markers])
        mean = np.mean([landmarks[name] for name in names], axis=0)
        spread = float(np.hypot(spreads[names], scatter))
        places.append(KnownPlace(tuple(markers), mean, spread, " and ".join(names)))
    return places


def marked_landmarks(skin: FaceSkin, landmarks: dict[str, FloatArray]) -> FaceLandmarks:
    """Return the landmarks that usually carry markers."""
    names = tuple(name for name in landmarks if landmark_spread_mm(name))
    activity = skin.activity()
    return FaceLandmarks(
        names,
        np.array([landmarks[name] for name in names]).reshape(-1, 3),
        np.array([landmark_spread_mm(name) for name in names]),
        float(skin.areas[activity > _ACTIVE_SHARE * activity.max()].sum()),
    )


def usual_scale(cloud: MarkerCloud, skin: FaceSkin, landmarks: dict[str, FloatArray]) -> float:
    """Estimate the scale from the performer to the face's frame, which is at an adult's size.

    By the height of the eyes over the mouth, if the markers may be in millimetres; else by the
    spread of the markers relative to that of the moving skin.
    """
    moving = rms_radius(skin.positions, skin.activity())
    covering = moving / max(rms_radius(cloud.neutral), 1e-9)
    if not {"mouth_middle", "lid_upper_L", "lid_lower_L"} <= landmarks.keys():
        return covering
    eyes = (landmarks["lid_upper_L"] + landmarks["lid_lower_L"])[1] / 2
    adult = float(eyes - landmarks["mouth_middle"][1]) / _EYES_TO_MOUTH_MM
    return adult if 1 / _OTHER_UNIT < covering / adult < _OTHER_UNIT else covering
