"""Fold a change into the edits of a performance."""

import difflib

import numpy as np

from usdface.core.arrays import BoolArray, FloatArray, IntArray
from usdface.core.errors import InputError
from usdface.core.progress import Progress, silent
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
from usdface.specs.paths import frame_range
from usdface.usdio.performance.edits import (
    ShapeEdit,
    edited_frames,
    edits_stamp,
    read_edits,
    write_edits,
)
from usdface.usdio.performance.read import PerformanceReader

FARTHEST_BEYOND = UNSAMPLED_FRAMES // 4
"""How far from a performance an edit's end is still written as an end: on both sides so far, the
span is one that needs no samples to bear it out."""


def run(spec: EditSpec, *, provenance: Provenance, progress: Progress = silent) -> StepResult:
    """Change the shapes named over the frames named, and keep all other edits."""
    stamp = edits_stamp(spec.performance)
    reader = PerformanceReader(spec.performance, prim=spec.prim)
    _check_shapes(spec, reader)
    first, last = frame_range(spec.frames) or (reader.first_frame, reader.last_frame)
    if last < reader.first_frame or first > reader.last_frame:
        raise InputError(
            f"{spec.performance}: frames {first}-{last} are not in the performance, which has "
            f"{reader.first_frame}-{reader.last_frame}"
        )
    # A change of all frames holds beyond the performance's ends, as a take mapped further needs it;
    # one of some frames ends where it was told to, though the performance may end there, too.
    reach = None if spec.frames is None else (first - spec.fade - 1, last + spec.fade + 1)
    frames = all_frames(reader, reach=reach)
    progress(0.2, "reading the edits")
    edits = read_edits(reader.animation, frames)
    mask = np.ones(len(frames))
    if spec.frames is not None:
        mask = fade_mask(frames, first, last, fade=spec.fade)
    solved = solved_over(reader, frames)
    changed = {}
    for shape in spec.shape:
        old = edits.get(shape, ShapeEdit(no_edit(len(frames)), np.full(len(frames), np.nan)))
        beneath = np.full(len(frames), np.nan)  # of a shape that the solve does not have any more
        if shape in reader.names:
            beneath = solved[:, reader.names.index(shape)]
        changed[shape] = renewed(old, _folded(spec, old.curve, mask), beneath, mask > 0)
    path = write_edits(
        spec.performance, reader.animation, changed, frames, stamp=stamp, provenance=provenance
    )
    progress(1.0, "written")
    inside = (frames >= reader.first_frame) & (frames <= reader.last_frame) & (mask > 0)
    what = "cleared" if spec.clear else ("added to" if spec.add is not None else "overridden")
    return StepResult(
        (path,),
        f"{', '.join(spec.shape)} {what} over {pluralize(int(inside.sum()), 'frame')}",
        tuple(_range_notes(spec, reader)),
        {"frames": int(inside.sum()), "shapes": list(spec.shape)},
    )


def all_frames(reader: PerformanceReader, *, reach: tuple[int, int] | None = None) -> IntArray:
    """Return every frame that the performance has, that an edit reaches, or that one is to reach.

    Of the last, those far beyond the performance are left out: a curve holds there what it ends in.
    """
    first, last = reader.first_frame, reader.last_frame
    if reach is not None:
        first = min(first, max(reach[0], first - FARTHEST_BEYOND))
        last = max(last, min(reach[1], last + FARTHEST_BEYOND))
    beyond = edited_frames(reader.animation)
    if beyond is not None:
        first, last = min(first, beyond[0]), max(last, beyond[1])
        solved = reader.last_frame - reader.first_frame + 1
        check_frame_span(f"{reader.path} and its edits", first, last, samples=solved)
    return np.arange(first, last + 1, dtype=np.int64)


def solved_over(reader: PerformanceReader, frames: IntArray) -> FloatArray:
    """Return the solve at frames, NaN where the performance has none, (frames, shapes)."""
    out = np.full((len(frames), len(reader.names)), np.nan)
    start = reader.first_frame - int(frames[0])
    solved = reader.solved()
    out[start : start + len(solved)] = solved
    return out


def renewed(old: ShapeEdit, curve: EditCurve, solved: FloatArray, now: BoolArray) -> ShapeEdit:
    """Return an edit whose solve beneath is today's wherever it was changed just now."""
    fresh = now | ~np.isfinite(old.beneath)
    beneath = np.where(fresh & np.isfinite(solved), solved, old.beneath)
    return ShapeEdit(curve, np.where(curve.active, beneath, np.nan))


def _folded(spec: EditSpec, curve: EditCurve, mask: FloatArray) -> EditCurve:
    if spec.add is not None:
        return add_to_edit(curve, spec.add, mask)
    if spec.override is not None:
        return override_edit(curve, spec.override, mask)
    return clear_edit(curve, mask)


def _check_shapes(spec: EditSpec, reader: PerformanceReader) -> None:
    for shape in spec.shape:
        if shape not in reader.names and not (spec.clear and shape in reader.edits):
            near = difflib.get_close_matches(shape, reader.names, n=3, cutoff=0.5)
            some = first_few(reader.names, most=3)
            hint = f"did you mean {' or '.join(near)}?" if near else f"they are {some}, ..."
            raise InputError(
                f"{spec.performance}: has no shape {shape!r} among its {len(reader.names)}; {hint}"
            )


def _range_notes(spec: EditSpec, reader: PerformanceReader) -> list[str]:
    """Say where the edited weights leave 0 to 1: meant or not, it is seen at once."""
    again = PerformanceReader(spec.performance, prim=spec.prim)
    edited = again.edited()
    notes = []
    for shape in spec.shape:
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
                f"({low:.2f} to "
                f"{high:.2f}); `usdface bake --limit` keeps it within the rig's range"
            )
    return notes
