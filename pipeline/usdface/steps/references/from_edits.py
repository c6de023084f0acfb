"""Turn frames that an animator corrected into tuned pairs."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import starmap
from pathlib import Path

import numpy as np

from usdface.core.arrays import BoolArray, FloatArray, IntArray, columns_by_name, index_of, runs
from usdface.core.assets import References, TrainedMapping
from usdface.core.errors import InputError
from usdface.core.locks import nobody_tunes
from usdface.core.progress import Progress, part, silent
from usdface.core.provenance import Provenance
from usdface.core.sidecars import proposed_path, reference_layers, tuned_path
from usdface.core.text import first_few, pluralize
from usdface.numerics.motion.key_reduction import EditCurve
from usdface.numerics.regression.reference_design import design_k_centre
from usdface.runner.origin import with_moved
from usdface.runner.result import StepResult
from usdface.specs.references import ReferencesAddSpec, ReferencesFromEditsSpec
from usdface.steps.inputs.cleaned_takes import read_markers, take_head_space
from usdface.steps.inputs.source_motion import read_source_motion
from usdface.steps.references.coverage import redraw_coverage
from usdface.steps.references.performance_inputs import MovedInputs, made_from
from usdface.usdio.performance.read import PerformanceReader
from usdface.usdio.references.read import read_pair_notes, read_references
from usdface.usdio.references.weight_layers import (
    SAME_WEIGHT,
    TunedPair,
    read_proposals,
    read_tuned_pairs,
)
from usdface.usdio.references.write import write_references
from usdface.usdio.rig.read import read_rig
from usdface.usdio.take.read import TakeReader

LEAST_CHANGE = 0.02
"""A change of every weight below this teaches nothing."""

FULL_STRENGTH = 0.8
"""Share of an edit's peak from which a frame counts as meant, not as its fade."""

MINOR_SHARE = 0.25
"""Edits below this share of a frame's largest do not count."""

EDITED_SHARE = 0.5
"""The same of all edits of a frame together, where no frame has every one at full strength."""


def run(
    spec: ReferencesFromEditsSpec,
    *,
    provenance: Provenance,
    progress: Progress = silent,
) -> StepResult:
    """Add the corrected frames to the references as pairs, and mark them as tuned."""
    old = read_references(spec.references)
    notes: list[str] = []
    lessons: list[_Lessons] = []
    takes = with_moved(spec.performances, spec.take, "take")
    for index, (performance, take) in enumerate(takes):
        moved = MovedInputs(take, spec.mapping)
        lessons.append(_learn(spec, performance, old, moved, notes))
        progress(0.8 * (index + 1) / len(spec.performances), f"looked at {performance.name}")
    references = _together(old, lessons, notes)
    added = len(references.frames) - len(old.frames)
    if not any(len(each.frames) for each in lessons):
        raise InputError(
            f"{', '.join(map(str, spec.performances))}: no frame was corrected by more than "
            f"{LEAST_CHANGE:g} with its markers seen; edit the performance first"
        )
    files = write_extended(spec, references, notes, provenance, part(progress, 0.8, 1.0))
    return StepResult(
        files,
        f"{pluralize(added, 'corrected frame')} added to {pluralize(len(old.frames), 'pair')}",
        tuple(notes),
        {
            "added": added,
            "pairs": len(references.frames),
            "frames": references.frames[len(old.frames) :].tolist(),
            "takes": list(references.takes[len(old.frames) :]),
        },
    )


@dataclass(frozen=True)
class _Lessons:
    """What one performance teaches: frames with their markers and the weights wanted there."""

    take: str
    frames: IntArray
    captured: FloatArray
    """(frames, ...): markers of the frames, or the weights that the take carries."""
    weights: FloatArray


_NO_LESSONS = _Lessons("", np.zeros(0, np.int64), np.zeros(0), np.zeros((0, 0)))


def _learn(
    spec: ReferencesFromEditsSpec,
    performance: Path,
    old: References,
    moved: MovedInputs,
    notes: list[str],
) -> _Lessons:
    reader = PerformanceReader(performance)
    driven = {each.shape for each in old.combinations}
    missing = [name for name in reader.names if name not in {*old.shape_names, *driven}]
    if missing:
        raise InputError(
            f"{performance}: its shapes {first_few(missing)} are not in {spec.references}; "
            "are these the references its mapping was trained on?"
        )
    edited = reader.edited().astype(np.float64)
    changes = np.abs(edited - reader.solved())
    own = [reader.names.index(name) for name in reader.edits]
    curves = [edit.curve for edit in reader.edits.values()]
    change, rows = changes.max(axis=1), np.flatnonzero(meant_frames(curves, changes[:, own].T))
    if not len(rows):
        notes.append(f"{performance}: no frame was corrected; nothing to learn from it")
        return _NO_LESSONS
    take, mapping = made_from(performance, old, moved)
    captured, seen = captured_at(take, mapping, old, reader.frames[rows])
    rows, captured = rows[seen], captured[seen]
    if not seen.all():
        notes.append(
            f"{performance}: left out, missing a marker: "
            f"{pluralize(int((~seen).sum()), 'corrected frame')}"
        )
    if not len(rows):
        return _NO_LESSONS
    chosen = spread_out(edited[rows], change[rows], spec.count)
    if len(chosen) < len(rows):
        notes.append(f"{performance}: taken {len(chosen)} of {len(rows)} corrected frames")
    weights = columns_by_name(edited[rows[chosen]], reader.names, old.shape_names)
    return _Lessons(take.name, reader.frames[rows[chosen]], captured[chosen], weights)


def meant_frames(edits: Sequence[EditCurve], changes: FloatArray) -> BoolArray:
    """Return the corrected frames at which every edit that counts is near its full strength.

    In a fade the weight is half the solve's and half the animator's: nobody wants exactly that.
    Curves of a DCC seldom peak at the same frame. Where no frame has all at their peaks, those are
    returned at which the edits are near them on average, each counted by how much it changes.

    Parameters
    ----------
    changes : (edits, frames) float array
        How far each moves its weight at each frame.
    """
    share = np.ones_like(changes)
    for row, edit in enumerate(edits):
        strength = np.maximum(np.abs(edit.offset), edit.mask)
        for stretch in starmap(slice, runs(edit.active)):
            share[row, stretch] = strength[stretch] / strength[stretch].max()
    largest = changes.max(axis=0, initial=0.0)
    counts = changes > MINOR_SHARE * largest
    meant: BoolArray = ((share >= FULL_STRENGTH) | ~counts).all(axis=0) & (largest > LEAST_CHANGE)
    if not meant.any():
        whole = changes.sum(axis=0)
        meant = ((changes * share).sum(axis=0) > EDITED_SHARE * whole) & (largest > LEAST_CHANGE)
    return meant


def spread_out(weights: FloatArray, change: FloatArray, count: int) -> IntArray:
    """Choose up to `count` rows: the most changed, and those farthest from any chosen one."""
    first = int(change.argmax())
    wanted = min(count, len(weights)) - 1
    if not wanted:
        return np.array([first], dtype=np.int64)
    further = design_k_centre(weights, wanted, already=np.array([first])).chosen
    return np.sort(np.concatenate([[first], further]))


def captured_at(
    take: TakeReader, mapping: TrainedMapping | None, old: References, frames: IntArray
) -> tuple[FloatArray, BoolArray]:
    """Return what a take captured at frames, as references have it, and which frames can be used.

    Returns
    -------
    (frames, markers, 3) or (frames, source names) float array, (frames,) bool array
        Markers [mm]; without a mapping, the weights that the take carries.
    """
    if mapping is not None:
        return _markers_at(take, mapping, old, frames)
    motion = read_source_motion(take.path)
    columns = columns_by_name(motion.weights, motion.names, old.source_names)
    return columns[frames - motion.first_frame], np.ones(len(frames), dtype=np.bool_)


def with_pairs(
    old: References,
    take: str,
    frames: IntArray,
    captured: FloatArray,
    weights: FloatArray,
    *,
    tuned: bool,
) -> References:
    """Return references with further pairs of one take."""
    unlabelled = ("",) * len(frames)
    markers, source = captured, old.source
    if source is not None:
        markers, source = np.zeros((len(frames), 0, 3)), np.concatenate([source, captured])
    return replace(
        old,
        markers=np.concatenate([old.markers, markers]),
        source=source,
        weights=np.concatenate([old.weights, weights]),
        frames=np.concatenate([old.frames, frames]),
        takes=(*old.takes, *((take,) * len(frames))),
        tuned=np.concatenate([old.tuned, np.full(len(frames), tuned)]),
        visemes=(*old.visemes, *unlabelled) if old.visemes else (),
        emotions=(*old.emotions, *unlabelled) if old.emotions else (),
        authors=(*old.authors, *unlabelled) if old.authors else (),
    )


def _markers_at(
    take: TakeReader, mapping: TrainedMapping, old: References, frames: IntArray
) -> tuple[FloatArray, BoolArray]:
    missing = [name for name in old.marker_names if name not in mapping.marker_names]
    if missing:
        raise InputError(
            f"{take.path}: its mapping does not know the references' markers "
            f"{first_few(missing)}; give the references that it was trained on"
        )
    space = take_head_space(take, mapping)
    order = [mapping.marker_names.index(name) for name in old.marker_names]
    positions = np.zeros((len(frames), len(order), 3))
    seen = np.zeros(len(frames), dtype=bool)
    for index, frame in enumerate(frames.tolist()):
        placed = space.place(read_markers(take, frame, frame))
        positions[index] = placed.positions[0, order]
        seen[index] = placed.visible[0, order].all()
    return positions, seen


def write_extended(
    spec: ReferencesFromEditsSpec | ReferencesAddSpec,
    references: References,
    notes: list[str],
    provenance: Provenance,
    progress: Progress,
) -> tuple[Path, ...]:
    """Write references that have more pairs than before; what is tuned stays.

    The coverage beside them is drawn again.

    Returns
    -------
    tuple of Path
        All that was written.
    """
    rig = read_rig(references.rig_file, prim=references.rig_prim)
    images = [note.image for note in read_pair_notes(spec.references)]
    images += [None] * (len(references.frames) - len(images))
    with nobody_tunes(spec.out):
        notes += _left_out(spec.out, references)
        tuned = _tuned_by_hand(spec, references, notes)
        write_references(
            spec.out, references, rig, tuned=tuned, images=images, provenance=provenance
        )
    pictures, undrawn = redraw_coverage(spec.out, progress)
    notes += undrawn
    progress(1.0, "written")
    return (*reference_layers(spec.out), *pictures)


def _tuned_by_hand(
    spec: ReferencesFromEditsSpec | ReferencesAddSpec, references: References, notes: list[str]
) -> list[TunedPair]:
    """Return the pairs that are tuned, as somebody tuned them in the asset that is replaced."""
    by_hand = {} if spec.out.resolve() == spec.references.resolve() else _by_hand(spec.out)
    tuned, kept = [], 0
    for pair, take in enumerate(references.takes):
        frame = int(references.frames[pair])
        weights = by_hand.get((take, frame))
        if weights is not None:
            kept += 1
        elif references.tuned[pair]:
            row = references.weights[pair].tolist()
            weights = dict(zip(references.shape_names, row, strict=True))
        if weights is not None:
            author = references.authors[pair] if references.authors else ""
            tuned.append(TunedPair(pair, take, frame, weights, author=author))
    if kept:
        notes.append(f"{spec.out}: kept as somebody tuned them there: {pluralize(kept, 'pair')}")
    return tuned


def _by_hand(out: Path) -> dict[tuple[str, int], dict[str, float]]:
    """Return weights, by take and frame, that differ from what an asset was written with."""
    if not out.is_file():
        return {}
    try:
        there = read_references(out)
        written = read_proposals(proposed_path(out), there)
    except InputError:  # damaged, so that nobody could tune it
        return {}
    away = np.abs(there.weights - written).max(axis=1, initial=0.0) > SAME_WEIGHT
    return {
        (there.takes[pair], int(there.frames[pair])): dict(
            zip(there.shape_names, there.weights[pair].tolist(), strict=True)
        )
        for pair in np.flatnonzero(away).tolist()
    }


def _left_out(out: Path, references: References) -> list[str]:
    """Name what was tuned in the asset that is replaced and is no pair of the new one."""
    here = set(zip(references.takes, references.frames.tolist(), strict=True))
    gone = [
        each for each in read_tuned_pairs(tuned_path(out)) if (each.take, each.frame) not in here
    ]
    if not gone:
        return []
    frames = first_few(each.frame for each in gone)
    return [
        f"{out}: no longer pairs: {pluralize(len(gone), 'pair')} tuned there before, "
        f"frames {frames}"
    ]


def _together(old: References, lessons: list[_Lessons], notes: list[str]) -> References:
    keys = zip(old.takes, old.frames.tolist(), strict=True)
    known = index_of(keys)
    weights, tuned = old.weights.copy(), old.tuned.copy()
    new: dict[tuple[str, int], tuple[FloatArray, FloatArray]] = {}
    renewed = 0
    for each in lessons:
        for row, frame in enumerate(each.frames.tolist()):
            key = (each.take, frame)
            pair = known.get(key)
            if pair is None:  # of a frame corrected in two performances, the later one counts
                new[key] = (each.captured[row], each.weights[row])
            else:
                weights[pair], tuned[pair] = each.weights[row], True
                renewed += 1
    if renewed:
        notes.append(
            f"pairs already, with new weights now: {pluralize(renewed, 'corrected frame')}"
        )
    together = replace(old, weights=weights, tuned=tuned)
    for (take, number), (captured, corrected) in new.items():
        frames = np.array([number], dtype=np.int64)
        together = with_pairs(together, take, frames, captured[None], corrected[None], tuned=True)
    return together
