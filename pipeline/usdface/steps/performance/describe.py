"""Describe a trained mapping or retargeting."""

import math
from collections.abc import Sequence
from pathlib import Path

from usdface.core.text import aligned_rows, pluralize
from usdface.model.retarget.train import describe_retargeting_figures
from usdface.runner.outputs import confine
from usdface.runner.result import StepResult
from usdface.steps.performance.train import describe_figures, variance_line
from usdface.usdio.mapping import read_mapping
from usdface.usdio.retarget.retargeting import is_retargeting, read_retargeting


def describe_mapping(path: Path) -> StepResult:
    """Return method, settings and scores of a mapping."""
    confine("describe", reads=[path])
    if is_retargeting(path):
        return _describe_retargeting(path)
    mapping = read_mapping(path)
    head = ("method", "surface, mm", "weights, RMSE", "settings")
    tried = [
        (
            score.method,
            "unknown" if math.isnan(score.vertex_rms_mm) else f"{score.vertex_rms_mm:.3f}",
            f"{score.weight_rmse:.4f}",
            score.settings,
        )
        for score in mapping.scores
    ]
    return StepResult(
        (),
        f"{mapping.method}: {len(mapping.marker_names)} markers to {len(mapping.shape_names)} "
        f"shapes, trained on {mapping.references or 'unnamed references'}",
        (),
        describe_figures(mapping),
        (variance_line(mapping), *_table(mapping.settings, head, tried)),
    )


def _describe_retargeting(path: Path) -> StepResult:
    trained = read_retargeting(path)
    head = ("method", "round trip", "pairs missed, of range", "overshoot", "settings")
    tried = [
        (s.method, f"{s.cyclic_mm:.4f}", f"{s.pair_error:.4f}", f"{s.overshoot:.0%}", s.settings)
        for s in trained.scores
    ]
    return StepResult(
        (),
        f"{trained.method}: {len(trained.source_shapes)} source shapes to {len(trained.shapes)} "
        f"shapes, {len(trained.joints)} joints and {len(trained.attributes)} attributes, trained "
        f"on {trained.pairs or 'unnamed pairs'}",
        (),
        describe_retargeting_figures(trained),
        _table(trained.settings, head, tried),
    )


def _table(
    settings: dict[str, float | int | str | bool],
    head: tuple[str, ...],
    tried: Sequence[tuple[str, ...]],
) -> tuple[str, ...]:
    """Return settings and scores as aligned lines, with the best, first score of each method."""
    best = {row[0]: row for row in reversed(tried)}
    rows = [row for row in tried if best[row[0]] is row]
    lines = aligned_rows(
        [
            (name.replace("_", " "), f"{value:.6g}" if isinstance(value, float) else str(value))
            for name, value in sorted(settings.items())
            if value != ""
        ]
    )
    if rows:
        lines += ["", "cross-validation, the best of each method:", *aligned_rows([head, *rows])]
    if len(rows) < len(tried):
        lines.append(f"and {pluralize(len(tried) - len(rows), 'other setting')}; --json lists them")
    return tuple(lines)
