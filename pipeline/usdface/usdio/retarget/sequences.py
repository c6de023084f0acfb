"""Emotional sequences, and their occurrences in takes."""

import math
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
from pxr import Sdf, Usd, UsdSkel

from usdface.core.controls import Controls, EmotionalSequence, SequenceMatch, shape_controls
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.core.rates import exact_rate, span_of_samples
from usdface.usdio.authoring import (
    apply_api,
    author_series,
    author_timing,
    author_uniform,
    define_prim,
    file_of,
    names_in,
    read_array_samples,
    text_of,
)
from usdface.usdio.layers import (
    new_layer,
    open_layer,
    open_stage,
    refusing_wrong_types,
    relative_path,
)
from usdface.usdio.retarget.controls import author_animation, controls_at
from usdface.usdio.units import author_units

_ROOT = Sdf.Path("/Sequence")
_SOURCE = _ROOT.AppendChild("Source")
_TARGET = _ROOT.AppendChild("Target")
_LABEL = "face:sequence:label"
ATTRIBUTES = "face:sequence:attributes"
VALUES = _ROOT.AppendProperty("face:sequence:values")
KEY_WEIGHT = _ROOT.AppendProperty("face:sequence:keyWeight")

MATCHES = Sdf.Path("/Matches")


def write_sequence(
    path: Path, sequence: EmotionalSequence, *, rate: Fraction, provenance: Provenance
) -> None:
    """Write a sequence: source and target each from time code 1, of different lengths."""
    kinds = Sdf.ValueTypeNames
    target = sequence.target
    with new_layer(path, provenance) as layer:
        author_units(layer)
        last = max(len(sequence.source), len(target))
        author_timing(layer, rate=rate, first=1, last=last)
        layer.defaultPrim = _ROOT.name
        root = define_prim(layer, _ROOT, "Scope")
        apply_api(root, "FaceSequenceAPI")
        author_uniform(root, _LABEL, kinds.Token, sequence.label)
        author_animation(layer, _SOURCE, shape_controls(sequence.source_shapes, sequence.source))
        author_animation(layer, _TARGET, target)
        author_uniform(root, ATTRIBUTES, kinds.StringArray, list(target.attributes))
        if target.attributes:
            author_series(root, VALUES.name, kinds.FloatArray, target.values.tolist())
        author_series(root, KEY_WEIGHT.name, kinds.Float, sequence.key_weights.tolist())


@refusing_wrong_types
def read_sequence(path: Path) -> EmotionalSequence:
    """Read a sequence."""
    stage = open_stage(path)
    root = stage.GetPrimAtPath(_ROOT)
    if not root or not root.HasAPI("FaceSequenceAPI"):
        raise InputError(
            f"{path}: not a sequence: no </Sequence> with FaceSequenceAPI; make one with "
            "`usdface make-sequence`"
        )
    source, _ = _read_side(stage, _SOURCE, path)
    target, times = _read_side(stage, _TARGET, path)
    names = names_in(root.GetAttribute(ATTRIBUTES))
    if names:
        attribute, remedy = root.GetAttribute(VALUES.name), "make the sequence again"
        values = read_array_samples(path, attribute, times, names, remedy=remedy)
        target = replace(target, attributes=names, values=values)
    weight = root.GetAttribute(KEY_WEIGHT.name)
    stated = [weight.Get(time) if weight else None for time in times]
    key_weights = np.array([1.0 if value is None else float(value) for value in stated])
    if not np.isfinite(key_weights).all():
        time = times[int(np.argmin(np.isfinite(key_weights)))]
        raise InputError(f"{path} <{KEY_WEIGHT}> time code {time}: is not finite; correct the key")
    if not (key_weights > 0).any():
        raise InputError(
            f"{path} <{KEY_WEIGHT}>: no key has a weight above 0, so the sequence has no effect; "
            "set some to 1"
        )
    return EmotionalSequence(
        label=text_of(root, _LABEL),
        source_shapes=source.shapes,
        source=source.weights,
        target=target,
        key_weights=key_weights,
    )


def sequence_rate(path: Path) -> Fraction:
    """Return the frames per second of a sequence."""
    rate = open_layer(path).timeCodesPerSecond
    return exact_rate(rate, where=f"{path}: timeCodesPerSecond")


def _read_side(stage: Usd.Stage, place: Sdf.Path, path: Path) -> tuple[Controls, range]:
    prim = stage.GetPrimAtPath(place)
    times = UsdSkel.Animation(prim).GetBlendShapeWeightsAttr().GetTimeSamples() if prim else []
    if len(times) < 2:
        raise InputError(f"{path} <{place}>: needs at least 2 time codes, has {len(times)}")
    first, last = span_of_samples(f"{path} <{place}>", times)
    span = range(first, last + 1)
    return controls_at(prim, None, (), span, path), span


def write_matches(
    path: Path, matches: tuple[SequenceMatch, ...], *, rate: Fraction, provenance: Provenance
) -> None:
    """Write occurrences of sequences, one prim each, which can be deactivated or edited.

    `rate`: of the frames, per second.
    """
    kinds = Sdf.ValueTypeNames
    with new_layer(path, provenance) as layer:
        author_units(layer)
        layer.timeCodesPerSecond = layer.framesPerSecond = float(rate)
        layer.defaultPrim = MATCHES.name
        define_prim(layer, MATCHES, "Scope")
        for number, match in enumerate(matches, start=1):
            prim = define_prim(layer, MATCHES.AppendChild(f"match_{number:03d}"), "Scope")
            apply_api(prim, "FaceMatchAPI")
            asset = Sdf.AssetPath(relative_path(match.sequence, path))
            for name, kind, value in (
                ("sequence", kinds.Asset, asset),
                ("label", kinds.Token, match.label),
                ("firstFrame", kinds.Int, match.first_frame),
                ("lastFrame", kinds.Int, match.last_frame),
                ("distance", kinds.Double, match.distance),
            ):
                author_uniform(prim, f"face:match:{name}", kind, value)


@refusing_wrong_types
def read_matches(path: Path, *, rate: Fraction) -> tuple[SequenceMatch, ...]:
    """Read the active matches; refuse those of another rate, whose frames are others."""
    stage = open_stage(path)
    counted = stage.GetTimeCodesPerSecond()
    if not math.isclose(counted, rate, rel_tol=1e-6):
        raise InputError(
            f"{path}: its frames are of a take with {counted:g} per second, not {float(rate):g}; "
            "find the sequences in the source of this performance"
        )
    root = stage.GetPrimAtPath(MATCHES)
    if not root:
        raise InputError(f"{path}: no </Matches>; make the file with `usdface find-sequences`")
    matches = []
    for prim in root.GetChildren():
        if not prim.HasAPI("FaceMatchAPI"):
            continue
        sequence = file_of(prim, "face:match:sequence")
        first, last = (
            prim.GetAttribute(f"face:match:{name}").Get() for name in ("firstFrame", "lastFrame")
        )
        if sequence is None or None in (first, last) or last <= first:
            raise InputError(
                f"{path} <{prim.GetPath()}>: frames {first}-{last} of {sequence} are no match of a "
                "sequence; correct it, or find sequences again"
            )
        matches.append(
            SequenceMatch(
                sequence=sequence,
                label=text_of(prim, "face:match:label"),
                first_frame=int(first),
                last_frame=int(last),
                distance=float(prim.GetAttribute("face:match:distance").Get() or 0.0),
            )
        )
    return tuple(matches)
