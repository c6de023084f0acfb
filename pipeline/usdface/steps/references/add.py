"""Add frames of a performance to the references, as pairs to be tuned."""

import numpy as np

from usdface.core.arrays import IntArray, columns_by_name
from usdface.core.assets import References
from usdface.core.errors import InputError
from usdface.core.progress import Progress, part
from usdface.core.provenance import Provenance
from usdface.core.text import first_few, pluralize, shell_word
from usdface.runner.result import StepResult
from usdface.specs.notes import read_notes
from usdface.specs.paths import frame_list, frame_range
from usdface.specs.references import ReferencesAddSpec
from usdface.steps.references.from_edits import (
    advise_markers,
    captured_markers,
    check_shapes,
    find_captured_take,
    with_pairs,
    write_extended,
)
from usdface.usdio.performance.read import PerformanceReader
from usdface.usdio.references.weight_layers import read_keyed_references

MOST_FRAMES = 1000
"""Largest number of frames to add: ten times the default of `select`."""


def run(spec: ReferencesAddSpec, *, provenance: Provenance, progress: Progress) -> StepResult:
    """Add the frames with the performance's weights as proposals."""
    old = read_keyed_references(spec.references)
    reader = PerformanceReader(spec.performance)
    if reader.time_shift:
        raise InputError(
            f"{spec.performance}: a layer moves its weights {reader.time_shift}, so that its "
            "frames are others than those of its take; give the performance as mapped"
        )
    notes: list[str] = []
    take = find_captured_take(spec.performance, old, spec.take)
    frames = _new_frames(spec, reader, old, take.name, notes)
    captured, seen = captured_markers(take, old, frames)
    if not seen.any():
        raise InputError(
            f"{spec.performance}: frames {first_few(frames.tolist())} lack more than a tenth of "
            f"the markers, which pairs need; {advise_markers(take, old)}"
        )
    if not seen.all():
        left_out = first_few(frames[~seen].tolist())
        notes.append(f"left out, missing more than a tenth of the markers: frames {left_out}")
    progress(0.8, f"read {pluralize(len(frames), 'frame')}")
    check_shapes(reader, old, spec.references)
    edited = reader.edited()[frames[seen] - reader.first_frame]
    weights = columns_by_name(edited, reader.names, old.shape_names)
    references = with_pairs(old, take.name, frames[seen], captured[seen], weights, tuned=False)
    files = write_extended(spec, references, notes, provenance, part(progress, 0.8, 1.0))
    added = frames[seen].tolist()
    return StepResult(
        files,
        f"{pluralize(len(added), 'frame')} added to {pluralize(len(old.frames), 'pair')}; tune "
        f"{'it' if len(added) == 1 else 'them'} with `usdface tune {shell_word(spec.out)} "
        f"--frame {added[0]}`",
        tuple(notes),
        {"added": len(added), "pairs": len(references.frames), "frames": added},
    )


def _new_frames(
    spec: ReferencesAddSpec, reader: PerformanceReader, old: References, take: str, notes: list[str]
) -> IntArray:
    """Return the given frames that are in the performance and not yet pairs, ascending."""
    wanted = set(frame_list(spec.frames) or ())
    if spec.frames is not None and not wanted:
        first, last = frame_range(spec.frames) or (0, -1)
        wanted = set(range(max(first, reader.first_frame), min(last, reader.last_frame) + 1))
    if spec.notes is not None:
        wanted |= {note.frame for note in read_notes(spec.notes).notes if not note.done}
    beyond = sorted(f for f in wanted if not reader.first_frame <= f <= reader.last_frame)
    if beyond:
        notes.append(
            f"outside {spec.performance.name}, {reader.first_frame}-{reader.last_frame}: frames "
            f"{first_few(beyond)}"
        )
    known = {f for name, f in zip(old.takes, old.frames.tolist(), strict=True) if name == take}
    pairs = sorted(wanted & known)
    if pairs:
        notes.append(f"pairs already: frames {first_few(pairs)}")
    frames = sorted(wanted - known - set(beyond))
    if not frames:
        raise InputError(
            f"{spec.performance}: there is no frame to add; {'; '.join(notes) or 'no note is open'}"
        )
    if len(frames) > MOST_FRAMES:
        raise InputError(
            f"{spec.performance}: {len(frames)} frames are too many to tune, at most {MOST_FRAMES} "
            "are added; choose frames with `usdface select`"
        )
    return np.array(frames, dtype=np.int64)
