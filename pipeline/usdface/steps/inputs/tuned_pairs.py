"""Tuned pairs of a references asset: set on the tuning page, in a DCC, or imported."""

from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from usdface.core.arrays import IntArray
from usdface.core.assets import References, Rig
from usdface.core.errors import InputError
from usdface.core.sidecars import tuned_path
from usdface.core.text import shell_word
from usdface.model.selection.coverage import (
    ReferenceConflict,
    conflict_text,
    find_reference_conflicts,
)
from usdface.specs.references import SelectSpec
from usdface.steps.inputs.cleaned_takes import CleanedTakes
from usdface.usdio.references.read import read_references
from usdface.usdio.references.weight_layers import (
    TunedPair,
    find_keyed_pairs,
    read_keyed_references,
    read_tuned_pairs,
)

_LISTED_CONFLICTS = 5


@dataclass(frozen=True)
class PlacedPair:
    """A tuned pair and its frame."""

    pair: int
    """Index in the asset."""
    row: int
    """Row among the frames of all takes."""
    tuned: TunedPair
    is_keyed: bool = False
    """Keyed by a DCC, which does not mark it as tuned."""


def find_placed_pairs(spec: SelectSpec, takes: CleanedTakes, rig: Rig) -> list[PlacedPair]:
    """Find the frames of tuned pairs; refuse those of other takes or rigs, or beyond --count."""
    layer = tuned_path(spec.out)
    marked = {each.pair: each for each in read_tuned_pairs(layer)}
    old = None
    with suppress(InputError):  # of a damaged asset, which is replaced
        old = read_references(spec.out) if spec.out.is_file() else None
    keyed = {} if old is None else _keyed_pairs(spec.out, old, marked)
    driven = set() if old is None else {each.shape for each in old.combinations}
    together = marked | keyed
    tuned = [together[pair] for pair in sorted(together)]
    rows = takes.find_rows([(each.take, each.frame) for each in tuned])
    missing = [each for each, row in zip(tuned, rows, strict=True) if row is None]
    if missing:
        raise InputError(
            f"{layer}: pair {missing[0].pair + 1} was tuned for frame {missing[0].frame} of "
            f"{missing[0].take}, which is not given; give that take as well, or write to another "
            "--out"
        )
    beyond = [each for each in tuned if each.pair >= spec.count]
    if beyond:
        raise InputError(
            f"{layer}: pair {beyond[-1].pair + 1} is tuned, so --count must be at least "
            f"{beyond[-1].pair + 1}, not {spec.count}"
        )
    for each in tuned:
        rig.check_has(
            [name for name in each.weights if name not in driven],
            source=f"{layer} pair {each.pair + 1}",
            remedy="it was tuned for another rig: give that rig, or select as before to another "
            f"--out, and `usdface references import` its keys there: --weights "
            f"{shell_word(spec.out.name)}, and --names if shapes were renamed",
        )
    return [
        PlacedPair(each.pair, row, each, each.pair in keyed)
        for each, row in zip(tuned, rows, strict=True)
        if row is not None
    ]


def _keyed_pairs(out: Path, old: References, marked: dict[int, TunedPair]) -> dict[int, TunedPair]:
    """Return the pairs of an existing asset that a DCC keyed; none if a sublayer cannot be read.

    Their weights differ from the proposals, and are not marked as tuned.
    """
    try:
        keyed = find_keyed_pairs(out, old)
    except InputError:
        return {}
    return {
        pair: TunedPair(
            pair,
            old.takes[pair],
            int(old.frames[pair]),
            old.weights_of(pair),
            done=pair in marked and marked[pair].done,
            author=marked[pair].author if pair in marked else "",
        )
        for pair in keyed
    }


def rows_of_pairs(count: int, kept: list[PlacedPair], chosen: IntArray) -> list[int]:
    """Return the row of each pair: tuned pairs keep their index, chosen ones fill the others."""
    place = {each.pair: each.row for each in kept}
    free = iter(chosen.tolist())
    rows = []
    for pair in range(count):
        row = place[pair] if pair in place else next(free, None)
        if row is None:
            break
        rows.append(row)
    return rows


def tuned_conflicts(path: Path) -> tuple[list[str], list[dict[str, object]]]:
    """Return contradictions among the tuned pairs of an asset, as texts and as data."""
    references = read_keyed_references(path)
    if not references.marker_names:
        return [], []
    places = np.flatnonzero(references.tuned)
    found = [
        replace(each, first=int(places[each.first]), second=int(places[each.second]))
        for each in find_reference_conflicts(references.rows(places))
    ]
    return _texts(references, found), [_data(each) for each in found]


def _texts(references: References, found: list[ReferenceConflict]) -> list[str]:
    texts = [
        f"{conflict_text(references, each)}; look at both" for each in found[:_LISTED_CONFLICTS]
    ]
    if len(found) > _LISTED_CONFLICTS:
        texts.append(f"and {len(found) - _LISTED_CONFLICTS} more pairs contradict each other")
    return texts


def _data(conflict: ReferenceConflict) -> dict[str, object]:
    return {
        "pairs": [conflict.first + 1, conflict.second + 1],
        "region": conflict.region,
        "shape": conflict.shape,
        "weights": list(conflict.weights),
    }
