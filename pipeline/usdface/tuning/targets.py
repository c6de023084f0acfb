"""Target positions of markers on the rig, for the live residual."""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import BoolArray, Float32Array, FloatArray, IntArray
from usdface.core.assets import References, Rig
from usdface.core.deformer import Deformer
from usdface.core.errors import InputError
from usdface.core.sidecars import corrected_path, proposed_path
from usdface.model.mapping.motion_space import motion_of_pairs, sampled_frames
from usdface.model.placement.shape_parts import shape_parts
from usdface.model.selection.baseline import BlendshapeEquation, PerformerMarkers
from usdface.numerics.measure.face_regions import shapes_by_region
from usdface.numerics.surface.surface_places import nearest_places
from usdface.runner.outputs import confine
from usdface.steps.inputs.marker_lines import lines_on_rig
from usdface.steps.inputs.placement import placed_equation, stored_placement
from usdface.tuning.session import TuningSession
from usdface.usdio.rig.mesh import rig_surfaces
from usdface.usdio.surface.binding import correct_binding
from usdface.usdio.surface.placement import RigPlacement, read_placement

_CARRIED_SHARE = 0.85
"""Factor on the jaw's motion, which also carries other parts, mainly the lower lip."""


@dataclass(frozen=True)
class MarkerTargets:
    """Markers attached to the rig, and captured positions in its space."""

    names: tuple[str, ...]
    rest: Float32Array
    """(markers, 3): on the rig at rest [mm]."""
    key_deltas: Float32Array
    """(keys, markers, 3): displacement by each key of ``Deformer(rig).shapes`` [mm]."""
    targets: Float32Array
    """(pairs, markers, 3): captured positions, in the character's proportions [mm]."""
    regions: tuple[str, ...]
    """Part of the face of each marker; empty for those that move with the skull only."""
    corrected: tuple[bool, ...]
    """Whether a person placed the marker."""
    lines: IntArray
    """(lines, 2): markers joined by lines."""
    equation: BlendshapeEquation
    """Solver for the weights of shapes."""


def find_targets(references: References, rig: Rig) -> MarkerTargets:
    """Attach the references' markers to the rig by their placement, or else place them.

    The takes are not needed: the asset has a sample of their motion.
    """
    # Blinks are judged by a sample of the takes, take by take, as by `select`.
    motion_space = references.motion or motion_of_pairs(references)
    positions = sampled_frames(motion_space)
    rigid = [references.marker_names.index(name) for name in references.rigid]
    placement, deformer = stored_placement(references, rig), Deformer(rig)
    equation = placed_equation(
        placement,
        rig,
        deformer,
        PerformerMarkers(
            neutral=references.neutral,
            positions=positions,
            visible=np.ones(positions.shape[:2], dtype=np.bool_),
            rigid=tuple(rigid),
            labels=references.marker_names,
            starts=motion_space.sample_starts,
        ),
    )
    rest = equation.virtual.places(deformer.neutral)
    motion = equation.motion(references.markers)
    return MarkerTargets(
        names=references.marker_names,
        rest=rest.astype(np.float32),
        key_deltas=np.asarray(equation.keys.deltas, np.float32),
        targets=(rest + motion).astype(np.float32),
        regions=_regions(equation, shape_parts(rig, deformer), rigid),
        corrected=_corrected(placement, references.marker_names),
        lines=lines_on_rig(references.marker_names, equation, deformer, rig.shapes),
        equation=equation,
    )


def solve_shapes(
    references: References, targets: MarkerTargets, pair: int, weights: FloatArray, free: BoolArray
) -> FloatArray:
    """Return the weights of a pair, solved for the `free` shapes by its markers: (shapes,).

    `weights`: (shapes,), of the rig's shapes; those that are not free are held.
    """
    ranges = np.where(free[:, None], targets.equation.ranges, weights[:, None])
    solved = targets.equation.propose(references.markers[pair : pair + 1], ranges=ranges)[0]
    return np.where(free, solved, weights)


def _corrected(placement: RigPlacement | None, names: tuple[str, ...]) -> tuple[bool, ...]:
    if placement is None:
        return (False,) * len(names)
    binding = placement.binding
    sources = dict(zip(binding.names, binding.sources, strict=True))
    return tuple(sources.get(name, "proposed") != "proposed" for name in names)


def _regions(
    equation: BlendshapeEquation, parts: tuple[str, ...], rigid: list[int]
) -> tuple[str, ...]:
    """Return for each marker the part of the face whose shapes have the largest relative motion."""
    moved = np.linalg.norm(equation.deltas, axis=2)
    share = moved / np.maximum(moved.max(axis=1, keepdims=True), 1e-9)
    by_region = shapes_by_region(parts)
    if not by_region:
        return tuple("" if marker in rigid else "face" for marker in range(moved.shape[1]))
    names = list(by_region)
    claims = np.array([share[columns].max(axis=0) for columns in by_region.values()])
    if "jaw" in names:
        claims[names.index("jaw")] *= _CARRIED_SHARE
    owner = claims.argmax(axis=0)
    return tuple("" if m in rigid else names[owner[m]] for m in range(moved.shape[1]))


def targets_or_reason(references: References, rig: Rig) -> MarkerTargets | str:
    """Return the targets, or the reason why there are none; tuning then has no residual."""
    if not references.marker_names:
        return "the references hold no markers"
    try:
        return find_targets(references, rig)
    except InputError as error:
        return str(error)


def correct_place(
    session: TuningSession, rig: Rig, marker: str, at: tuple[float, float, float] | None
) -> None:
    """Write the position of a marker to the corrected layer of the references' placement.

    `at`: on the rig at rest [mm]; None removes a correction.
    """
    placement = session.references.placement
    if placement is None:
        raise InputError(
            f"{session.path.name}: has no placement to correct; select again, which writes one"
        )
    session.lock.check()
    confine("tune", reads=[placement], writes=[corrected_path(placement)])
    read_placement(placement, rig)  # raises if it is damaged or of another rig
    surface = rig_surfaces(rig)[0]
    place = None
    if at is not None:
        mesh, wanted = surface.mesh, np.array([at])
        on_it = nearest_places(mesh.points, mesh.face_counts, mesh.face_indices, wanted)
        place = on_it.positions(mesh.points)[0]
        away = float(np.linalg.norm(place - wanted[0]))
        if away > surface.reach_mm:
            raise InputError(f"{marker}: {away:.0f} mm off the rig; drop it on the face")
    made = session.provenance(proposed_path(placement))
    correct_binding(placement, {marker: place}, made, author=session.author)
