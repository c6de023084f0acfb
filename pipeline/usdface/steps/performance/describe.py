"""Say what a mapping is."""

import math
from pathlib import Path

from usdface.core.assets import TrainedMapping
from usdface.core.errors import InputError
from usdface.media.picture.image import write_image
from usdface.model.retarget.train import describe_retargeting_figures, retargeting_table
from usdface.runner.origin import path_made_from
from usdface.runner.outputs import confine
from usdface.runner.result import StepResult
from usdface.steps.performance.eigenspace import eigenspace_picture, variance_line
from usdface.steps.performance.train import describe_figures
from usdface.usdio.mapping import read_mapping
from usdface.usdio.references.read import read_references
from usdface.usdio.retarget.retargeting import is_retargeting, read_retargeting


def describe_mapping(path: Path, *, picture: Path | None = None) -> StepResult:
    """Return a mapping's method, settings and the table of what was tried, best first.

    Parameters
    ----------
    picture : Path, optional
        Picture of the eigen-space to write.
    """
    confine("describe", reads=[path], writes=[] if picture is None else [picture])
    if is_retargeting(path):
        return _describe_retargeting(path)
    mapping = read_mapping(path)
    if picture is not None:
        _draw(mapping, path, picture)
    lines = [variance_line(mapping)]
    lines += [f"setting {name}: {value}" for name, value in sorted(mapping.settings.items())]
    for rank, score in enumerate(mapping.scores, start=1):
        surface = "" if math.isnan(score.vertex_rms_mm) else f"{score.vertex_rms_mm:.3f} mm, "
        lines.append(
            f"tried {rank}: {score.method} ({score.settings}): {surface}"
            f"{score.weight_rmse:.4f} in the weights"
        )
    return StepResult(
        () if picture is None else (picture,),
        f"{mapping.method}: {len(mapping.marker_names)} markers to {len(mapping.shape_names)} "
        f"shapes, trained on {mapping.references or 'unnamed references'}",
        tuple(lines),
        describe_figures(mapping),
    )


def _draw(mapping: TrainedMapping, path: Path, picture: Path) -> None:
    if picture.exists():
        raise InputError(f"{picture}: exists already; choose another name")
    references = path_made_from(path, "references")
    if references is None:
        raise InputError(
            f"{path}: its references are not where they were, and the picture shows them; put them "
            "back, or train again with --picture"
        )
    drawn = eigenspace_picture(mapping, read_references(references), f"eigen-space of {path.stem}")
    write_image(picture, drawn)


def _describe_retargeting(path: Path) -> StepResult:
    trained = read_retargeting(path)
    lines = [f"setting {name}: {value}" for name, value in sorted(trained.settings.items())]
    lines += [f"tried {rank}: {line}" for rank, line in enumerate(retargeting_table(trained), 1)]
    return StepResult(
        (),
        f"{trained.method}: {len(trained.source_shapes)} source shapes to {len(trained.shapes)} "
        f"shapes, {len(trained.joints)} joints and {len(trained.attributes)} attributes, trained "
        f"on {trained.pairs or 'unnamed pairs'}",
        tuple(lines),
        describe_retargeting_figures(trained),
    )
