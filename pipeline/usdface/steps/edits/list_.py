"""List the edits of a performance, and where the solve has changed since."""

from pathlib import Path

import numpy as np

from usdface.core.text import pluralize
from usdface.runner.outputs import confine
from usdface.runner.result import StepResult
from usdface.steps.inputs.edit_ranges import NOTABLE_CHANGE, EditedRange, find_edited_ranges
from usdface.usdio.performance.read import PerformanceReader

_LISTED_RANGES = 60
"""Largest number of printed ranges; an import can make thousands."""


def list_edit_ranges(performance: Path, *, prim: str | None = None) -> StepResult:
    """Return the edited ranges of a performance, and changes of the solve since the edits."""
    confine("edits list", reads=[performance])
    reader = PerformanceReader(performance, prim=prim)
    ranges = find_edited_ranges(reader)
    largest = sorted(ranges, key=_weight, reverse=True)[:_LISTED_RANGES]
    table = tuple(
        f"{each.shape} {each.first}-{each.last}: {each.change:+.2f}"
        + (
            f"; the solve has since changed by {each.solve_change:+.2f} at frame {each.solve_frame}"
            if abs(each.solve_change) > NOTABLE_CHANGE
            else ""
        )
        for each in ranges
        if each in largest
    )
    if len(ranges) > _LISTED_RANGES:
        table += (f"and {len(ranges) - _LISTED_RANGES} smaller ones; --json lists them all",)
    changed = sum(abs(each.solve_change) > NOTABLE_CHANGE for each in ranges)
    shapes = {each.shape for each in ranges}
    summary = f"{pluralize(len(ranges), 'edited range')} of {pluralize(len(shapes), 'shape')}"
    if changed:
        summary += f"; the solve of {changed} has changed since"
    figures = [
        {
            "shape": each.shape,
            "first": each.first,
            "last": each.last,
            "change": each.change,
            "solve_change": each.solve_change if np.isfinite(each.solve_change) else None,
            "solve_frame": each.solve_frame,
        }
        for each in ranges
    ]
    return StepResult((), summary, table=table, figures={"edits": figures})


def _weight(edited: EditedRange) -> float:
    """Return the larger of the edit and the change of the solve."""
    return float(np.nanmax(np.abs([edited.change, edited.solve_change])))
