"""What a report tells in tables: errors, repairs, edits, and where everything came from."""

import numpy as np

from usdface.core.arrays import FloatArray
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.media.page.report_page import Listing
from usdface.model.mapping.evaluation import Evaluation, evaluate_weights
from usdface.runner.origin import provenance_of, spec_of
from usdface.steps.inputs.edit_ranges import find_edited_ranges
from usdface.steps.review.evaluation_tables import evaluation_figures, shapes_with_motion
from usdface.steps.review.pictures import Shot
from usdface.usdio.performance.read import PerformanceReader

MARKERS_TOLD = 12
EDITS_TOLD = 200
INPUT_DIGITS = 12


def evaluate_shown(shot: Shot, truth: FloatArray | None) -> Evaluation | None:
    """Measure a shot against the truth at the frames that have one; None without any."""
    if truth is None:
        return None
    known = ~np.isnan(truth).any(axis=1)
    return evaluate_weights(
        shot.rig,
        shot.weights[known],
        truth[known],
        frames=shot.frames[known],
        compared=np.ones(len(shot.rig.shapes), bool),
        observable=shapes_with_motion(shot.rig.shapes),
    )


def listings(
    shot: Shot, evaluation: Evaluation | None, provenance: Provenance
) -> tuple[Listing, ...]:
    """Return every table that has rows."""
    found = [_edits(shot), _repairs(shot), _provenance(shot, provenance)]
    if evaluation is not None:
        found[:0] = [_figures(evaluation), _regions(evaluation)]
    return tuple(each for each in found if each.rows)


def _figures(evaluation: Evaluation) -> Listing:
    said = evaluation_figures(evaluation)
    names = {
        "vertex_rms_mm": ("surface error, RMS", "mm"),
        "vertex_p95_mm": ("surface error, 95 % below", "mm"),
        "weight_rmse": ("weight error, RMS", ""),
        "lip_error_mm": ("lip opening error, RMS", "mm"),
        "blink_bias": ("blink bias", ""),
        "jitter": ("jitter, truth 1", ""),
    }
    rows = []
    for key, (label, unit) in names.items():
        value = said.get(key)
        if isinstance(value, float):
            rows.append((label, f"{value:.3f} {unit}".strip()))
    return Listing("Measured against the truth", ("figure", "value"), tuple(rows))


def _regions(evaluation: Evaluation) -> Listing:
    rows = tuple(
        (
            region.name,
            f"{region.shape_count}",
            f"{region.surface.rms_mm:.3f} mm",
            f"{region.surface.p95_mm:.3f} mm",
            f"{region.surface.max_mm:.2f} mm",
        )
        for region in evaluation.regions
    )
    return Listing("By region", ("region", "shapes", "RMS", "95 %", "most"), rows)


def _edits(shot: Shot) -> Listing:
    ranges = find_edited_ranges(PerformanceReader(shot.performance_file))
    shown = [each for each in ranges if each.shape in shot.rig.shapes][:EDITS_TOLD]
    return Listing(
        "Edits by hand",
        ("frames", "shape", "at most"),
        tuple((f"{each.first}-{each.last}", each.shape, f"{each.change:+.3f}") for each in shown),
        tuple(each.first for each in shown),
    )


def _repairs(shot: Shot) -> Listing:
    """Return the markers that cleaning had to mend or fill most, within the frames shown."""
    markers = shot.take.markers
    if markers is None:
        return Listing("Markers that were repaired", (), ())
    rows = shot.frames - shot.take.first_frame
    confidence, visible = markers.confidence[rows], markers.visible[rows]
    mended = (confidence < 1) & (confidence > 0)
    lost = ~visible | (confidence <= 0)
    share = (mended | lost).mean(axis=0)
    worst = np.argsort(-share, kind="stable")[:MARKERS_TOLD]
    told = [marker for marker in worst.tolist() if share[marker] > 0]
    first = [int(shot.frames[np.argmax((mended | lost)[:, marker])]) for marker in told]
    return Listing(
        "Markers that were repaired",
        ("first at", "marker", "mended", "lost", "mean confidence"),
        tuple(
            (
                str(at),
                markers.names[marker],
                f"{100 * mended[:, marker].mean():.1f} %",
                f"{100 * lost[:, marker].mean():.1f} %",
                f"{confidence[:, marker].mean():.2f}",
            )
            for at, marker in zip(first, told, strict=True)
        ),
        tuple(first),
    )


def _provenance(shot: Shot, page: Provenance) -> Listing:
    rows = []
    try:
        solved = provenance_of(shot.performance_file)
    except InputError:
        solved = None
    for name, each in ((shot.performance_file.name, solved), ("this page", page)):
        if each is None:
            rows.append((name, "not written by usdface", ""))
            continue
        options = ", ".join(
            f"{key} {value}" for key, value in sorted(spec_of(each).items()) if key != "step"
        )
        rows.append((name, f"usdface {each.version} {each.step}", options))
        rows += [
            (f"read: {path}", "SHA-256", digest[:INPUT_DIGITS])
            for path, digest in sorted(each.inputs.items())
        ]
    return Listing("Where it came from", ("file", "made by", "with"), tuple(rows))
