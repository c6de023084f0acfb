"""Propose pairs of corresponding expressions of two characters; list pairs of their shapes."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from usdface.capture.sniff import recognise_format
from usdface.capture.weight_samples import read_weight_samples
from usdface.capture.weight_table import read_weight_take
from usdface.core.assets import Rig, range_ends
from usdface.core.controls import Controls, ExpressionPairs
from usdface.core.errors import InputError, as_input_error
from usdface.core.progress import Progress, silent
from usdface.core.provenance import Provenance
from usdface.core.sidecars import is_usd_name, proposed_path
from usdface.core.text import counted, first_few, pluralize
from usdface.model.placement.rig_orientation import describe_orientation
from usdface.model.retarget.control_space import constant_controls
from usdface.model.retarget.name_matching import (
    NameMatch,
    NameMatching,
    Transfer,
    expression_rows,
    match_names,
    transfer_by_names,
)
from usdface.model.retarget.shape_matching import ShapeMatch, differing_sides, match_deformations
from usdface.model.retarget.shape_vocabulary import ARKIT
from usdface.runner.outputs import confine
from usdface.runner.result import StepResult
from usdface.specs.retarget import PairsProposeSpec
from usdface.steps.inputs.source_motion import (
    read_source_motion,
    transfer_by_table,
    write_name_table,
)
from usdface.steps.retarget.pairs_import import IMPORTED_NAME
from usdface.usdio.retarget.controls import rest_controls
from usdface.usdio.retarget.pairs import keyed_above, merge_pairs, read_pairs, write_pairs
from usdface.usdio.rig.read import read_rig
from usdface.usdio.take.read import is_take

REST_PAIR = "rest"


def run(spec: PairsProposeSpec, *, provenance: Provenance, progress: Progress) -> StepResult:
    """Match shapes, and write a pair for rest and one for each match."""
    shapes, source = source_shapes(spec.source, prim=spec.source_prim)
    target = read_rig(spec.target, prim=spec.target_prim)
    matches, notes = _match(spec, shapes, source, target, progress)
    if not matches:
        raise InputError(
            f"{spec.source} and {spec.target}: no shapes correspond; key pairs by hand and import "
            "them with `usdface pairs import`"
        )
    rest = rest_controls(target, attributes=spec.attributes, joints=spec.joints)
    by_table = spec.names is not None
    pairs = _pairs(shapes, source, target, matches, rest, by_table=by_table)
    kept = 0
    if spec.out.is_file():
        pairs, kept, merge_notes = _with_existing(spec.out, pairs)
        notes += merge_notes
    progress(0.9, f"writing {spec.out.name}")
    write_pairs(spec.out, pairs, source_rig=source, target_rig=target, provenance=provenance)
    dead = constant_controls(pairs)
    if dead:
        notes.append(
            f"{len(dead)} controls of the target are at rest in every pair: {first_few(dead)}; "
            "key expressions that use them"
        )
    if kept:
        notes.append(f"kept {pluralize(kept, 'pair')} at their time codes")
    return StepResult(
        (spec.out, proposed_path(spec.out)),
        f"{len(pairs)} pairs of {len(shapes)} source shapes and {pairs.target.summary}; "
        "proposals to be tuned",
        tuple(notes),
        {"pairs": len(pairs), "names": list(pairs.names), "dead": list(dead)},
    )


def source_shapes(path: Path, *, prim: str | None = None) -> tuple[tuple[str, ...], Rig | None]:
    """Return the shapes of a rig, take, performance, capture or table, and the rig if it is one."""
    if not is_usd_name(path):
        if recognise_format(path).read is read_weight_take:  # names need no rate, unit or take
            return read_weight_samples(path).names, None
        return read_source_motion(path).names, None
    if is_take(path):
        return read_source_motion(path).names, None
    try:
        rig = read_rig(path, prim=prim)
    except InputError as error:
        try:
            return read_source_motion(path).names, None
        except InputError:
            raise error from None
    return rig.shapes, rig


def match_rigs(
    source: Rig, target: Rig, *, by: str = "both", progress: Progress = silent
) -> tuple[NameMatching, list[str]]:
    """Match shapes by name, deformation or both, names first; return the matches and notes."""
    progress(0.1, "matching names")
    named = NameMatching(()) if by == "deformation" else match_names(source.shapes, target.shapes)
    matches, how = list(named.matches), dict(named.by)
    notes = [f"matched {pluralize(len(matches), 'shape')} by name"] if matches else []
    about = [describe_orientation(rig) for rig in (source, target)]
    if matches and about[0] != about[1]:  # two rigs of the viewer's names agree
        files = (source.file.name, target.file.name)
        notes += [
            f"{name}: {note}" for name, each in zip(files, about, strict=True) for note in each
        ]
    if by != "name":
        progress(0.2, "registering the faces")
        driven: dict[str, list[tuple[str, float]]] = {}
        for each in _alike(source, target, by, matches, notes):
            driven.setdefault(each.source, []).append((each.target, each.share))
            notes.append(
                f"matched by deformation: {each.source} and {each.target} (similarity "
                f"{each.similarity:.2f})"
            )
        matches += [NameMatch(s, ((s, 1.0),), tuple(parts)) for s, parts in driven.items()]
        how |= dict.fromkeys(driven, "deformation")
        sides = {name: [target for target, _ in parts] for name, parts in driven.items()}
        notes += [
            f"left and right are matched differently: {each}; check them in the table"
            for each in differing_sides(sides, source.shapes, target.shapes)
        ]
    return NameMatching(tuple(matches), named.ambiguous, how), notes


def _match(
    spec: PairsProposeSpec,
    shapes: tuple[str, ...],
    source: Rig | None,
    target: Rig,
    progress: Progress,
) -> tuple[list[NameMatch], list[str]]:
    if spec.names is not None:
        transfer = transfer_by_table(spec.names, shapes, target.shapes)
        named, notes = _rows_as_matches(transfer), list(transfer.ambiguous)
    else:
        if source is not None:
            found, notes = match_rigs(source, target, by=spec.match, progress=progress)
        elif spec.match == "deformation":
            raise InputError(
                f"{spec.source}: is no rig, so its shapes cannot be compared by deformation; use "
                "--match name"
            )
        else:
            found = match_names(shapes, target.shapes)
            notes = ["the source is no rig: its shapes are matched by name only"]
        named = list(found.matches)
        if found.ambiguous:
            ambiguous = first_few(found.ambiguous, most=3)
            notes.append(f"not matched by name: {ambiguous}")
    used = {name for match in named for name, _ in match.source}
    unmatched = [name for name in shapes if name not in used]
    if unmatched:
        notes.append(f"in no pair and without effect: {counted(unmatched, 'source shape')}")
    return named, notes


def _rows_as_matches(transfer: Transfer) -> list[NameMatch]:
    """Return a pair for each source shape of a table."""
    return [
        NameMatch(
            name,
            ((name, 1.0),),
            tuple((transfer.target[j], float(row[j])) for j in np.flatnonzero(row).tolist()),
        )
        for name, row in zip(transfer.source, transfer.matrix, strict=True)
        if row.any()
    ]


def _alike(
    source: Rig, target: Rig, by: str, named: list[NameMatch], notes: list[str]
) -> tuple[ShapeMatch, ...]:
    """Match the remaining shapes by deformation; if names matched some, a failure is a note."""
    used = {name for match in named for name, _ in match.source}
    driven = {name for match in named for name, _ in match.target}
    try:
        return match_deformations(
            source,
            target,
            source_shapes=tuple(name for name in source.shapes if name not in used),
            target_shapes=tuple(name for name in target.shapes if name not in driven),
        )
    except InputError as error:
        if by == "deformation" or not named:
            raise
        notes.append(f"deformations could not be compared: {error}")
        return ()


def _pairs(
    shapes: tuple[str, ...],
    source: Rig | None,
    target: Rig,
    matches: list[NameMatch],
    rest: Controls,
    *,
    by_table: bool,
) -> ExpressionPairs:
    left = expression_rows([(), *(match.source for match in matches)], shapes)
    right = expression_rows([(), *(match.target for match in matches)], target.shapes)
    low, high = target.ranges.T
    if not by_table:  # full expressions, some at negative weights; a table states its weights
        left *= 1.0 if source is None else np.sign(range_ends(source.ranges))
        right *= np.sign(range_ends(target.ranges))
    return ExpressionPairs(
        names=(REST_PAIR, *(match.name for match in matches)),
        source_shapes=shapes,
        source=left,
        target=replace(
            rest.rows([0] * len(right)),
            weights=np.clip(right, np.minimum(low, 0), np.maximum(high, 0)),
        ),
        source_rig=source.file if source else None,
        source_prim=source.prim if source else "",
        target_rig=target.file,
        target_prim=target.prim,
    )


def _with_existing(path: Path, new: ExpressionPairs) -> tuple[ExpressionPairs, int, list[str]]:
    """Return the pairs of an asset that were imported or keyed, their number, new ones, and notes.

    Keys hide proposals at every time code: there all stay, and no new one is added.
    """
    old, keyed = read_pairs(path), keyed_above(path)
    if not keyed:
        imported = [i for i, name in enumerate(old.names) if name.startswith(IMPORTED_NAME)]
        old = old.rows(np.array(imported, dtype=np.int64))
    kept = len(old)
    if not kept:
        return new, 0, []
    with as_input_error(path, of=InputError):
        merged = merge_pairs(old, new)
    if not keyed or len(merged) == kept:
        return merged, kept, []
    note = (
        f"left out {pluralize(len(merged) - kept, 'new pair')} "
        f"({first_few(merged.names[kept:], most=3)}): keys made by hand, of {keyed[0]}, hide "
        "proposals at every time code; key these pairs there, or propose to another --out"
    )
    return old, kept, [note]


_TABLES = (".csv", ".json")


def list_names(
    rig: Path,
    source: Path | None = None,
    *,
    prims: tuple[str, ...] = (),
    names: Path | None = None,
    by: str = "both",
    out: Path | None = None,
    overwrite: bool = False,
) -> StepResult:
    """Match a source's shapes, by default ARKit's, with a rig's; write the table to `out`.

    `prims`: the faces in the rig and in the source, where these hold several.
    """
    files = [each for each in (rig, source, names) if each is not None]
    confine("names", reads=files, writes=[] if out is None else [out])
    if out is not None and out.suffix.lower() not in _TABLES:
        raise InputError(f"{out}: a table is written, so the name must end in {', '.join(_TABLES)}")
    if out is not None and out.exists() and not overwrite:
        raise InputError(f"{out} exists; choose another --out, or --overwrite it")
    prim, source_prim, *_ = (*prims, None, None)
    target = read_rig(rig, prim=prim)
    shapes, other = source_shapes(source, prim=source_prim) if source else (tuple(ARKIT), None)
    notes: list[str] = []
    if names is not None:
        transfer = transfer_by_table(names, shapes, target.shapes)
    elif other is not None:
        matching, notes = match_rigs(other, target, by=by)
        transfer = transfer_by_names(shapes, target.shapes, matching=matching)
    else:
        transfer = transfer_by_names(shapes, target.shapes)
    if out is not None:
        write_name_table(out, transfer)
    return _report(transfer, source, rig, out, notes)


def _report(
    transfer: Transfer, source: Path | None, rig: Path, out: Path | None, notes: list[str]
) -> StepResult:
    rows = transfer.rows()
    matched, driven = set(transfer.matched), set(transfer.driven)
    lost = [name for name in transfer.source if name not in matched]
    still = [name for name in transfer.target if name not in driven]
    width = max((len(str(row["source"])) for row in rows), default=0)
    table = [
        f"{row['source']!s:{width}}  ->  {row['target']}"
        + ("" if row["weight"] == 1.0 else f" x {row['weight']:.4g}")
        + f"  ({row['by']})"
        for row in rows
    ]
    label = "ARKit" if source is None else source.name
    if lost:
        notes.append(
            f"{pluralize(len(lost), 'shape')} of {label} without a counterpart: {first_few(lost)}"
        )
    if still:
        notes.append(
            f"{pluralize(len(still), 'shape')} of {rig.name} not driven: {first_few(still)}"
        )
    notes += [f"not matched: {each}" for each in transfer.ambiguous]
    return StepResult(
        () if out is None else (out,),
        f"{len(matched)} of {pluralize(len(transfer.source), 'shape')} of {label} drive "
        f"{len(driven)} of {len(transfer.target)} of {rig.name}",
        tuple(notes),
        {
            "pairs": rows,
            "unmatched_source": lost,
            "unmatched_target": still,
            "ambiguous": list(transfer.ambiguous),
        },
        table=tuple(table),
    )
