"""Choose pairs of takes that carry weights instead of markers, as those of phones."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from usdface.core.arrays import FloatArray, IntArray
from usdface.core.assets import References, Rig
from usdface.core.errors import InputError
from usdface.core.progress import Progress
from usdface.core.text import first_few
from usdface.model.retarget.name_matching import transfer_by_names
from usdface.numerics.regression.reference_design import design_k_centre
from usdface.specs.references import SelectSpec
from usdface.steps.inputs.cleaned_takes import CleanedTakes, check_take_names
from usdface.steps.inputs.scene import candidate_frames
from usdface.steps.inputs.source_motion import (
    MOVING_WEIGHT,
    SourceMotion,
    read_source_motion,
    source_transfer,
    unmatched_moving,
)
from usdface.steps.inputs.tuned_pairs import PlacedPair, find_placed_pairs, rows_of_pairs
from usdface.usdio.take.read import TakeReader, read_first_frame

_OF_MARKERS = ("phones", "mapping", "placement", "landmarks", "picture")
"""Options of `select` that need markers."""


@dataclass(frozen=True)
class WeightSelection:
    """Pairs of takes of weights, whose proposals are the takes' weights on the rig."""

    references: References
    kept: list[PlacedPair]
    takes: CleanedTakes
    """Without markers."""
    notes: tuple[str, ...]


def have_weights_only(paths: tuple[Path, ...]) -> bool:
    """Whether all takes have weights and no markers."""
    readers = map(TakeReader, paths)
    return all(
        not each.marker_names and each.read_source(range(each.first_frame, each.first_frame + 1))
        for each in readers
    )


def select_by_weights(spec: SelectSpec, rig: Rig, progress: Progress) -> WeightSelection:
    """Choose frames of distant weights, matched to the rig by name, by greedy k-centre."""
    given = [name for name in _OF_MARKERS if spec.is_given(name)]
    if given:
        raise InputError(
            f"{first_few(spec.takes)}: has weights and no markers, so --{given[0]} has no effect; "
            "leave it out"
        )
    motions = [read_source_motion(path) for path in spec.takes]
    takes = _without_markers(spec, motions)
    kept = find_placed_pairs(spec, takes, rig)
    progress(0.3, "matching names")
    rows_on_rig: list[FloatArray] = []
    notes: list[str] = []
    for path, motion in zip(spec.takes, motions, strict=True):
        transfer, transfer_notes = source_transfer(path, motion, rig.shapes, spec.names)
        rows_on_rig.append(motion.weights @ transfer.matrix)
        notes += transfer_notes
    low, high = rig.ranges.T
    proposed = np.clip(np.concatenate(rows_on_rig), np.minimum(low, 0.0), high)
    already = np.array([each.row for each in kept], dtype=np.int64)
    free = np.flatnonzero(candidate_frames(takes, spec.frames))
    chosen = _far_apart(spec, proposed, already, free)
    rows = np.array(rows_of_pairs(spec.count, kept, chosen), dtype=np.int64)
    names, source = motions[0].names, list[FloatArray]()
    for path, motion in zip(spec.takes, motions, strict=True):
        same = transfer_by_names(motion.names, names)
        source.append(motion.weights @ same.matrix)
        if lost := unmatched_moving(same, motion):
            notes.append(
                f"{path.name}: {first_few(lost)} move, and {spec.takes[0].name} has no such "
                "shapes: `train-retarget` ignores them; give the take with the most shapes first"
            )
    references = replace(
        takes.new_references(rig, rows, proposed[rows]),
        emotions=tuple(motions[take].emotion for take, _ in takes.take_rows(rows)),
        source_names=names,
        source=np.concatenate(source)[rows],
    )
    return WeightSelection(references, kept, takes, tuple(dict.fromkeys(notes)))


def _without_markers(spec: SelectSpec, motions: list[SourceMotion]) -> CleanedTakes:
    """Return the takes as `CleanedTakes` without markers."""
    sources = [replace(read_first_frame(path), source=None) for path in spec.takes]
    check_take_names(spec.takes, sources)
    counts = [len(motion.weights) for motion in motions]
    return CleanedTakes(
        marker_names=(),
        rigid=(),
        neutral=np.zeros((0, 3)),
        positions=tuple(np.zeros((count, 0, 3), np.float32) for count in counts),
        usable=tuple(np.zeros((count, 0), np.bool_) for count in counts),
        frames=np.concatenate([np.arange(m.first_frame, m.last_frame + 1) for m in motions]),
        takes=tuple(
            take.name for take, count in zip(sources, counts, strict=True) for _ in range(count)
        ),
        dropped=(),
        sources=tuple(sources),
        neutrals=(),
    )


def _far_apart(
    spec: SelectSpec, weights: FloatArray, already: IntArray, free: IntArray
) -> IntArray:
    """Return rows for the pairs that are not tuned yet, the most distant first."""
    wanted = spec.count - len(already)
    free = free[~np.isin(free, already)]
    rows = np.concatenate([already, free])
    if not wanted:
        return rows[:0]
    if len(free) >= wanted:
        places = np.arange(len(already), dtype=np.int64)
        design = design_k_centre(weights[rows], wanted, already=places)
        chosen = design.chosen[design.gain > MOVING_WEIGHT**2]
        if len(chosen) == wanted:
            return rows[chosen]
        free = rows[chosen]
    raise InputError(
        f"--count is {spec.count}, but only {len(free) + len(already)} frames differ; lower it, "
        "widen --frames or give more takes"
    )
