"""Choose reference frames and propose weights for them."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from usdface.core.arrays import BoolArray, FloatArray, IntArray
from usdface.core.assets import References, Rig, TrainedMapping
from usdface.core.errors import InputError
from usdface.core.locks import check_tuning_lock, tuning_lock
from usdface.core.progress import Progress, part
from usdface.core.provenance import Provenance
from usdface.core.replacing import replacing_group
from usdface.core.sidecars import binding_layers, placement_path, reference_layers, tuned_path
from usdface.core.text import first_few, pluralize, shell_word
from usdface.media.picture.image import write_image
from usdface.model.mapping.performer_face import face_of_mapping
from usdface.model.mapping.predict import WeightPredictor
from usdface.model.selection.design import (
    ReferenceChoice,
    choose_by_design,
    choose_visemes,
    features_at,
    rank_by_information,
)
from usdface.model.selection.lip_contact import find_lips, keep_lip_contact
from usdface.numerics.motion.noise import measurement_noise, still_range_mm
from usdface.runner.result import StepResult
from usdface.specs.references import SelectSpec
from usdface.speech.phones import VISEMES
from usdface.steps.inputs.cleaned_takes import CleanedTakes, plausibility_notes, read_cleaned_takes
from usdface.steps.inputs.coverage_report import TakesCoverage, coverage_and_growth
from usdface.steps.inputs.landmark_files import read_landmarks
from usdface.steps.inputs.phone_labels import PhoneLabels, read_phone_labels
from usdface.steps.inputs.placed_takes import (
    PlacedTakes,
    PlacementScene,
    draw_placement,
    place_takes,
    placement_figures,
    placement_notes,
)
from usdface.steps.inputs.placement import read_placement_of
from usdface.steps.inputs.scene import SelectionScene, candidate_frames, set_up_scene
from usdface.steps.inputs.tuned_pairs import (
    PlacedPair,
    find_placed_pairs,
    rows_of_pairs,
    tuned_conflicts,
)
from usdface.steps.references.images import PairImages, remove_unused_images, store_images
from usdface.steps.references.select_notes import next_step, selection_notes
from usdface.steps.references.weight_takes import have_weights_only, select_by_weights
from usdface.usdio.mapping import read_mapping
from usdface.usdio.references.weight_layers import read_tuned_pairs
from usdface.usdio.references.write import write_references
from usdface.usdio.rig.read import read_rig
from usdface.usdio.surface.placement import RigPlacement, write_placement

_EXTREME_COUNT = 10
"""Extreme frames of each emotion with `viseme`, as in the paper."""


@dataclass(frozen=True)
class _Selection:
    """Inputs of the choice of frames."""

    spec: SelectSpec
    scene: SelectionScene
    spoken: PhoneLabels
    kept: list[PlacedPair]
    candidates: BoolArray
    mapping: TrainedMapping | None
    """Proposes the weights."""

    @property
    def already(self) -> IntArray:
        """Rows of the tuned pairs."""
        return np.array([each.row for each in self.kept], dtype=np.int64)

    @property
    def wanted(self) -> int:
        """Number of pairs to choose."""
        return self.spec.count - len(self.kept)


def run(spec: SelectSpec, *, provenance: Provenance, progress: Progress) -> StepResult:
    """Choose pairs, propose their weights, write the asset and draw its coverage."""
    check_tuning_lock(spec.out)
    if have_weights_only(spec.takes):
        return _run_on_weights(spec, provenance, progress)
    if spec.names is not None:
        raise InputError(
            f"{first_few(spec.takes)}: has markers, so --names has no effect; leave it out"
        )
    takes = read_cleaned_takes(spec.takes)
    clip, usable = takes.positions[0], takes.usable[0]
    still = still_range_mm(takes.positions, measurement_noise(clip, usable))
    if still is not None:
        raise InputError(
            f"{first_few(spec.takes)}: no marker moves on the head (at most {still:.2f} mm along "
            f"an axis, in {len(takes.frames)} frames), so there are no expressions to select; give "
            "takes of a moving face. If the face did move, the export lost its motion: export and "
            "ingest it again"
        )
    rig = read_rig(spec.rig, prim=spec.prim)
    warnings = plausibility_notes(takes, spec.takes, rig)
    progress(0.1, "placing the markers on the rig")
    takes, placed, moved = place_takes(takes, rig, _placing(spec, takes, rig))
    warnings += moved
    selection = _set_up(spec, takes, rig, placed.placement, progress)
    progress(0.5, "choosing frames")
    choice = _choose(selection)
    rows = np.array(rows_of_pairs(spec.count, selection.kept, choice.rows), dtype=np.int64)
    progress(0.7, "proposing weights")
    references = _references(selection, choice, rows, _propose(selection, rows))
    images = store_images(spec, references, takes.sources, provenance, part(progress, 0.75, 0.85))
    progress(0.85, f"writing {spec.out.name}")
    made_here = None if spec.placement is not None else placed.placement
    _write(spec, references, rig, selection.kept, images, provenance, made_here)
    title = f"{spec.out.stem} on {rig.file.stem}"
    picture = draw_placement(placed, rig, title=title, quality="draft")
    write_image(_placement_picture(spec), picture, metadata=provenance.metadata)
    progress(0.9, "measuring the coverage")
    coverage = _measure_coverage(selection, rows, provenance)
    return _result(selection, placed, choice, references, images, coverage, warnings)


def _placing(
    spec: SelectSpec, takes: CleanedTakes, rig: Rig
) -> Callable[[PlacementScene], PlacedTakes]:
    """Return what places the takes' markers: the stored placement, or labels and motion."""
    if spec.placement is not None:
        stored = read_placement_of(spec.placement, rig, takes.marker_names, takes.neutral)
        return partial(PlacementScene.judge, placement=stored)
    landmarks = read_landmarks(spec.landmarks, takes.marker_names, rig)
    return partial(PlacementScene.place, out=placement_path(spec.out), landmarks=landmarks)


def _run_on_weights(spec: SelectSpec, provenance: Provenance, progress: Progress) -> StepResult:
    """Choose pairs of takes that carry weights, and write the asset."""
    rig = read_rig(spec.rig, prim=spec.prim)
    found = select_by_weights(spec, rig, progress)
    references = found.references
    images = store_images(
        spec, references, found.takes.sources, provenance, part(progress, 0.6, 0.9)
    )
    progress(0.9, f"writing {spec.out.name}")
    _write(spec, references, rig, found.kept, images, provenance)
    return StepResult(
        reference_layers(spec.out),
        f"{len(references.frames)} pairs of {len(found.takes.frames)} frames, {len(found.kept)} of "
        "them tuned",
        (
            *found.notes,
            *images.notes,
            f"next: `usdface tune {shell_word(spec.out)}`; then `usdface train-retarget` with "
            "--references",
        ),
        _figures(references, found.kept, images),
    )


def _write(
    spec: SelectSpec,
    references: References,
    rig: Rig,
    kept: list[PlacedPair],
    images: PairImages,
    provenance: Provenance,
    placement: RigPlacement | None = None,
) -> None:
    """Write references, and a placement made here, unless pairs were tuned since they were read."""
    written = (*binding_layers(placement_path(spec.out)), *reference_layers(spec.out))
    with tuning_lock(spec.out), replacing_group(written):
        _check_tuning_is_as_read(spec, kept)
        if placement is not None:
            write_placement(placement_path(spec.out), placement, rig, provenance=provenance)
        write_references(
            spec.out,
            references,
            rig,
            tuned=[each.tuned for each in kept if each.is_keyed],
            images=images.files,
            provenance=provenance,
        )
    remove_unused_images(spec.out, images.files)


def _check_tuning_is_as_read(spec: SelectSpec, kept: list[PlacedPair]) -> None:
    """Refuse to write if pairs were tuned since they were read."""
    now = {(each.pair, each.take, each.frame) for each in read_tuned_pairs(tuned_path(spec.out))}
    before = {(each.tuned.pair, each.tuned.take, each.tuned.frame) for each in kept}
    if now - before:
        raise InputError(
            f"{tuned_path(spec.out)}: {pluralize(len(now - before), 'pair')} tuned while frames "
            "were chosen; nothing was changed. Select again, which keeps tuned pairs"
        )


def _measure_coverage(
    selection: _Selection, rows: IntArray, provenance: Provenance
) -> TakesCoverage:
    """Measure the coverage of the takes by the pairs, and draw it."""
    spec, scene = selection.spec, selection.scene
    frames, growth = coverage_and_growth(
        scene,
        features_at(scene.features, rows),
        scene.displacements(rows),
        candidates=selection.candidates,
        rows=rows,
    )
    pairs, tuned = np.arange(len(rows), dtype=np.int64), selection.already
    coverage = TakesCoverage(scene.takes, frames, growth, pairs, rows, tuned, len(tuned))
    picture = coverage.picture(spec.out.stem)
    write_image(spec.picture_path(), picture, metadata=provenance.metadata)
    return coverage


def _result(
    selection: _Selection,
    placed: PlacedTakes,
    choice: ReferenceChoice,
    references: References,
    images: PairImages,
    coverage: TakesCoverage,
    warnings: list[str],
) -> StepResult:
    spec, scene, kept = selection.spec, selection.scene, selection.kept
    takes = scene.takes
    contradictions, conflicts = tuned_conflicts(spec.out)
    return StepResult(
        (
            *reference_layers(spec.out),
            spec.picture_path(),
            *((placement_path(spec.out),) if spec.placement is None else ()),
            _placement_picture(spec),
        ),
        f"{len(references.frames)} pairs of {len(takes.frames)} frames, {len(kept)} of them tuned; "
        f"mean coverage {coverage.frames.mean:.0%}",
        (
            *warnings,
            f"placement: {placed.verdict.sentence}; see {_placement_picture(spec).name}",
            *placement_notes(placed),
            *selection_notes(spec, scene, selection.spoken, kept, choice),
            *images.notes,
            *contradictions,
            *next_step(spec.out, spec.count, len(kept)),
        ),
        {
            **_figures(references, kept, images),
            "conflicts": conflicts,
            "design": choice.design,
            "measured_mm": {name: round(mm, 4) for name, mm in choice.measured_mm.items()},
            "visemes": list(references.visemes),
            "emotions": list(references.emotions),
            "neutrals": {
                take.name: neutral.figures()
                for take, neutral in zip(takes.sources, takes.neutrals, strict=True)
            },
            "placement": placement_figures(placed),
            **coverage.figures(),
        },
    )


def _figures(
    references: References, kept: list[PlacedPair], images: PairImages
) -> dict[str, object]:
    return {
        "pairs": len(references.frames),
        "frames": references.frames.tolist(),
        "takes": list(references.takes),
        "kept": len(kept),
        "images": sum(file is not None for file in images.files),
    }


def _placement_picture(spec: SelectSpec) -> Path:
    return placement_path(spec.out).with_suffix(".jpg")


def _set_up(
    spec: SelectSpec, takes: CleanedTakes, rig: Rig, placement: RigPlacement, progress: Progress
) -> _Selection:
    spoken = read_phone_labels(spec, takes)
    kept = find_placed_pairs(spec, takes, rig)
    mapping = None if spec.mapping is None else read_mapping(spec.mapping)
    if mapping is not None:
        remedy = "it was trained for another rig: give the mapping of this one"
        rig.check_has(mapping.shape_names, source=spec.mapping, remedy=remedy)
    candidates = candidate_frames(takes, spec.frames)
    free = candidates.copy()
    free[[each.row for each in kept]] = False
    if int(free.sum()) < spec.count - len(kept):
        raise InputError(
            f"--count is {spec.count}, but only {int(free.sum()) + len(kept)} frames can be used; "
            "lower it, widen --frames or give more takes"
        )
    scene = set_up_scene(takes, rig, placement=placement, progress=progress)
    return _Selection(spec, scene, spoken, kept, candidates, mapping)


def _choose(selection: _Selection) -> ReferenceChoice:
    """Choose the frames that are not tuned yet, by --method."""
    spec = selection.spec
    spoken = ReferenceChoice(np.zeros(0, dtype=np.int64))
    if selection.spoken.segments and spec.method in ("viseme", "both"):
        spoken = choose_visemes(
            selection.scene.features,
            # With both, half of the pairs are chosen by design.
            selection.wanted if spec.method == "viseme" else selection.wanted // 2,
            segments=selection.spoken.segments,
            emotion_of=selection.spoken.emotion_of,
            visemes=VISEMES,
            extremes=_EXTREME_COUNT if spec.method == "viseme" else 0,
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
        proposals=selection.scene.proposals,
    )
    together = np.concatenate([spoken.rows, designed.rows])
    return replace(
        designed,
        rows=rank_by_information(selection.scene.features, together, selection.already),
        visemes=spoken.visemes,
        extremes=spoken.extremes,
        missing=spoken.missing,
    )


def _propose(selection: _Selection, rows: IntArray) -> FloatArray:
    """Return proposed weights, from the mapping if there is one, else from the rig's geometry."""
    scene, mapping = selection.scene, selection.mapping
    positions = scene.takes.positions_at(rows).astype(np.float64)
    weights = scene.equation.propose(positions, visible=scene.takes.usable_at(rows))
    lips = find_lips(scene.equation, scene.deformer, scene.parts)
    if lips is not None:
        weights = keep_lip_contact(scene.equation, scene.deformer, lips, positions, weights)
    if mapping is not None:
        space = scene.takes.head_space(face_of_mapping(mapping))
        placed = space.place(scene.takes.markers_at(rows))
        predicted = WeightPredictor(mapping).predict(placed.positions, visible=placed.visible)
        columns = [scene.rig.shapes.index(name) for name in mapping.shape_names]
        weights[:, columns] = predicted.weights
    return weights


def _references(
    selection: _Selection, choice: ReferenceChoice, rows: IntArray, weights: FloatArray
) -> References:
    scene, spoken = selection.scene, selection.spoken
    return replace(
        scene.takes.new_references(scene.rig, rows, weights),
        motion=scene.motion,
        visemes=tuple(choice.visemes.get(row, spoken.viseme_of[row]) for row in rows.tolist()),
        emotions=tuple(spoken.emotion_of[row] for row in rows.tolist()),
        placement=selection.spec.placement or placement_path(selection.spec.out),
    )
