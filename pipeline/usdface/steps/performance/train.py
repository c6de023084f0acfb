"""Train a mapping on references."""

from dataclasses import replace

import numpy as np

from usdface.core.arrays import ByteImage, FloatArray, IntArray, columns_by_name, index_of
from usdface.core.assets import CandidateScore, References, Rig, TrainedMapping
from usdface.core.deformer import Deformer
from usdface.core.errors import InputError
from usdface.core.progress import Progress
from usdface.core.provenance import Provenance
from usdface.core.rig_logic import Combination
from usdface.core.sidecars import proposed_path
from usdface.core.text import counted, pluralize, shell_word
from usdface.media.charts.eigenspace import draw_eigenspace
from usdface.media.picture.image import write_image
from usdface.model.mapping.motion_space import marker_coordinates, motion_of
from usdface.model.mapping.regions import offsets_at, skin_points
from usdface.model.mapping.rig_match import rig_summary
from usdface.model.mapping.train import train_mapping
from usdface.model.mapping.uncertainty import proposal_error
from usdface.model.placement.label_hints import are_image_landmarks
from usdface.model.placement.rig_orientation import check_rig_upright
from usdface.model.placement.shape_parts import shape_parts
from usdface.model.regressions.base import Choices
from usdface.model.regressions.gaussian_rbf import PAPER_DIMENSIONS
from usdface.model.regressions.shape_sides import ShapeSides
from usdface.numerics.measure.face_regions import gaze_and_tongue_shapes
from usdface.runner.result import StepResult
from usdface.specs.performance import TrainSpec
from usdface.steps.inputs.placement import rest_places
from usdface.steps.performance.train_notes import mirrored_notes, training_notes
from usdface.usdio.mapping import write_mapping
from usdface.usdio.references.read import read_rig_of
from usdface.usdio.references.weight_layers import read_keyed_references, read_proposals

_ENOUGH_TUNED = 8
"""Tuned pairs from which training leaves out proposals. In the order of `select` 6 are enough; in
one random order 8 were: the error falls by a quarter to a half (decision 39)."""

_SHOWN_MM = 0.5
"""Largest displacement of a marker by a full shape, below which markers do not show the shape."""


def run(spec: TrainSpec, *, provenance: Provenance, progress: Progress) -> StepResult:
    """Train the mapping, write it, and with --picture draw the eigen-space."""
    references, notes = _read_pairs(spec)
    rig = read_rig_of(references, spec.references)
    notes += check_rig_upright(rig)
    deformer = Deformer(rig)
    part_of = dict(zip(rig.shapes, shape_parts(rig, deformer), strict=True))
    references = replace(references, parts=tuple(part_of[name] for name in references.shape_names))
    mapping = _train(spec, references, rig, deformer, progress)
    write_mapping(spec.out, mapping, provenance=provenance)
    # Shapes that move markers and are 0 in every pair, the largest motion first.
    moved_mm = np.sqrt(mapping.arrays["forward_shape_size2"].max(axis=1))[: len(mapping.ranges)]
    moved_mm[references.weights.any(axis=0)] = 0.0
    moved_mm[gaze_and_tongue_shapes(references.parts or references.shape_names)] = 0.0
    order = np.argsort(-moved_mm, kind="stable").tolist()
    unkeyed = [references.shape_names[column] for column in order if moved_mm[column] > _SHOWN_MM]
    if unkeyed:
        notes.append(
            f"0 in every pair: {counted(unkeyed, 'shape')}. They stay near 0 in the solve, unless "
            "the other shapes cannot follow the markers; tune frames that show those the performer "
            "uses"
        )
    notes += [*training_notes(mapping, references), variance_line(mapping)]
    if spec.picture is not None:
        picture = eigenspace_picture(mapping, references, f"eigen-space of {spec.references.stem}")
        write_image(spec.picture, picture, metadata=provenance.metadata)
    return StepResult(
        (spec.out, *spec.paths_of("picture")),
        _summary(mapping, references),
        tuple(notes),
        describe_figures(mapping) | {"unkeyed_shapes": unkeyed},
    )


def _read_pairs(spec: TrainSpec) -> tuple[References, list[str]]:
    """Return the pairs to train on, and notes on proposals and on mirrored pairs."""
    references = read_keyed_references(spec.references)
    if references.source is not None:
        raise InputError(
            f"{spec.references}: its takes have weights and no markers; use it with `usdface "
            "train-retarget --references`"
        )
    tuned, pairs = int(references.tuned.sum()), len(references.tuned)
    if spec.tuned_only and not tuned:
        raise InputError(
            f"{spec.references}: no pair is tuned; tune some, or train without --tuned-only"
        )
    notes = [] if tuned == pairs or spec.tuned_only else [_proposals_note(spec, tuned, pairs)]
    notes += mirrored_notes(spec.references, references)
    if spec.tuned_only or (tuned >= _ENOUGH_TUNED and not spec.all_pairs):
        references = references.rows(references.tuned)
    return references, notes


def _train(
    spec: TrainSpec, references: References, rig: Rig, deformer: Deformer, progress: Progress
) -> TrainedMapping:
    columns = [rig.shapes.index(name) for name in references.shape_names]
    points = skin_points(deformer.shapes.target_offsets())
    between, skin = separate_motion(rig, deformer, points, references.shape_names)
    poses = columns_by_name(references.weights, references.shape_names, rig.shapes)
    mapping = train_mapping(
        replace(references, combinations=(*references.combinations, *between)),
        ranges=rig.ranges_of(references.shape_names),
        gram=deformer.shapes.gram(poses)[np.ix_(columns, columns)],
        skin=skin,
        rest=rest_places(references, rig, deformer.neutral[points]),
        method=spec.method,
        choices=Choices(spec.dimensions, spec.widths),
        progress=progress,
    )
    return replace(
        mapping,
        references=spec.references.name,
        arrays=mapping.arrays
        | rig_summary(rig, mapping.shape_names)
        | {"uncertainty_proposals": _proposal_error(spec, mapping, references)},
        settings=mapping.settings | {"tuned": int(references.tuned.sum())},
    )


def _proposal_error(spec: TrainSpec, mapping: TrainedMapping, references: References) -> FloatArray:
    """Return the terms of the uncertainty due to proposals; see `proposal_error`."""
    sides, proposals = ShapeSides.from_arrays(mapping.arrays, mapping.ranges), None
    span = np.ptp(sides.ranges, axis=1)
    layer = proposed_path(spec.references)
    if 0 < references.tuned.sum() < len(references.tuned) and layer.is_file():
        proposals = sides.split(read_proposals(layer, references)) / span
    return proposal_error(
        mapping.arrays["uncertainty_grams"],
        sides.split(references.weights) / span,
        references.tuned,
        proposals,
        landmarks=are_image_landmarks(references.marker_names),
    )


def separate_motion(
    rig: Rig, deformer: Deformer, points: IntArray, names: tuple[str, ...]
) -> tuple[tuple[Combination, ...], FloatArray]:
    """Return in-betweens as combinations of one part, and the motion of points by each shape alone.

    At weight w a shape moves the skin by ``w full + sum_p hat_p(w) (in-between_p - p full)``, where
    ``hat_p`` is 1 at the in-between's weight p and 0 at its neighbours. The motion, (n, points, 3)
    [mm], is that of the shapes `names`, of the rig's combinations, and of the in-betweens.
    """
    peaks: dict[str, set[float]] = {}
    for mesh in rig.meshes:
        for shape in mesh.shapes:
            between = {float(key.weight) for key in shape.keys if 0 < key.weight < 1}
            if between and shape.name in names:
                peaks.setdefault(shape.name, set()).update(between)
    column, each = index_of(rig.shapes), np.eye(len(rig.shapes) + len(rig.combinations))

    def moved(weights: FloatArray) -> FloatArray:
        return offsets_at(deformer.shapes.separate_offsets(weights), points)

    found, motion = [], [moved(each[[column[name] for name in names]]), moved(each[len(column) :])]
    for name, between in peaks.items():
        knots = [0.0, *sorted(between), 1.0]
        at = np.array(knots[1:])[:, None]
        offsets = moved(at * each[column[name]])
        motion.append(offsets[:-1] - at[:-1, :, None] * offsets[-1])
        found += [
            Combination(f"{name}@{peak:g}", (name,), weights=(peak,), spans=((low, high),))
            for low, peak, high in zip(knots, knots[1:], knots[2:], strict=False)
        ]
    return tuple(found), np.concatenate(motion)


def describe_figures(mapping: TrainedMapping) -> dict[str, object]:
    """Return method, settings and scores of a mapping as plain data."""
    return {
        "method": mapping.method,
        "markers": len(mapping.marker_names),
        "shapes": len(mapping.shape_names),
        "settings": dict(mapping.settings),
        "variance_shares": [round(float(share), 6) for share in variance_shares(mapping)],
        "scores": [vars(score) for score in mapping.scores],
        "references": mapping.references,
    }


def _proposals_note(spec: TrainSpec, tuned: int, pairs: int) -> str:
    """Return the note on proposals: trained on, or left out."""
    if not tuned:
        return (
            f"an untuned start: all {pairs} pairs are proposals from the rig's geometry, so this "
            "mapping reproduces them with their errors, and its cross-validated error is the "
            "distance from proposals. Tune a dozen or two (`usdface tune "
            f"{shell_word(spec.references)}`), then train again"
        )
    proposals = pluralize(pairs - tuned, "untuned proposal")
    if tuned >= _ENOUGH_TUNED and not spec.all_pairs:
        return (
            f"trained on the {tuned} tuned pairs; {proposals} left out, as their errors are larger "
            "than what they add (--all-pairs trains on them as well)"
        )
    return (
        f"trained on {pluralize(tuned, 'tuned pair')} and {proposals}, which reproduces the "
        f"proposals' errors; tune {_ENOUGH_TUNED} pairs or more and train again, which leaves "
        "them out"
    )


def _summary(mapping: TrainedMapping, references: References) -> str:
    summary = (
        f"{mapping.method} on {len(references.frames)} pairs, {len(mapping.marker_names)} markers "
        f"to {len(mapping.shape_names)} shapes"
    )
    errors: dict[str, CandidateScore] = {}
    for score in mapping.scores:  # of a method's settings the best comes first
        errors.setdefault(score.method, score)
    chosen = errors.pop(mapping.method, None)
    if chosen is not None:
        summary += (
            f"; cross-validated error {chosen.vertex_rms_mm:.2f} mm on the surface, "
            f"{chosen.weight_rmse:.3f} in the weights"
        )
        others = [f"{name} {score.vertex_rms_mm:.2f}" for name, score in errors.items()]
        summary += f" ({', '.join(others)} mm)" if others else ""
    return summary


def variance_shares(mapping: TrainedMapping) -> FloatArray:
    """Return the share of the markers' variance that each component holds: (dimensions,) [0-1]."""
    motion = motion_of(mapping)
    return motion.variances / motion.total_variance


def variance_line(mapping: TrainedMapping) -> str:
    """Return the share of the variance in the first components and in those that are used."""
    shares = variance_shares(mapping)
    first = shares[:PAPER_DIMENSIONS]
    listed = ", ".join(f"{100 * share:.2f}" for share in first)
    line = (
        f"{pluralize(len(first), 'principal component')} hold {100 * first.sum():.2f} % of the "
        f"markers' variance ({listed})"
    )
    used = mapping.settings.get("dimensions")
    if isinstance(used, int) and used != len(first):
        line += f"; the {used} in use hold {100 * shares[:used].sum():.2f} %"
    return line


def eigenspace_picture(mapping: TrainedMapping, references: References, title: str) -> ByteImage:
    """Draw the takes and the references along the first components."""
    motion = motion_of(mapping)
    markers = references.markers.astype(np.float64)
    return draw_eigenspace(
        title,
        (variance_line(mapping),),
        takes=motion.sample,
        references=marker_coordinates(motion, markers),
        shares=variance_shares(mapping),
    )
