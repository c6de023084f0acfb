"""Weights in the tuned and the proposed layer of references."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from pxr import Sdf

from usdface.core.arrays import FloatArray
from usdface.core.assets import References
from usdface.core.errors import InputError
from usdface.core.sidecars import proposed_path, tuned_path
from usdface.core.text import first_few
from usdface.usdio.layers import open_layer, open_stage, refusing_wrong_types
from usdface.usdio.references.read import (
    AUTHOR,
    DONE,
    FRAME_PATH,
    TAKE,
    TUNED,
    WEIGHTS_ATTRIBUTE,
    WEIGHTS_PATH,
    read_references,
)

SAME_WEIGHT = 1e-6
"""Difference up to which weights are equal: that of single precision."""

_OTHER_SELECTION = (
    "it belongs to another selection. Nothing was changed; put back the layer that belongs here, "
    "or move this one away and bring its weights in with `usdface references import`"
)


@dataclass(frozen=True)
class TunedPair:
    """Weights that a person set for one frame of a take, by shape name.

    `done` if the person marked the pair as finished.
    """

    pair: int
    take: str
    frame: int
    weights: dict[str, float]
    done: bool = True
    author: str = ""
    """The person, if known."""


@refusing_wrong_types
def read_tuned_pairs(path: Path) -> list[TunedPair]:
    """Return the tuned pairs of a tuned layer; empty without the layer."""
    if not path.is_file():
        return []
    layer = open_layer(path)
    names = _layer_shapes(layer) or []
    pairs = []
    for time in layer.ListTimeSamplesForPath(TUNED):
        if not layer.QueryTimeSample(TUNED, time):
            continue
        weights = _weights_at(layer, path, time, names, "restore the layer from its last version")
        pairs.append(
            TunedPair(
                pair=round(time) - 1,
                take=str(layer.QueryTimeSample(TAKE, time)),
                frame=int(layer.QueryTimeSample(FRAME_PATH, time)),
                weights=dict(zip(names, weights.tolist(), strict=True)),
                done=layer.QueryTimeSample(DONE, time) is not False,
                author=str(layer.QueryTimeSample(AUTHOR, time) or ""),
            )
        )
    return pairs


@refusing_wrong_types
def read_proposals(path: Path, references: References) -> FloatArray:
    """Return the weights of a proposed layer, in the order of the asset: (pairs, shapes)."""
    layer = open_layer(path)
    names = _layer_shapes(layer) or []
    _check_shapes(path, names, references)
    order = [names.index(name) for name in references.shape_names]
    rows = np.zeros((len(references.frames), len(names)))
    for pair in range(len(rows)):
        rows[pair] = _weights_at(layer, path, pair + 1, names, "select again")
    return rows[:, order]


@refusing_wrong_types
def check_tuned_layer(path: Path, references: References) -> None:
    """Refuse a tuned layer that belongs to another selection or another rig."""
    if not path.is_file():
        return
    layer = open_layer(path)
    names = _layer_shapes(layer)
    if names is None:
        return
    _check_shapes(path, names, references)
    times = layer.ListTimeSamplesForPath(WEIGHTS_ATTRIBUTE)
    count = len(references.frames)
    if [round(time) for time in times] != list(range(1, count + 1)):
        raise InputError(
            f"{path}: holds {len(times)} pairs and the references {count}: {_OTHER_SELECTION}"
        )
    for pair in range(count):
        frame, take = (layer.QueryTimeSample(each, pair + 1) for each in (FRAME_PATH, TAKE))
        if frame is None and take is None:
            continue  # keyed in a DCC, without our attributes
        expected = (int(references.frames[pair]), references.takes[pair])
        if (frame, str(take)) != expected:
            raise InputError(
                f"{path}: pair {pair + 1} was tuned for frame {frame} of {take}, and the "
                f"references have frame {expected[0]} of {expected[1]} there: {_OTHER_SELECTION}"
            )


def check_shown(path: Path) -> None:
    """Refuse references with weights in a stronger layer, which would hide tuned ones."""
    stage = open_stage(path)  # keep a reference: specs do not outlive their stage
    stack = stage.GetAttributeAtPath(WEIGHTS_ATTRIBUTE).GetPropertyStack()
    keyed = next((each.layer for each in stack if each.HasInfo("timeSamples")), None)
    below = {each.resolve() for each in (tuned_path(path), proposed_path(path))}
    if keyed is not None and Path(keyed.realPath).resolve() not in below:
        raise InputError(
            f"{path}: its keys in {Path(keyed.realPath).name} would hide what is tuned; nothing "
            "was changed. Select again with --out of this asset and --overwrite, which makes them "
            "tuned pairs, or remove these keys"
        )


def _layer_shapes(layer: Sdf.Layer) -> list[str] | None:
    """Return the shapes of a layer's weights; None without weights."""
    prim = layer.GetPrimAtPath(WEIGHTS_PATH)
    if prim is None or "blendShapes" not in prim.attributes:
        return None
    return [str(name) for name in prim.attributes["blendShapes"].default or ()]


def _weights_at(
    layer: Sdf.Layer, path: Path, time: float, names: list[str], remedy: str
) -> FloatArray:
    weights = layer.QueryTimeSample(WEIGHTS_ATTRIBUTE, time)
    if weights is None or len(weights) != len(names):
        raise InputError(
            f"{path} <{WEIGHTS_ATTRIBUTE}> time code {time:g}: "
            f"{0 if weights is None else len(weights)} weights for {len(names)} shapes; {remedy}"
        )
    return np.array(weights, np.float64)


def _check_shapes(path: Path, names: list[str], references: References) -> None:
    missing = [name for name in references.shape_names if name not in names]
    driven = {combination.shape for combination in references.combinations}
    names = [name for name in names if name not in driven]
    if missing or len(names) != len(references.shape_names):
        raise InputError(
            f"{path}: holds {len(names)} shapes and the references {len(references.shape_names)}"
            + (f", without {first_few(missing)}" if missing else "")
            + ": it belongs to another rig. Nothing was changed; put back the layer that belongs "
            "here, or select again"
        )


def find_keyed_pairs(path: Path, references: References) -> list[int]:
    """Return the pairs whose composed weights are neither proposals nor marked as tuned."""
    check_tuned_layer(tuned_path(path), references)
    known = read_proposals(proposed_path(path), references).copy()
    for tuned in read_tuned_pairs(tuned_path(path)):
        known[tuned.pair] = [tuned.weights.get(name, 0.0) for name in references.shape_names]
    differs = np.abs(references.weights - known).max(axis=1, initial=0.0) > SAME_WEIGHT
    return list(np.flatnonzero(differs).tolist())


def read_keyed_references(path: Path) -> References:
    """Read references, with those keyed in a DCC as tuned too, if the sublayers can be read."""
    references = read_references(path)
    try:
        keyed = find_keyed_pairs(path, references)
    except InputError:
        return references
    tuned = references.tuned.copy()
    tuned[keyed] = True
    return replace(references, tuned=tuned)
