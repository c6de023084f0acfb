"""Add edited frames of performances to the references, as tuned pairs."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from fractions import Fraction
from itertools import starmap
from pathlib import Path

import numpy as np

from usdface.core.arrays import BoolArray, FloatArray, IntArray, columns_by_name, index_of, runs
from usdface.core.assets import References
from usdface.core.errors import InputError
from usdface.core.locks import tuning_lock
from usdface.core.progress import Progress, part
from usdface.core.provenance import Provenance
from usdface.core.sidecars import proposed_path, reference_layers, tuned_path
from usdface.core.text import first_few, pluralize
from usdface.core.trajectories import TRAJECTORY_SECONDS, read_trajectories
from usdface.model.mapping.motion_space import frames_at, marker_coordinates, motion_of_pairs
from usdface.model.mapping.performer_face import face_of_references
from usdface.model.retarget.name_matching import transfer_by_names
from usdface.numerics.motion.key_reduction import EditCurve
from usdface.numerics.regression.reference_design import design_k_centre
from usdface.runner.origin import find_made_by, find_take, made_files, pair_with_files, take_name
from usdface.runner.result import StepResult
from usdface.specs.references import ReferencesAddSpec, ReferencesFromEditsSpec
from usdface.steps.inputs.cleaned_takes import read_markers_at, take_head_space
from usdface.steps.inputs.scene import USABLE_SHARE
from usdface.steps.inputs.source_motion import read_source_motion
from usdface.steps.references.coverage import redraw_coverage
from usdface.usdio.performance.read import PerformanceReader
from usdface.usdio.references.read import read_pair_notes, read_references
from usdface.usdio.references.weight_layers import (
    SAME_WEIGHT,
    TunedPair,
    read_keyed_references,
    read_proposals,
    read_tuned_pairs,
)
from usdface.usdio.references.write import write_references
from usdface.usdio.rig.read import read_rig
from usdface.usdio.take.read import TakeReader

LEAST_CHANGE = 0.02
"""Smallest change of a weight by which a frame counts as edited."""

FULL_STRENGTH = 0.8
"""Share of an edit's peak above which a frame is not in a fade."""

MINOR_SHARE = 0.25
"""Edits below this share of a frame's largest change are ignored."""

EDITED_SHARE = 0.5
"""Mean share of their peaks above which a frame counts, if no frame has all edits at full
strength."""


def run(spec: ReferencesFromEditsSpec, *, provenance: Provenance, progress: Progress) -> StepResult:
    """Add the edited frames to the references as tuned pairs."""
    old = read_keyed_references(spec.references)
    notes: list[str] = []
    edited: list[_EditedFrame] = []
    takes = pair_with_files(spec.performances, spec.take, "take")
    for index, (performance, moved_take) in enumerate(takes):
        edited += _edited_frames(spec, performance, old, moved_take, notes)
        progress(0.8 * (index + 1) / len(spec.performances), f"read {performance.name}")
    references = _with_edited(old, edited, notes)
    added = len(references.frames) - len(old.frames)
    if not edited:
        raise InputError(f"there is no frame to add; {'; '.join(notes)}")
    files = write_extended(spec, references, notes, provenance, part(progress, 0.8, 1.0))
    return StepResult(
        files,
        f"{pluralize(added, 'edited frame')} added to {pluralize(len(old.frames), 'pair')}",
        tuple(notes),
        {
            "added": added,
            "pairs": len(references.frames),
            "frames": references.frames[len(old.frames) :].tolist(),
            "takes": list(references.takes[len(old.frames) :]),
        },
    )


_EditedFrame = tuple[str, int, FloatArray, FloatArray]
"""Take and frame, its markers or, of a take without markers, weights, and the edited weights."""


def _edited_frames(
    spec: ReferencesFromEditsSpec,
    performance: Path,
    old: References,
    moved_take: Path | None,
    notes: list[str],
) -> list[_EditedFrame]:
    reader = PerformanceReader(performance)
    check_shapes(reader, old, spec.references)
    edited = reader.edited().astype(np.float64)
    changes = np.abs(edited - reader.solved())
    known = [name for name in reader.edits if name in reader.names]
    columns = [reader.names.index(name) for name in known]
    curves = [reader.edits[name].curve for name in known]
    rows = np.flatnonzero(full_strength_frames(curves, changes[:, columns].T))
    if not len(rows):
        notes.append(f"{performance}: no frame was edited by more than {LEAST_CHANGE:g}")
        return []
    take = find_captured_take(performance, old, moved_take)
    frames = reader.take_frames_at(reader.frames[rows])
    captured, seen = captured_markers(take, old, frames)
    rows, frames, captured = rows[seen], frames[seen], captured[seen]
    if not seen.all():
        notes.append(
            f"{performance}: left out, missing more than a tenth of the markers: "
            f"{pluralize(int((~seen).sum()), 'edited frame')}; {advise_markers(take, old)}"
        )
    if not len(rows):
        return []
    chosen = choose_distant_rows(edited[rows], changes.max(axis=1)[rows], spec.count)
    if len(chosen) < len(rows):
        notes.append(f"{performance}: used {len(chosen)} of {len(rows)} edited frames")
    weights = columns_by_name(edited[rows[chosen]], reader.names, old.shape_names)
    return [
        (take.name, int(frames[row]), captured[row], edited_weights)
        for row, edited_weights in zip(chosen, weights, strict=True)
    ]


def advise_markers(take: TakeReader, old: References) -> str:
    """Return what to do about frames that lack markers: other frames, or another selection."""
    absent = [name for name in old.marker_names if name not in take.marker_names]
    if not absent:
        return "choose other frames"
    return (
        f"{take.path.name} has no {first_few(absent)}: `usdface select` from it and their takes "
        "leaves these markers out, and keeps tuned pairs"
    )


def check_shapes(reader: PerformanceReader, old: References, references: Path) -> None:
    """Refuse a performance with shapes that neither the references nor their combinations have."""
    driven = {each.shape for each in old.combinations}
    missing = [name for name in reader.names if name not in {*old.shape_names, *driven}]
    if missing:
        raise InputError(
            f"{reader.path}: its shapes {first_few(missing)} are not in {references}; give the "
            "references that its mapping was trained on"
        )


def full_strength_frames(edits: Sequence[EditCurve], changes: FloatArray) -> BoolArray:
    """Return the edited frames at which all larger edits are near full strength.

    Weights in a fade are a blend with the solve that no animator keyed. If no frame has all edits
    near their peaks, as curves of a DCC rarely peak together, frames are returned at which the
    mean strength, weighted by change, is high.

    `changes`: (edits, frames), absolute change of the weight by each edit.
    """
    share = np.ones_like(changes)
    for row, edit in enumerate(edits):
        strength = np.maximum(np.abs(edit.offset), edit.mask)
        for stretch in starmap(slice, runs(edit.active)):
            share[row, stretch] = strength[stretch] / strength[stretch].max()
    largest = changes.max(axis=0, initial=0.0)
    counts = changes > MINOR_SHARE * largest
    full: BoolArray = ((share >= FULL_STRENGTH) | ~counts).all(axis=0) & (largest > LEAST_CHANGE)
    if not full.any():
        total = changes.sum(axis=0)
        full = ((changes * share).sum(axis=0) > EDITED_SHARE * total) & (largest > LEAST_CHANGE)
    return full


def choose_distant_rows(weights: FloatArray, change: FloatArray, count: int) -> IntArray:
    """Choose up to `count` rows: the most changed, and those farthest from any chosen one."""
    first = int(change.argmax())
    wanted = min(count, len(weights)) - 1
    if not wanted:
        return np.array([first], dtype=np.int64)
    further = design_k_centre(weights, wanted, already=np.array([first])).chosen
    return np.sort(np.concatenate([[first], further]))


def captured_markers(
    take: TakeReader, old: References, frames: IntArray
) -> tuple[FloatArray, BoolArray]:
    """Return the captured motion of frames, and which frames show enough markers.

    The motion is that of the markers in the references' space, at `TRAJECTORY_SECONDS`: (frames,
    times, markers, 3) [mm]. Markers that are not visible have the prediction from the others. Of
    references of takes that carry weights, it is the weights, in the order of their source names.
    Frames that the take lacks are refused.
    """
    beyond = frames[(frames < take.first_frame) | (frames > take.last_frame)]
    if len(beyond):
        raise InputError(
            f"{take.path}: has frames {take.first_frame}-{take.last_frame}, so not "
            f"{first_few(beyond.tolist())} of the performance; give the take it was made from"
        )
    if old.source is not None:
        source = read_source_motion(take.path)
        columns = source.weights @ transfer_by_names(source.names, old.source_names).matrix
        return columns[frames - source.first_frame], np.ones(len(frames), dtype=np.bool_)
    # Not the mapping's space, which differs if the references were selected again since.
    space = take_head_space(take, face_of_references(old))
    space_of_motion = old.motion or motion_of_pairs(old)
    enough = np.zeros(len(frames), np.bool_)

    def positions_at(needed: IntArray) -> FloatArray:
        placed = space.place(read_markers_at(take, needed.tolist()))
        positions, visible = placed.positions.astype(np.float64), placed.visible
        enough[:] = visible[np.searchsorted(needed, frames)].mean(axis=1) >= USABLE_SHARE
        coordinates = marker_coordinates(space_of_motion, positions, visible=visible)
        expected = frames_at(space_of_motion, coordinates)
        return np.where(visible[:, :, None], positions, expected)

    motion = read_trajectories(
        frames,
        rate=float(take.rate),
        first=take.first_frame,
        last=take.last_frame,
        positions_at=positions_at,
    )
    return motion, enough


def with_pairs(
    old: References,
    take: str,
    frames: IntArray,
    captured: FloatArray,
    weights: FloatArray,
    *,
    tuned: bool,
) -> References:
    """Return references with further pairs of one take; `captured`: as of `captured_markers`."""
    unlabelled = ("",) * len(frames)
    source, trajectories = old.source, old.trajectories
    if source is not None:
        markers, source = np.zeros((len(frames), 0, 3)), np.concatenate([source, captured])
    else:
        markers = captured[:, TRAJECTORY_SECONDS == 0][:, 0]
    if trajectories is not None:
        trajectories = np.concatenate([trajectories, captured - markers[:, None]])
    return replace(
        old,
        markers=np.concatenate([old.markers, markers]),
        source=source,
        trajectories=trajectories,
        weights=np.concatenate([old.weights, weights]),
        frames=np.concatenate([old.frames, frames]),
        takes=(*old.takes, *((take,) * len(frames))),
        tuned=np.concatenate([old.tuned, np.full(len(frames), tuned)]),
        visemes=(*old.visemes, *unlabelled) if old.visemes else (),
        emotions=(*old.emotions, *unlabelled) if old.emotions else (),
        authors=(*old.authors, *unlabelled) if old.authors else (),
    )


def write_extended(
    spec: ReferencesFromEditsSpec | ReferencesAddSpec,
    references: References,
    notes: list[str],
    provenance: Provenance,
    progress: Progress,
) -> tuple[Path, ...]:
    """Write extended references, keeping tuned pairs; draw the coverage again; return the files.

    In place, the proposals of existing pairs are kept as well. In another file their weights are
    the proposals, so that what is tuned there is known when it is written again.
    """
    rig = read_rig(references.rig_file, prim=references.rig_prim)
    images = [note.image for note in read_pair_notes(spec.references)]
    images += [None] * (len(references.frames) - len(images))
    with tuning_lock(spec.out):
        notes += _left_out(spec.out, references)
        there = _replaced(spec.out)
        tuned = _tuned_by_hand(spec, references, there, notes)
        if there is not None and spec.out.resolve() == spec.references.resolve():
            proposals = np.concatenate([there[1], references.weights[len(there[1]) :]])
            references = replace(references, weights=proposals)
        write_references(
            spec.out, references, rig, tuned=tuned, images=images, provenance=provenance
        )
    pictures, picture_notes = redraw_coverage(spec.out, progress)
    notes += picture_notes
    return (*reference_layers(spec.out), *pictures)


def _tuned_by_hand(
    spec: ReferencesFromEditsSpec | ReferencesAddSpec,
    references: References,
    there: tuple[References, FloatArray] | None,
    notes: list[str],
) -> list[TunedPair]:
    """Return the tuned pairs; weights tuned by hand in the replaced asset take precedence.

    Pairs with the same weights keep whether they are done.
    """
    marked = {
        (each.take, each.frame): each
        for each in read_tuned_pairs(tuned_path(spec.references))
        if references.weights_of(each.pair).items() <= each.weights.items()
    }
    by_hand: dict[tuple[str, int], TunedPair] = {}
    if there is not None and spec.out.resolve() != spec.references.resolve():
        differs = np.abs(there[0].weights - there[1]).max(axis=1, initial=0.0) > SAME_WEIGHT
        pairs = [_tuned_pair(there[0], pair) for pair in np.flatnonzero(differs).tolist()]
        by_hand = {(each.take, each.frame): each for each in pairs}
    frames = list(zip(references.takes, references.frames.tolist(), strict=True))
    tuned = []
    for pair, frame in enumerate(frames):
        known = by_hand.get(frame, marked.get(frame))
        if known is not None:
            tuned.append(replace(known, pair=pair))
        elif references.tuned[pair]:
            tuned.append(_tuned_pair(references, pair))
    if kept := by_hand.keys() & frames:
        notes.append(f"{spec.out}: kept as tuned there: {pluralize(len(kept), 'pair')}")
    return tuned


def _tuned_pair(references: References, pair: int) -> TunedPair:
    return TunedPair(
        pair,
        references.takes[pair],
        int(references.frames[pair]),
        references.weights_of(pair),
        author=references.authors[pair] if references.authors else "",
    )


def _replaced(out: Path) -> tuple[References, FloatArray] | None:
    """Return the asset that is replaced, and its proposals; None if missing or damaged."""
    with suppress(InputError):
        existing = read_references(out)
        return existing, read_proposals(proposed_path(out), existing)
    return None


def _left_out(out: Path, references: References) -> list[str]:
    """Return a note on tuned pairs of the replaced asset that the new one lacks."""
    new = set(zip(references.takes, references.frames.tolist(), strict=True))
    gone = [p.frame for p in read_tuned_pairs(tuned_path(out)) if (p.take, p.frame) not in new]
    words = f"{pluralize(len(gone), 'pair')} tuned there before, frames {first_few(gone)}"
    return [f"{out}: no longer pairs: {words}"] if gone else []


def _with_edited(old: References, edited: list[_EditedFrame], notes: list[str]) -> References:
    """Return references with edited frames as new pairs, or as new weights of existing pairs."""
    known = index_of(zip(old.takes, old.frames.tolist(), strict=True))
    weights, tuned, authors = old.weights.copy(), old.tuned.copy(), list(old.authors)
    new: dict[tuple[str, int], tuple[FloatArray, FloatArray]] = {}
    renewed = 0
    for take, frame, captured, edited_weights in edited:
        pair = known.get((take, frame))
        if pair is None:  # of a frame edited in two performances, the later one counts
            new[take, frame] = captured, edited_weights
        else:
            if authors and np.abs(weights[pair] - edited_weights).max() > SAME_WEIGHT:
                authors[pair] = ""  # `train` brings the keys of an author to one gain
            weights[pair], tuned[pair] = edited_weights, True
            renewed += 1
    if renewed:
        notes.append(f"existing pairs with new weights: {pluralize(renewed, 'edited frame')}")
    extended = replace(old, weights=weights, tuned=tuned, authors=tuple(authors))
    for (take, frame), (captured, edited_weights) in new.items():
        frames = np.array([frame], dtype=np.int64)
        extended = with_pairs(
            extended, take, frames, captured[None], edited_weights[None], tuned=True
        )
    return extended


def find_captured_take(performance: Path, old: References, moved: Path | None) -> TakeReader:
    """Return the take of a performance, from its new path or by the performance's provenance.

    Or by that of the performance in a shot, or of parts.
    """
    step = "map" if old.source is None else "retarget"
    made = find_made_by(performance, step, {"join": "parts"})
    if made is None and moved is None:
        below = first_few(each.name for each in made_files(performance)[1:])
        raise InputError(
            f"{performance}: does not name the take it was made from"
            f"{f', nor does {below}, which holds its weights' if below else ''}; give --take, "
            f"or give a performance that `usdface {step}` wrote, or one joined from such parts "
            "that still exist"
        )
    made = (made or performance).resolve()
    take = TakeReader(moved or find_take(made, None))
    if take_name(made) not in ("", take.name):
        raise InputError(f"{take.path}: is not the take of {performance}; leave out --take")
    rate = PerformanceReader(made).rate
    if abs(rate / take.rate - 1) > Fraction(1, 500):  # frames of 120 and 119.88 are the same
        raise InputError(
            f"{take.path}: runs at {float(take.rate):g} frames per second, {made} at "
            f"{float(rate):g}, so that their frames differ; leave out --take, or map this take"
        )
    return take
