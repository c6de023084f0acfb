"""Placement of a performer's markers on a rig: computed, judged, drawn, and read back."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from usdface.core.arrays import ByteImage, FloatArray, rms_radius, sample_frames
from usdface.core.assets import References, Rig
from usdface.core.deformer import Deformer
from usdface.core.errors import InputError, as_input_error
from usdface.core.text import counted, first_few
from usdface.media.face.render import Quality
from usdface.media.picture.binding_picture import BoundMarkers, draw_binding
from usdface.model.placement.marker_cloud import MarkerCloud, marker_cloud
from usdface.model.placement.place import place_markers
from usdface.model.placement.rig_orientation import facing_degrees
from usdface.model.placement.verdict import PlacementVerdict, judge_placement, warn_upside_down
from usdface.model.regressions.base import RestPlaces
from usdface.model.selection.baseline import (
    BlendshapeEquation,
    PerformerMarkers,
    equation_at,
    set_up_equation,
)
from usdface.model.surface.binding import bind_at
from usdface.numerics.registration.marker_binding import FEWEST_MARKERS
from usdface.numerics.registration.virtual_markers import VirtualMarkers
from usdface.numerics.rigid.rigid_alignment import align_rigid_robust
from usdface.numerics.surface.surface_places import places_of_corners
from usdface.runner.origin import path_made_from
from usdface.steps.inputs.cleaned_takes import (
    CleanedTakes,
    check_neutral_frame,
    check_stabilized,
    read_markers_at,
)
from usdface.usdio.references.read import read_references
from usdface.usdio.rig.mesh import rig_surfaces
from usdface.usdio.surface.binding import has_binding
from usdface.usdio.surface.placement import (
    GivenPlaces,
    RigPlacement,
    read_given_places,
    read_placement,
)
from usdface.usdio.take.read import TakeReader

_SAMPLE_FRAMES = 2000
"""Frames of the takes that a placement uses, evenly spread."""

_LEAST_COMMON_SHARE = 0.8
"""Share of the markers that a placement must hold, or it is one of another marker set."""

_RIG_SIZE_RANGE = (0.4, 2.5)
"""Usual size of a character's face over an adult's; a unit wrong by 2.54 is outside."""

_SAME_FACE_SHARE = 0.1
"""Largest difference of neutral faces of one performer, as a share of the face's size: they differ
by 1 to 2 mm of 55, other faces by more."""


@dataclass(frozen=True)
class PlacedTakes:
    """A placement of takes' markers on a rig, and the verdict on it."""

    placement: RigPlacement
    verdict: PlacementVerdict
    rig_size: float
    """Size of the rig's face over an adult's."""


class PlacementScene:
    """Takes and a rig, for placing and judging."""

    def __init__(self, takes: CleanedTakes, rig: Rig) -> None:
        self._takes, self._rig = takes, rig
        deformer = Deformer(rig)
        rows = sample_frames(len(takes.frames), _SAMPLE_FRAMES)
        self._sample = takes.positions_at(rows).astype(np.float64)
        self._mesh = rig_surfaces(rig)[0].mesh
        with as_input_error(f"the markers cannot be placed on {rig.file}"):
            self._cloud = marker_cloud(
                takes.marker_names,
                takes.neutral,
                self._sample,
                visible=takes.usable_at(rows),
                rigid=[takes.marker_names.index(name) for name in takes.rigid],
            )
            self._skin = deformer.face_skin()

    def place(self, *, out: Path, landmarks: Mapping[str, FloatArray]) -> PlacedTakes:
        """Place the markers, keeping landmarks [mm] and the corrections of a placement at `out`."""
        takes, rig, mesh = self._takes, self._rig, self._mesh
        given = read_given_places(out, rig) if has_binding(out) else GivenPlaces({}, {}, (), {})
        names = takes.marker_names
        known = {**landmarks, **given.corrected}
        pins = {names.index(name): at for name, at in known.items() if name in names}
        with as_input_error(f"the markers cannot be placed on {rig.file}"):
            found = place_markers(
                self._cloud, self._skin, rig.shapes, ranges=rig.ranges_of_ends, pinned=pins
            )
            at = found.virtual
            binding = bind_at(
                mesh,
                places_of_corners(mesh.face_counts, mesh.face_indices, at.points, at.weights),
                names,
                neutral=takes.neutral,
                sample=self._sample,
                pins=pins,
                sources={
                    marker: "corrected" if names[marker] in given.corrected else "landmark"
                    for marker in pins
                },
            )
        placed = self.judge(
            RigPlacement(
                binding=binding,
                neutral=takes.neutral,
                rotation=at.rotation,
                motion_scale=at.motion_scale,
                explained=float("nan"),
                by_labels=found.by_labels,
                left_out=given.left_out,
                authors=given.authors,
            )
        )
        return replace(placed, verdict=warn_upside_down(placed.verdict, found.overturned_gain))

    def judge(self, placement: RigPlacement) -> PlacedTakes:
        """Judge a placement of these markers on this rig."""
        row_of = _rows_by_name(placement)
        rows = [row for row, name in enumerate(self._takes.marker_names) if name in row_of]
        names = tuple(self._takes.marker_names[row] for row in rows)
        cloud = self._cloud
        virtual = virtual_markers(placement, names, cloud.neutral[rows])
        sources = [placement.binding.sources[row_of[name]] for name in names]
        verdict = judge_placement(
            MarkerCloud(names, cloud.neutral[rows], cloud.motion[:, rows], cloud.still[rows]),
            self._skin,
            self._rig.shapes,
            virtual,
            at=virtual.places(self._mesh.points),
            ranges=self._rig.ranges_of_ends,
            by_labels=placement.by_labels,
            placed=[row for row, source in enumerate(sources) if source != "proposed"],
        )
        return PlacedTakes(
            replace(placement, explained=verdict.explained),
            verdict,
            self._skin.unit,
        )


def _rows_by_name(placement: RigPlacement) -> dict[str, int]:
    """Return the row of every marker that the placement does not leave out."""
    return {
        name: row
        for row, name in enumerate(placement.binding.names)
        if name not in placement.left_out
    }


def read_placement_of(
    path: Path, rig: Rig, names: tuple[str, ...], neutral: FloatArray
) -> RigPlacement:
    """Read a placement; refuse one of another marker set or face."""
    placement = read_placement(path, rig)
    missing = _missing(placement, names)
    if missing:
        raise InputError(
            f"{path}: places {len(names) - len(missing)} of the takes' {len(names)} markers, "
            f"without {first_few(missing)}; run `usdface place` with these takes"
        )
    if not is_placement_of(placement, names, neutral):
        raise InputError(
            f"{path}: places the markers of another face; run `usdface place` with these takes"
        )
    return placement


def _missing(placement: RigPlacement, names: tuple[str, ...]) -> list[str]:
    known = {*placement.binding.names, *placement.left_out}
    return [name for name in names if name not in known]


def is_placement_of(placement: RigPlacement, names: tuple[str, ...], neutral: FloatArray) -> bool:
    """Whether a placement is of these markers and this performer's face."""
    row_of = _rows_by_name(placement)
    bound = [marker for marker, name in enumerate(names) if name in row_of]
    if len(_missing(placement, names)) > (1 - _LEAST_COMMON_SHARE) * len(names):
        return False
    if len(bound) < FEWEST_MARKERS:
        return False
    placed = placement.neutral[[row_of[names[marker]] for marker in bound]]
    everywhere = np.ones((1, len(bound)), np.bool_)
    turned = align_rigid_robust(neutral[None, bound], placed, visible=everywhere)
    away = neutral[bound] - placed @ turned.rotations[0].T - turned.translations[0]
    size = rms_radius(placed)
    return bool(np.sqrt((away**2).sum(axis=1).mean()) <= _SAME_FACE_SHARE * size)


def virtual_markers(
    placement: RigPlacement, names: tuple[str, ...], neutral: FloatArray
) -> VirtualMarkers:
    """Return the virtual markers of a placement, in the order and head space of a take.

    `neutral`: the performer's neutral face in that space, (markers, 3) [mm]. Markers that the
    placement leaves out get the place of the first; see `placed_equation`.
    """
    row_of = _rows_by_name(placement)
    rows = [row_of.get(name, 0) for name in names]
    bound = [marker for marker, name in enumerate(names) if name in row_of]
    current, placed = neutral[bound], placement.neutral[[row_of[names[m]] for m in bound]]
    rotation = placement.rotation
    if not np.array_equal(current, placed):  # another head space than the one it was placed in
        everywhere = np.ones((1, len(bound)), np.bool_)
        turned = align_rigid_robust(placed[None], current, visible=everywhere)
        rotation = rotation @ turned.rotations[0]
    places = placement.binding.places
    return VirtualMarkers(
        places.corners[rows],
        places.weights[rows],
        placement.motion_scale,
        rotation,
    )


def read_performer_markers(take: TakeReader, frames: Sequence[int]) -> PerformerMarkers:
    """Read the neutral face and some frames, in ascending order, of a cleaned take."""
    markers = read_markers_at(take, frames)
    check_stabilized(take.path, markers)
    check_neutral_frame(take.path, markers.neutral_frame, take)
    neutral = read_markers_at(take, [markers.neutral_frame]).positions[0]
    return PerformerMarkers.of_take(markers, neutral)


def placed_equation(
    placement: RigPlacement | None, rig: Rig, deformer: Deformer, performer: PerformerMarkers
) -> BlendshapeEquation:
    """Return the blendshape equation of placed markers; place them first if there is no placement.

    Markers that the placement leaves out are treated as rigid.
    """
    labels, neutral = performer.labels, performer.neutral
    if placement is None or not is_placement_of(placement, labels, neutral):
        return set_up_equation(rig, deformer, performer)
    unplaced = [m for m, name in enumerate(labels) if name not in _rows_by_name(placement)]
    used = replace(performer, rigid=tuple(sorted({*performer.rigid, *unplaced})))
    made = equation_at(rig, deformer, virtual_markers(placement, labels, neutral), used)
    return replace(made, unplaced=tuple(unplaced))


def stored_placement(references: References, rig: Rig) -> RigPlacement | None:
    """Return the placement that references were selected with; None if there is none."""
    if references.placement is None:
        return None
    return read_placement(references.placement, rig)


def rest_places(references: References, rig: Rig, points: FloatArray) -> RestPlaces:
    """Return places on the rig's neutral, with the references' markers as they were placed.

    `points`: of the skin, (points, 3) [mm]. Markers are those placed by labels or by a person, NaN
    for others; without a placement of these markers, there are neither markers nor a motion scale.
    """
    placement = stored_placement(references, rig)
    if placement is None or not is_placement_of(
        placement, references.marker_names, references.neutral
    ):
        return RestPlaces(points)
    binding, row_of = placement.binding, _rows_by_name(placement)
    at = binding.places.positions(rig_surfaces(rig)[0].mesh.points)
    places = np.full((len(references.marker_names), 3), np.nan)
    for marker, name in enumerate(references.marker_names):
        row = row_of.get(name)
        if row is not None and (placement.by_labels or binding.sources[row] != "proposed"):
            places[marker] = at[row]
    return RestPlaces(points, places, placement.motion_scale)


def placement_of_performance(performance: Path, rig: Rig) -> RigPlacement | None:
    """Return the placement of the references that a performance was mapped from, if it exists.

    It is found by provenance: performance, mapping, references; for a baseline, its placement. None
    if a file is missing or was made for another rig.
    """
    mapping = path_made_from(performance, "mapping")
    references = None if mapping is None else path_made_from(mapping, "references")
    given = path_made_from(performance, "placement")
    try:
        if given is not None:
            return read_placement(given, rig)
        return None if references is None else stored_placement(read_references(references), rig)
    except InputError:
        return None


def draw_placement(
    placed: PlacedTakes, rig: Rig, *, title: str, quality: Quality = "final"
) -> ByteImage:
    """Draw the markers on the rig with the verdict."""
    placement, verdict = placed.placement, placed.verdict
    row_of = _rows_by_name(placement)
    names, rows = tuple(row_of), list(row_of.values())
    binding = placement.binding
    yaw = facing_degrees(rig)
    turned = (f"the rig faces {yaw:.0f} degrees from Z, about Y",) if yaw else ()
    return draw_binding(
        rig.meshes,
        BoundMarkers(
            names,
            binding.places.positions(rig_surfaces(rig)[0].mesh.points)[rows],
            tuple(verdict.warnings.get(name, "") for name in names),
            np.array([binding.sources[row] != "proposed" for row in rows]),
            {names.index(name): at for name, at in verdict.wanted.items()},
        ),
        title=title,
        verdict=(verdict.level, verdict.sentence),
        facts=(*verdict.facts, *turned),
        yaw_degrees=yaw,
        quality=quality,
    )


def placement_notes(placed: PlacedTakes) -> tuple[str, ...]:
    """Return notes on markers left out, on authors of corrections, and on a rig's unusual size."""
    left_out, authors = placed.placement.left_out, placed.placement.authors
    notes = [f"left out by the placement: {counted(left_out, 'marker')}"] if left_out else []
    for author in sorted(set(authors.values())):
        markers = [name for name, by in authors.items() if by == author]
        notes.append(f"corrected by {author}: {counted(markers, 'marker')}")
    low, high = _RIG_SIZE_RANGE
    if not low <= placed.rig_size <= high:
        notes.append(
            f"the rig's face is {placed.rig_size:.2g} times the size of an adult's; if that is not "
            "meant, correct metersPerUnit in its file: all figures in mm are of this size"
        )
    return tuple(notes)


def placement_figures(placed: PlacedTakes) -> dict[str, object]:
    """Return the verdict as plain data."""
    verdict, sources = placed.verdict, placed.placement.binding.sources
    return {
        "verdict": verdict.level,
        "explained": None if np.isnan(verdict.explained) else round(verdict.explained, 4),
        "tilt_degrees": None if np.isnan(verdict.roll_degrees) else round(verdict.roll_degrees, 2),
        "by_labels": placed.placement.by_labels,
        "placed_by_a_person": sum(source != "proposed" for source in sources),
        "corrected_by": dict(placed.placement.authors),
        "far": dict(verdict.warnings),
    }
