"""Verdict on a placement of markers on a rig, and the markers to check."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import KDTree

from usdface.core.arrays import FloatArray
from usdface.core.text import first_few, pluralize
from usdface.model.placement.known_places import places_by_labels
from usdface.model.placement.marker_cloud import MarkerCloud
from usdface.model.placement.place import FEWEST_PINS, pose_errors_at, without_errors
from usdface.model.placement.region_shapes import words_on_missing_shapes
from usdface.model.placement.rig_landmarks import find_landmarks
from usdface.numerics.registration.face_skin import TYPICAL_SIZE_MM, FaceSkin
from usdface.numerics.registration.skin_placement import (
    KnownPlace,
    explained_share,
    solve_weights_at,
)
from usdface.numerics.registration.virtual_markers import VirtualMarkers, certain_errors

_FAR_SPREADS = 3.0
"""Distance from a marker's landmark, in standard deviations, from which it is reported: 0.3 % of
normal deviates. Twice that for a marker that a person placed on the rig."""

_MOST_FAR_SHARE = 1 / 3
"""Share of markers far from their landmarks from which the whole placement is wrong."""

_LEVEL_DEGREES, _TILTED_DEGREES = 3.0, 6.0
"""Roll for a check and for a wrong placement. Twenty pairs placed to 3 mm give a standard error of
half a degree."""

_SHIFT_SHARE = 0.25
"""Shift of a placement, over the face's size, with which explained motion is compared: 14 mm on an
adult's face, the distance from lid to brow."""

_GAIN, _LARGE_GAIN = 0.02, 0.08
"""Gain of explained share by a shift, for a check and for a wrong placement; every shift of a right
one loses."""

_LEAST_EXPLAINED = 0.5
"""Explained share of motion below which a placement by motion is to be checked."""

_OVERTURNED_GAIN, _LARGE_OVERTURNED_GAIN = 0.03, 0.1
"""Gain of value of a cloud turned upside down, for a check and for a wrong placement. A candidate
that gains the former replaces another one."""

_ONE_SIDE_SHARE = 0.05
"""Share of the markers off the midline below which a side of the face counts as not captured."""

_MIDLINE_MM = 8.0
"""Largest distance of a marker of the midline from the plane of symmetry, on an adult's face; that
of a recorded performer's forehead is 6 mm."""

_NECK_SHARE = 0.5
"""Distance below the chin, over that from eyes to chin, from which a marker is on the neck."""

_NECK_MARKERS = 0.05
"""Share of markers on the neck above which the placement is wrong."""

_OPENINGS = {"good": "Looks right", "check": "Look at it", "bad": "Looks wrong"}


@dataclass(frozen=True)
class PlacementVerdict:
    """Level, reasons and figures of a placement's verdict."""

    level: str
    """``'good'``, ``'check'`` or ``'bad'``."""
    sentence: str
    """The verdict and its reasons."""
    facts: tuple[str, ...]
    """Count, method and figures behind the verdict."""
    explained: float
    """Share of the markers' motion that the shapes explain [0-1]; NaN without motion."""
    roll_degrees: float
    """Of the markers' plane of symmetry against the rig's; NaN without symmetry."""
    warnings: dict[str, str]
    """Distance from the landmark, as text, of markers to check, by label."""
    wanted: dict[str, FloatArray]
    """dict of str to (3,) float array: the landmarks of these markers, in the rig's space [mm]."""


def judge_placement(
    cloud: MarkerCloud,
    skin: FaceSkin,
    shapes: tuple[str, ...],
    virtual: VirtualMarkers,
    *,
    at: FloatArray,
    ranges: FloatArray,
    by_labels: bool,
    placed: Collection[int] = (),
) -> PlacementVerdict:
    """Return the verdict on markers at places on a rig.

    Parameters
    ----------
    shapes : tuple of str
        Names of the rig's shapes.
    at : (markers, 3) float array
        Positions on the rig, in its space [mm].
    ranges : (shapes, 2) float array
        Limits of the weights.
    by_labels : bool
        True if placed by labels, False if by motion.
    placed : collection of int
        Markers placed by a person.
    """
    local = skin.to_frame(at)
    nearest = KDTree(skin.positions)
    samples = np.asarray(nearest.query(local)[1], np.int64)
    landmarks = find_landmarks(skin, shapes)
    known = places_by_labels(cloud, landmarks)
    far = _far_markers(local, known, placed, skin.unit)
    roll = _roll_degrees(replace(cloud, neutral=local))
    reasons = [_tilt(roll), _missed(far, cloud.labels, known), _one_sided(local, skin)]
    reasons.append(_on_neck(cloud.labels, local, landmarks))
    explained = float("nan")
    if len(cloud.motion):
        errors = pose_errors_at(cloud, skin, virtual, samples)
        cloud = without_errors(certain_errors(errors), cloud)
        moved = skin.to_frame(virtual.motion_scale * (cloud.motion @ virtual.rotation.T))
        weights = solve_weights_at(skin, samples, moved, ranges)
        explained = explained_share(skin, samples, moved, weights)
        shift_mm = _SHIFT_SHARE * TYPICAL_SIZE_MM
        gains = {}
        for way, step in _SHIFTS.items():
            there = np.asarray(nearest.query(local + np.multiply(step, shift_mm))[1], np.int64)
            shifted = solve_weights_at(skin, there, moved, ranges, start=weights)
            gains[way] = explained_share(skin, there, moved, shifted) - explained
        reasons.append(_better_elsewhere(gains, skin.unit * shift_mm))
        missing = words_on_missing_shapes(
            cloud.labels, skin, shapes, samples, moved, ranges, placed=by_labels or bool(placed)
        )
        reasons.append(("check", missing) if missing else _FINE)
    if not by_labels and not placed:
        reasons.append(_by_motion(len(known), explained))
    found = [each for each in reasons if each[0] != "good"]
    level = max((each[0] for each in found), key=list(_OPENINGS).index, default="good")
    found.sort(key=lambda each: -list(_OPENINGS).index(each[0]))
    share = "" if np.isnan(explained) else f"shapes explain {explained:.0%} of the motion"
    fine = ("" if np.isnan(roll) else "level", "at its landmarks" if known else "", share)
    why = [text for _, text in found] or [", ".join(filter(None, fine))]
    return PlacementVerdict(
        level,
        f"{_OPENINGS[level]}: {'; '.join(why)}",
        _facts(cloud, by_labels, share if found else "", roll, len(placed)),
        explained,
        roll,
        {cloud.labels[marker]: f"{away:.0f} mm" for marker, (away, _) in far.items()},
        {cloud.labels[marker]: skin.from_frame(known.place) for marker, (_, known) in far.items()},
    )


def warn_upside_down(verdict: PlacementVerdict, gain: float) -> PlacementVerdict:
    """Return the verdict on a placement of some gain upside down; unchanged for a small one.

    `gain`: `MarkerPlacement.overturned_gain`.
    """
    if gain <= _OVERTURNED_GAIN:
        return verdict
    certain = gain > _LARGE_OVERTURNED_GAIN
    text = (
        f"the markers fit {'far ' * certain}better upside down; "
        f"{'' if certain else 'if they lie so, '}ingest the takes again and state --up"
    )
    others = [] if verdict.level == "good" else [verdict.sentence.partition(": ")[2]]
    level = "bad" if certain else max("check", verdict.level, key=list(_OPENINGS).index)
    return replace(
        verdict, level=level, sentence=f"{_OPENINGS[level]}: {'; '.join([text, *others])}"
    )


_SHIFTS = {
    "higher": (0.0, 1.0, 0.0),
    "lower": (0.0, -1.0, 0.0),
    "further to its left": (1.0, 0.0, 0.0),
    "further to its right": (-1.0, 0.0, 0.0),
}

_Reason = tuple[str, str]
"""A level, and the words; ``'good'`` needs none."""

_FINE: _Reason = ("good", "")


def _by_motion(known: int, explained: float) -> _Reason:
    """Return a check for a placement by motion without labels, or with little explained motion."""
    weak = not explained >= _LEAST_EXPLAINED
    if known < FEWEST_PINS:
        alone = "placed by motion alone, as labels and shapes name too few landmarks"
        if weak and not np.isnan(explained):
            alone += (
                f", and shapes explain {explained:.0%} of it: all markers may be far off; give "
                "three or more their places with --landmarks"
            )
        return "check", alone
    if weak:
        return "check", f"placed by motion, of which shapes explain {explained:.0%}"
    return _FINE


def _far_markers(
    local: FloatArray, known: Sequence[KnownPlace], placed: Collection[int], unit: float
) -> dict[int, tuple[float, KnownPlace]]:
    """Return distance on the rig [mm] and landmark of markers far from it, in descending order."""
    far: dict[int, tuple[float, KnownPlace]] = {}
    for each in known:
        away = float(np.linalg.norm(each.step(local)))
        doubled = 2 if set(each.markers) & set(placed) else 1
        if away > doubled * _FAR_SPREADS * each.spread_mm:
            far |= {marker: (unit * away, each) for marker in each.markers}
    return dict(sorted(far.items(), key=lambda each: -each[1][0]))


def _missed(
    far: dict[int, tuple[float, KnownPlace]], labels: tuple[str, ...], known: Sequence[KnownPlace]
) -> _Reason:
    if not far:
        return _FINE
    count = sum(len(each.markers) for each in known)
    if len(far) > _MOST_FAR_SHARE * count:
        return "bad", f"{len(far)} of {count} named markers lie far from their landmarks"
    named = [
        f"{labels[marker]} lies {away:.0f} mm from {known.name.replace('_', ' ')}"
        for marker, (away, known) in far.items()
    ]
    return "check", first_few(named, most=3)


def _tilt(roll: float) -> _Reason:
    if np.isnan(roll) or abs(roll) < _LEVEL_DEGREES:
        return _FINE
    level = "bad" if abs(roll) >= _TILTED_DEGREES else "check"
    return level, f"tilted by {abs(roll):.0f} degrees"


def _one_sided(local: FloatArray, skin: FaceSkin) -> _Reason:
    across = local[:, 0] - skin.sagittal_x
    beside = across[np.abs(across) > _MIDLINE_MM]
    left = float((beside > 0).mean()) if len(beside) else 0.5
    if min(left, 1 - left) >= _ONE_SIDE_SHARE:
        return _FINE
    side = "left" if left > 0.5 else "right"
    return "check", f"the markers are on its {side} side only"


def _on_neck(
    labels: tuple[str, ...], local: FloatArray, landmarks: dict[str, FloatArray]
) -> _Reason:
    if not {"chin", "lid_lower_L"} <= landmarks.keys():
        return _FINE
    chin, eye = float(landmarks["chin"][1]), float(landmarks["lid_lower_L"][1])
    below = np.flatnonzero(local[:, 1] < chin - _NECK_SHARE * (eye - chin))
    if not len(below):
        return _FINE
    level = "bad" if len(below) > _NECK_MARKERS * len(local) else "check"
    named = first_few([labels[marker] for marker in below], most=3)
    return level, f"{pluralize(len(below), 'marker')} far below the chin ({named})"


def _better_elsewhere(gains: dict[str, float], shift_mm: float) -> _Reason:
    way = max(gains, key=gains.__getitem__)
    if gains[way] < _GAIN:
        return _FINE
    level = "bad" if gains[way] >= _LARGE_GAIN else "check"
    return level, f"the motion fits {gains[way]:.0%} better {shift_mm:.0f} mm {way}"


def _roll_degrees(cloud: MarkerCloud) -> float:
    try:
        normal = cloud.levelled()[0][0]
    except ValueError:
        return float("nan")
    return float(np.degrees(np.arctan(normal[1] / normal[0]))) if normal[0] else 90.0


def _facts(
    cloud: MarkerCloud, by_labels: bool, share: str, roll: float, placed: int
) -> tuple[str, ...]:
    facts = [
        pluralize(len(cloud.labels), "marker"),
        "placed by names" if by_labels else "placed by motion",
        share,
        "" if np.isnan(roll) else f"tilt {abs(roll):.1f} degrees",
        f"{placed} placed by a person" if placed else "",
    ]
    return tuple(fact for fact in facts if fact)
