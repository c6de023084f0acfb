"""Landmarks of a rig's face, from its shapes.

Lids are found from blinks, the line of the mouth from the opening jaw; nose, bridge and chin from
the profile between them. Shapes are recognised by name; in rigs with foreign names, blinks and jaw
by their displacements. On a rig whose jaw is a joint, the middle of the mouth is where lips pucker,
and its corners are where they dimple.
"""

from collections import Counter
from collections.abc import Sequence

import numpy as np
from scipy.spatial import KDTree

from usdface.core.arrays import BoolArray, FloatArray
from usdface.model.retarget.shape_names import read_meanings
from usdface.numerics.registration.face_skin import TYPICAL_SIZE_MM, FaceSkin

_SIDES = (("L", 1.0), ("R", -1.0))
"""The character's left lies towards +X of the face's frame."""

_JAW, _PUCKER = ("jawopen", ""), ("mouthpucker", "")
"""Motion and side of shapes from which the mouth is found."""

_SIGNS = dict(_SIDES)
_OTHER = {"L": "R", "R": "L"}

_CENTROIDS = (
    ("browinnerup", "brow_inner", 1.0),
    ("browouterup", "brow_outer", 1.0),
    ("browdown", "brow_middle", 1.0),
    ("cheeksquint", "cheek_upper", 1.0),
    ("nosesneer", "nostril", 1.0),
    ("cheekpuff", "cheek", 8.0),
)
"""Motion, the landmark at the centroid of its largest displacements, and least distance of samples
from the plane of symmetry [mm]."""

MOST_MOVED_SHARE = 0.6
"""Share of a shape's largest displacement from which samples count for its centroid."""

_LEAST_MOTION_MM = 0.5
"""Largest displacement below which a shape, such as an empty one, is not used."""

_CREASE_SHARE = 0.2
"""Height of upper-lid markers above the lid's margin, as a share of that of the brow: the margin
itself has lashes and must be free to close."""

_MIDDLE_MM = 5.0
"""Distance from the plane of symmetry up to which samples belong to the profile."""

_PROFILE_DEPTH = 1.5
"""Largest depth of the profile behind the mouth, relative to that of the nose before it."""

_AHEAD_MM = 20.0
"""Distance before the mouth from which the nearest sample is on the lips, not on the teeth."""

_LEAST_FALL = 0.5
"""Least downward share of a lid's displacements."""

_LEAST_JAW_FALL = 0.35
"""The same for a jaw, which turns about the ears, so that the chin moves back as well."""

_ALIKE_SHARE = 0.25
"""Largest difference of both sides' energies over their sum, for a symmetric shape."""

_LID_RADIUS = 0.27
"""Largest RMS radius of a lid's displacements over the face's size; brows have more."""

_JAW_RADIUS = 0.5
"""Least RMS radius of a jaw's displacements over the face's size; lips that roll in have less."""

_LID_BESIDE = 0.35
"""Least distance of a lid's centre from the plane of symmetry over the face's size; half of a lip
that rolls in is as small as a lid."""

_STILL_SHARE = 0.2
"""Share of the jaw's largest displacement below which skin is not of the mouth."""

_SEAM_REACH, _PARTED_REACH = 0.12, 0.2
"""Largest distance of neighbours over the face's size: closed lips have samples within 7 mm, lips
that are parted at rest within 11."""

_SEAM_STRAIN = 2.0
"""Least relative displacement of neighbours over their distance where lips part; cheeks stretch by
1.5 at most."""

_LEAST_DISTANCE_MM = 1.0
"""Least distance of neighbours: samples on closed lips may coincide."""

_LEAST_PARTED = 0.05
"""Least relative displacement of neighbours over the jaw's largest; noise has less."""

_MOUTH_LEVEL = 0.25
"""Largest height of the seam above or below the mouth's middle, over the face's size."""

_CREASE_OF_EYE = 0.45
"""Height of the crease above the margin over the eye's opening, if no brow shape is known."""


def find_landmarks(skin: FaceSkin, shapes: Sequence[str]) -> dict[str, FloatArray]:
    """Return landmarks by name, each a position in the face's frame [mm].

    Returns the (3,) positions of ``nose_tip``, ``chin``, ``mouth_L``, ``lid_upper_L`` and so on,
    mirrored onto each other; those whose shapes the rig lacks are left out.

    `shapes`: names of the rig's shapes, in the order of the skin's deltas.
    """
    moved = _displacements(skin, shapes)
    if not {("eyeblink", "L"), ("eyeblink", "R"), _JAW} <= moved.keys():
        jaw = _jaw_row(skin)
        recognised = {} if jaw is None else recognise_shapes(skin, jaw)
        if jaw is not None and _PUCKER in moved and read_meanings(shapes)[shapes[jaw]].understood:
            recognised.pop(_JAW, None)  # a named shape of the mouth: the jaw is a joint
        moved = recognised | moved
    found: dict[str, FloatArray] = {}
    for side, sign in _SIDES:
        blink = moved.get(("eyeblink", side))
        if blink is not None:
            found |= _eye(skin, blink, side, sign)
        for motion, name, least in _CENTROIDS:
            delta = moved.get((motion, side), moved.get((motion, "")))
            beside = sign * (skin.positions[:, 0] - skin.sagittal_x) > least
            if delta is not None and np.abs(delta[beside]).max(initial=0.0) > _LEAST_MOTION_MM:
                found[f"{name}_{side}"] = _centroid(skin, delta, beside)
        if f"lid_upper_{side}" in found:
            margin, brow = found[f"lid_upper_{side}"], found.get(f"brow_middle_{side}")
            if brow is None:
                rise = _CREASE_OF_EYE * (margin - found[f"lid_lower_{side}"]) * [0.0, 1.0, 0.0]
            else:
                rise = _CREASE_SHARE * (brow - margin)
            found[f"lid_crease_{side}"] = _nearest(skin, margin + rise)
    if _JAW in moved:
        found |= _mouth(skin, moved[_JAW], found)
    elif _PUCKER in moved:
        found |= _lips(skin, moved)
    if "mouth_middle" in found and "lid_upper_L" in found:
        found |= _profile(skin, found)
    return _mirrored(skin, found)


def _displacements(skin: FaceSkin, shapes: Sequence[str]) -> dict[tuple[str, str], FloatArray]:
    found: dict[tuple[str, str], FloatArray] = {}
    meanings = read_meanings(shapes)
    for index in sorted(range(len(shapes)), key=lambda each: meanings[shapes[each]].rank):
        if np.abs(skin.deltas[index]).max(initial=0.0) > _LEAST_MOTION_MM:
            meant = meanings[shapes[index]]
            found.setdefault((meant.motion, meant.side), skin.deltas[index])
    # Named by the viewer's sides, or exchanged, if the one named left moves the right side.
    votes = Counter[str]()
    for (motion, side), delta in found.items():
        across = np.linalg.norm(delta, axis=1) @ (skin.positions[:, 0] - skin.sagittal_x)
        votes[motion] += int(_SIGNS.get(side, 0.0) * np.sign(across))
    return {
        (motion, _OTHER.get(side, side) if votes[motion] < 0 else side): delta
        for (motion, side), delta in found.items()
    }


def _centroid(skin: FaceSkin, delta: FloatArray, mask: BoolArray) -> FloatArray:
    """Return the sample nearest to the centroid of a shape's largest displacements."""
    size = np.where(mask, np.linalg.norm(delta, axis=1), 0.0)
    most = size > MOST_MOVED_SHARE * size.max()
    return _nearest(skin, (size[most] / size[most].sum()) @ skin.positions[most])


def _nearest(skin: FaceSkin, place: FloatArray, mask: BoolArray | None = None) -> FloatArray:
    rows = np.arange(len(skin.positions)) if mask is None else np.flatnonzero(mask)
    away = ((skin.positions[rows] - place) ** 2).sum(axis=1)
    return np.asarray(skin.positions[rows[int(away.argmin())]])


def _eye(skin: FaceSkin, blink: FloatArray, side: str, sign: float) -> dict[str, FloatArray]:
    """Return lids and corners; the upper margin is the lowest part of a blink's displacements."""
    at, size = skin.positions, np.linalg.norm(blink, axis=1)
    lid = size > 0.8 * size.max()
    margin = lid & (at[:, 1] <= np.quantile(at[lid, 1], 0.35))
    upper = np.median(at[margin], axis=0)
    lower = upper + blink[margin].mean(axis=0)
    middle = (upper + lower) / 2
    gap = max(abs(float(blink[lid].mean(axis=0)[1])), 4.0)
    out = sign * (at[:, 0] - skin.sagittal_x)
    beside = (out > 3) & (size > 0.22 * size.max()) & (abs(at[:, 1] - middle[1]) < 0.9 * gap)
    if not beside.any():  # a blink of the other eye
        return {}
    found = {f"lid_upper_{side}": upper, f"lid_lower_{side}": lower}
    for name, quantile in (("eye_inner", 0.02), ("eye_outer", 0.98)):
        edge = float(np.quantile(out[beside], quantile))  # between samples, maybe far from both
        near = beside & (abs(out - edge) <= max(3.0, abs(out[beside] - edge).min()))
        found[f"{name}_{side}"] = np.array(
            [skin.sagittal_x + sign * edge, *np.median(at[near][:, 1:], axis=0)]
        )
    return found


def _mouth(skin: FaceSkin, jaw: FloatArray, eyes: dict[str, FloatArray]) -> dict[str, FloatArray]:
    """Return the mouth's middle and corners, on the seam where the jaw parts neighbours."""
    at, size = skin.positions, np.linalg.norm(jaw, axis=1)
    pairs = KDTree(at).query_pairs(_PARTED_REACH * TYPICAL_SIZE_MM, output_type="ndarray")
    parted = np.linalg.norm(jaw[pairs[:, 0]] - jaw[pairs[:, 1]], axis=1)
    far = parted > _LEAST_PARTED * size.max(initial=0.0)
    pairs, parted = pairs[far], parted[far]
    lower, upper = np.where(
        (size[pairs[:, 0]] > size[pairs[:, 1]])[:, None], pairs, pairs[:, ::-1]
    ).T
    distance = np.linalg.norm(at[lower] - at[upper], axis=1)
    line = (at[lower] + at[upper]) / 2
    seam = parted > _SEAM_STRAIN * np.maximum(distance, _LEAST_DISTANCE_MM)
    seam &= at[lower, 1] < at[upper, 1] + _LEAST_DISTANCE_MM
    if "eye_outer_L" in eyes:
        seam &= abs(line[:, 0] - skin.sagittal_x) < abs(eyes["eye_outer_L"][0] - skin.sagittal_x)
    closed = seam & (distance <= _SEAM_REACH * TYPICAL_SIZE_MM)
    across = line[:, 0] - skin.sagittal_x
    central = abs(across) < _MIDDLE_MM
    at_seam = closed if (closed & central).any() else seam
    line, across, central = line[at_seam], across[at_seam], central[at_seam]
    if not central.any():
        return {}
    middle = np.median(line[central], axis=0)
    middle[0] = skin.sagittal_x
    found = {"mouth_middle": middle}
    level = abs(line[:, 1] - middle[1]) < _MOUTH_LEVEL * TYPICAL_SIZE_MM
    for side, sign in _SIDES:
        along = np.sort(np.append(0.0, np.maximum(sign * across[level], 0.0)))
        breaks = np.flatnonzero(np.diff(along) > 6.0)  # beyond a break it is another line
        corner = along[breaks[0]] if len(breaks) else along[-1]
        near_corner = level & (abs(sign * across - corner) < 3)
        if near_corner.any():
            found[f"mouth_{side}"] = np.array(
                [skin.sagittal_x + sign * corner, *np.median(line[near_corner][:, 1:], axis=0)]
            )
    return found


def _lips(skin: FaceSkin, moved: dict[tuple[str, str], FloatArray]) -> dict[str, FloatArray]:
    """Return the mouth's middle and corners, where lips pucker and dimple.

    On five heads within 7 and 8 mm of those found from the jaw.
    """
    away = skin.positions[:, 0] - skin.sagittal_x
    middle = _centroid(skin, moved[_PUCKER], np.ones(len(away), np.bool_))
    middle[0] = skin.sagittal_x
    found = {"mouth_middle": middle}
    for side, sign in _SIDES:
        dimple = moved.get(("mouthdimple", side))
        if dimple is not None and np.abs(dimple[sign * away > 0]).max() > _LEAST_MOTION_MM:
            found[f"mouth_{side}"] = _centroid(skin, dimple, sign * away > 0)
    return found


def _profile(skin: FaceSkin, known: dict[str, FloatArray]) -> dict[str, FloatArray]:
    """Return nose, bridge, chin and lips of the profile."""
    at, mouth = skin.positions, known["mouth_middle"]
    middle = abs(at[:, 0] - skin.sagittal_x) < _MIDDLE_MM
    middle &= at[:, 2] > mouth[2] - _PROFILE_DEPTH * (at[:, 2].max() - mouth[2])
    eye_y = float(known["lid_upper_L"][1] + known["lid_lower_L"][1]) / 2
    span = eye_y - float(mouth[1])
    found: dict[str, FloatArray] = {}

    def extreme(name: str, low: float, high: float, *, foremost: bool = True) -> None:
        """Store the foremost, or rearmost, sample between two heights."""
        band = np.flatnonzero(middle & (at[:, 1] > low) & (at[:, 1] < high))
        if len(band):
            depth = at[band, 2]
            row = band[int(depth.argmax() if foremost else depth.argmin())]
            found[name] = np.array([skin.sagittal_x, at[row, 1], at[row, 2]])

    nose_y = float(mouth[1]) + 0.2 * span
    extreme("nose_tip", nose_y, mouth[1] + 0.8 * span)
    extreme("chin", mouth[1] - 0.95 * span, mouth[1] - 0.3 * span)
    extreme("nose_bridge", eye_y - 0.02 * span, eye_y + 0.18 * span, foremost=False)
    if "brow_inner_L" in known and "brow_inner_R" in known:
        between = (known["brow_inner_L"] + known["brow_inner_R"]) / 2
        level = middle & (abs(at[:, 1] - between[1]) < _MIDDLE_MM)  # a muzzle is farther ahead
        if level.any():
            ahead = np.array([skin.sagittal_x, between[1], between[2] + 60.0])
            found["brow_centre"] = _nearest(skin, ahead, level)
    for name, share in (("lip_upper", 0.16), ("lip_lower", -0.2)):
        ahead = np.array([skin.sagittal_x, mouth[1] + share * span, mouth[2] + _AHEAD_MM])
        found[name] = _nearest(skin, ahead, middle & (at[:, 1] < nose_y))
    return found


def _mirrored(skin: FaceSkin, found: dict[str, FloatArray]) -> dict[str, FloatArray]:
    """Average each landmark with the reflection of its partner on the other side."""
    out = dict(found)
    for name, place in found.items():
        partner = found.get(f"{name[:-1]}R") if name.endswith("_L") else None
        if partner is not None:
            mean = (place + skin.mirrored(partner[None])[0]) / 2
            out[name], out[f"{name[:-1]}R"] = mean, skin.mirrored(mean[None])[0]
    return out


def _jaw_row(skin: FaceSkin) -> int | None:
    """Return the shape that opens the jaw: of downward ones, the symmetric one of most energy."""
    side = np.sign(skin.positions[:, 0] - skin.sagittal_x)
    jaw, largest = None, 0.0
    for row, delta in enumerate(skin.deltas):
        if not _falls(delta, _LEAST_JAW_FALL):
            continue
        energy = (delta**2).sum(axis=1) * skin.areas
        alike = abs(energy @ side) < _ALIKE_SHARE * energy.sum()
        if alike and energy.sum() > largest and _spread(skin, energy)[1] > _JAW_RADIUS:
            jaw, largest = row, float(energy.sum())
    return jaw


def recognise_shapes(skin: FaceSkin, jaw_row: int) -> dict[tuple[str, str], FloatArray]:
    """Return blinks and the opening jaw among shapes with foreign names, by their displacements.

    A blink is the downward shape with the largest displacement among those as small as a lid, on
    each side, outside the jaw's region.

    Returns (samples, 3) arrays under keys as of `motion_and_side`, ``('eyeblink', 'L')``,
    ``('jawopen', '')``; none without two blinks that mirror each other.
    """
    side = np.sign(skin.positions[:, 0] - skin.sagittal_x)
    jaw = skin.deltas[jaw_row]
    still = np.linalg.norm(jaw, axis=1) < _STILL_SHARE * np.linalg.norm(jaw, axis=1).max()
    falling = [delta for delta in skin.deltas if _falls(delta, _LEAST_FALL)]
    blinks, centres = {}, {}
    for name, sign in _SIDES:
        farthest = 0.0
        for delta in falling:
            lid = np.where((side == sign)[:, None], delta, 0.0)
            energy = (lid**2).sum(axis=1) * skin.areas
            if energy.sum() < _ALIKE_SHARE * ((delta**2).sum(axis=1) @ skin.areas):
                continue  # what a shape of the other side leaves here
            centre, radius = _spread(skin, energy)
            beside = sign * (centre[0] - skin.sagittal_x) > _LID_BESIDE * TYPICAL_SIZE_MM
            small = beside and radius < _LID_RADIUS
            peak = float(np.linalg.norm(lid, axis=1).max())
            if small and energy[still].sum() > 0.5 * energy.sum() and peak > farthest:
                blinks[name], centres[name], farthest = lid, centre, peak
    if len(blinks) < len(_SIDES):
        return {}
    apart = np.linalg.norm(centres["L"] - skin.mirrored(centres["R"][None])[0])
    if apart > _LID_RADIUS * TYPICAL_SIZE_MM:
        return {}
    return {("eyeblink", name): lid for name, lid in blinks.items()} | {("jawopen", ""): jaw}


def _spread(skin: FaceSkin, energy: FloatArray) -> tuple[FloatArray, float]:
    """Return centroid and RMS radius, over the face's size, of a motion's energy."""
    centre = energy @ skin.positions / energy.sum()
    squared = energy @ ((skin.positions - centre) ** 2).sum(axis=1) / energy.sum()
    return centre, float(np.sqrt(squared)) / TYPICAL_SIZE_MM


def _falls(delta: FloatArray, least: float) -> bool:
    """Whether a shape's largest displacements go down."""
    size = np.linalg.norm(delta, axis=1)
    most = size > 0.5 * size.max()
    return bool(size.max() > 0 and -delta[most, 1].sum() > least * size[most].sum())
