"""Measure the error of a performance against keys."""

import numpy as np

from usdface.core.arrays import FloatArray, IntArray, columns_by_name
from usdface.core.errors import InputError
from usdface.core.progress import Progress
from usdface.core.provenance import Provenance
from usdface.media.charts.evaluation import draw_evaluation
from usdface.media.picture.image import write_measurements
from usdface.model.mapping.evaluation import evaluate_weights
from usdface.runner.origin import take_name
from usdface.runner.result import StepResult
from usdface.specs.paths import frame_range
from usdface.specs.review import EvaluateSpec
from usdface.steps.inputs.weight_tables import WeightTable, missing_shape_notes
from usdface.steps.review.evaluation_tables import (
    evaluation_figures,
    evaluation_page,
    evaluation_summary,
    evaluation_table,
)
from usdface.steps.review.scoring import read_key_table
from usdface.usdio.performance.read import PerformanceReader, performance_of
from usdface.usdio.rig.reference import read_rig_of_stage
from usdface.usdio.rig.rig_motion import RigMotion


def run(spec: EvaluateSpec, *, provenance: Provenance, progress: Progress) -> StepResult:
    """Measure the performance and write figures and curves."""
    reader = PerformanceReader(spec.performance)
    solved = performance_of(reader).weights
    rig = read_rig_of_stage(reader.stage, reader.animation)
    table, notes = read_key_table(
        spec.against,
        rig,
        solved,
        unit=spec.weight_unit,
        take=take_name(spec.performance),
        performance=spec.performance,
    )
    frames = reader.frames
    truth = table.at_frames(frames, rig.shapes)
    rows = _common_rows(spec, frames, truth, table)
    progress(0.4, "measuring")
    names = np.array(rig.shapes)
    evaluation = evaluate_weights(
        rig,
        columns_by_name(solved.values[rows], solved.names, rig.shapes),
        truth[rows],
        frames=frames[rows],
        compared=np.isin(names, solved.names) | np.isin(names, table.names),
    )
    figures = evaluation_figures(evaluation)
    progress(0.8, "writing")
    title = f"{spec.performance.stem} against {spec.against.stem}"
    write_measurements(
        spec.out,
        {"performance": str(spec.performance), "against": str(spec.against), **figures},
        lambda: draw_evaluation(evaluation_page(evaluation, title=title)),
        metadata=provenance.metadata,
    )
    notes += _missing_notes(spec, table.frames, len(frames))
    notes += missing_shape_notes(
        spec.performance, solved.names, [name for name in table.names if name in rig.shapes]
    )
    if RigMotion(spec.performance, rig).shares.nnz:
        notes.append(
            f"{spec.performance.name} moves joints or Xforms, whose error is not measured: compare "
            "them with `usdface faces`"
        )
    return StepResult(
        spec.out,
        evaluation_summary(evaluation),
        tuple(notes),
        figures,
        table=evaluation_table(evaluation),
    )


def _common_rows(
    spec: EvaluateSpec, frames: IntArray, truth: FloatArray, table: WeightTable
) -> IntArray:
    """Return the rows of the performance's frames that are keyed and within --frames."""
    keyed = ~np.isnan(truth).any(axis=1)
    limits = frame_range(spec.frames)
    if limits is not None:
        keyed &= (frames >= limits[0]) & (frames <= limits[1])
    if not keyed.any():
        within = f" in {spec.frames}" if spec.frames else ""
        raise InputError(
            f"{spec.performance} (frames {frames[0]}-{frames[-1]}) and {spec.against} (frames "
            f"{min(table.frames)}-{max(table.frames)}) have no common frame{within}; give keys of "
            "the same take"
        )
    return np.flatnonzero(keyed)


def _missing_notes(spec: EvaluateSpec, keyed: tuple[int, ...], count: int) -> list[str]:
    """Return a note if a table with a row for every frame ends before the performance."""
    if spec.frames or len(keyed) < 2 or len(keyed) >= count or (np.diff(np.sort(keyed)) > 1).any():
        return []
    return [f"{spec.against.name} has {len(keyed)} of the {count} frames; the others have no keys"]
