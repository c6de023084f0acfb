"""Edited ranges of a performance, and notes on a new solve below them."""

from dataclasses import dataclass
from itertools import starmap
from pathlib import Path

import numpy as np

from usdface.core.arrays import FloatArray, runs
from usdface.core.sidecars import edits_path
from usdface.core.text import first_few, pluralize
from usdface.usdio.performance.edits import edited_frames, edits_elsewhere, read_edits
from usdface.usdio.performance.read import PerformanceReader
from usdface.usdio.referenced_files import lost_targets
from usdface.usdio.rig.reference import replaced_motion_notes

NOTABLE_CHANGE = 0.1
"""Change of the solved weight below an edit that is reported: a tenth of a shape is visible."""


@dataclass(frozen=True)
class EditedRange:
    """Consecutive frames at which one shape is edited."""

    shape: str
    first: int
    last: int
    """Inclusive."""
    change: float
    """Largest change of the weight by the edits, signed."""
    solve_change: float
    """Largest change of the solve since the edit was made, signed; NaN if not known."""
    solve_frame: int
    """Frame of `solve_change`."""


def find_edited_ranges(reader: PerformanceReader) -> list[EditedRange]:
    """Return every edited range of a performance, by shape and frame; unknown shapes left out."""
    edits = {name: edit for name, edit in reader.edits.items() if name in reader.names}
    if not edits:
        return []
    solved, edited = reader.solved(), reader.edited()
    found = []
    for name, edit in sorted(edits.items()):
        column = reader.names.index(name)
        change = edited[:, column].astype(np.float64) - solved[:, column]
        moved = solved[:, column] - edit.solve_when_edited
        for part in starmap(slice, runs(edit.curve.active)):
            worst = _largest(moved[part])
            found.append(
                EditedRange(
                    name,
                    int(reader.frames[part.start]),
                    int(reader.frames[part.stop - 1]),
                    float(change[part][_largest(change[part])]),
                    float(moved[part][worst]),
                    int(reader.frames[part.start + worst]),
                )
            )
    return found


def edits_outside(reader: PerformanceReader) -> list[str]:
    """Return the shapes and frames of edits that lie outside a performance, as "jawOpen 10-20"."""
    reach = edited_frames(reader.animation)
    if reach is None or (reach[0] >= reader.first_frame and reach[1] <= reader.last_frame):
        return []
    frames = np.arange(reach[0], reach[1] + 1, dtype=np.int64)
    outside = (frames < reader.first_frame) | (frames > reader.last_frame)
    return [
        f"{shape} {frames[part.start]}-{frames[part.stop - 1]}"
        for shape, edit in sorted(read_edits(reader.animation, frames).items())
        for part in starmap(slice, runs(edit.curve.active))
        if outside[part].all()
    ]


def performance_notes(performance: Path) -> list[str]:
    """Return notes on a new solve: on what it loses of the rig, and on edits above it."""
    reader = PerformanceReader(performance)
    notes = replaced_motion_notes(reader.stage, reader.animation)
    lost = [f"<{path}>: {fault}" for path, fault in lost_targets(reader.stage).items()]
    if lost:
        more = f" ({len(lost) - 1} more: `usdface validate` names them)" if lost[1:] else ""
        notes.append(lost[0] + more)
    return [*notes, *_edit_notes(reader)] if edits_path(performance).is_file() else notes


def _edit_notes(reader: PerformanceReader) -> list[str]:
    """Return notes on edits kept above a new solve: where it changed, and edits without effect."""
    ranges = find_edited_ranges(reader)
    shapes = {each.shape for each in ranges}
    notes = (
        [f"kept the edits of {pluralize(len(shapes), 'shape')}: {first_few(sorted(shapes))}"]
        if shapes
        else []
    )
    notes += [
        f"{each.shape} {each.first}-{each.last}: the solve below the edit changed by up to "
        f"{each.solve_change:+.2f} at frame {each.solve_frame}; check the edit"
        for each in ranges
        if abs(each.solve_change) > NOTABLE_CHANGE
    ]
    beyond = edits_outside(reader)
    if beyond:
        notes.append(
            f"edits outside frames {reader.first_frame}-{reader.last_frame} have no effect: "
            f"{first_few(beyond)}; they are kept for when those frames are mapped"
        )
    unknown = sorted(set(reader.edits) - set(reader.names))
    if unknown:
        notes.append(
            f"edits of shapes missing from this solve have no effect: {first_few(unknown)}; they "
            "are kept for when the shapes are solved"
        )
    notes += [
        f"edits at <{path}> have no effect, as there is no animation; they are kept: map with that "
        "--prim again, or move them"
        for path in edits_elsewhere(reader.path, reader.animation)
    ]
    return notes


def _largest(values: FloatArray) -> int:
    return int(np.argmax(np.where(np.isfinite(values), np.abs(values), -1.0)))
