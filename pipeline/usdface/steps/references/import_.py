"""Import tuned weights into a references asset, by frame and shape name."""

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from usdface.capture.channel_take import LARGEST_FRACTION
from usdface.core.arrays import columns_by_name, index_of
from usdface.core.assets import References, Take, Video
from usdface.core.errors import InputError
from usdface.core.progress import Progress, part
from usdface.core.provenance import Provenance
from usdface.core.sidecars import is_usd_name, tuned_path
from usdface.core.text import counted, first_few, pluralize
from usdface.model.retarget.name_matching import meaning_notes
from usdface.runner.origin import provenance_of, spec_of, take_of_performance
from usdface.runner.result import StepResult
from usdface.specs.references import ReferencesImportSpec
from usdface.steps.inputs.source_motion import check_no_name_twice, transfer_by_table
from usdface.steps.inputs.tuned_pairs import tuned_conflicts
from usdface.steps.inputs.weight_tables import (
    USUAL_RATES,
    WeightTable,
    read_weight_table,
    undo_clamping,
)
from usdface.steps.references.coverage import redraw_coverage
from usdface.usdio.references.read import read_rig_of
from usdface.usdio.references.weight_layers import TunedPair, check_shown, read_keyed_references
from usdface.usdio.references.write import write_tuned_weights
from usdface.usdio.take.read import read_first_frame

_RATE_SHARE = 0.9
"""Share of a table's rows that must be at pairs at another rate for the table to have that rate."""

_CHANCE_PROBABILITY = 0.01
"""Largest probability that as many random rows would be at pairs."""


def run(spec: ReferencesImportSpec, *, provenance: Provenance, progress: Progress) -> StepResult:
    """Match the file's rows to pairs and its columns to shapes, and write the tuned layer."""
    references = read_keyed_references(spec.references)
    check_shown(spec.references)
    given = _pairs_of_references(spec) or read_weight_table(
        spec.weights,
        known=references.shape_names,
        unit=spec.weight_unit,
        shapes=spec.shapes,
        take=None,
    )
    if spec.at == "frames" and references.rate:
        rate = Fraction(references.rate)
        given.check_rate(rate, file=spec.weights, performance=spec.references)
    if spec.at == "video":
        given = _at_times_of_pairs(spec, references, given)
    combinations = {each.shape for each in references.combinations}
    if spec.names is None:
        table, transfer = given.by_meaning(references.shape_names, leave=combinations)
        check_no_name_twice(spec.weights, transfer.source, transfer)
    else:
        transfer = transfer_by_table(spec.names, given.names, references.shape_names)
        table = given.renamed(transfer)
    known = table.shapes_among(references.shape_names, file=spec.weights, owner="on the rig")
    if spec.names is None:
        _check_matched(spec, references, given, {*transfer.matched, *combinations})
    if is_usd_name(spec.weights):
        _check_size(spec, references, table, known)
    pairs = _pairs(spec, references, table, known)
    unmatched = _unmatched_rows(spec, references, table, matched=len(pairs))
    write_tuned_weights(
        references, pairs, layer_path=tuned_path(spec.references), provenance=provenance
    )
    pictures, picture_notes = redraw_coverage(spec.references, part(progress, 0.1, 1.0))
    tuned = set(np.flatnonzero(references.tuned).tolist()) | {pair.pair for pair in pairs}
    count = len(references.frames)
    texts, conflicts = tuned_conflicts(spec.references)
    notes = [
        *picture_notes,
        *_row_notes(spec, table, pairs, unmatched),
        *_missed_notes(spec, references, table, pairs),
        *meaning_notes(transfer),
        *given.notes(spec.weights, {*transfer.matched, *combinations}, owner="on the rig"),
        *_missing_notes(spec, references, table, pairs),
    ]
    driven = [name for name in given.names if name in combinations]
    if driven:
        notes.append(f"not imported, as other shapes drive them: {counted(driven, 'combination')}")
    if len(tuned) < count:
        notes.append(
            f"still untuned proposals: {pluralize(count - len(tuned), 'pair')}; `usdface train` "
            "leaves them out once 8 pairs are tuned"
        )
    return StepResult(
        (tuned_path(spec.references), *pictures),
        f"{pluralize(len(pairs), 'pair')} imported, {pluralize(len(known), 'shape')} each; "
        f"{len(tuned)} of {count} pairs are tuned",
        (*notes, *texts),
        {
            "pairs": len(pairs),
            "tuned": len(tuned),
            "shapes": len(known),
            "rows": len(table.frames),
            "unmatched": [frame for frame, _ in unmatched],
            "conflicts": conflicts,
        },
    )


def _pairs_of_references(spec: ReferencesImportSpec) -> WeightTable | None:
    """Return the tuned pairs of other references, by take and frame; None for other files."""
    if not tuned_path(spec.weights).is_file():
        return None
    other = read_keyed_references(spec.weights)
    other = other.rows(other.tuned)
    frames = tuple(other.frames.tolist())
    if not frames or spec.at != "frames":
        raise InputError(
            f"{spec.weights}: these references have {pluralize(len(frames), 'tuned pair')}, which "
            "are imported by take and frame; tune some, and leave --at out"
        )
    return WeightTable(
        other.shape_names, frames, other.weights, keyed=frozenset(frames), takes=other.takes
    )


def _check_matched(
    spec: ReferencesImportSpec, references: References, given: WeightTable, matched: set[str]
) -> None:
    """Refuse a file of another rig's names, of which pairs would be tuned with most shapes at 0."""
    moving = [given.names[column] for column in np.flatnonzero((given.weights != 0).any(axis=0))]
    lost = [name for name in moving if name not in matched]
    found = len(matched.intersection(given.names))
    if 2 * len(lost) > len(moving) and 2 * found < len(references.shape_names):
        raise InputError(
            f"{spec.weights}: {len(lost)} of its {pluralize(len(moving), 'shape')} with weights "
            f"({first_few(lost, most=3)}) are not on the rig, or not clearly one of its shapes "
            f"({first_few(references.shape_names, most=3)}); match them: `usdface names`, --names"
        )


def _check_size(
    spec: ReferencesImportSpec, references: References, table: WeightTable, known: list[str]
) -> None:
    """Refuse weights of USD far beyond the rig's ranges, such as percent."""
    weights = np.abs(table.columns(tuple(known)))
    if weights.max(initial=0.0) <= LARGEST_FRACTION:
        return
    rig = read_rig_of(references, spec.references)
    ends = columns_by_name(np.abs(rig.ranges).max(axis=1)[None], rig.shapes, known)[0]
    far = np.argwhere(weights > LARGEST_FRACTION * ends)
    if len(far):
        row, column = far[0].tolist()
        raise InputError(
            f"{spec.weights} frame {table.frames[row]}: {known[column]} is "
            f"{weights[row, column]:g}, and {ends[column]:g} is full on the rig; if 100 is full in "
            "this file, divide its weights by 100"
        )


def _row_notes(
    spec: ReferencesImportSpec,
    table: WeightTable,
    pairs: list[TunedPair],
    unmatched: list[tuple[int, str]],
) -> list[str]:
    """Return notes on rows that match no pair, and on pairs with interpolated weights."""
    notes = []
    if unmatched:
        listed = first_few([f"{frame} of {take}" if take else frame for frame, take in unmatched])
        reason = (
            f"have numbers of no pair ({listed})"
            if spec.at == "pairs"
            else f"are at frames that are no pairs ({listed}): add pairs at these frames with "
            "`usdface references add`, and import again"
        )
        notes.append(
            f"not imported: {len(unmatched)} of {pluralize(len(table.frames), 'row')} {reason}"
        )
    between = sum(pair.frame not in table.keyed for pair in pairs)
    if between and spec.at == "frames":
        notes.append(
            f"interpolated between keys of {spec.weights.name}: {pluralize(between, 'pair')}"
        )
    return notes


def _missed_notes(
    spec: ReferencesImportSpec, references: References, table: WeightTable, pairs: list[TunedPair]
) -> list[str]:
    """Return a note on pairs that the file has no weights for, if it has those of some."""
    imported = {pair.pair for pair in pairs}
    missed = [
        f"{pair + 1} at frame {frame}"
        for pair, frame in enumerate(references.frames.tolist())
        if pair not in imported
    ]
    if not missed:
        return []
    return [
        f"not in {spec.weights.name}, whose {'pairs' if spec.at != 'frames' else 'frames'} are "
        f"{min(table.frames)}-{max(table.frames)}: {len(missed)} of "
        f"{pluralize(len(references.frames), 'pair')} ({first_few(missed)})"
    ]


def _missing_notes(
    spec: ReferencesImportSpec, references: References, table: WeightTable, pairs: list[TunedPair]
) -> list[str]:
    """Return notes on the weights of shapes missing from the file."""
    missing = [name for name in references.shape_names if name not in table.names]
    if not missing:
        return []
    notes = []
    first = [pair.pair for pair in pairs if not references.tuned[pair.pair]]
    if first:
        columns = [references.shape_names.index(name) for name in missing]
        proposed = np.abs(references.weights[np.ix_(first, columns)]).max(axis=0)
        most = [
            f"{missing[column]} {proposed[column]:.2f}"
            for column in np.argsort(-proposed, kind="stable").tolist()
        ]
        done = (
            "keep their proposals, which count as tuned"
            if spec.keep_proposed
            else "are set to 0; --keep-proposed keeps the proposals"
        )
        notes.append(
            f"not in the file: {pluralize(len(missing), 'shape')}, which in "
            f"{pluralize(len(first), 'pair')} not tuned before {done} (largest: {first_few(most)})"
        )
    if len(first) < len(pairs):
        notes.append(
            f"not in the file, so unchanged in the {pluralize(len(pairs) - len(first), 'pair')} "
            f"tuned before: {counted(missing, 'shape')}"
        )
    return notes


def _at_times_of_pairs(
    spec: ReferencesImportSpec, references: References, table: WeightTable
) -> WeightTable:
    """Return the weights at the times of the pairs, by the common video of both takes."""
    takes = spec_of(provenance_of(spec.references)).get("takes", [])
    solved = take_of_performance(spec.weights)
    if solved is None or len(takes) != 1:
        unclear = spec.references if solved is not None else spec.weights
        raise InputError(
            f"{unclear}: does not name a single take, whose video --at video needs; give "
            "--weights made by `usdface map`, and references of one take"
        )
    own, other = (_timed_take(path) for path in (spec.references.parent / str(takes[0]), solved))
    if own[1].file.resolve() != other[1].file.resolve():
        raise InputError(
            f"{spec.weights}: its take has the video {other[1].file}, and the pairs' take "
            f"{own[1].file}; track or ingest the same performance with the same video"
        )
    seconds = own[0].video_seconds(references.frames.astype(np.float64))
    at = other[1].take_time(seconds) * float(other[0].rate)
    at = at + other[0].first_frame
    numbers = np.array(table.frames, np.float64)
    inside = (at >= numbers[0]) & (at <= numbers[-1])
    if not inside.any():
        raise InputError(
            f"{spec.weights}: none of the {len(at)} pairs is within its frames "
            f"{table.frames[0]}-{table.frames[-1]} by the video; align both takes with it"
        )
    weights = np.stack(
        [np.interp(at[inside], numbers, column) for column in table.weights.T], axis=1
    )
    pairs = tuple((1 + np.flatnonzero(inside)).tolist())
    return replace(table, frames=pairs, weights=weights, keyed=frozenset(pairs), takes=())


def _timed_take(path: Path) -> tuple[Take, Video]:
    """Return the first frame of a take, and its video."""
    if not path.is_file():
        raise InputError(f"{path}: no such take; --at video needs the takes of both sides")
    take = read_first_frame(path)
    if take.video is None:
        raise InputError(
            f"{path}: has no video, which --at video needs; ingest it with --video and align it"
        )
    return take, take.video


def _unmatched_rows(
    spec: ReferencesImportSpec, references: References, table: WeightTable, *, matched: int
) -> list[tuple[int, str]]:
    """Return frame and take of the keys at no pair; none for a file with a row for every frame.

    Refuses a table without rows at pairs, or whose rows would be at pairs at another rate.
    """
    takes = table.takes if spec.at == "frames" and table.takes else ("",) * len(table.frames)
    rows = list(zip(table.frames, takes, strict=True))
    if spec.at == "frames":
        names = references.takes if any(takes) else ("",) * len(references.takes)
        places = set(zip(references.frames.tolist(), names, strict=True))
    else:
        places = {(1 + pair, "") for pair in range(len(references.frames))}
    unmatched = [row for row in rows if row not in places and row[0] in table.keyed]
    steps = set(np.diff(sorted(set(table.frames))).tolist())
    if matched and len(steps) == 1 and len(rows) > len(references.frames):
        return []
    if spec.at == "frames" and 2 * matched < len(rows):
        _check_counting(spec, references, table, matched)
    if not matched:
        raise InputError(
            f"{spec.weights}: none of its {len(table.frames)} frames "
            f"({table.frames[0]}-{table.frames[-1]}) is one of the {len(references.frames)} pairs; "
            "check --at and the take"
        )
    return unmatched


def _check_counting(
    spec: ReferencesImportSpec, references: References, table: WeightTable, matched: int
) -> None:
    """Refuse rows of which nearly all are at pairs at another rate."""
    rows = np.unique(table.frames)
    for rate in USUAL_RATES if references.rate else ():
        if abs(rate / references.rate - 1) < 0.002:
            continue
        # Tools round or truncate to a frame.
        places = references.frames * (rate / references.rate)
        near = np.unique([np.floor(places), np.ceil(places)])
        found = int(np.isin(rows, near).sum())
        by_chance = min(len(near) / (np.ptp(rows) + 1), 1.0)
        if found >= _RATE_SHARE * len(rows) and by_chance**found < _CHANCE_PROBABILITY:
            raise InputError(
                f"{spec.weights}: {matched} of {pluralize(len(rows), 'row')} are at pairs, but "
                f"{found} would be at {rate:.5g} frames per second, and the pairs' takes have "
                f"{references.rate:.5g}; export it at their rate, or number its rows by pair and "
                "give --at pairs"
            )


def _pairs(
    spec: ReferencesImportSpec, references: References, table: WeightTable, known: list[str]
) -> list[TunedPair]:
    by_take = bool(table.takes) and spec.at == "frames"
    row_of: dict[object, int] = dict(
        index_of(zip(table.takes, table.frames, strict=True)) if by_take else index_of(table.frames)
    )
    if spec.at == "frames" and len(set(references.takes)) > 1 and not by_take:
        raise InputError(
            f"{spec.references}: its pairs are of {len(set(references.takes))} takes, so frame "
            "numbers are ambiguous; add a `take` column, or number the rows by pair and use --at "
            "pairs"
        )
    if by_take and not set(table.takes) & set(references.takes):
        raise InputError(
            f"{spec.weights}: none of its takes ({first_few(dict.fromkeys(table.takes), most=3)}) "
            f"is one of the pairs' ({first_few(dict.fromkeys(references.takes), most=3)}); correct "
            "the `take` column"
        )
    pairs = []
    for pair, (take, frame) in enumerate(
        zip(references.takes, references.frames.tolist(), strict=True)
    ):
        key = (take, frame) if by_take else frame if spec.at == "frames" else pair + 1
        if key not in row_of:
            continue
        if spec.at != "frames" and key not in table.keyed:
            continue  # values between keys of pairs mean nothing
        weights = references.weights_of(pair)
        if not (references.tuned[pair] or spec.keep_proposed):
            weights |= dict.fromkeys(weights.keys() - set(known), 0.0)
        row = np.array([row_of[key]])
        for name in known:
            weights[name] = float(undo_clamping(table, name, row, np.array([weights[name]]))[0])
        pairs.append(TunedPair(pair, take, frame, weights, author=spec.author))
    return pairs
