"""Place a performer's markers on a rig: by labels and landmarks, else by motion."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks._placement.face_skin import FaceSkin
from benchmarks._placement.motion_search import search_by_motion
from benchmarks._placement.rig_landmarks import find_landmarks
from benchmarks._placement.sagittal_plane import (
    SagittalPlane,
    plane_by_reflection,
    plane_of_pairs,
)
from benchmarks._placement.skin_placement import (
    TYPICAL_SIZE_MM,
    PlaneFit,
    SkinPlacement,
    explained_share,
    fit_in_plane,
    in_character,
    place_on_skin,
)
from usdface.core.arrays import BoolArray, FloatArray, IntArray, RealArray
from usdface.model.placement.label_hints import label_hint, mirrored_label, side_of_label
from usdface.numerics.registration.cloud_alignment import align_cloud, align_landmarks
from usdface.numerics.registration.marker_binding import FEWEST_MARKERS
from usdface.numerics.registration.motion_correspondence import place_by_motion
from usdface.numerics.registration.registration import VirtualMarkers
from usdface.numerics.regression.reference_design import design_k_centre

FEWEST_HINTS = 6
"""Labelled markers with a landmark on the rig, from which a placement by labels starts."""

FEWEST_PINS = 3
"""Points from which an alignment follows."""

_PIN_SPREAD_MM = 0.5
_WARPED_SPREAD_MM = 6.0
"""Standard deviation of a warped marker about its landmark-free fit: what proportions leave."""

_PICKED_FRAMES = 150
_POOL_FRAMES = 3000

MOTION_SHRINKAGE = 0.95
"""Times sqrt(sx sy), by which motion is scaled: places are estimated with errors, which lengthen
distances between them but not motion. Measured on three simulated performers, where .85 to .96 is
best."""

_MIDDLE_REGIONS = ("forehead", "brow", "bridge", "nose", "mouth", "chin")

_WARP_COST = 0.3
"""Explained share that a mean warp of the face's size costs, between candidates of the search."""

_LEAST_GAIN = 0.03
"""Value by which the search in the plane must be better than closest points to be believed."""

_SIZE_COST = 0.3
"""Explained share that e times too large or too small a cloud costs: captures cover the face."""


@dataclass(frozen=True)
class MarkerCloud:
    """What is known of a performer's markers before they are placed.

    Attributes
    ----------
    neutral : (markers, 3) float array
        At rest, Y roughly up, looking anywhere [mm].
    motion : (frames, markers, 3) float array or None
        Displacements from `neutral`, of frames that differ [mm].
    still : (markers,) bool array
        Markers whose motion says nothing about their place: of the skull, or without any.
    """

    labels: tuple[str, ...]
    neutral: FloatArray
    motion: FloatArray | None
    still: BoolArray


@dataclass(frozen=True)
class MarkerPlacement:
    """Markers on a rig's skin.

    Attributes
    ----------
    samples : (markers,) int array
        Of the skin.
    virtual : VirtualMarkers
        The same as points of the rig, with the map from the performer's motion to the rig's.
    explained : float
        Share of the markers' motion that the shapes explain there [0-1]; NaN without motion.
    landmark_mm : dict of str to (str, float)
        For markers whose label names a landmark of the rig: which, and how far it is [mm].
    by_labels : bool
        Whether labels and landmarks placed the cloud, or motion alone.
    """

    samples: IntArray
    virtual: VirtualMarkers
    explained: float
    landmark_mm: dict[str, tuple[str, float]]
    by_labels: bool


def marker_cloud(
    labels: tuple[str, ...],
    neutral: FloatArray,
    positions: RealArray | None,
    *,
    visible: BoolArray | None = None,
    rigid: Sequence[int] = (),
) -> MarkerCloud:
    """Gather what a placement needs of a stabilised take.

    Parameters
    ----------
    neutral : (markers, 3) float array
        [mm]
    positions : (frames, markers, 3) float array, optional
        Stabilised, in the space of `neutral` [mm]; frames that differ are picked.
    visible : (frames, markers) bool array, optional
        Frames that miss markers are avoided.
    rigid : sequence of int
        Markers that move with the skull alone.

    Raises
    ------
    ValueError
        If the arrays do not fit together, or are not finite.
    """
    y = np.asarray(neutral, float)
    if y.ndim != 2 or y.shape[1] != 3 or not np.isfinite(y).all():
        raise ValueError(f"neutral must be (markers, 3) and finite, got {y.shape}")
    if len(y) < FEWEST_MARKERS:
        raise ValueError(f"registration needs at least {FEWEST_MARKERS} markers, got {len(y)}")
    still = np.zeros(len(y), np.bool_)
    still[list(rigid)] = True
    motion = None if positions is None else _pick_frames(y, positions, visible, still)
    return MarkerCloud(labels, y, motion, still)


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
    known = _named_places(cloud.labels, find_landmarks(skin, shapes), unit)
    named = len(known) >= FEWEST_HINTS
    pins = {m: np.asarray(at, float) @ skin.frame.T for m, at in (pinned or {}).items()}
    scene = _Scene(
        cloud, skin, limits, known | {m: (at, _PIN_SPREAD_MM * unit) for m, at in pins.items()}
    )
    if len(pins) >= FEWEST_PINS:
        start = _by_pins(scene, pins)
    elif named:
        start = _by_labels(scene)
    else:
        start = _by_motion(scene)
    placement = start.placement
    samples = placement.samples.copy()
    for marker, at in pins.items():
        samples[marker] = ((skin.positions - at) ** 2).sum(axis=1).argmin()
    rotation = placement.fit.rotation @ start.frame
    explained = float("nan")
    if cloud.motion is not None:
        moved = in_character(cloud.motion @ start.frame.T, placement.fit)
        explained = explained_share(skin, samples, moved, limits)
    aligned = placement.fit.apply(start.levelled)
    return MarkerPlacement(
        samples,
        VirtualMarkers(
            skin.corners[samples],
            skin.shares[samples],
            np.full(3, _motion_scale(cloud.neutral @ rotation.T, skin, samples)),
            skin.frame.T @ rotation,
            np.zeros(3),
            np.linalg.norm(aligned - skin.positions[samples], axis=1),
            placement.agreement,
        ),
        explained,
        {
            cloud.labels[marker]: (
                " and ".join(label_hint(cloud.labels[marker]).landmarks),
                float(np.linalg.norm(skin.positions[samples[marker]] - place)),
            )
            for marker, (place, _) in known.items()
        },
        named,
    )


@dataclass(frozen=True)
class _Scene:
    """A cloud, a skin, and the places that labels or people gave, with their spreads [mm]."""

    cloud: MarkerCloud
    skin: FaceSkin
    ranges: FloatArray
    landmarks: dict[int, tuple[FloatArray, float]]


@dataclass(frozen=True)
class _Start:
    """A placement, and the rotation and cloud that it was found in."""

    frame: FloatArray
    levelled: FloatArray
    placement: SkinPlacement


def _pick_frames(
    neutral: FloatArray, positions: RealArray, visible: BoolArray | None, still: BoolArray
) -> FloatArray:
    """Return the displacements of frames that differ most from each other."""
    if positions.ndim != 3 or positions.shape[1:] != neutral.shape or not len(positions):
        raise ValueError(
            f"motion must be (frames, {len(neutral)}, 3) like the neutral, got {positions.shape}"
        )
    rows = np.arange(len(positions))
    if visible is not None:
        seen = np.asarray(visible, bool).mean(axis=1)
        rows = np.flatnonzero(seen >= min(0.999, float(np.quantile(seen, 0.5))))
    moved = positions[rows[:: max(1, len(rows) // _POOL_FRAMES)]] - neutral
    if not np.isfinite(moved).all():
        raise ValueError("motion must be finite; fill gaps first")
    moved[:, still] = 0
    flat = moved.reshape(len(moved), -1)
    count = min(_PICKED_FRAMES, len(flat))
    return np.asarray(moved[design_k_centre(flat, count).chosen], float)


def _named_places(
    labels: tuple[str, ...], landmarks: dict[str, FloatArray], unit: float
) -> dict[int, tuple[FloatArray, float]]:
    """Return place and spread of every marker whose label names landmarks that are known."""
    places = {}
    for marker, label in enumerate(labels):
        hint = label_hint(label)
        if hint.landmarks and all(name in landmarks for name in hint.landmarks):
            mean = np.mean([landmarks[name] for name in hint.landmarks], axis=0)
            places[marker] = (mean, hint.spread_mm * unit)
    return places


def _levelled(scene: _Scene) -> tuple[FloatArray, FloatArray]:
    """Return the rotation that levels the cloud, and the cloud with its plane at x = 0."""
    plane = _plane(scene.cloud.neutral, scene.cloud.labels)
    frame = plane.levelled_frame()
    return frame, scene.cloud.neutral @ frame.T - [plane.offset, 0.0, 0.0]


def _plane(neutral: FloatArray, labels: tuple[str, ...]) -> SagittalPlane:
    row_of = {label: row for row, label in enumerate(labels)}
    pairs = []
    for label, row in row_of.items():
        if side_of_label(label) == "L":
            partner = next((each for each in mirrored_label(label) if each in row_of), None)
            if partner is not None:
                pairs.append((row, row_of[partner]))
    if len(pairs) >= 3:
        return plane_of_pairs(neutral, np.array(pairs), np.array(_middle(labels), np.int64))
    return plane_by_reflection(neutral)


def _middle(labels: tuple[str, ...]) -> list[int]:
    """Return the markers of parts of the face that lie in the middle, whose labels name no side."""
    return [
        row
        for row, label in enumerate(labels)
        if not side_of_label(label) and label_hint(label).region in _MIDDLE_REGIONS
    ]


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
        middle=_middle(cloud.labels),
    )
    return _Start(frame, levelled, placement)


def _by_pins(scene: _Scene, pins: dict[int, FloatArray]) -> _Start:
    """Start from the similarity of the places that a person gave."""
    rows = list(pins)
    found = align_landmarks(scene.cloud.neutral[rows], np.array(list(pins.values())))
    fit = PlaneFit(found.rotation, found.scale, found.translation)
    return _settle(scene, np.eye(3), scene.cloud.neutral, fit)


def _by_labels(scene: _Scene) -> _Start:
    """Start from the landmarks that labels name."""
    frame, levelled = _levelled(scene)
    rows = list(scene.landmarks)
    centre = np.array([scene.skin.sagittal_x, 0.0, 0.0])
    targets = np.array([place for place, _ in scene.landmarks.values()])
    spreads = np.array([spread for _, spread in scene.landmarks.values()])
    start = fit_in_plane(levelled[rows], targets - centre, spreads)
    fit = PlaneFit(start.rotation, start.scale, start.shift + centre)
    return _settle(scene, frame, levelled, fit)


def _by_motion(scene: _Scene) -> _Start:
    """Search for where motion agrees; of the best starts, take what it explains best at last.

    The search has one scale; proportions are fitted to what it finds, and the cloud placed again.
    """
    motion = scene.cloud.motion
    starts = _by_shape(scene)
    if motion is None or not motion.any():
        if not starts:
            raise ValueError("neither labels, motion nor shape say where the markers belong")
        return starts[0]
    try:
        frame, levelled = _levelled(scene)
    except ValueError:  # no symmetry: what closest points find is all there is
        if not starts:
            raise
        return starts[0]
    centre = np.array([scene.skin.sagittal_x, 0.0, 0.0])
    spreads = np.full(len(levelled), _WARPED_SPREAD_MM)
    for _, yaw, fit in search_by_motion(
        levelled, scene.skin, motion @ frame.T, ranges=scene.ranges
    ):
        turn = np.array([yaw, 1.0, yaw])
        first = _settle(scene, turn[:, None] * frame, levelled * turn, fit)
        refit = fit_in_plane(first.levelled, first.placement.warped - centre, spreads)
        again = PlaneFit(refit.rotation, refit.scale, refit.shift + centre)
        starts.append(_settle(scene, first.frame, first.levelled, again))
    if not starts:
        raise ValueError("no place on the rig explains the markers' motion; give landmarks")
    values = [_value(scene, start, motion) for start in starts]
    best = int(np.argmax(values))
    return starts[best] if values[best] > values[0] + _LEAST_GAIN else starts[0]


def _value(scene: _Scene, start: _Start, motion: FloatArray) -> float:
    """Return the explained share, less what warp and an unlikely size of the face cost."""
    placement, skin = start.placement, scene.skin
    moved = in_character(motion @ start.frame.T, placement.fit)
    share = explained_share(skin, placement.samples, moved, scene.ranges)
    placed = placement.fit.apply(start.levelled)
    bent = float(np.linalg.norm(placement.warped - placed, axis=1).mean()) / skin.size_mm
    width = float(np.sqrt(placed.var(axis=0)[:2].sum()))
    weight = skin.activity() / skin.activity().sum()
    spread = skin.positions - weight @ skin.positions
    usual = float(np.sqrt((weight @ spread**2)[:2].sum()))
    return share - _WARP_COST * bent - _SIZE_COST * abs(float(np.log(width / usual)))


def _by_shape(scene: _Scene) -> list[_Start]:
    """Place by closest points, with how far each marker moves as a fourth coordinate.

    Needs neither symmetry nor motion, and is nearest where many markers cover the whole face; with
    few it slides, up to a face in the wrong place and of the wrong size.
    """
    cloud, skin = scene.cloud, scene.skin
    moved = None if cloud.motion is None else np.sqrt((cloud.motion**2).sum(axis=2)).mean(axis=0)
    try:
        found = align_cloud(
            cloud.neutral,
            skin.positions,
            activity=skin.activity(),
            areas=skin.areas,
            amplitude=moved,
        )
    except ValueError:  # nothing ends upright
        return []
    placed = place_by_motion(
        cloud.neutral,
        skin.positions,
        found,
        skin_deltas=None if cloud.motion is None else skin.deltas,
        motion=cloud.motion,
        ranges=scene.ranges,
        pinned={row: place for row, (place, spread) in scene.landmarks.items() if spread < 1.0},
    )
    alignment = placed.alignment
    fit = PlaneFit(alignment.rotation, alignment.scale, alignment.translation)
    placement = SkinPlacement(placed.chosen, placed.warped, placed.agreement, fit)
    return [_Start(np.eye(3), cloud.neutral, placement)]


def _motion_scale(turned: FloatArray, skin: FaceSkin, samples: IntArray) -> float:
    """Return MOTION_SHRINKAGE sqrt(sx sy), the axes' scales by least squares on the places."""
    own = turned - turned.mean(axis=0)
    places = skin.positions[samples]
    places = places - places.mean(axis=0)
    scale = (own * places).sum(axis=0) / (own**2).sum(axis=0)
    return float(MOTION_SHRINKAGE * np.sqrt(max(scale[0] * scale[1], 1e-12)))
