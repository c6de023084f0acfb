"""Define which shapes of a rig are driven by others."""

from fnmatch import fnmatchcase
from pathlib import Path

from usdface.core.arrays import columns_by_name
from usdface.core.errors import InputError
from usdface.core.progress import Progress, silent
from usdface.core.provenance import Provenance
from usdface.core.rig_logic import Combination, order_combinations
from usdface.core.text import first_few, pluralize
from usdface.numerics.regression.combination_inference import infer_combinations
from usdface.runner.result import StepResult
from usdface.specs.surface import LogicSpec
from usdface.steps.inputs.weight_tables import read_weight_table
from usdface.steps.surface.logic_sources import (
    combinations_of_metadata,
    combinations_of_names,
    merged,
    read_definition,
)
from usdface.usdio.rig.read import read_rig, shape_metadata
from usdface.usdio.rig.write import write_logic

_MOST_ROWS = 2000
"""Rows of weights used for inference, evenly spread."""


def run(spec: LogicSpec, *, provenance: Provenance, progress: Progress = silent) -> StepResult:
    """Read the logic, check it against the rig and write an asset over the rig."""
    rig = read_rig(spec.rig, prim=spec.prim)
    shapes = (*rig.shapes, *(each.shape for each in rig.combinations))
    sources = []
    if spec.naming:
        sources.append(combinations_of_names(shapes))
    if spec.definition is not None:
        sources.append(read_definition(spec.definition))
    if spec.metadata is not None:
        sources.append(combinations_of_metadata(shape_metadata(spec.rig, rig.prim, spec.metadata)))
    notes = []
    if spec.weights is not None:
        inferred, note = _inferred(spec, spec.weights, shapes)
        sources.append(inferred)
        notes.append(note)
    new = merged(sources)
    if not new:
        raise InputError(
            f"{spec.rig}: none of its {pluralize(len(shapes), 'shape')} is a combination by the "
            "given sources; nothing was written. Give another source"
        )
    stated = {each.shape for each in new}
    kept = [each for each in rig.combinations if each.shape not in stated]
    every = order_combinations((*new, *kept), shapes, source=spec.definition or spec.rig)
    write_logic(spec.out, rig, every, provenance=provenance)
    progress(1.0, "written")
    driven = {each.shape for each in every}
    return StepResult(
        (spec.out,),
        f"{pluralize(len(every), 'combination')}; {len(shapes) - len(driven)} of "
        f"{pluralize(len(shapes), 'shape')} are animated",
        (*notes, *map(str, every[: spec.listed]), *_rest(every, spec.listed)),
        {"combinations": [_figures(each) for each in every]},
    )


def _rest(combinations: tuple[Combination, ...], listed: int) -> list[str]:
    more = len(combinations) - listed
    return [f"and {more} more; --json lists all"] if more > 0 else []


def _figures(combination: Combination) -> dict[str, object]:
    return {
        "shape": combination.shape,
        "parts": list(combination.parts),
        "mode": combination.mode,
        "weights": list(combination.part_weights),
        "spans": [list(span) for span in combination.spans],
    }


def _inferred(
    spec: LogicSpec, weights: Path, shapes: tuple[str, ...]
) -> tuple[tuple[Combination, ...], str]:
    """Infer the logic of the shapes of --driven from weights."""
    driven = [name for name in shapes if any(fnmatchcase(name, each) for each in spec.driven)]
    if not driven:
        raise InputError(
            f"{spec.rig}: --driven matches none of its shapes ({first_few(shapes, most=3)}); name "
            "the driven shapes"
        )
    table = read_weight_table(weights, known=shapes, unit=spec.weight_unit)
    table.shapes_among(driven, file=weights, owner="among those driven")
    rows = table.weights[:: -(-len(table.weights) // _MOST_ROWS)]
    free = tuple(name for name in shapes if name not in driven and name in table.names)
    found = infer_combinations(
        free,
        columns_by_name(rows, table.names, free),
        driven,
        columns_by_name(rows, table.names, driven),
    )
    left = [name for name in driven if name not in {each.shape for each in found}]
    note = f"inferred {len(found)} of {len(driven)} from {pluralize(len(rows), 'row')}"
    if left:
        note += f"; {first_few(left)} stay animated, as they are at rest or follow no known rule"
    return found, note
