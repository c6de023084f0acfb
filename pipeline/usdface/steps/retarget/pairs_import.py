"""Make pairs from the common frames of two animations."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from usdface.core.arrays import columns_by_name
from usdface.core.assets import Rig
from usdface.core.controls import Controls, ExpressionPairs, shape_controls
from usdface.core.errors import InputError
from usdface.core.progress import Progress
from usdface.core.provenance import Provenance
from usdface.core.sidecars import is_usd_name, proposed_path
from usdface.core.text import counted, first_few, pluralize
from usdface.model.retarget.control_space import LEAST_WEIGHT, check_pairs, unused_shapes
from usdface.model.retarget.name_matching import meaning_notes
from usdface.runner.result import StepResult
from usdface.specs.retarget import PairsImportSpec
from usdface.steps.inputs.weight_tables import WeightTable, read_weight_table
from usdface.usdio.retarget.controls import (
    find_control_attributes,
    read_control_clip,
    rest_controls,
)
from usdface.usdio.retarget.pairs import keyed_above, write_pairs
from usdface.usdio.rig.read import read_rig

IMPORTED_NAME = "frame "
"""Beginning of the names of imported pairs, before the number of the frame."""


def run(spec: PairsImportSpec, *, provenance: Provenance, progress: Progress) -> StepResult:
    """Read both sides, pair them by frame, and write the asset."""
    keyed = keyed_above(spec.out) if spec.out.is_file() else ()
    if keyed:
        raise InputError(
            f"{spec.out}: keys made in it by hand, of {pluralize(len(keyed), 'attribute')} "
            f"({first_few(keyed, most=3)}), would hide the imported pairs; nothing was changed. "
            "Write to another --out, or remove these keys"
        )
    source_rig = read_rig(spec.source_rig, prim=spec.source_prim)
    target_rig = read_rig(spec.target_rig, prim=spec.target_prim)
    table, notes = _read_table(spec, spec.source, source_rig)
    frames, target, target_notes = _read_target(spec, target_rig)
    _check_sides(spec, table.frames, frames)
    progress(0.5, "read")
    order = [frames.index(frame) for frame in table.frames]
    pairs = ExpressionPairs(
        names=tuple(f"{IMPORTED_NAME}{frame}" for frame in table.frames),
        source_shapes=source_rig.shapes,
        source=table.columns(source_rig.shapes),
        target=target.rows(order),
        source_rig=source_rig.file,
        source_prim=source_rig.prim,
        target_rig=target_rig.file,
        target_prim=target_rig.prim,
    )
    check_pairs(pairs, f"{spec.source} and {spec.target}")
    pairs = _with_rest(pairs, target_rig)
    write_pairs(
        spec.out, pairs, source_rig=source_rig, target_rig=target_rig, provenance=provenance
    )
    notes += target_notes
    if len(pairs) > len(frames):
        notes.append("no frame has the source at rest: added a pair of both at rest")
    unused = unused_shapes(pairs)
    if unused:
        notes.append(f"in no pair and without effect: {counted(unused, 'source shape')}")
    return StepResult(
        (spec.out, proposed_path(spec.out)),
        f"{pluralize(len(pairs), 'pair')} of {pluralize(len(source_rig.shapes), 'source shape')} "
        f"and {target.summary}",
        tuple(notes),
        {"pairs": len(pairs), "unused": list(unused)},
    )


def _with_rest(pairs: ExpressionPairs, rig: Rig) -> ExpressionPairs:
    """Add a pair of both characters at rest if no pair has the source there."""
    target = pairs.target
    rest = rest_controls(rig, attributes=target.attributes, joints=bool(target.joints))
    rest = replace(rest, shapes=target.shapes, weights=np.zeros((1, len(target.shapes))))
    if rest.joints != target.joints or (np.abs(pairs.source) < LEAST_WEIGHT).all(axis=1).any():
        return pairs
    return replace(
        pairs,
        names=(*pairs.names, "rest"),
        source=np.vstack([pairs.source, np.zeros(pairs.source.shape[1])]),
        target=target.mapped(lambda *parts: np.concatenate(parts), rest),
    )


def _read_target(spec: PairsImportSpec, rig: Rig) -> tuple[list[int], Controls, list[str]]:
    """Return the frames of the target, its controls there, and notes on shapes by meaning."""
    if is_usd_name(spec.target):
        names = find_control_attributes(rig, spec.attributes)
        clip = read_control_clip(spec.target, attributes=names)
        # Shapes that others drive are evaluated.
        shapes = tuple(name for name in clip.controls.shapes if name not in rig.logic.driven)
        rig.check_has(shapes, source=spec.target, remedy="give the rig it animates")
        weights = columns_by_name(clip.controls.weights, clip.controls.shapes, shapes)
        controls = replace(clip.controls, shapes=shapes, weights=weights)
        return list(range(clip.first_frame, clip.last_frame + 1)), controls, []
    if spec.attributes:
        raise InputError(
            f"{spec.target}: attributes are read from USD; give the target as a .usd animation"
        )
    table, notes = _read_table(spec, spec.target, rig)
    return list(table.frames), shape_controls(rig.shapes, table.columns(rig.shapes)), notes


def _read_table(spec: PairsImportSpec, path: Path, rig: Rig) -> tuple[WeightTable, list[str]]:
    """Return weights by a rig's shapes, matched by meaning, and notes."""
    given = read_weight_table(path, unit=spec.weight_unit)
    table, transfer = given.by_meaning(rig.shapes, leave=rig.logic.driven)
    owner = f"on {rig.file}"
    table.shapes_among(rig.shapes, file=path, owner=owner)
    known = {*transfer.matched, *rig.logic.driven}
    return table, meaning_notes(transfer) + given.notes(path, known, owner=owner)


def _check_sides(spec: PairsImportSpec, source: tuple[int, ...], target: list[int]) -> None:
    for these, those, path, side in (
        (source, target, spec.target, "target"),
        (target, source, spec.source, "source"),
    ):
        missing = sorted(set(these) - set(those))
        if missing:
            raise InputError(
                f"{path}: {len(missing)} pairs have no {side}: its weights have no keys at frames "
                f"{first_few(missing)}; key both animations at the same frames"
            )
