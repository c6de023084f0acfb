"""Tables of a report: errors, repairs, edits, coverage and provenance."""

from pathlib import Path

import numpy as np

from usdface.core.arrays import FloatArray
from usdface.core.errors import InputError
from usdface.core.progress import silent
from usdface.core.provenance import Provenance
from usdface.media.page.report_page import Listing, PagePicture
from usdface.media.picture.image import encode_image
from usdface.model.mapping.coverage import LEAST_COVERAGE
from usdface.model.mapping.evaluation import Evaluation, evaluate_weights
from usdface.runner.origin import find_take, path_made_from, provenance_of, spec_of
from usdface.runner.outputs import confine
from usdface.specs.review import ReportSpec
from usdface.steps.inputs.coverage_report import TakesCoverage, measure_pairs
from usdface.steps.inputs.edit_ranges import find_edited_ranges
from usdface.steps.review.evaluation_tables import evaluation_figures
from usdface.steps.review.shot import Shot
from usdface.usdio.performance.read import PerformanceReader

_LISTED_MARKERS = 12
_LISTED_EDITS = 200
INPUT_DIGITS = 12


def listings(shot: Shot, truth: FloatArray | None, provenance: Provenance) -> tuple[Listing, ...]:
    """Return every table that has rows; errors are measured at the frames that have keys."""
    found = [_edits(shot), _repairs(shot), _provenance(shot, provenance)]
    if truth is not None:
        known = ~np.isnan(truth).any(axis=1)
        evaluation = evaluate_weights(
            shot.rig,
            shot.weights[known],
            truth[known],
            frames=shot.frames[known],
            compared=np.ones(len(shot.rig.shapes), bool),
        )
        found[:0] = [_figures(evaluation), _regions(evaluation)]
    return tuple(each for each in found if each.rows)


def _figures(evaluation: Evaluation) -> Listing:
    figures = evaluation_figures(evaluation)
    names = {
        "skin_mean_mm": ("error of the skin, without gaze and tongue, mean", "mm"),
        "skin_p95_mm": ("error of the skin, 95th percentile", "mm"),
        "gaze_mean_mm": ("gaze alone, mean", "mm"),
        "tongue_mean_mm": ("tongue alone, mean", "mm"),
        "weight_rmse": ("weight error, RMS", ""),
        "lip_error_mm": ("lip opening error, RMS", "mm"),
        "blink_bias": ("blink bias", ""),
        "jitter": ("jitter, over that of the keys", ""),
    }
    rows = []
    for key, (label, unit) in names.items():
        value = figures.get(key)
        if isinstance(value, float):
            rows.append((label, f"{value:.3f} {unit}".strip()))
    return Listing("Measured against the keys", ("figure", "value"), tuple(rows))


def _regions(evaluation: Evaluation) -> Listing:
    rows = tuple(
        (
            region.name,
            f"{region.shape_count}",
            f"{region.skin.mean_mm:.3f} mm",
            f"{region.skin.p95_mm:.3f} mm",
            f"{region.skin.max_mm:.2f} mm",
        )
        for region in evaluation.regions
    )
    return Listing("By region", ("region", "shapes", "mean", "95th percentile", "largest"), rows)


def _edits(shot: Shot) -> Listing:
    ranges = find_edited_ranges(PerformanceReader(shot.performance_file))
    shown = [each for each in ranges if each.shape in shot.rig.shapes][:_LISTED_EDITS]
    return Listing(
        "Edits by hand",
        ("frames", "shape", "largest"),
        tuple((f"{each.first}-{each.last}", each.shape, f"{each.change:+.3f}") for each in shown),
        tuple(each.first for each in shown),
    )


def _repairs(shot: Shot) -> Listing:
    """Return the markers that cleaning repaired most, within the frames shown."""
    markers = shot.take.markers
    if markers is None:
        return Listing("Markers that were repaired", (), ())
    rows = shot.frames - shot.take.first_frame
    confidence, visible = markers.confidence[rows], markers.visible[rows]
    repaired = (confidence < 1) & (confidence > 0)
    missing = ~visible | (confidence <= 0)
    share = (repaired | missing).mean(axis=0)
    worst = np.argsort(-share, kind="stable")[:_LISTED_MARKERS]
    listed = [marker for marker in worst.tolist() if share[marker] > 0]
    first = [int(shot.frames[np.argmax((repaired | missing)[:, marker])]) for marker in listed]
    return Listing(
        "Markers that were repaired",
        ("first at", "marker", "filled or relabelled", "missing", "mean confidence"),
        tuple(
            (
                str(at),
                markers.names[marker],
                f"{repaired[:, marker].mean():.1%}",
                f"{missing[:, marker].mean():.1%}",
                f"{confidence[:, marker].mean():.2f}",
            )
            for at, marker in zip(first, listed, strict=True)
        ),
        tuple(first),
    )


def _provenance(shot: Shot, page: Provenance) -> Listing:
    rows = []
    solved = provenance_of(shot.performance_file)
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
    return Listing("Provenance", ("file", "made by", "with"), tuple(rows))


def show_coverage(
    spec: ReportSpec, shot: Shot, notes: list[str]
) -> tuple[tuple[Listing, ...], tuple[PagePicture, ...]]:
    """Return tables and a picture of the coverage of a shot by its references.

    Without references of markers there are none; if it cannot be measured, there is a note.
    """
    references = spec.references or find_references(shot.performance_file)
    if references is None or shot.take.markers is None:
        return (), ()
    try:
        if spec.references is None:
            confine("report", reads=[references])
        takes = (find_take(spec.performance, spec.take),)
        measured = measure_pairs(references, takes, progress=silent)
    except InputError as error:
        if spec.references is not None:
            raise
        notes.append(f"coverage is left out: {error}")
        return (), ()
    picture = PagePicture(
        "Coverage",
        f"Coverage by {references.name}",
        encode_image(measured.picture(references.stem), "png"),
        "image/png",
    )
    return (_shares(measured, references), _next(measured)), (picture,)


def find_references(performance: Path) -> Path | None:
    """Return the references that a performance's mapping was trained on, if they exist."""
    mapping = path_made_from(performance, "mapping")
    mapping = mapping or path_made_from(performance, "retargeting")
    return None if mapping is None else path_made_from(mapping, "references")


def _shares(measured: TakesCoverage, references: Path) -> Listing:
    coverage = measured.frames
    rows = [
        ("pairs", f"{len(measured.pairs)}"),
        ("tuned pairs of this take", f"{len(measured.tuned)}"),
        ("mean coverage", f"{coverage.mean:.0%}"),
        (f"frames with {LEAST_COVERAGE:.0%} or more", f"{coverage.sufficient_share:.0%}"),
    ]
    if len(coverage.regions) > 1:
        means = coverage.by_region.mean(axis=0).tolist()
        rows += [
            (f"mean coverage, {region}", f"{mean:.0%}")
            for region, mean in zip(coverage.regions, means, strict=True)
        ]
    return Listing(f"Coverage by {references.name}", ("figure", "value"), tuple(rows))


def _next(measured: TakesCoverage) -> Listing:
    frames = measured.next_frames()
    return Listing(
        "Tune next",
        ("frame", "coverage", "mean coverage, once tuned"),
        tuple(
            (str(each.frame), f"{each.coverage:.0%}", f"{each.mean_then:.1%}") for each in frames
        ),
        tuple(each.frame for each in frames),
    )
