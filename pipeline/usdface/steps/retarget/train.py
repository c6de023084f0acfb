"""Train a retargeting on expression pairs."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from usdface.core.arrays import BoolArray, FloatArray, columns_by_name
from usdface.core.assets import Rig
from usdface.core.controls import ExpressionPairs, Retargeting, shape_controls
from usdface.core.deformer import Deformer
from usdface.core.errors import InputError
from usdface.core.progress import Progress
from usdface.core.provenance import Provenance
from usdface.core.text import counted, first_few, pluralize
from usdface.model.placement.shape_parts import shape_parts
from usdface.model.retarget.control_space import (
    check_pairs,
    constant_controls,
    find_pair_conflicts,
    inseparable_sides,
    unused_shapes,
)
from usdface.model.retarget.cyclic import sampled_displacements
from usdface.model.retarget.name_matching import transfer_by_names
from usdface.model.retarget.pair_doubts import PairDoubt, find_pair_doubts, find_unkeyed_regions
from usdface.model.retarget.train import (
    describe_retargeting_figures,
    retargeting_table,
    train_retargeting,
)
from usdface.runner.result import StepResult
from usdface.specs.retarget import TrainRetargetSpec
from usdface.steps.inputs.source_motion import read_source_motion, source_columns
from usdface.usdio.references.weight_layers import read_keyed_references
from usdface.usdio.retarget.pairs import read_pairs
from usdface.usdio.retarget.retargeting import write_retargeting
from usdface.usdio.rig.read import read_rig

_LOST_WEIGHT = 0.1
"""Smallest weight of a source shape whose loss is reported."""

LISTED_CONFLICTS = 5
"""Conflicts, and pairs that may be wrong, listed in notes."""


def run(spec: TrainRetargetSpec, *, provenance: Provenance, progress: Progress) -> StepResult:
    """Train the retargeting and write it."""
    pairs = read_pairs(spec.pairs)
    notes: list[str] = []
    if spec.references is not None:
        pairs, notes = _with_tuned(pairs, spec.references)
    check_pairs(pairs, str(spec.pairs))
    notes += pair_notes(pairs)
    progress(0.0, "comparing the faces of the pairs")
    source = _rig(pairs.source_rig, pairs.source_prim)
    target = _rig(pairs.target_rig, pairs.target_prim)
    doubts = _doubts(pairs, source, target)
    unkeyed = find_unkeyed_regions(
        pairs, _parts(source, pairs.source_shapes), _parts(target, pairs.target.shapes)
    )
    notes += [*_doubt_notes(pairs, doubts), *_unkeyed_notes(unkeyed)]
    performance = None
    if spec.source is not None:
        motion = read_source_motion(spec.source)
        performance, source_notes = source_columns(spec.source, motion, pairs.source_shapes)
        notes += source_notes
    surface = source_surface(pairs)
    if surface is None:
        notes.append(
            "the source's rig is not known, so errors were compared in weights, not millimetres"
        )
    trained = train_retargeting(
        pairs,
        method=spec.method,
        shape_ranges=target_ranges(pairs),
        surface=surface,
        performance=performance,
        alpha=spec.alpha,
        published=spec.published,
        progress=progress,
    )
    for moved, _ in unkeyed.values():
        trained.arrays["unfollowed"] += moved
    trained = replace(trained, pairs=spec.pairs.name)
    write_retargeting(spec.out, trained, provenance=provenance)
    return StepResult(
        (spec.out,),
        _summary(
            trained,
            pairs,
            unit="mm on the source's surface" if surface is not None else "in the weights",
            probes="mixtures of the pairs" if performance is None else "the performance",
        ),
        tuple(notes),
        describe_retargeting_figures(trained)
        | {
            "unused": list(unused_shapes(pairs)),
            "conflicts": [[each.first + 1, each.second + 1] for each in find_pair_conflicts(pairs)],
            "doubted": [each.pair + 1 for each in doubts],
            "unkeyed": {region: list(controls) for region, (_, controls) in unkeyed.items()},
        },
        table=retargeting_table(trained),
    )


def _with_tuned(pairs: ExpressionPairs, path: Path) -> tuple[ExpressionPairs, list[str]]:
    """Add the tuned pairs of references; return a note on source shapes that no pair has."""
    references, target = read_keyed_references(path), pairs.target
    tuned = np.flatnonzero(references.tuned)
    if references.source is None:
        raise InputError(
            f"{path}: its takes have markers, for `usdface train`; give references of takes that "
            "carry weights"
        )
    if not len(tuned):
        raise InputError(f"{path}: no pair is tuned; tune some, or leave out --references")
    if target.joints or target.attributes:
        raise InputError(
            f"{path}: holds only weights, but the pairs key {target.summary} of the target; key "
            "these frames in the pairs"
        )
    missing = [name for name in target.shapes if name not in references.shape_names]
    if missing:
        raise InputError(
            f"{path}: of another rig than the pairs: it has no {first_few(missing)}; select again "
            "for the pairs' target"
        )
    # Shapes in no pair, such as head rotation, do not explain corrections.
    used = np.flatnonzero(pairs.source.any(axis=0))
    shapes = tuple(pairs.source_shapes[index] for index in used.tolist())
    transfer = transfer_by_names(references.source_names, shapes)
    weights = columns_by_name(references.weights[tuned], references.shape_names, target.shapes)
    together = shape_controls(target.shapes, np.concatenate([target.weights, weights]))
    moved = np.abs(references.source[tuned]).max(axis=0) * ~transfer.matrix.any(axis=1)
    lost = [
        references.source_names[row]
        for row in np.argsort(-moved, kind="stable")
        if moved[row] > _LOST_WEIGHT and "head" not in references.source_names[row].lower()
    ]
    notes = [
        f"{path.name}: {pluralize(len(lost), 'source shape')} of the tuned frames "
        f"{'is' if len(lost) == 1 else 'are'} in no pair, and not used: "
        f"{first_few(lost)}; add pairs in which they move (`usdface pairs propose --names`)"
    ]
    extended = replace(
        pairs,
        names=(
            *pairs.names,
            *(f"{references.takes[pair]} {references.frames[pair]}" for pair in tuned.tolist()),
        ),
        source_shapes=shapes,
        source=np.concatenate([pairs.source[:, used], references.source[tuned] @ transfer.matrix]),
        target=together,
    )
    return extended, notes if lost else []


def _rig(file: Path | None, prim: str) -> Rig | None:
    return read_rig(file, prim=prim) if file is not None and file.is_file() else None


def source_surface(pairs: ExpressionPairs) -> FloatArray | None:
    """Return the displacements of the source's surface per shape; None without its rig."""
    rig = _rig(pairs.source_rig, pairs.source_prim)
    if rig is None or any(name not in rig.shapes for name in pairs.source_shapes):
        return None
    return sampled_displacements(rig, pairs.source_shapes)


def target_ranges(pairs: ExpressionPairs) -> FloatArray | None:
    """Return the ranges of the target's weights, extended to the weights of the pairs."""
    rig = _rig(pairs.target_rig, pairs.target_prim)
    if rig is None:
        return None
    ranges = rig.ranges_of(pairs.target.shapes)
    low, high = pairs.target.weights.min(axis=0), pairs.target.weights.max(axis=0)
    return np.stack([np.minimum(ranges[:, 0], low), np.maximum(ranges[:, 1], high)], axis=1)


def _parts(rig: Rig | None, shapes: tuple[str, ...]) -> list[str]:
    """Return names of shapes from which their regions can be read, by the rig if it is known."""
    parts = dict(zip(rig.shapes, shape_parts(rig, Deformer(rig)), strict=True)) if rig else {}
    return [parts.get(name, name) for name in shapes]


def _unkeyed_notes(unkeyed: dict[str, tuple[BoolArray, tuple[str, ...]]]) -> list[str]:
    return [
        f"{region}: the source moves there, and the target rests in every pair, at "
        f"{counted(controls, 'control')}: it will not follow; key them in these pairs"
        for region, (_, controls) in unkeyed.items()
    ]


def _doubts(
    pairs: ExpressionPairs, source: Rig | None, target: Rig | None
) -> tuple[PairDoubt, ...]:
    """Return pairs that may be wrong; none if the rigs are unknown or cannot be compared."""
    try:
        return find_pair_doubts(pairs, source, target) if source and target else ()
    except InputError:
        return ()


def _doubt_notes(pairs: ExpressionPairs, doubts: tuple[PairDoubt, ...]) -> list[str]:
    notes = []
    for each in doubts[:LISTED_CONFLICTS]:
        like = "the mirror image of its source"
        if each.other is not None:
            like = f"the source of pair {_pair(pairs, each.other)}"
        notes.append(
            f"pair {_pair(pairs, each.pair)}: the target moves like {like} (similarity "
            f"{each.similarity:.2f}), and not like its own source ({each.own:.2f}); correct it if "
            "it is keyed wrongly"
        )
    return notes


def pair_notes(pairs: ExpressionPairs) -> list[str]:
    """Return notes on conflicting pairs and unused shapes and controls."""
    notes = []
    for each in find_pair_conflicts(pairs)[:LISTED_CONFLICTS]:
        notes.append(
            f"pairs {_pair(pairs, each.first)} and {_pair(pairs, each.second)} conflict: the "
            f"sources are {each.source:.2f} of the usual distance apart, the targets "
            f"{each.target:.2f}; keep one, or make the sources differ"
        )
    for names, noun, what in (
        (unused_shapes(pairs), "source shape", "in no pair and without effect"),
        (constant_controls(pairs), "target control", "the same in every pair and in the result"),
    ):
        if names:
            notes.append(f"{what}: {counted(names, noun)}")
    if alike := inseparable_sides(pairs):
        notes.append(
            "on both sides alike in every pair, so that one side alone moves both of the target "
            f"(add pairs of one side): {counted(alike, 'source shape')}"
        )
    return notes


def _pair(pairs: ExpressionPairs, index: int) -> str:
    name = pairs.names[index]
    return f"{index + 1} ({name})" if name else f"{index + 1}"


def _summary(trained: Retargeting, pairs: ExpressionPairs, *, unit: str, probes: str) -> str:
    return (
        f"{trained.method} on {len(pairs)} pairs, {len(trained.source_shapes)} shapes to "
        f"{pairs.target.summary}; round trip of {probes}: {trained.scores[0].cyclic_mm:.3f} {unit}"
    )
