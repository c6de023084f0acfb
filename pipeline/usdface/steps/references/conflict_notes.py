"""What tuned pairs contradict, told where people tune and select."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from usdface.core.assets import References
from usdface.model.selection.conflicts import (
    ReferenceConflict,
    conflict_text,
    find_reference_conflicts,
)
from usdface.steps.inputs.tuned_pairs import read_set_references

_MOST_TOLD = 5


def tuned_conflicts(path: Path) -> tuple[list[str], list[dict[str, object]]]:
    """Return what contradicts itself among the tuned pairs of an asset: for people, and as data."""
    references = read_set_references(path)
    places = np.flatnonzero(references.tuned)
    tuned = replace(
        references,
        markers=references.markers[places],
        weights=references.weights[places],
        frames=references.frames[places],
        takes=tuple(references.takes[pair] for pair in places),
        tuned=references.tuned[places],
    )
    found = [
        replace(each, first=int(places[each.first]), second=int(places[each.second]))
        for each in find_reference_conflicts(tuned)
    ]
    return _texts(references, found), [_data(each) for each in found]


def _texts(references: References, found: list[ReferenceConflict]) -> list[str]:
    texts = [f"{conflict_text(references, each)}; look at both" for each in found[:_MOST_TOLD]]
    if len(found) > _MOST_TOLD:
        texts.append(f"and {len(found) - _MOST_TOLD} more pairs contradict each other")
    return texts


def _data(conflict: ReferenceConflict) -> dict[str, object]:
    return {
        "pairs": [conflict.first + 1, conflict.second + 1],
        "region": conflict.region,
        "shape": conflict.shape,
        "weights": list(conflict.weights),
    }
