"""Import an animation changed in another tool as edits."""

import numpy as np

from usdface.core.arrays import BoolArray, IntArray, columns_by_name
from usdface.core.errors import InputError
from usdface.core.progress import Progress
from usdface.core.provenance import Provenance
from usdface.core.sidecars import controls_path
from usdface.core.text import first_few, pluralize
from usdface.numerics.motion.key_reduction import EditCurve, no_edit
from usdface.runner.origin import take_name
from usdface.runner.result import StepResult
from usdface.specs.edits import EditsImportSpec
from usdface.steps.edits.edit import all_frames, range_notes, solve_at, with_curve
from usdface.steps.inputs.weight_tables import (
    WeightTable,
    changed_on_other_meshes,
    other_mesh_notes,
    read_weight_table,
    undo_clamping,
)
from usdface.usdio.performance.driving_layers import opened_driving_layer
from usdface.usdio.performance.edits import (
    ShapeEdit,
    edited_weights,
    edits_stamp,
    read_edits,
    write_edits,
)
from usdface.usdio.performance.read import PerformanceReader

_LEAST_CHANGE = 0.002
"""Smallest difference in weight that counts as an edit; smaller ones are rounding."""

_SAME_SHARE = 0.5
"""Share of the frames above which a file that starts elsewhere is the performance, moved in time.
"""


def run(spec: EditsImportSpec, *, provenance: Provenance, progress: Progress) -> StepResult:
    """Set edits so that the performance equals the file at its frames.

    Where they are equal already, edits do not change, including overrides and masks.
    """
    stamp = edits_stamp(spec.performance)
    reader = PerformanceReader(spec.performance, prim=spec.prim)
    table = read_weight_table(
        spec.changed,
        known=reader.names,
        unit=spec.weight_unit,
        take=take_name(spec.performance),
    )
    table.check_rate(reader.rate, file=spec.changed, performance=spec.performance)
    driven = {each.shape for each in reader.combinations}
    editable = [name for name in reader.names if name not in driven]
    known = table.shapes_among(editable, file=spec.changed, owner="in the performance")
    # An edit of the last frame must not extend to frames that are mapped later.
    frames = all_frames(reader, reach=(reader.first_frame - 1, reader.last_frame + 1))
    given = _rows(spec, reader, table)
    progress(0.3, "comparing with the solve")
    changed, elsewhere, differing = _changes(spec, reader, table, known, frames, given)
    notes = (
        *table.notes(spec.changed, reader.names, owner="in the performance"),
        *other_mesh_notes(table, elsewhere),
    )
    outside = len(table.frames) - len(given)
    if outside:
        notes += (f"left out {pluralize(outside, 'frame')} outside the performance",)
    if opened_driving_layer(reader, controls_path):
        notes += ("edits are of weights: changes of joints and attributes are not imported",)
    if not changed:
        return StepResult(
            (),
            "nothing differs from the performance; its edits do not change",
            notes,
            {"frames": 0, "shapes": []},
        )
    count = int(differing.sum())
    if 2 * count > len(given) > 1:
        _check_not_moved(spec, reader, table, known)
        notes += (
            "most frames differ: between sparse keys the file's interpolation is imported, and if "
            "the take was mapped again after it was baked, the changes of the solve; key every "
            "frame, or bake again, change that file and import it",
        )
    path = write_edits(
        spec.performance, reader.animation, changed, frames, stamp=stamp, provenance=provenance
    )
    notes += tuple(range_notes(spec.performance, spec.prim, changed))
    return StepResult(
        (path,),
        f"{count} of {len(given)} frames differ from the performance, in "
        f"{pluralize(len(changed), 'shape')}: {first_few(sorted(changed))}",
        notes,
        {"frames": count, "shapes": sorted(changed)},
    )


def _check_not_moved(
    spec: EditsImportSpec, reader: PerformanceReader, table: WeightTable, known: list[str]
) -> None:
    """Refuse a file that most often equals the performance if both begin at the same time."""
    own = columns_by_name(reader.edited(), reader.names, tuple(known))
    rows = np.array(table.frames) - min(table.frames)
    inside = rows < len(own)
    moved = np.abs(table.columns(tuple(known))[inside] - own[rows[inside]]).max(axis=1)
    if (moved < _LEAST_CHANGE).mean() > _SAME_SHARE:
        raise InputError(
            f"{spec.changed}: is {spec.performance.name} in another time, from frame "
            f"{min(table.frames)} instead of {reader.first_frame}; export it from there, or import "
            "it to the shot in which it plays"
        )


def _changes(
    spec: EditsImportSpec,
    reader: PerformanceReader,
    table: WeightTable,
    known: list[str],
    frames: IntArray,
    given: IntArray,
) -> tuple[dict[str, ShapeEdit], dict[str, list[str]], BoolArray]:
    """Return new edits by shape, meshes with other values by shape, and which rows differ.

    `given`: frame numbers and rows of the table, as of `_rows`.
    """
    edits = read_edits(reader.animation, frames)
    solved = solve_at(reader, frames)
    rows = given[:, 0] - int(frames[0])
    shown = edited_weights(reader.names, solved, edits)
    changed: dict[str, ShapeEdit] = {}
    elsewhere: dict[str, list[str]] = {}
    differing = np.zeros(len(rows), dtype=bool)
    for shape in known:
        solve = solved[:, reader.names.index(shape)]
        before = shown[rows, reader.names.index(shape)]
        now = undo_clamping(table, shape, given[:, 1], before)
        offset = now - solve[rows]
        meshes = changed_on_other_meshes(
            table,
            shape,
            given[:, 1],
            weights=now,
            current=before,
            solved=solve[rows],
            least=_LEAST_CHANGE,
        )
        if meshes:
            elsewhere[shape] = meshes
        differs = np.abs(now - before) > _LEAST_CHANGE
        if not differs.any():
            continue
        old = edits.get(shape, ShapeEdit(no_edit(len(frames)), np.full(len(frames), np.nan)))
        differing |= differs
        touched = np.zeros(len(frames), dtype=bool)
        touched[rows[differs]] = True
        offset = np.where(np.abs(offset) > _LEAST_CHANGE, offset, 0.0)[differs]
        offsets, mask = old.curve.offset.copy(), old.curve.mask.copy()
        offsets[rows[differs]], mask[rows[differs]] = offset, 0.0
        curve = EditCurve(offsets, old.curve.override, mask)
        changed[shape] = with_curve(old, curve, solve, touched)
    return changed, elsewhere, differing


def _rows(spec: EditsImportSpec, reader: PerformanceReader, table: WeightTable) -> IntArray:
    """Return (frame number, row of the table) of the common frames."""
    frames = np.array(table.frames, dtype=np.int64)
    rows = np.flatnonzero((frames >= reader.first_frame) & (frames <= reader.last_frame))
    if not len(rows):
        raise InputError(
            f"{spec.changed} (frames {min(table.frames)}-{max(table.frames)}) and "
            f"{spec.performance} (frames {reader.first_frame}-{reader.last_frame}) have no common "
            "frame; if the animation was shifted in the other tool, shift it back"
        )
    return np.stack([frames[rows], rows], axis=1)
