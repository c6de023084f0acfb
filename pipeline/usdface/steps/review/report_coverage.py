"""In a report: how well the references that a mapping learned from cover the take."""

import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from usdface.core.arrays import FloatArray, IntArray
from usdface.core.errors import InputError
from usdface.core.progress import Progress
from usdface.media.page.report_page import Listing, PagePicture, Strip
from usdface.media.picture.image import write_image
from usdface.runner.origin import path_made_from
from usdface.runner.sandbox import confine
from usdface.specs.references import ReferencesCoverageSpec
from usdface.specs.review import ReportSpec
from usdface.steps.inputs.coverage_report import holes_of
from usdface.steps.references.coverage import MeasuredCoverage, measure
from usdface.steps.review.pictures import Shot


@dataclass(frozen=True)
class ShownCoverage:
    """What a page shows of coverage.

    Attributes
    ----------
    strip : Strip
        Share of the motion that the references determine, picture by picture.
    listings : tuple of Listing
    picture : PagePicture
    """

    strip: Strip
    listings: tuple[Listing, ...]
    picture: PagePicture


def show_coverage(
    spec: ReportSpec, shot: Shot, rows: IntArray, notes: list[str], progress: Progress
) -> ShownCoverage | None:
    """Measure how the references cover a shot; None where they are not known.

    Parameters
    ----------
    spec : ReportSpec
    shot : Shot
    rows : (pictures,) int array
        Row of the shot that each picture shows.
    notes : list of str
        Added to, where references are known and cannot be used.
    progress : callable

    Raises
    ------
    InputError
        If references that were asked for cannot be used.
    """
    references = spec.references or find_references(shot.performance_file)
    if references is None:
        return None
    try:
        if spec.references is None:
            confine("report", reads=[references])
        measured = measure(
            ReferencesCoverageSpec(
                references=references, takes=(spec.take,), out=Path("coverage.png")
            ),
            progress=progress,
        )
    except InputError as error:
        if spec.references is not None:
            raise
        notes.append(f"coverage is left out: {error}")
        return None
    covered = measured.covered.coverage
    own: FloatArray = covered.covered[shot.frames - shot.take.first_frame]
    return ShownCoverage(
        Strip("covered", own[rows], 0.0, 1.0, "by references"),
        (_shares(measured, references), _next(measured)),
        PagePicture(
            "Coverage", f"Coverage by {references.name}", _png(measured, references), "image/png"
        ),
    )


def find_references(performance: Path) -> Path | None:
    """Return the references that a performance's mapping was trained on; None if not there."""
    mapping = path_made_from(performance, "mapping")
    return None if mapping is None else path_made_from(mapping, "references")


def _shares(measured: MeasuredCoverage, references: Path) -> Listing:
    coverage = measured.covered.coverage
    rows = [
        ("pairs", f"{len(measured.pairs)}"),
        ("of them frames of this take, tuned", f"{len(measured.tuned)}"),
        ("motion of the take covered", f"{100 * coverage.share:.1f} %"),
        ("frames that are holes", f"{100 * coverage.hole_share:.1f} %"),
    ]
    if len(coverage.regions) > 1:
        means = coverage.region_covered.mean(axis=0).tolist()
        rows += [
            (f"{region} covered", f"{100 * mean:.1f} %")
            for region, mean in zip(coverage.regions, means, strict=True)
        ]
    return Listing(f"Covered by {references.name}", ("figure", "value"), tuple(rows))


def _next(measured: MeasuredCoverage) -> Listing:
    holes = holes_of(measured.covered, measured.takes)
    return Listing(
        "Tune these next",
        ("frame", "covered now", "take covered then"),
        tuple(
            (str(hole.frame), f"{100 * hole.covered:.1f} %", f"{100 * hole.share:.1f} %")
            for hole in holes
        ),
        tuple(hole.frame for hole in holes),
    )


def _png(measured: MeasuredCoverage, references: Path) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "coverage.png"
        write_image(file, np.ascontiguousarray(measured.picture(references.stem)))
        return file.read_bytes()
