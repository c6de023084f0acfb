"""Say what a mapping is."""

import math
from pathlib import Path

from usdface.model.retarget.train import describe_retargeting_figures, retargeting_table
from usdface.runner.outputs import confine
from usdface.runner.result import StepResult
from usdface.steps.performance.train import describe_figures
from usdface.usdio.mapping import read_mapping
from usdface.usdio.retarget.retargeting import is_retargeting, read_retargeting


def describe_mapping(path: Path) -> StepResult:
    """Return a mapping's method, settings and the table of what was tried, best first."""
    confine("describe", reads=[path])
    if is_retargeting(path):
        return _describe_retargeting(path)
    mapping = read_mapping(path)
    lines = [f"setting {name}: {value}" for name, value in sorted(mapping.settings.items())]
    for rank, score in enumerate(mapping.scores, start=1):
        surface = "" if math.isnan(score.vertex_rms_mm) else f"{score.vertex_rms_mm:.3f} mm, "
        lines.append(
            f"tried {rank}: {score.method} ({score.settings}): {surface}"
            f"{score.weight_rmse:.4f} in the weights"
        )
    return StepResult(
        (),
        f"{mapping.method}: {len(mapping.marker_names)} markers to {len(mapping.shape_names)} "
        f"shapes, trained on {mapping.references or 'unnamed references'}",
        tuple(lines),
        describe_figures(mapping),
    )


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
