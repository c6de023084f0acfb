"""Say what a mapping is."""

import math
from pathlib import Path

from usdface.steps.report import Report
from usdface.steps.train import describe_figures
from usdface.usdio.mapping import read_mapping


def describe_mapping(path: Path) -> Report:
    """Return a mapping's method, settings and the table of what was tried, best first."""
    mapping = read_mapping(path)
    lines = [f"setting {name}: {value}" for name, value in sorted(mapping.settings.items())]
    for rank, score in enumerate(mapping.scores, start=1):
        surface = "" if math.isnan(score.vertex_rms_mm) else f"{score.vertex_rms_mm:.3f} mm, "
        lines.append(
            f"tried {rank}: {score.method} ({score.settings}): {surface}"
            f"{score.weight_rmse:.4f} in the weights"
        )
    return Report(
        (),
        f"{mapping.method}: {len(mapping.marker_names)} markers to {len(mapping.shape_names)} "
        f"shapes, trained on {mapping.references or 'unnamed references'}",
        tuple(lines),
        describe_figures(mapping),
    )
