"""Bind the markers of a take to points of a mesh."""

from dataclasses import replace

import numpy as np

from usdface.core.arrays import FloatArray, rms_radius
from usdface.core.progress import Progress
from usdface.core.provenance import Provenance
from usdface.core.sidecars import binding_layers, corrected_path
from usdface.core.text import counted, first_few
from usdface.media.picture.binding_picture import BoundMarkers, draw_binding
from usdface.media.picture.image import write_image
from usdface.model.review.verdict import VERDICT_WORDS
from usdface.model.selection.baseline import PerformerMarkers
from usdface.model.surface.binding import FEWEST_LANDMARKS, UNCERTAIN_CONFIDENCE, facing_yaw
from usdface.numerics.registration.cloud_alignment import align_landmarks
from usdface.numerics.registration.marker_binding import MarkerBinding
from usdface.numerics.surface.surface_places import SurfacePoints
from usdface.runner.result import StepResult
from usdface.specs.surface import BindSpec
from usdface.steps.inputs.cleaned_takes import spread_frames, take_warnings
from usdface.steps.inputs.placement import read_performer_markers
from usdface.steps.surface.picture import other_meshes
from usdface.steps.surface.plan import PLAN_FRAMES, bind_take, landmark_places
from usdface.usdio.rig.mesh import FaceMesh, read_face_mesh
from usdface.usdio.surface.binding import has_binding, read_binding, write_binding
from usdface.usdio.take.read import TakeReader

_SUSPECT_SHARE = 0.25
"""Share of uncertain markers [0-1] above which a landmark is probably wrong. On the demo's face 4
of 102 are uncertain, and 44 if one of three landmarks is on the neck."""

_LANDMARK_SHARE = 0.25
"""Distance of landmarks from the performer's aligned ones [of their spread] from which they are
probably wrong. Between three heads it is 0.19 at most, and 0.26 and more for 95 % of the sets of
four to six of which two are exchanged."""


def run(spec: BindSpec, *, provenance: Provenance, progress: Progress) -> StepResult:
    """Propose a binding, keep the corrections of an earlier one, and write it."""
    face = read_face_mesh(spec.mesh, prim=spec.mesh_prim)
    take = TakeReader(spec.take)
    sample = read_performer_markers(take, spread_frames(take, PLAN_FRAMES))
    warnings = take_warnings(take)
    pinned = landmark_places(spec.landmarks, sample.labels, face, spec.take)
    sources = dict.fromkeys(pinned, "landmark")
    corrections, left_out = _corrections(spec, sample, face)
    pinned |= corrections
    sources |= dict.fromkeys(corrections, "corrected")
    progress(0.2, "placing the markers")
    binding = bind_take(sample, face, pinned=pinned, sources=sources)
    write_binding(spec.out, binding, face, provenance=provenance)
    at = binding.places.positions(face.mesh.points)
    if spec.picture is not None:
        progress(0.7, f"drawing {spec.picture.name}")
        write_image(
            spec.picture,
            draw_binding(
                [face.mesh, *other_meshes(face)],
                BoundMarkers(
                    binding.names,
                    at,
                    tuple(
                        f"{each:.0%}" if each < UNCERTAIN_CONFIDENCE else ""
                        for each in binding.confidence
                    ),
                    np.array([source != "proposed" for source in binding.sources]),
                ),
                title=f"{take.name} on {spec.mesh.stem}",
                verdict=_verdict(binding),
                facts=_facts(binding),
                yaw_degrees=facing_yaw(face.mesh, at),
                quality=spec.quality,
            ),
            metadata=provenance.metadata,
        )
    report = _report(spec, binding, face, left_out)
    doubts = _landmark_notes(sample.neutral, binding, at)
    return replace(report, notes=(*warnings, *doubts, *report.notes))


def _corrections(
    spec: BindSpec, sample: PerformerMarkers, face: FaceMesh
) -> tuple[dict[int, SurfacePoints], tuple[str, ...]]:
    """Return the corrected places of an earlier binding, and the markers it leaves out."""
    if not has_binding(spec.out):
        return {}, ()
    before = read_binding(spec.out, face)
    corrected = {
        sample.labels.index(name): before.binding.places.select([index])
        for index, (name, source) in enumerate(
            zip(before.binding.names, before.binding.sources, strict=True)
        )
        if source == "corrected" and name in sample.labels
    }
    return corrected, before.left_out


def _verdict(binding: MarkerBinding) -> tuple[str, str]:
    """Return level and sentence of the verdict, by the number of uncertain markers."""
    doubtful = [binding.names[index] for index in _doubtful(binding)]
    count = len(binding.names)
    if not doubtful:
        return "good", f"{VERDICT_WORDS['good']}: all {count} markers agree with their neighbours"
    level = "bad" if len(doubtful) > _SUSPECT_SHARE * count else "check"
    return level, (
        f"{VERDICT_WORDS[level]}: {len(doubtful)} of {count} markers may be misplaced (confidence "
        f"is next to them): {first_few(doubtful)}"
    )


def _doubtful(binding: MarkerBinding) -> list[int]:
    """Return the indices of uncertain markers, the lowest confidence first."""
    order = np.argsort(binding.confidence).tolist()
    return [index for index in order if binding.confidence[index] < UNCERTAIN_CONFIDENCE]


def _facts(binding: MarkerBinding) -> tuple[str, ...]:
    placed = sum(source != "proposed" for source in binding.sources)
    return (
        f"{len(binding.names)} markers",
        f"{placed} placed by a person",
        f"median {np.median(binding.distance_mm):.1f} mm from the performer's proportions",
    )


def _landmark_notes(neutral: FloatArray, binding: MarkerBinding, places: FloatArray) -> list[str]:
    """Return a note if no similarity takes the neutral markers [mm] to their landmarks [mm]."""
    landmarks = [i for i, source in enumerate(binding.sources) if source == "landmark"]
    if len(landmarks) < FEWEST_LANDMARKS:
        return []
    markers, at = neutral[landmarks], places[landmarks]
    worst = max(landmarks, key=lambda index: binding.distance_mm[index])
    try:
        aligned = align_landmarks(markers, at).apply(markers)
    except ValueError:  # on a line: enough where the mesh has shapes
        return []
    away = np.sqrt(((aligned - at) ** 2).sum(axis=1).mean())
    share = float(away / rms_radius(at))
    if share < _LANDMARK_SHARE:
        return []
    return [
        f"the landmarks are {away:.1f} mm, {share:.0%} of the face's size, from where those "
        f"markers are on a face of the performer's shape, {binding.names[worst]} the farthest: "
        "check it, and that none are exchanged"
    ]


def _report(
    spec: BindSpec, binding: MarkerBinding, face: FaceMesh, left_out: tuple[str, ...]
) -> StepResult:
    doubtful = [binding.names[index] for index in _doubtful(binding)]
    notes = []
    if doubtful:
        notes.append(
            f"uncertain: {counted(doubtful, 'marker')}; check and correct them in "
            f"{corrected_path(spec.out).name}"
        )
    if spec.landmarks and len(doubtful) > _SUSPECT_SHARE * len(binding.names):
        notes.append(
            f"{len(doubtful)} of {len(binding.names)} markers are uncertain: check the points of "
            f"the landmarks {', '.join(spec.landmarks)}"
        )
    if left_out:
        notes.append(f"still left out: {counted(left_out, 'marker')}")
    if face.others:
        notes.append(f"other meshes of {spec.mesh.name}, which have no markers: {len(face.others)}")
    return StepResult(
        (*binding_layers(spec.out), *spec.paths_of("picture")),
        f"{len(binding.names)} markers on {len(face.mesh.points)} points, {len(doubtful)} of them "
        "uncertain",
        tuple(notes),
        {
            "markers": len(binding.names),
            "doubtful": doubtful,
            "median_distance_mm": float(np.median(binding.distance_mm)),
            "left_out": list(left_out),
            "corrected": [
                name
                for name, source in zip(binding.names, binding.sources, strict=True)
                if source == "corrected"
            ],
        },
    )
