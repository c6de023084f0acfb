"""Stored placements of a performer's markers on a rig, and the equation of placed markers."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from usdface.core.arrays import FloatArray, rms_radius
from usdface.core.assets import References, Rig
from usdface.core.deformer import Deformer
from usdface.core.errors import InputError
from usdface.core.text import first_few
from usdface.model.regressions.base import RestPlaces
from usdface.model.selection.baseline import (
    BlendshapeEquation,
    PerformerMarkers,
    equation_at,
    set_up_equation,
)
from usdface.numerics.registration.marker_binding import FEWEST_MARKERS
from usdface.numerics.registration.virtual_markers import VirtualMarkers
from usdface.numerics.rigid.rigid_alignment import align_rigid_robust
from usdface.runner.origin import path_made_from
from usdface.steps.inputs.cleaned_takes import (
    check_neutral_frame,
    check_stabilized,
    read_markers_at,
)
from usdface.usdio.references.read import read_references
from usdface.usdio.rig.mesh import rig_surfaces
from usdface.usdio.surface.placement import RigPlacement, read_placement
from usdface.usdio.take.read import TakeReader

_LEAST_COMMON_SHARE = 0.8
"""Share of the markers that a placement must hold, or it is one of another marker set."""

_SAME_FACE_SHARE = 0.1
"""Largest difference of neutral faces of one performer, as a share of the face's size: they differ
by 1 to 2 mm of 55, other faces by more."""


def rows_by_name(placement: RigPlacement) -> dict[str, int]:
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
    row_of = rows_by_name(placement)
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
    row_of = rows_by_name(placement)
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
        places.corners[rows], places.weights[rows], placement.motion_scale, rotation
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
    unplaced = [m for m, name in enumerate(labels) if name not in rows_by_name(placement)]
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
    binding, row_of = placement.binding, rows_by_name(placement)
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
