"""Regions of the face that markers move and a rig's shapes do not.

Shapes of neighbouring regions carry the skin along: without its own shapes a brow still follows a
blink by 2 mm. Therefore each shape is assigned to one region, by its name or, if that tells none,
by where it moves the skin most, and a region is compared with its shapes alone.
"""

from collections.abc import Sequence

import numpy as np
from scipy.spatial import KDTree

from usdface.core.arrays import BoolArray, FloatArray, IntArray, row_lengths
from usdface.core.text import first_few, pluralize
from usdface.model.placement.label_hints import face_region, label_hint
from usdface.model.placement.rig_landmarks import MOST_MOVED_SHARE
from usdface.model.placement.shape_parts import RegionTemplate, fit_region_template
from usdface.model.retarget.shape_names import read_meanings
from usdface.numerics.measure.face_regions import REGIONS, gaze_and_tongue_shapes, region_of_shape
from usdface.numerics.registration.face_skin import FaceSkin
from usdface.numerics.registration.skin_placement import solve_weights_at

_STILL_MM = 1.0
"""RMS motion of skin on an adult's face from which the rig needs a shape there."""

_LEAST_MOBILITY = 1 / 3
"""Largest displacement of skin by shapes, over the RMS motion of markers, below which they do not
move these."""

_FOLLOWED_SHARE = 0.9
"""Share of a region's motion that shapes of other regions explain, from which none is missing."""

_FARTHER_WEIGHT = 2.0
"""Largest weight, over its limit, for that share: performers differ in amplitude by that factor."""

_UNFOLLOWED_MM, _UNFOLLOWED_SHARE = 4.5, 0.5
"""RMS motion of a marker on an adult's face that all shapes leave, and the share of its motion
that they follow, above and below which no shape is for it. Recordings on rigs with all shapes leave
3.8 mm at most; without a shape for the jaw, 5 to 9 mm at the chin."""

_CELL_MM = 30.0
"""Distance from the nearest marker, on an adult's face, up to which skin belongs to its region."""

_LID_TRAVEL_MM = 6.0
"""Downward displacement by a shape that closes an eye, on an adult's face: eyes open by 8 to 11."""

_BLINK = "eyeblink"


def words_on_missing_shapes(
    labels: Sequence[str],
    skin: FaceSkin,
    shapes: tuple[str, ...],
    samples: IntArray,
    moved: FloatArray,
    ranges: FloatArray,
    *,
    placed: bool,
) -> str:
    """Return words on regions whose markers move and whose shapes the rig lacks; ``''`` if none.

    With `placed`, places are known other than by motion; then single markers that all shapes do not
    follow are named as well.

    Parameters
    ----------
    shapes : tuple of str
        Names of the rig's shapes.
    samples : (markers,) int array
        Sample of the skin under each marker.
    moved : (frames, markers, 3) float array
        Motion of the markers in the face's frame [mm].
    ranges : (shapes, 2) float array
    """
    motion = np.sqrt((moved**2).sum(axis=2).mean(axis=0))
    moving = motion > _STILL_MM
    moving[[label.startswith("iris_") for label in labels]] = False  # eyeballs have joints
    template = fit_region_template(skin, shapes)
    regions = _marker_regions(labels, skin, template, samples)
    size = row_lengths(skin.deltas)[..., 0]
    owners = _owners(skin, size, shapes, template, samples, regions)
    reach = size.max(axis=1, initial=0.0)
    named, missing = [], set()
    for region in REGIONS:
        at = np.flatnonzero((regions == region) & moving)
        if not len(at):
            continue
        if reach[owners == region].max(initial=0.0) > _LEAST_MOBILITY * np.median(motion[at]):
            continue
        share = 0.0  # of the motion's energy
        if skin.deltas[:, samples[at]].any():
            left = _left_motion(skin, samples[at], moved[:, at], ranges)
            share = 1.0 - float((left**2).sum() / (moved[:, at] ** 2).sum())
        if share < _FOLLOWED_SHARE:
            missing.add(region)
            named.append(
                f"the {region} ({pluralize(len(at), 'marker')}; other shapes follow "
                f"{max(share, 0.0):.0%} of their motion)"
            )
    words = [f"the rig has no shapes for {' and '.join(named)}"] if named else []
    lids = (regions == "lids") & moving
    if lids.any() and "lids" not in missing and not _closes_eyes(skin, shapes, owners):
        words.append("the rig has no shape that closes the eyes, so blinks are not followed")
    mobility = size[:, samples].max(axis=0, initial=0.0)
    rest = moving & ~np.isin(regions, list(missing)) & (mobility < _LEAST_MOBILITY * motion)
    still = _still_parts(labels, rest)
    if still:
        words.append(f"no shape of the rig moves the skin at {still}")
    left = _unfollowed_mm(skin, samples, moved, ranges)
    left[~moving | rest | np.isin(regions, list(missing))] = 0.0
    if placed and left.any():
        worst = [f"{labels[m]} {skin.unit * left[m]:.0f} mm" for m in np.argsort(-left) if left[m]]
        words.append(
            f"shapes of the rig do not follow {first_few(worst, most=3)}, as of skin that a joint "
            "moves: no reference or tuning helps; add a shape for it"
        )
    return "; ".join(words)


def _marker_regions(
    labels: Sequence[str], skin: FaceSkin, template: RegionTemplate | None, samples: IntArray
) -> np.ndarray:
    """Return the region of each marker, by its label, else by its place: (markers,) array of str.

    Empty for markers of the skull, and for those whose region is unknown.
    """
    regions = []
    for label, sample in zip(labels, samples, strict=True):
        if template is None or label_hint(label).region:
            regions.append(face_region(label))
        else:
            regions.append(template.part_at(skin.positions[[sample]], np.ones(1)))
    return np.array(regions, dtype=object)


def _owners(
    skin: FaceSkin,
    sizes: FloatArray,
    shapes: tuple[str, ...],
    template: RegionTemplate | None,
    samples: IntArray,
    regions: np.ndarray,
) -> np.ndarray:
    """Return the region that each shape moves: (shapes,) array of str.

    By its name or, if that tells none, by the template; without one, the region of the markers at
    most of its energy. Empty for gaze and tongue.
    """
    meanings = read_meanings(shapes)
    hidden = set(gaze_and_tongue_shapes(shapes).tolist())
    away, near = KDTree(skin.positions[samples]).query(skin.positions)
    cells = np.where(away < _CELL_MM, regions[near], "")
    masks = np.array([cells == region for region in REGIONS])
    owners = []
    for shape, (name, size) in enumerate(zip(shapes, sizes, strict=True)):
        region = region_of_shape(meanings[name].motion if meanings[name].understood else name)
        if shape in hidden or not size.any():
            region = ""
        elif not region and not meanings[name].understood and template is not None:
            region = template.part_at(skin.positions, size)
        elif not region and not meanings[name].understood:
            peak = size > MOST_MOVED_SHARE * size.max()
            shares = masks @ np.where(peak, size**2 * skin.areas, 0.0)
            region = REGIONS[int(shares.argmax())] if shares.any() else ""
        owners.append(region)
    return np.array(owners, dtype=object)


def _unfollowed_mm(
    skin: FaceSkin, samples: IntArray, moved: FloatArray, ranges: FloatArray
) -> FloatArray:
    """Return the RMS motion that all shapes leave, (markers,) [mm]; 0 where they follow it."""
    away = _left_motion(skin, samples, moved, ranges)
    left, motion = (np.sqrt((each**2).sum(axis=2).mean(axis=0)) for each in (away, moved))
    follows = left**2 < (1 - _UNFOLLOWED_SHARE) * motion**2
    follows |= left < _UNFOLLOWED_MM
    return np.asarray(np.where(follows, 0.0, left))


def _left_motion(
    skin: FaceSkin, samples: IntArray, moved: FloatArray, ranges: FloatArray
) -> FloatArray:
    """Return the motion of markers that all shapes leave: (frames, markers, 3) [mm]."""
    weights = solve_weights_at(skin, samples, moved, _FARTHER_WEIGHT * ranges)
    followed = np.einsum("fk,kmc->fmc", weights, skin.deltas[:, samples], optimize=True)
    return np.asarray(moved - followed)


def _closes_eyes(skin: FaceSkin, shapes: tuple[str, ...], owners: np.ndarray) -> bool:
    """Whether a shape closes an eye: by its name or, if that tells nothing, by its displacement."""
    meanings = read_meanings(shapes)
    travel = -skin.deltas[:, :, 1].min(axis=1, initial=0.0)
    return any(
        mm > (0.0 if meanings[name].motion == _BLINK else _LID_TRAVEL_MM)
        for name, owner, mm in zip(shapes, owners, travel, strict=True)
        if owner == "lids" and (meanings[name].motion == _BLINK or not meanings[name].understood)
    )


def _still_parts(labels: Sequence[str], still: BoolArray) -> str:
    """Return parts of the face most of whose markers no shape moves, and unnamed such markers."""
    hints = np.array([label_hint(label).region for label in labels], dtype=object)
    named = []
    for part in dict.fromkeys(hints.tolist()):
        bare = np.flatnonzero((hints == part) & still)
        if not len(bare):
            continue
        if not part:
            named.append(first_few([labels[marker] for marker in bare.tolist()], most=3))
        elif len(bare) > (hints == part).sum() / 2:
            markers = first_few([labels[marker] for marker in bare.tolist()], most=3)
            named.append(f"the {_PLURALS.get(part, part)} ({markers})")
    return first_few(named, most=3) if named else ""


_PLURALS = {"brow": "brows", "lid": "lids", "cheek": "cheeks", "eye": "eyes"}
