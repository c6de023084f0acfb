"""Measure the error of a performance against keys."""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import BoolArray, FloatArray, IntArray, columns_by_name
from usdface.core.assets import Performance, Rig
from usdface.core.errors import InputError
from usdface.core.progress import Progress
from usdface.core.provenance import Provenance
from usdface.core.replacing import write_text
from usdface.core.text import json_text
from usdface.media.charts.evaluation import draw_evaluation
from usdface.media.picture.image import write_image
from usdface.model.mapping.evaluation import Evaluation, evaluate_weights
from usdface.model.retarget.name_matching import meaning_notes
from usdface.runner.origin import take_name
from usdface.runner.result import StepResult
from usdface.specs.paths import frame_range
from usdface.specs.review import EvaluateSpec
from usdface.steps.inputs.weight_tables import WeightTable, missing_shape_notes, read_weight_table
from usdface.steps.review.evaluation_tables import (
    evaluation_figures,
    evaluation_page,
    evaluation_summary,
    evaluation_table,
)
from usdface.usdio.performance.read import PerformanceReader, read_performance
from usdface.usdio.rig.reference import read_rig_of_stage


@dataclass(frozen=True)
class _Comparison:
    """Weights of both sides at their common frames, in the rig's order of shapes."""

    frames: IntArray
    solved: FloatArray
    truth: FloatArray
    compared: BoolArray
    notes: tuple[str, ...]


def run(spec: EvaluateSpec, *, provenance: Provenance, progress: Progress) -> StepResult:
    """Measure the performance and write figures and curves."""
    performance = read_performance(spec.performance)
    reader = PerformanceReader(spec.performance)
    rig = read_rig_of_stage(reader.stage, reader.animation)
    given = read_weight_table(
        spec.against, known=rig.shapes, unit=spec.weight_unit, take=take_name(spec.performance)
    )
    comparison = _compare(spec, performance, given, rig)
    progress(0.4, "measuring")
    evaluation = evaluate_weights(
        rig,
        comparison.solved,
        comparison.truth,
        frames=comparison.frames,
        compared=comparison.compared,
    )
    figures = evaluation_figures(evaluation)
    progress(0.8, "writing")
    _write(spec, evaluation, figures, provenance)
    return StepResult(
        spec.out,
        evaluation_summary(evaluation),
        comparison.notes,
        figures,
        table=evaluation_table(evaluation),
    )


def _compare(
    spec: EvaluateSpec, performance: Performance, given: WeightTable, rig: Rig
) -> _Comparison:
    clip = performance.weights
    given.check_rate(clip.rate, file=spec.against, performance=spec.performance)
    truth, transfer = given.by_meaning(rig.shapes, leave=rig.logic.driven)
    truth.check_numbering(clip, columns=rig.shapes, file=spec.against, performance=spec.performance)
    keyed = truth.shapes_among(rig.shapes, file=spec.against, owner=f"on {rig.file}")
    solved_frames = np.arange(clip.first_frame, clip.first_frame + len(clip.values), dtype=np.int64)
    truth_frames = np.array(truth.frames, dtype=np.int64)
    frames, solved_rows, truth_rows = np.intersect1d(
        solved_frames, truth_frames, assume_unique=True, return_indices=True
    )
    limits = frame_range(spec.frames)
    if limits is not None:
        inside = (frames >= limits[0]) & (frames <= limits[1])
        frames, solved_rows, truth_rows = frames[inside], solved_rows[inside], truth_rows[inside]
    if not len(frames):
        within = f" in {spec.frames}" if spec.frames else ""
        raise InputError(
            f"{spec.performance} (frames {solved_frames[0]}-{solved_frames[-1]}) and "
            f"{spec.against} (frames {truth_frames.min()}-{truth_frames.max()}) have no common "
            f"frame{within}; give keys of the same take"
        )
    names = np.array(rig.shapes)
    known = {*transfer.matched, *rig.logic.driven}
    either = np.isin(names, clip.names) | np.isin(names, keyed)
    return _Comparison(
        frames=frames,
        solved=columns_by_name(clip.values[solved_rows], clip.names, rig.shapes),
        truth=columns_by_name(truth.weights[truth_rows], truth.names, rig.shapes),
        compared=either,
        notes=(
            *meaning_notes(transfer),
            *given.notes(spec.against, known, owner="on the rig"),
            *_missing_notes(spec, truth_frames, len(solved_frames)),
            *missing_shape_notes(spec.performance, clip.names, _on(rig, truth.names)),
            *missing_shape_notes(spec.against, truth.names, _on(rig, clip.names)),
        ),
    )


def _on(rig: Rig, names: tuple[str, ...]) -> list[str]:
    return [name for name in names if name in rig.shapes]


def _missing_notes(spec: EvaluateSpec, keyed: IntArray, count: int) -> list[str]:
    """Return a note if a table with a row for every frame ends before the performance."""
    if spec.frames or len(keyed) < 2 or len(keyed) >= count or (np.diff(np.sort(keyed)) > 1).any():
        return []
    return [f"{spec.against.name} has {len(keyed)} of the {count} frames; the others have no keys"]


def _write(
    spec: EvaluateSpec,
    evaluation: Evaluation,
    figures: dict[str, object],
    provenance: Provenance,
) -> None:
    made = provenance.metadata
    for path in spec.out:
        if path.suffix.lower() == ".json":
            data = {
                "performance": str(spec.performance),
                "against": str(spec.against),
                **figures,
                "provenance": made,
            }
            write_text(path, json_text(data))
        else:
            title = f"{spec.performance.stem} against {spec.against.stem}"
            page = evaluation_page(evaluation, title=title)
            write_image(path, draw_evaluation(page), metadata=made)
