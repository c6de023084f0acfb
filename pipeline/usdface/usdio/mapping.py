"""Reading and writing of trained mappings, as attributes of a typed prim."""

import json
from dataclasses import asdict
from fractions import Fraction
from pathlib import Path
from typing import Any

from pxr import Sdf, Usd

from usdface.core.assets import CandidateScore, TrainedMapping
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.core.text import first_few
from usdface.usdio.authoring import (
    author_arrays,
    author_uniform,
    define_in_scope,
    doubles,
    key_times,
    read_arrays,
    read_training,
    shaped,
    trained_prim,
    value_of,
)
from usdface.usdio.layers import new_layer, open_stage, refusing_wrong_types
from usdface.usdio.units import author_units

ATTRIBUTE = "face:mapping:alpha"


def write_mapping(path: Path, mapping: TrainedMapping, *, provenance: Provenance) -> None:
    """Write a mapping, without loss."""
    kinds = Sdf.ValueTypeNames
    tokens, numbers, string = kinds.TokenArray, kinds.DoubleArray, kinds.String
    scores = [
        {key: None if value != value else value for key, value in asdict(score).items()}
        for score in mapping.scores
    ]
    with new_layer(path, provenance) as layer:
        prim = define_in_scope(layer, "Mapping", "FaceMapping")
        author_units(layer)
        for name, kind, value in (
            ("method", kinds.Token, mapping.method),
            ("markers", tokens, list(mapping.marker_names)),
            ("rigid", tokens, list(mapping.rigid)),
            ("channels", tokens, list(mapping.shape_names)),
            ("neutral", numbers, doubles(mapping.neutral)),
            ("ranges", numbers, doubles(mapping.ranges)),
            ("settings", string, json.dumps(mapping.settings)),
            ("scores", string, json.dumps(scores)),
            ("references", string, mapping.references),
        ):
            author_uniform(prim, f"face:mapping:{name}", kind, value)
        author_arrays(prim, mapping.arrays)


@refusing_wrong_types
def read_mapping(path: Path) -> TrainedMapping:
    """Read a mapping."""
    stage = open_stage(path)
    prim = trained_prim(path, stage, "FaceMapping")
    settings, scores = read_training(path, prim, "mapping", CandidateScore)
    markers, shapes, rigid = (
        tuple(map(str, _value(path, prim, name))) for name in ("markers", "channels", "rigid")
    )
    if unknown := [name for name in rigid if name not in markers]:
        raise InputError(
            f"{path} <{prim.GetPath()}>: face:mapping:rigid names {first_few(unknown)}, which are "
            "none of its markers; train again"
        )
    return TrainedMapping(
        method=str(_value(path, prim, "method")),
        marker_names=markers,
        shape_names=shapes,
        rigid=rigid,
        neutral=shaped(path, _value(path, prim, "neutral"), (len(markers), 3), "neutral"),
        ranges=shaped(path, _value(path, prim, "ranges"), (len(shapes), 2), "ranges"),
        arrays=read_arrays(path, prim),
        settings=settings,
        scores=scores,
        references=str(_value(path, prim, "references") or ""),
    )


def _value(path: Path, prim: Usd.Prim, name: str) -> Any:
    value = value_of(prim, f"face:mapping:{name}")
    if value is None and name in ("method", "markers", "channels", "neutral", "ranges", "rigid"):
        raise InputError(f"{path} <{prim.GetPath()}>: face:mapping:{name} is missing; train again")
    return value


_RATE_TOLERANCE = 1e-3
"""Relative difference of rates that are the same, such as 59.94 and 60000/1001."""


@refusing_wrong_types
def read_alpha_keys(path: Path, *, rate: Fraction | None = None) -> list[tuple[float, float]]:
    """Return (time code, alpha) of every key; one for a constant value.

    `rate`: of the motion, whose frames the time codes are; a layer that states another is refused.
    """
    stage = open_stage(path)
    keyed = [
        attribute
        for prim in stage.TraverseAll()
        if (attribute := prim.GetAttribute(ATTRIBUTE)) and attribute.HasAuthoredValue()
    ]
    if len(keyed) != 1:
        raise InputError(f"{path}: {len(keyed)} prims have a value of {ATTRIBUTE}; key it on one")
    times = key_times(keyed[0])
    if not times:
        return [(0.0, float(keyed[0].Get()))]
    stated = stage.GetTimeCodesPerSecond()
    states = stage.GetRootLayer().HasTimeCodesPerSecond()
    if rate is not None and states and abs(stated - rate) > _RATE_TOLERANCE * rate:
        raise InputError(
            f"{path}: its keys are at {stated:g} time codes per second, and the motion has "
            f"{float(rate):g}; key alpha at the motion's frames, and set timeCodesPerSecond to it"
        )
    return [(float(time), float(keyed[0].Get(time))) for time in times]
