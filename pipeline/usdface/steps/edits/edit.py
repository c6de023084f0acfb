"""Add a change of shapes over a range of frames to the edits of a performance."""

import difflib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from usdface.core.arrays import BoolArray, FloatArray, IntArray
from usdface.core.errors import InputError
from usdface.core.progress import Progress
from usdface.core.provenance import Provenance
from usdface.core.rates import UNSAMPLED_FRAMES, check_frame_span
from usdface.core.text import first_few, pluralize
from usdface.numerics.motion.key_reduction import (
    EditCurve,
    add_to_edit,
    clear_edit,
    fade_mask,
    no_edit,
    override_edit,
)
from usdface.runner.result import StepResult
from usdface.specs.edits import EditSpec
from usdface.specs.notes import read_notes
from usdface.specs.paths import frame_range
from usdface.usdio.performance.edits import (
    ShapeEdit,
    edited_frames,
    edits_stamp,
    read_edits,
    write_edits,
)
from usdface.usdio.performance.read import PerformanceReader

MAX_FRAMES_BEYOND = UNSAMPLED_FRAMES // 4
"""Largest distance of an edit's end from the performance; with it on both sides, the span of frames
is still below the limit of `check_frame_span`."""

_LISTED_SHAPES = 5
"""Largest number of shapes with a note of their own."""


@dataclass(frozen=True)
class _Change:
    """A change of some shapes over a range of frames; without `add` and `override`, a clearing."""

    shapes: tuple[str, ...]
    add: float | None = None
    override: float | None = None
    frames: tuple[int, int] | None = None
    """None means all."""
    fade: int = 0

    @property
    def reach(self) -> tuple[int, int] | None:
        """Last unchanged frame before and first one after the change; None for all frames."""
        if self.frames is None:
            return None
        return self.frames[0] - self.fade - 1, self.frames[1] + self.fade + 1

    def mask(self, frames: IntArray) -> FloatArray:
        """Return the strength of the change at frames [0-1]."""
        if self.frames is None:
            return np.ones(len(frames))
        return fade_mask(frames, *self.frames, fade=self.fade)

    def folded(self, curve: EditCurve, mask: FloatArray) -> EditCurve:
        """Return an edit with the change applied."""
        if self.add is not None:
            return add_to_edit(curve, self.add, mask)
        if self.override is not None:
            return override_edit(curve, self.override, mask)
        return clear_edit(curve, mask)


def run(spec: EditSpec, *, provenance: Provenance, progress: Progress) -> StepResult:
    """Write the changed edits, keeping all others."""
    stamp = edits_stamp(spec.performance)
    reader = PerformanceReader(spec.performance, prim=spec.prim)
    notes: list[str] = []
    changes = _changes(spec, reader, notes)
    for change in changes:
        _check_shapes(spec, change, reader)
        first, last = change.frames or (reader.first_frame, reader.last_frame)
        if last < reader.first_frame or first > reader.last_frame:
            raise InputError(
                f"{spec.performance}: frames {first}-{last} are outside the performance, "
                f"{reader.first_frame}-{reader.last_frame}; give some of these"
            )
    # A change of all frames also holds beyond the performance, in case more of the take is mapped;
    # a change of a range ends with the range, even at the end of the performance.
    reaches = [change.reach for change in changes if change.reach is not None]
    reach = (min(a for a, _ in reaches), max(b for _, b in reaches)) if reaches else None
    frames = all_frames(reader, reach=reach)
    progress(0.2, "reading the edits")
    edits = read_edits(reader.animation, frames)
    solved, changed = solve_at(reader, frames), dict[str, ShapeEdit]()
    touched = np.zeros(len(frames), dtype=bool)
    for change in changes:
        mask, clears = change.mask(frames), change.add is None and change.override is None
        for shape in change.shapes:
            fresh = ShapeEdit(no_edit(len(frames)), np.full(len(frames), np.nan))
            old = changed.get(shape, edits.get(shape, fresh))
            solve = np.full(len(frames), np.nan)  # if the solve no longer has the shape
            if shape in reader.names:
                solve = solved[:, reader.names.index(shape)]
            touched |= (mask > 0) & (old.curve.active | (not clears))
            changed[shape] = with_curve(old, change.folded(old.curve, mask), solve, mask > 0)
    path = write_edits(
        spec.performance, reader.animation, changed, frames, stamp=stamp, provenance=provenance
    )
    inside = (frames >= reader.first_frame) & (frames <= reader.last_frame) & touched
    return StepResult(
        (path,),
        f"{_summary(spec, changes)} over {pluralize(int(inside.sum()), 'frame')}",
        (*notes, *range_notes(spec.performance, spec.prim, changed)),
        {"frames": int(inside.sum()), "shapes": list(changed)},
    )


def _changes(spec: EditSpec, reader: PerformanceReader, notes: list[str]) -> list[_Change]:
    """Return the change of the options, or the open corrections of --notes."""
    if spec.notes is None:
        return [_Change(spec.shape, spec.add, spec.override, frame_range(spec.frames), spec.fade)]
    corrections = [note for note in read_notes(spec.notes).notes if note.is_correction]
    wanted = [note for note in corrections if not note.done and note.version == reader.version]
    old = [note for note in corrections if not note.done and note.version != reader.version]
    if old:
        notes.append(
            f"{spec.notes}: not applied, as noted on another version of {spec.performance.name}: "
            f"{first_few([note.sentence() for note in old], most=3)}; open them in a report, where "
            "they can be changed to notes on this version"
        )
    if not wanted:
        raise InputError(
            f"{spec.notes}: has no open correction for this version of {spec.performance.name}, "
            f"which is {reader.version}; "
            f"{'; '.join(notes) or 'add corrections in a report'}"
        )
    by_time = sorted(wanted, key=lambda note: note.made)
    return [
        _Change((str(note.shape),), note.add, note.override, note.span, note.fade)
        for note in by_time
    ]


def _summary(spec: EditSpec, changes: list[_Change]) -> str:
    if spec.notes is not None:
        shapes = dict.fromkeys(shape for change in changes for shape in change.shapes)
        return f"{pluralize(len(changes), 'correction')} of {', '.join(shapes)} applied"
    named = ", ".join(spec.shape)
    if spec.add is not None:
        return f"{spec.add:+g} added to {named}"
    return f"{named} {'cleared' if spec.clear else 'overridden'}"


def all_frames(reader: PerformanceReader, *, reach: tuple[int, int] | None = None) -> IntArray:
    """Return all frames of the performance, its edits and a new change.

    Frames of a change far beyond the performance are left out: curves hold their last value.
    """
    first, last = reader.first_frame, reader.last_frame
    if reach is not None:
        first = min(first, max(reach[0], first - MAX_FRAMES_BEYOND))
        last = max(last, min(reach[1], last + MAX_FRAMES_BEYOND))
    beyond = edited_frames(reader.animation)
    if beyond is not None:
        first, last = min(first, beyond[0]), max(last, beyond[1])
        solved = reader.last_frame - reader.first_frame + 1
        check_frame_span(f"{reader.path} and its edits", first, last, samples=solved)
    return np.arange(first, last + 1, dtype=np.int64)


def solve_at(reader: PerformanceReader, frames: IntArray) -> FloatArray:
    """Return the solve at frames, NaN outside the performance, (frames, shapes)."""
    out = np.full((len(frames), len(reader.names)), np.nan)
    start = reader.first_frame - int(frames[0])
    solved = reader.solved()
    out[start : start + len(solved)] = solved
    return out


def with_curve(old: ShapeEdit, curve: EditCurve, solved: FloatArray, now: BoolArray) -> ShapeEdit:
    """Return an edit with a new curve, and the current solve stored where `now` is true."""
    fresh = now | ~np.isfinite(old.solve_when_edited)
    solve = np.where(fresh & np.isfinite(solved), solved, old.solve_when_edited)
    return ShapeEdit(curve, np.where(curve.active, solve, np.nan))


def _check_shapes(spec: EditSpec, change: _Change, reader: PerformanceReader) -> None:
    for shape in change.shapes:
        if shape not in reader.names and not (spec.clear and shape in reader.edits):
            near = difflib.get_close_matches(shape, reader.names, n=3, cutoff=0.5)
            some = first_few(reader.names, most=3)
            hint = f"did you mean {' or '.join(near)}?" if near else f"they are {some}, ..."
            raise InputError(
                f"{spec.performance}: has no shape {shape!r} among its {len(reader.names)}; {hint}"
            )


def range_notes(performance: Path, prim: str | None, shapes: Iterable[str]) -> list[str]:
    """Return a note on each shape whose edited weights are outside 0 to 1."""
    again = PerformanceReader(performance, prim=prim)
    edited = again.edited()
    notes = []
    for shape in shapes:
        if shape not in again.edits or shape not in again.names:
            continue
        column = again.names.index(shape)
        values = edited[:, column]
        touched = again.edits[shape].curve.active
        beyond = touched & ((values < -1e-4) | (values > 1 + 1e-4))
        if beyond.any():
            low, high = values[beyond].min(), values[beyond].max()
            notes.append(
                f"{shape} is outside 0 to 1 at {pluralize(int(beyond.sum()), 'frame')} "
                f"({low:.2f} to {high:.2f}); `usdface bake --limit` clamps it to the rig's range"
            )
    rest = pluralize(len(notes) - _LISTED_SHAPES, "more shape")
    return notes if len(notes) <= _LISTED_SHAPES else [*notes[:_LISTED_SHAPES], f"also {rest}"]
