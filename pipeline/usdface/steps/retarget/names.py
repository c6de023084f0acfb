"""List which shapes of a source drive which shapes of a rig."""

from pathlib import Path

from usdface.core.errors import InputError
from usdface.core.text import first_few, pluralize
from usdface.model.retarget.name_matching import Transfer, transfer_by_names
from usdface.model.retarget.shape_vocabulary import ARKIT
from usdface.runner.outputs import confine
from usdface.runner.result import StepResult
from usdface.steps.inputs.name_tables import transfer_by_table, write_name_table
from usdface.steps.retarget.pairs_propose import match_rigs, source_shapes
from usdface.usdio.rig.read import read_rig

_TABLES = (".csv", ".json")


def list_names(
    rig: Path,
    source: Path | None = None,
    *,
    names: Path | None = None,
    by: str = "both",
    out: Path | None = None,
    overwrite: bool = False,
) -> StepResult:
    """Match a source's shapes, by default ARKit's, with a rig's; write the table to `out`."""
    files = [each for each in (rig, source, names) if each is not None]
    confine("names", reads=files, writes=[] if out is None else [out])
    _check_out(out, overwrite=overwrite)
    target = read_rig(rig)
    shapes, other = (tuple(ARKIT), None) if source is None else source_shapes(source)
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


def _check_out(out: Path | None, *, overwrite: bool) -> None:
    if out is None:
        return
    if out.suffix.lower() not in _TABLES:
        raise InputError(f"{out}: a table is written, so the name must end in {', '.join(_TABLES)}")
    if out.exists() and not overwrite:
        raise InputError(f"{out} exists; choose another --out, or --overwrite it")


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
