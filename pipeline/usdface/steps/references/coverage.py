"""Measure and draw the coverage of takes by references."""

from pathlib import Path

from usdface.core.errors import InputError
from usdface.core.progress import Progress
from usdface.core.provenance import Provenance
from usdface.core.sidecars import coverage_path
from usdface.media.picture.image import write_image
from usdface.model.mapping.coverage import LEAST_COVERAGE
from usdface.runner.origin import provenance_of, spec_of
from usdface.runner.outputs import confine
from usdface.runner.result import StepResult
from usdface.specs.references import ReferencesCoverageSpec
from usdface.steps.inputs.coverage_report import measure_pairs

_NAMED_FRAMES = 3
"""Suggested frames listed in notes; figures and picture have all."""


def run(spec: ReferencesCoverageSpec, *, provenance: Provenance, progress: Progress) -> StepResult:
    """Measure the coverage of the takes by the pairs, and draw it."""
    measured = measure_pairs(
        spec.references, spec.takes, tuned_only=spec.tuned_only, progress=progress
    )
    pairs, coverage = measured.pairs, measured.frames
    progress(0.9, f"writing {spec.out.name}")
    picture = measured.picture(spec.references.stem)
    write_image(spec.out, picture, metadata=provenance.metadata)
    notes = []
    if len(measured.rows) < len(pairs):
        notes.append(
            f"{len(pairs) - len(measured.rows)} of {len(pairs)} pairs are of other takes, and "
            "count by their markers"
        )
    notes += [
        f"with frame {each.frame} of {each.take}, mean coverage would be {each.mean_then:.0%}"
        for each in measured.next_frames()[:_NAMED_FRAMES]
    ]
    notes += measured.notes
    return StepResult(
        (spec.out,),
        f"{len(pairs)} pairs, {measured.tuned_count} of them tuned: mean coverage "
        f"{coverage.mean:.0%}, {LEAST_COVERAGE:.0%} or more in {coverage.sufficient_share:.0%} of "
        f"{len(measured.takes.frames)} frames",
        tuple(notes),
        {
            "pairs": [pair + 1 for pair in pairs.tolist()],
            "of_other_takes": len(pairs) - len(measured.rows),
            **measured.figures(),
        },
    )


def redraw_coverage(references: Path, progress: Progress) -> tuple[tuple[Path, ...], list[str]]:
    """Draw `select`'s picture of the coverage again, of the current pairs, with its provenance.

    Returns the picture, if there is one, and a note if it cannot be drawn.
    """
    made = spec_of(provenance_of(references))
    picture = references.parent / str(made.get("picture") or coverage_path(references).name)
    origin = provenance_of(picture) if picture.is_file() else None
    if origin is None or origin.step != "select":
        return (), []
    takes = tuple(references.parent / str(name) for name in spec_of(origin).get("takes", ()))
    try:
        confine("references coverage", reads=takes, writes=[picture])
        measured = measure_pairs(references, takes, progress=progress)
    except InputError as error:
        return (), [f"{picture.name} was not drawn again, and is out of date: {error}"]
    write_image(picture, measured.picture(references.stem), metadata=origin.metadata)
    return (picture,), []
