"""Pairs of a references asset that somebody keyed in a DCC, which marks none as tuned."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from usdface.assets import References
from usdface.errors import InputError
from usdface.specs.references import proposed_path, tuned_path
from usdface.usdio.references import read_references, read_tuned_pairs
from usdface.usdio.tuning import check_tuned_layer, read_proposals

SAME = 1e-6
"""Weights that differ by less are one: layers hold single precision."""


def keyed_pairs(path: Path, references: References) -> list[int]:
    """Return the pairs whose weights are neither those proposed nor those marked as tuned.

    Parameters
    ----------
    path : Path
        The asset.
    references : References
        As it composes.

    Raises
    ------
    InputError
        If a layer beneath the asset cannot be read, or is of another selection.
    """
    check_tuned_layer(tuned_path(path), references)
    shown = read_proposals(proposed_path(path), references).copy()
    for each in read_tuned_pairs(tuned_path(path)):
        shown[each.pair] = [each.weights.get(name, 0.0) for name in references.shape_names]
    away = np.abs(references.weights - shown).max(axis=1, initial=0.0) > SAME
    return list(np.flatnonzero(away).tolist())


def read_set_references(path: Path) -> References:
    """Read references of which those count as tuned that a person set, on the page or in a DCC.

    Where the layers beneath the asset cannot be read, those that are marked.
    """
    references = read_references(path)
    try:
        keyed = keyed_pairs(path, references)
    except InputError:
        return references
    tuned = references.tuned.copy()
    tuned[keyed] = True
    return replace(references, tuned=tuned)
