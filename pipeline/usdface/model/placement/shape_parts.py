"""Region of the face of shapes with foreign names, from their displacements.

An adult's face is fitted to the rig's landmarks (`usdface.model.placement.rig_landmarks`), with a
scale for its breadth and one for its height. A shape belongs to the region whose landmarks are
nearest to the centroid of its largest displacements, left and right folded onto each other. A shape
that moves points off the skin, and the skin much less, turns an eye or moves the tongue, or brows
that are meshes of their own; so does one that turns the same eye.
"""

from collections.abc import Sequence

import numpy as np
from scipy import sparse

from usdface.core.arrays import FloatArray, row_lengths
from usdface.core.assets import Rig
from usdface.core.deformer import Deformer
from usdface.model.placement.face_template import landmark_place
from usdface.model.placement.rig_landmarks import MOST_MOVED_SHARE, find_landmarks
from usdface.model.retarget.shape_names import read_meanings
from usdface.numerics.measure.face_regions import (
    REGIONS,
    gaze_and_tongue_shapes,
    gaze_shapes,
    region_of_shape,
)
from usdface.numerics.registration.face_skin import FaceSkin

GAZE, TONGUE = "gaze", "tongue"

_FITTED = ("lid_lower_L", "eye_inner_L", "eye_outer_L", "mouth_L", "nose_bridge", "nose_tip")
"""Landmarks to which the adult's face is fitted; the chin, found from the jaw, is less precise."""

_LANDMARKS = (
    ("brows", ("brow_centre", "brow_inner_L", "brow_middle_L", "brow_outer_L")),
    ("lids", ("eye_inner_L", "eye_outer_L", "lid_lower_L")),
    ("cheeks and nose", ("nose_tip",)),
    ("mouth", ("lip_upper", "lip_lower", "mouth_L")),
    ("jaw", ("chin",)),
)

_FURTHER_MM = (
    ("lids", (31.0, 2.0, -14.0)),  # the margin of the upper lid
    ("cheeks and nose", (17.0, -48.0, 8.0)),  # the wing of the nose
    ("cheeks and nose", (35.0, -30.0, -14.0)),  # under the rim of the eye's socket
    ("cheeks and nose", (48.0, -45.0, -20.0)),  # under the cheekbone
    ("cheeks and nose", (50.0, -75.0, -20.0)),  # beside the mouth
    ("jaw", (20.0, -105.0, -6.0)),  # beside the chin
)
"""Further places of regions, in the coordinates of `landmark_place` [mm]."""

_FARTHEST_MM = 30.0
"""Distance from all landmarks, on an adult's face, beyond which a shape has no region."""

_LID_SHARE, _SKIN_SHARE = 2 / 3, 1 / 3
"""Share of a shape's largest displacement below which the skin hardly moves: of the lids, which
follow an eye that turns, and of other regions."""

_LEAST_MOTION_MM = 0.1
"""Largest displacement below which a shape has no region."""


def shape_parts(rig: Rig, deformer: Deformer) -> tuple[str, ...]:
    """Return a name for each shape from which its region can be read.

    A shape whose name tells its region, gaze or tongue keeps it; others get the name of the region
    that they move (`REGIONS`, ``'gaze'``, ``'tongue'``), which `shapes_by_region` reads as a name,
    unless the rig's landmarks are not found. A name that a vocabulary reads as motion of another
    region, such as ``mouthOpen`` for the jaw, is replaced by that motion.
    """
    names = _read_by_vocabulary(rig.shapes)
    unseen = set(gaze_and_tongue_shapes(names).tolist())
    foreign = [i for i, name in enumerate(names) if i not in unseen and not region_of_shape(name)]
    if not foreign:
        return names
    try:
        skin = deformer.face_skin()
    except ValueError:
        return names
    template = fit_region_template(skin, names)
    if template is None:
        return names
    points = skin.to_frame(deformer.neutral)
    off_skin = np.ones(len(points), dtype=np.bool_)
    off_skin[skin.corners] = False
    found = list(names)
    motions = _motions(deformer.full_offsets())
    moving = [shape for shape in foreign if motions[shape].max(initial=0.0) > _LEAST_MOTION_MM]
    for shape in moving:
        moved, on_skin = motions[shape], row_lengths(skin.deltas[shape])[:, 0]
        part, share = template.part_at(points, moved), on_skin.max() / moved.max()
        if part == "lids" and share < _LID_SHARE:
            found[shape] = GAZE
        elif share < _SKIN_SHARE:
            found[shape] = part if part == "brows" else TONGUE
        else:
            found[shape] = template.part_at(skin.positions, on_skin) or found[shape]
    least = MOST_MOVED_SHARE * motions.max(axis=1, initial=0.0)
    for gaze in gaze_shapes(found).tolist():
        eye = np.flatnonzero(off_skin & (motions[gaze] > least[gaze]))  # the points it turns
        if not len(eye):
            continue
        carried = motions[:, eye].mean(axis=1) > least  # a look down carries lids as far as the eye
        for shape in np.intersect1d(moving, np.flatnonzero(carried)).tolist():
            found[shape] = GAZE
    return tuple(found)


def _read_by_vocabulary(names: tuple[str, ...]) -> tuple[str, ...]:
    """Replace names by their motions where these are of another region, or the name tells none."""
    read = list(names)
    for index, (name, meaning) in enumerate(zip(names, read_meanings(names).values(), strict=True)):
        named, meant = region_of_shape(name), region_of_shape(meaning.motion)
        if meaning.understood and meant and named != meant:
            read[index] = meaning.motion
    return tuple(read)


def _motions(offsets: sparse.csr_array) -> FloatArray:
    """Return displacements: (shapes, points) [mm]."""
    points = offsets.indices // 3  # each three times, which are added
    shape = (offsets.shape[0], offsets.shape[1] // 3)
    squares = sparse.csr_array((offsets.data**2, points, offsets.indptr.copy()), shape=shape)
    squares.sum_duplicates()
    return np.asarray(squares.sqrt().toarray())


def missing_parts_note(parts: Sequence[str]) -> str:
    """Return a note on regions without a known shape, or on eyes that do not close; else empty.

    `parts`: of a rig's shapes, as `shape_parts` returns them.
    """
    known = {region_of_shape(each) for each in parts}
    missing = [region for region in REGIONS if region not in known]
    if not missing:
        return "no shape of this rig closes the eyes: blinks are not followed" * _stay_open(parts)
    listed = ", ".join(missing)
    return (
        f"no shape of this rig is known to move the {listed}: uncertainty, coverage and residual "
        "say nothing of that skin by itself; check it in the pictures"
    )


def _stay_open(parts: Sequence[str]) -> bool:
    """Whether the names of all shapes of the lids tell that they do not close the eyes."""
    meanings = read_meanings(parts)
    lids = [meanings[part] for part in parts if region_of_shape(part) == "lids"]
    return bool(lids) and all(m.understood and "eyeblink" not in m.motion for m in lids)


class RegionTemplate:
    """An adult's landmarks fitted to a rig."""

    def __init__(self, skin: FaceSkin, scale: FloatArray, origin: FloatArray) -> None:
        self._middle_x, self._size = skin.sagittal_x, float(scale.mean())
        landmarks = [(part, _adult([name])[0]) for part, names in _LANDMARKS for name in names]
        rows = [*landmarks, *_FURTHER_MM]
        self._parts = [part for part, _ in rows]
        self._places = np.array([place for _, place in rows]) * scale + origin

    def part_at(self, positions: FloatArray, moved: FloatArray) -> str:
        """Return the region at the centroid of the largest displacements; empty if far from all."""
        most = np.flatnonzero(moved > MOST_MOVED_SHARE * moved.max())
        weight, folded = moved[most], positions[most] - [self._middle_x, 0.0, 0.0]
        folded[:, 0] = np.abs(folded[:, 0])
        away = np.linalg.norm(self._places - weight @ folded / weight.sum(), axis=1)
        nearest = int(away.argmin())
        return self._parts[nearest] if away[nearest] < _FARTHEST_MM * self._size else ""


def fit_region_template(skin: FaceSkin, names: Sequence[str]) -> RegionTemplate | None:
    """Return the regions of an adult's face, fitted to a rig; None without eyes or mouth.

    `names`: of the rig's shapes.
    """
    found = find_landmarks(skin, names)
    shared = [name for name in _FITTED if name in found]
    if not {"lid_lower_L", "mouth_L"} <= set(shared):
        return None
    adult = _adult(shared)
    rig = np.stack([found[name] for name in shared]) - [skin.sagittal_x, 0.0, 0.0]
    breadth = float(adult[:, 0] @ rig[:, 0] / (adult[:, 0] @ adult[:, 0]))
    centred = adult[:, 1] - adult[:, 1].mean()
    height = float(centred @ rig[:, 1] / (centred @ centred))
    if min(breadth, height) <= 0:
        return None
    scale = np.array([breadth, height, (breadth + height) / 2])
    return RegionTemplate(skin, scale, np.mean(rig - adult * scale, axis=0) * [0.0, 1.0, 1.0])


def _adult(names: Sequence[str]) -> FloatArray:
    """Return positions of landmarks on an adult's face: (n, 3) [mm]."""
    return np.array([landmark_place(name) for name in names], dtype=np.float64)
