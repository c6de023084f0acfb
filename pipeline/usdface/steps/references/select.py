"""Choose reference frames and propose weights for them."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from usdface.core.arrays import BoolArray, FloatArray, IntArray
from usdface.core.assets import References, Rig, TrainedMapping
from usdface.core.errors import InputError
from usdface.core.locks import check_nobody_tunes, nobody_tunes
from usdface.core.progress import Progress, silent
from usdface.core.provenance import Provenance
from usdface.core.replacing import appearing_together
from usdface.core.sidecars import (
    binding_layers,
    placement_path,
    reference_layers,
    tuned_path,
)
from usdface.core.text import first_few, pluralize
from usdface.media.picture.image import write_image
from usdface.model.selection.design import (
    ReferenceChoice,
    choose_by_design,
    choose_visemes,
    in_order_of_worth,
)
from usdface.model.selection.lip_contact import find_lips, keep_lip_contact
from usdface.model.selection.neutral_check import find_better_neutral
from usdface.numerics.motion.noise import measurement_noise, still_range_mm
from usdface.runner.origin import provenance_metadata
from usdface.runner.result import StepResult
from usdface.specs.references import SelectSpec
from usdface.speech.phones import VISEMES, viseme_label
from usdface.steps.inputs.cleaned_takes import CleanedTakes, plausibility_notes, read_cleaned_takes
from usdface.steps.inputs.coverage_report import cover, coverage_figures, coverage_picture
from usdface.steps.inputs.landmark_files import read_landmarks
from usdface.steps.inputs.phone_labels import PhoneLabels, read_phone_labels
from usdface.steps.inputs.placement import (
    PlacedTakes,
    draw_placement,
    judge_stored,
    place_takes,
    placement_figures,
    placement_notes,
)
from usdface.steps.inputs.scene import (
    SelectionScene,
    TakesPrediction,
    candidate_frames,
    set_up_scene,
    takes_prediction,
)
from usdface.steps.inputs.tuned_pairs import (
    PlacedPair,
    find_placed_pairs,
    rows_in_place,
    tuned_conflicts,
)
from usdface.steps.references.images import (
    PairImages,
    remove_unused_images,
    write_pair_images,
)
from usdface.steps.references.weight_takes import carry_weights_alone, select_by_weights
from usdface.usdio.mapping import read_mapping
from usdface.usdio.references.read import read_tuned_pairs
from usdface.usdio.references.write import write_references
from usdface.usdio.rig.read import read_rig
from usdface.usdio.surface.placement import RigPlacement, write_placement


@dataclass(frozen=True)
class _Selection:
    """What is chosen from, and for what."""

    spec: SelectSpec
    scene: SelectionScene
    spoken: PhoneLabels
    kept: list[PlacedPair]
    candidates: BoolArray

    @property
    def already(self) -> IntArray:
        """Rows of the tuned pairs."""
        return np.array([each.row for each in self.kept], dtype=np.int64)

    @property
    def wanted(self) -> int:
        """How many pairs are to be found."""
        return self.spec.count - len(self.kept)


def run(spec: SelectSpec, *, provenance: Provenance, progress: Progress = silent) -> StepResult:
    """Choose pairs, propose weights to start from, write the asset and draw its coverage."""
    progress(0.0, "reading the takes")
    check_nobody_tunes(spec.out)
    if carry_weights_alone(spec.takes):
        return _run_on_weights(spec, provenance, progress)
    if spec.names is not None:
        raise InputError(f"{first_few(spec.takes)}: has markers, so --names has no effect")
    takes = read_cleaned_takes(spec.takes)
    _check_something_moves(spec, takes)
    rig = read_rig(spec.rig, prim=spec.prim)
    doubts = plausibility_notes(takes, spec.takes, rig)
    progress(0.1, "placing the markers on the rig")
    placed = _place(spec, takes, rig)
    spoken = read_phone_labels(spec, takes)
    kept = find_placed_pairs(spec, takes, rig)
    mapping = None if spec.mapping is None else _mapping_for(spec, rig)
    selection = _set_up(spec, takes, rig, placed.placement, spoken, kept, progress)
    progress(0.5, "choosing frames")
    mapped = None if mapping is None else takes_prediction(mapping, takes)
    choice = _choose(selection)
    rows = np.array(rows_in_place(spec.count, kept, choice.rows), dtype=np.int64)
    progress(0.7, "proposing weights")
    weights = _propose(selection, mapped, rows)
    references = replace(
        _references(selection, choice, rows, weights),
        placement=spec.placement or placement_path(spec.out),
    )
    images = PairImages((), ())
    metadata = provenance_metadata(provenance)
    if spec.images:
        progress(0.75, "keeping the video frames of the pairs")
        images = write_pair_images(spec.out, references, takes.sources, metadata=metadata)
    progress(0.85, f"writing {spec.out.name}")
    written = (*binding_layers(placement_path(spec.out)), *reference_layers(spec.out))
    with nobody_tunes(spec.out), appearing_together(written):
        _check_tuning_is_as_read(spec, kept)
        if spec.placement is None:
            write_placement(placement_path(spec.out), placed.placement, rig, provenance=provenance)
        write_references(
            spec.out,
            references,
            rig,
            tuned=[each.tuned for each in kept if each.is_keyed],
            images=images.files,
            provenance=provenance,
        )
    remove_unused_images(spec.out, images.files)
    _draw_placement(spec, placed, rig, provenance)
    progress(0.9, "measuring the coverage")
    scene = selection.scene
    covered = cover(scene.space, scene.features, rows, candidates=selection.candidates)
    picture = coverage_picture(covered, takes, rows, tuned=selection.already, title=spec.out.stem)
    write_image(spec.picture_path(), picture, metadata=metadata)
    progress(1.0, "done")
    contradictions, conflicts = tuned_conflicts(spec.out)
    return StepResult(
        (
            *reference_layers(spec.out),
            spec.picture_path(),
            *((placement_path(spec.out),) if spec.placement is None else ()),
            _placement_picture(spec),
        ),
        f"{len(rows)} pairs of {len(takes.frames)} frames, {len(kept)} of them tuned; their "
        f"markers span {covered.coverage.share:.0%} of the motion",
        (
            *doubts,
            f"placement: {placed.verdict.sentence}; see {_placement_picture(spec).name}",
            *placement_notes(placed),
            *_notes(selection, choice, mapping),
            *images.notes,
            *contradictions,
            *_next(spec, kept),
        ),
        {
            "pairs": len(rows),
            "frames": references.frames.tolist(),
            "takes": list(references.takes),
            "kept": len(kept),
            "conflicts": conflicts,
            "design": choice.design,
            "measured_mm": {name: round(mm, 4) for name, mm in choice.measured_mm.items()},
            "visemes": list(references.visemes),
            "emotions": list(references.emotions),
            "images": sum(file is not None for file in images.files),
            "neutrals": {
                take.name: neutral.figures()
                for take, neutral in zip(takes.sources, takes.neutrals, strict=True)
            },
            "placement": placement_figures(placed),
            **coverage_figures(covered, takes),
        },
    )


def _run_on_weights(spec: SelectSpec, provenance: Provenance, progress: Progress) -> StepResult:
    """Choose pairs of takes that carry weights, and write the asset."""
    rig = read_rig(spec.rig, prim=spec.prim)
    found = select_by_weights(spec, rig, progress)
    references, images = found.references, PairImages((), ())
    if spec.images:
        progress(0.6, "keeping the video frames of the pairs")
        metadata = provenance_metadata(provenance)
        images = write_pair_images(spec.out, references, found.takes.sources, metadata=metadata)
    progress(0.9, f"writing {spec.out.name}")
    with nobody_tunes(spec.out):
        _check_tuning_is_as_read(spec, found.kept)
        write_references(
            spec.out,
            references,
            rig,
            tuned=[each.tuned for each in found.kept if each.is_keyed],
            images=images.files,
            provenance=provenance,
        )
    remove_unused_images(spec.out, images.files)
    progress(1.0, "done")
    count = len(references.frames)
    return StepResult(
        reference_layers(spec.out),
        f"{count} pairs of {len(found.takes.frames)} frames, {len(found.kept)} of them tuned",
        (
            *found.notes,
            *images.notes,
            f"next: `usdface tune {spec.out}`; then `usdface train-retarget` with --references",
        ),
        {
            "pairs": count,
            "frames": references.frames.tolist(),
            "takes": list(references.takes),
            "kept": len(found.kept),
            "images": sum(file is not None for file in images.files),
        },
    )


def _check_something_moves(spec: SelectSpec, takes: CleanedTakes) -> None:
    """Refuse takes of one expression, before the markers are placed: their pairs would be noise."""
    clip, usable = takes.positions[0], takes.usable[0]
    still = still_range_mm(takes.positions, measurement_noise(clip, usable))
    if still is not None:
        raise InputError(
            f"{first_few(spec.takes)}: no marker moves on the head (by at most {still:.2f} mm "
            f"along an axis, in {len(takes.frames)} frames), so there are no expressions to "
            "select; give takes of a moving face. If the face did move, the capture was "
            "exported without its motion: export and ingest it again"
        )


def _check_tuning_is_as_read(spec: SelectSpec, kept: list[PlacedPair]) -> None:
    """Refuse to write where pairs were tuned while frames were chosen."""
    now = {(each.pair, each.take, each.frame) for each in read_tuned_pairs(tuned_path(spec.out))}
    before = {(each.tuned.pair, each.tuned.take, each.tuned.frame) for each in kept}
    if now - before:
        raise InputError(
            f"{tuned_path(spec.out)}: somebody tuned {pluralize(len(now - before), 'pair')} while "
            "frames were chosen; nothing was changed. Select again, which keeps what is tuned"
        )


def _mapping_for(spec: SelectSpec, rig: Rig) -> TrainedMapping:
    """Read a mapping that is to say something of this rig."""
    if spec.mapping is None:
        raise InputError("no mapping is given")
    mapping = read_mapping(spec.mapping)
    remedy = "it was trained for another rig: give the mapping of this one"
    rig.check_has(mapping.shape_names, source=spec.mapping, remedy=remedy)
    return mapping


def _place(spec: SelectSpec, takes: CleanedTakes, rig: Rig) -> PlacedTakes:
    """Return the placement that is given, or place the markers by landmarks and corrections."""
    if spec.placement is not None:
        return judge_stored(spec.placement, takes, rig)
    landmarks = {}
    if spec.landmarks is not None:
        landmarks = read_landmarks(spec.landmarks, takes.marker_names, rig)
    return place_takes(takes, rig, out=placement_path(spec.out), landmarks=landmarks)


def _draw_placement(spec: SelectSpec, placed: PlacedTakes, rig: Rig, made: Provenance) -> None:
    """Draw the placement beside the references."""
    title = f"{spec.out.stem} on {rig.file.stem}"
    picture = draw_placement(placed, rig, title=title, quality="draft")
    write_image(_placement_picture(spec), picture, metadata=provenance_metadata(made))


def _placement_picture(spec: SelectSpec) -> Path:
    return placement_path(spec.out).with_suffix(".jpg")


def _set_up(
    spec: SelectSpec,
    takes: CleanedTakes,
    rig: Rig,
    placement: RigPlacement,
    spoken: PhoneLabels,
    kept: list[PlacedPair],
    progress: Progress,
) -> _Selection:
    candidates = candidate_frames(takes, spec.frames)
    free = candidates.copy()
    free[[each.row for each in kept]] = False
    if int(free.sum()) < spec.count - len(kept):
        raise InputError(
            f"{spec.count} pairs are asked for and {int(free.sum()) + len(kept)} frames can be "
            "used; lower --count, widen --frames or give more takes"
        )
    scene = set_up_scene(takes, rig, placement=placement, progress=progress)
    return _Selection(spec, scene, spoken, kept, candidates)


def _choose(selection: _Selection) -> ReferenceChoice:
    """Choose the frames that are to be found, by the method asked for."""
    spec = selection.spec
    spoken = ReferenceChoice(np.zeros(0, dtype=np.int64))
    if selection.spoken.segments and spec.method in ("viseme", "both"):
        spoken = choose_visemes(
            selection.scene.features,
            # With both, half of the pairs are left to design, whatever is spoken.
            selection.wanted if spec.method == "viseme" else selection.wanted // 2,
            segments=selection.spoken.segments,
            emotion_of=selection.spoken.emotion_of,
            visemes=VISEMES,
            extremes=spec.extremes if spec.method == "viseme" else 0,
            already=selection.already,
            candidates=selection.candidates,
        )
    rest = selection.wanted - len(spoken.rows)
    if not rest:
        return spoken
    designed = choose_by_design(
        selection.scene.features,
        rest,
        already=np.concatenate([selection.already, spoken.rows]),
        candidates=selection.candidates,
        stand_ins=selection.scene.stand_ins,
    )
    together = np.concatenate([spoken.rows, designed.rows])
    return replace(
        designed,
        rows=in_order_of_worth(selection.scene.features, together, selection.already),
        visemes=spoken.visemes,
        extremes=spoken.extremes,
        missing=spoken.missing,
    )


def _propose(selection: _Selection, mapped: TakesPrediction | None, rows: IntArray) -> FloatArray:
    """Return weights to start from: the mapping's where there is one, else the rig's geometry."""
    scene = selection.scene
    positions = scene.positions(rows)
    weights = scene.equation.propose(positions, visible=scene.usable(rows))
    lips = find_lips(scene.equation, scene.deformer, scene.rig.shapes)
    if lips is not None:
        weights = keep_lip_contact(scene.equation, scene.deformer, lips, positions, weights)
    if mapped is not None:
        columns = [scene.rig.shapes.index(name) for name in mapped.shape_names]
        weights[:, columns] = mapped.weights(rows)
    return weights


def _references(
    selection: _Selection, choice: ReferenceChoice, rows: IntArray, weights: FloatArray
) -> References:
    scene, takes, spoken = selection.scene, selection.scene.takes, selection.spoken
    return References(
        marker_names=takes.marker_names,
        shape_names=scene.rig.shapes,
        markers=scene.positions(rows),
        weights=weights,
        frames=takes.frames[rows],
        takes=tuple(takes.takes[row] for row in rows),
        tuned=np.zeros(len(rows), dtype=np.bool_),
        rigid=takes.rigid,
        neutral=takes.neutral,
        rig_file=scene.rig.file,
        rig_prim=scene.rig.prim,
        combinations=scene.rig.combinations,
        motion=scene.motion,
        visemes=tuple(choice.visemes.get(row, spoken.viseme_of[row]) for row in rows.tolist()),
        emotions=tuple(spoken.emotion_of[row] for row in rows.tolist()),
        performer=takes.sources[0].performer,
        session=takes.sources[0].session,
    )


def _neutral_notes(scene: SelectionScene) -> list[str]:
    """Say if the first take's neutral frame, which is the performer's, is not neutral."""
    takes = scene.takes
    rows = np.flatnonzero(takes.usable[0].all(axis=1))
    found = find_better_neutral(scene.equation, takes.positions[0], rows)
    if found is None:
        return []
    name, frame = takes.sources[0].name, int(takes.frames[found.row])
    return [
        f"{name}: its neutral frame is not neutral: from frame {frame} the rig's shapes explain "
        f"the take to {found.residual_mm:.1f} mm, from the neutral frame to "
        f"{found.stated_mm:.1f} mm. Clean the take with --neutral {frame}, "
        "or a frame in which the face is at rest"
    ]


def _notes(
    selection: _Selection, choice: ReferenceChoice, mapping: TrainedMapping | None
) -> list[str]:
    notes, dropped = list(selection.spoken.notes), selection.scene.takes.dropped
    if dropped:
        notes.append(
            f"left out {pluralize(len(dropped), 'marker')}, not in every take: {first_few(dropped)}"
        )
    takes = selection.scene.takes
    notes += _neutral_notes(selection.scene)
    for take, neutral in zip(takes.sources, takes.neutrals, strict=True):
        notes += neutral.notes(take.name)
    if selection.kept:
        notes.append(f"kept in place: {pluralize(len(selection.kept), 'tuned pair')}")
    keyed = sum(each.is_keyed for each in selection.kept)
    if keyed:
        notes.append(
            f"keyed in the asset itself, and tuned from now on: {pluralize(keyed, 'pair')}"
        )
    if selection.spoken.segments and selection.spec.method in ("viseme", "both"):
        notes += _viseme_notes(selection, choice)
    if selection.spec.method == "both" and not selection.spec.phones:
        notes.append(
            "no phones are given, so frames were chosen by design alone; that costs nothing in "
            "accuracy, but pairs carry no viseme"
        )
    if mapping is None:
        notes += selection.scene.notes
    else:
        notes.append("weights to start from are the mapping's own predictions")
    return notes


def _viseme_notes(selection: _Selection, choice: ReferenceChoice) -> list[str]:
    """Count what was chosen as what, and name the visemes that are not spoken."""
    visemes, extremes = len(choice.visemes), len(choice.extremes)
    rest = len(choice.rows) - visemes - extremes
    notes = [
        f"chosen: {pluralize(visemes, 'frame')} of visemes, {pluralize(extremes, 'extreme')} of "
        f"emotions, {rest} by design"
    ]
    spoken = {segment.viseme for segment in selection.spoken.segments}
    silent = [viseme_label(viseme) for viseme in VISEMES if viseme not in spoken]
    if silent:
        notes.append(
            f"nobody speaks {pluralize(len(silent), 'viseme')} of {len(VISEMES)}: "
            f"{first_few(silent, most=len(VISEMES))}"
        )
    some = [f"{v} {e}".strip() for e, v in choice.missing if v in spoken]
    if some:
        notes.append(
            f"spoken, but not in every emotion: {pluralize(len(some), 'viseme')}, "
            f"{first_few(some, most=8)}"
        )
    return notes


def _next(spec: SelectSpec, kept: list[PlacedPair]) -> list[str]:
    """Say what to do where weights are proposals that nobody has seen."""
    rest = spec.count - len(kept)
    if not rest:
        return []
    if kept:
        return [
            f"next: tune some of the {pluralize(rest, 'proposal')}, then `usdface train` with "
            "--tuned-only"
        ]
    return [
        "an untuned start: all weights are proposals of the rig's geometry, which knows nothing of "
        f"this performer. Next: `usdface tune {spec.out}`; tune the first dozen or two (they are "
        "in order of worth), then `usdface train` with --tuned-only"
    ]
