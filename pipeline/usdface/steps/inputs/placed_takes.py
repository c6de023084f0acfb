"""Takes' markers placed on a rig: computed, judged and drawn."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from usdface.core.arrays import BoolArray, ByteImage, FloatArray, median_places, sample_frames
from usdface.core.assets import Rig, range_ends
from usdface.core.deformer import Deformer
from usdface.core.errors import as_input_error
from usdface.core.text import counted, first_few
from usdface.media.face.render import Quality
from usdface.media.picture.binding_picture import BoundMarkers, draw_binding
from usdface.model.placement.marker_cloud import MarkerCloud, marker_cloud
from usdface.model.placement.place import place_markers
from usdface.model.placement.rig_orientation import facing_degrees
from usdface.model.placement.verdict import PlacementVerdict, judge_placement, warn_upside_down
from usdface.model.selection.baseline import PerformerMarkers
from usdface.model.surface.binding import bind_at
from usdface.numerics.registration.virtual_markers import marker_deltas, motion_by_rig
from usdface.numerics.rigid.rigid_template import RigidTemplate
from usdface.numerics.surface.surface_places import nearest_places, places_of_corners
from usdface.steps.inputs.cleaned_takes import CleanedTakes
from usdface.steps.inputs.placement import rows_by_name, virtual_markers
from usdface.usdio.rig.mesh import rig_surfaces
from usdface.usdio.surface.binding import has_binding
from usdface.usdio.surface.placement import GivenPlaces, RigPlacement, read_given_places

_SAMPLE_FRAMES = 2000
"""Frames of the takes that a placement uses, evenly spread."""

_RIG_SIZE_RANGE = (0.4, 2.5)
"""Usual size of a character's face over an adult's; a unit wrong by 2.54 is outside."""

_STILL_MM = 0.15
"""Root mean square motion of a coordinate of rigid markers, from which they are on skin: those of
head bands have 0.01 to 0.16 after cleaning, those of faces without skull markers 0.1 to 1.9."""

_LARGE_ERROR_MM, _STEADIER_SHARE = 1.2, 0.5
"""Expected error of the poses by the rigid markers from which others are chosen, if theirs is less
than this share of it. Three markers of a band and one on skin have 0.3 to 1.1 mm."""

_LEAST_GAIN = 0.005
"""Gain of the mean logarithm of the motion's density, per degree of freedom, for which they are."""

_ALIGNMENT_ROUNDS = 3
"""Placements at most, each after the takes are aligned by the last one."""


@dataclass(frozen=True)
class PlacedTakes:
    """A placement of takes' markers on a rig, and the verdict on it."""

    placement: RigPlacement
    verdict: PlacementVerdict
    rig_size: float
    """Size of the rig's face over an adult's."""


class PlacementScene:
    """Frames of a performer's markers and a rig, for placing and judging."""

    def __init__(self, performer: PerformerMarkers, rig: Rig) -> None:
        self._names, self._neutral, self._rig = performer.labels, performer.neutral, rig
        self._rigid = list(performer.rigid)
        self._deformer = deformer = Deformer(rig)
        self._sample, self._usable = performer.positions.astype(np.float64), performer.visible
        self._mesh = rig_surfaces(rig)[0].mesh
        with as_input_error(f"the markers cannot be placed on {rig.file}"):
            self._cloud = marker_cloud(
                self._names, self._neutral, self._sample, visible=self._usable, rigid=self._rigid
            )
            self._skin = deformer.face_skin()

    def place(self, *, out: Path | None, landmarks: Mapping[str, FloatArray]) -> PlacedTakes:
        """Place the markers, keeping landmarks [mm] and the corrections of a placement at `out`."""
        names, rig, mesh = self._names, self._rig, self._mesh
        given = GivenPlaces({}, {}, (), {})
        if out is not None and has_binding(out):
            given = read_given_places(out, rig)
        known = {**landmarks, **given.corrected}
        pins = {names.index(name): at for name, at in known.items() if name in names}
        with as_input_error(f"the markers cannot be placed on {rig.file}"):
            found = place_markers(
                self._cloud, self._skin, rig.shapes, ranges=rig.ranges_of_ends, pinned=pins
            )
            at = found.virtual
            counts, indices = mesh.face_counts, mesh.face_indices
            places = places_of_corners(counts, indices, at.points, at.weights)
            on_skin = {
                marker: nearest_places(mesh.points, counts, indices, place[None])
                for marker, place in pins.items()
            }
            binding = bind_at(
                mesh,
                places.replaced(on_skin),
                names,
                neutral=self._neutral,
                sample=self._sample,
                sources={
                    marker: "corrected" if names[marker] in given.corrected else "landmark"
                    for marker in pins
                },
            )
        placed = self.judge(
            RigPlacement(
                binding=binding,
                neutral=self._neutral,
                rotation=at.rotation,
                motion_scale=at.motion_scale,
                explained=float("nan"),
                by_labels=found.by_labels,
                left_out=given.left_out,
                authors=given.authors,
            )
        )
        return replace(placed, verdict=warn_upside_down(placed.verdict, found.overturned_gain))

    def find_steadier(self, placement: RigPlacement) -> tuple[tuple[str, ...], str]:
        """Return the markers that tell the head's pose best by the rig, and a note.

        Empty if the takes' rigid markers do not move, as those of a head band, and if the takes'
        motion is not more probable by the rig once they are aligned by the others.
        """
        names, rigid = self._names, np.array(self._rigid, np.int64)
        if _motion_mm(self._sample[:, rigid], self._usable[:, rigid]) < _STILL_MM:
            return (), ""
        virtual = virtual_markers(placement, names, self._cloud.neutral)
        deltas = marker_deltas(virtual, self._deformer.shapes.target_offsets())
        full = range_ends(self._rig.ranges)[:, None, None] * deltas
        expressions = motion_by_rig(virtual, full, self._cloud.neutral, rigid=())
        placed = np.array([name in rows_by_name(placement) for name in names])
        steady = expressions.steadiest_markers(placed)
        before, after = map(expressions.alignment_error_mm, (rigid, steady))
        if before < _LARGE_ERROR_MM or after > _STEADIER_SHARE * before:
            return (), ""
        usable = self._usable & placed
        template = RigidTemplate(steady, self._cloud.neutral[steady])
        aligned = template.align(self._sample.astype(np.float32), self._usable)
        now, then = (
            expressions.find_errors(each, usable).evidence for each in (self._sample, aligned)
        )
        if then - now < _LEAST_GAIN:
            return (), ""
        found = tuple(names[marker] for marker in steady)
        return found, (
            f"the rigid markers ({first_few([names[m] for m in rigid])}) are on skin: as the rig "
            "moves it, "
            f"they leave an error of {before:.1f} mm in the head's pose, at the markers, and "
            f"{first_few(found)} {after:.1f} mm. The takes are aligned by these; if there are "
            "markers on the skull, name them with `usdface clean --rigid`"
        )

    def judge(self, placement: RigPlacement) -> PlacedTakes:
        """Judge a placement of these markers on this rig."""
        row_of = rows_by_name(placement)
        rows = [row for row, name in enumerate(self._names) if name in row_of]
        names = tuple(self._names[row] for row in rows)
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
            replace(placement, explained=verdict.explained), verdict, self._skin.unit
        )


def place_takes(
    takes: CleanedTakes, rig: Rig, place: Callable[[PlacementScene], PlacedTakes]
) -> tuple[CleanedTakes, PlacedTakes, tuple[str, ...]]:
    """Place takes' markers, and again after they are aligned by markers that the rig moves less.

    Returns the takes, as aligned, their placement, and notes.
    """
    notes = dict[str, None]()
    for rounds_left in reversed(range(_ALIGNMENT_ROUNDS)):
        sample = takes.markers_at(sample_frames(len(takes.frames), _SAMPLE_FRAMES))
        scene = PlacementScene(PerformerMarkers.of_take(sample, takes.neutral), rig)
        placed = place(scene)
        steadier, note = scene.find_steadier(placed.placement) if rounds_left else ((), "")
        if not steadier:
            break
        takes, notes = takes.aligned_by(steadier), notes | {note: None}
    return takes, placed, tuple(notes)


def _motion_mm(positions: FloatArray, seen: BoolArray) -> float:
    """Return the root mean square motion of a coordinate of aligned markers [mm].

    Relative to the degrees of freedom that rigid alignment leaves.
    """
    away = np.where(seen[:, :, None], positions - median_places(positions, seen), 0.0)
    squared = (away**2).sum() / max(3 * seen.sum(), 1)
    markers = positions.shape[1]
    return float(np.sqrt(squared * markers / max(markers - 2, 1)))


def draw_placement(
    placed: PlacedTakes, rig: Rig, *, title: str, quality: Quality = "final"
) -> ByteImage:
    """Draw the markers on the rig with the verdict."""
    placement, verdict = placed.placement, placed.verdict
    row_of = rows_by_name(placement)
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
