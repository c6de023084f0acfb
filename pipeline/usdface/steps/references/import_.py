"""Bring tuned weights into a references asset, by frame and shape name."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from usdface.core.arrays import index_of
from usdface.core.assets import References, Video
from usdface.core.errors import InputError
from usdface.core.progress import Progress, part, silent
from usdface.core.provenance import Provenance
from usdface.core.sidecars import tuned_path
from usdface.core.text import counted, first_few, pluralize
from usdface.model.retarget.name_matching import meaning_notes
from usdface.runner.origin import provenance_of, spec_of, take_of_performance
from usdface.runner.result import StepResult
from usdface.specs.references import ReferencesImportSpec
from usdface.steps.inputs.name_tables import check_no_name_twice, transfer_by_table
from usdface.steps.inputs.tuned_pairs import tuned_conflicts
from usdface.steps.inputs.weight_tables import WeightTable, read_weight_table, weights_meant
from usdface.steps.references.coverage import redraw_coverage
from usdface.usdio.references.read import read_references
from usdface.usdio.references.weight_layers import TunedPair
from usdface.usdio.references.write import write_tuned_weights
from usdface.usdio.take.read import TakeReader


def run(
    spec: ReferencesImportSpec,
    *,
    provenance: Provenance,
    progress: Progress = silent,
) -> StepResult:
    """Match the file's rows to pairs and its columns to shapes, and write the tuned layer."""
    references = read_references(spec.references)
    given = read_weight_table(
        spec.weights, known=references.shape_names, unit=spec.weight_unit, shapes=spec.shapes
    )
    _check_rate(spec, given)
    if spec.at == "video":
        given = _at_moments_of_pairs(spec, references, given)
    combinations = {each.shape for each in references.combinations}
    if spec.names is None:
        table, transfer = given.by_meaning(references.shape_names, leave=combinations)
        check_no_name_twice(spec.weights, transfer.source, transfer)
    else:
        transfer = transfer_by_table(spec.names, given.names, references.shape_names)
        table = given.renamed(transfer)
    known = table.shapes_among(references.shape_names, file=spec.weights, owner="on the rig")
    pairs = _pairs(spec, references, table, known)
    if not pairs:
        raise InputError(
            f"{spec.weights}: none of its {len(table.frames)} frames "
            f"({table.frames[0]}-{table.frames[-1]}) is one of the {len(references.frames)} pairs; "
            "is --at right?"
        )
    write_tuned_weights(
        references, pairs, layer_path=tuned_path(spec.references), provenance=provenance
    )
    pictures, undrawn = redraw_coverage(spec.references, part(progress, 0.1, 1.0))
    progress(1.0, "imported")
    notes = [*undrawn, *meaning_notes(transfer), *given.numbering_notes(spec.weights)]
    matched = set(transfer.matched)
    driven = [name for name in given.names if name in combinations]
    if driven:
        notes.append(f"not imported, as other shapes drive them: {counted(driven, 'combination')}")
    unknown = [name for name in given.names if name not in {*matched, *driven}]
    if unknown:
        notes.append(
            f"left out {pluralize(len(unknown), 'column')}, of no shape of the rig: "
            f"{first_few(unknown)}"
        )
    missing = [name for name in references.shape_names if name not in table.names]
    if missing:
        notes.append(f"not in the file, so unchanged: {counted(missing, 'shape')}")
    between = sum(_key(spec, pair) not in table.keyed for pair in pairs)
    if between:
        notes.append(
            f"interpolated, as {spec.weights.name} has no key there: {pluralize(between, 'pair')}"
        )
    tuned = set(np.flatnonzero(references.tuned).tolist()) | {pair.pair for pair in pairs}
    count = len(references.frames)
    if len(tuned) < count:
        notes.append(
            f"still proposals that nobody tuned: {pluralize(count - len(tuned), 'pair')}; "
            "`usdface train` with --tuned-only leaves them out"
        )
    texts, conflicts = tuned_conflicts(spec.references)
    notes += texts
    return StepResult(
        (tuned_path(spec.references), *pictures),
        f"{pluralize(len(pairs), 'pair')} imported, {pluralize(len(known), 'shape')} each; "
        f"{len(tuned)} of {count} pairs are tuned",
        tuple(notes),
        {
            "pairs": len(pairs),
            "tuned": len(tuned),
            "shapes": len(known),
            "conflicts": conflicts,
        },
    )


def _check_rate(spec: ReferencesImportSpec, table: WeightTable) -> None:
    """Refuse rows that count at another rate than the pairs' takes, where these are there."""
    takes = spec_of(provenance_of(spec.references)).get("takes", [])
    for name in takes if spec.at == "frames" and not table.numbered else ():
        take = spec.references.parent / str(name)
        if take.is_file():
            table.check_rate(TakeReader(take).rate, file=spec.weights, performance=take)


def _at_moments_of_pairs(
    spec: ReferencesImportSpec, references: References, table: WeightTable
) -> WeightTable:
    """Return the weights at the moments of the pairs, by the video that both takes name."""
    takes = spec_of(provenance_of(spec.references)).get("takes", [])
    solved = take_of_performance(spec.weights)
    if solved is None or len(takes) != 1:
        what = spec.references if solved is not None else spec.weights
        raise InputError(
            f"{what}: does not say which one take it is of, so that --at video knows no video; "
            "give --weights that `usdface map` made, and references of one take"
        )
    own, other = (_timed_take(path) for path in (spec.references.parent / str(takes[0]), solved))
    if own[1].file.resolve() != other[1].file.resolve():
        raise InputError(
            f"{spec.weights}: its take names the video {other[1].file}, and the pairs' take "
            f"{own[1].file}; track or ingest the same performance with the same video"
        )
    seconds = (references.frames - own[0].first_frame) / float(own[0].rate)
    at = other[1].take_time(own[1].video_time(seconds)) * float(other[0].rate)
    at = at + other[0].first_frame
    numbers = np.array(table.frames, np.float64)
    inside = (at >= numbers[0]) & (at <= numbers[-1])
    if not inside.any():
        raise InputError(
            f"{spec.weights}: none of the {len(at)} pairs lies in its frames "
            f"{table.frames[0]}-{table.frames[-1]} by the video; is the take aligned with it?"
        )
    weights = np.stack(
        [np.interp(at[inside], numbers, column) for column in table.weights.T], axis=1
    )
    pairs = tuple((1 + np.flatnonzero(inside)).tolist())
    return replace(table, frames=pairs, weights=weights, keyed=frozenset(pairs), takes=())


def _timed_take(path: Path) -> tuple[TakeReader, Video]:
    if not path.is_file():
        raise InputError(f"{path}: no such take; --at video needs the takes of both sides")
    take = TakeReader(path)
    video = take.read(take.first_frame, take.first_frame, head_motion=False).video
    if video is None:
        raise InputError(
            f"{path}: names no video, so that nothing tells its moments; ingest it with --video "
            "and align it"
        )
    return take, video


def _key(spec: ReferencesImportSpec, pair: TunedPair) -> int:
    return pair.frame if spec.at == "frames" else pair.pair + 1


def _pairs(
    spec: ReferencesImportSpec, references: References, table: WeightTable, known: list[str]
) -> list[TunedPair]:
    by_take = bool(table.takes) and spec.at == "frames"
    row_of: dict[object, int] = dict(
        index_of(zip(table.takes, table.frames, strict=True)) if by_take else index_of(table.frames)
    )
    keys = (
        references.frames
        if spec.at == "frames"
        else np.arange(1, len(references.frames) + 1, dtype=np.int64)
    )
    if spec.at == "frames" and len(set(references.takes)) > 1 and not by_take:
        raise InputError(
            f"{spec.references}: its pairs are of {len(set(references.takes))} takes, so a frame "
            "number alone does not tell which; add a `take` column, or number the rows by pair and "
            "use --at pairs"
        )
    if by_take and not set(table.takes) & set(references.takes):
        raise InputError(
            f"{spec.weights}: its takes ({first_few(dict.fromkeys(table.takes), most=3)}) are none "
            f"of the pairs' ({first_few(dict.fromkeys(references.takes), most=3)}); correct the "
            "`take` column"
        )
    pairs = []
    for pair, number in enumerate(keys.tolist()):
        key = (references.takes[pair], number) if by_take else number
        if key not in row_of:
            continue
        if spec.at != "frames" and key not in table.keyed:
            continue  # between two pairs lies nothing that anybody meant
        # A shape the file does not name keeps what composes now.
        weights = dict(zip(references.shape_names, references.weights[pair].tolist(), strict=True))
        row = np.array([row_of[key]])
        for name in known:
            weights[name] = float(weights_meant(table, name, row, np.array([weights[name]]))[0])
        pairs.append(TunedPair(pair, references.takes[pair], int(references.frames[pair]), weights))
    return pairs
