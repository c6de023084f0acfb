"""Expression pairs: pair *i* at time code *i*, with both faces in one file.

``/Pairs/Source`` and ``/Pairs/Target`` are the two characters, ``/Pairs/SourceWeights`` and
``/Pairs/TargetControls`` their animations; deformer attributes are animated on the target's prims.
Proposals are in a sublayer, so that keys in the layer to open are preserved when pairs are proposed
again.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
from pxr import Kind, Sdf, Usd, UsdSkel

from usdface.core.assets import Rig
from usdface.core.controls import ExpressionPairs, shape_controls
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.core.sidecars import proposed_path
from usdface.usdio.authoring import (
    apply_api,
    author_series,
    author_uniform,
    define_prim,
    sampled_properties,
    text_of,
)
from usdface.usdio.layers import (
    new_layers,
    open_layer,
    open_stage,
    refusing_wrong_types,
    sublayer_asset,
)
from usdface.usdio.references.pair_layers import author_pair_header, open_pair_stage
from usdface.usdio.retarget.controls import (
    NAMES,
    attribute_names,
    author_animation,
    author_attribute_specs,
    control_attribute,
    controls_at,
    set_attribute_samples,
)
from usdface.usdio.rig.reference import (
    convert_to_our_units,
    define_reference,
    missing_reference,
    point_skeletons_at,
    rig_of,
)

_ROOT = Sdf.Path("/Pairs")
_SOURCE = _ROOT.AppendChild("Source")
_TARGET = _ROOT.AppendChild("Target")
SOURCE_WEIGHTS = _ROOT.AppendChild("SourceWeights")
TARGET_CONTROLS = _ROOT.AppendChild("TargetControls")
_NAME = _ROOT.AppendProperty("face:pair:name")


def write_pairs(
    path: Path,
    pairs: ExpressionPairs,
    *,
    source_rig: Rig | None,
    target_rig: Rig,
    provenance: Provenance,
) -> None:
    """Write a pairs asset, and preserve keys in the layer to open.

    Parameters
    ----------
    path : Path
        The layer to open, with `proposed_path` as sublayer.
    source_rig : Rig, optional
        None for a source of weights alone.
    """
    samples = proposed_path(path)
    with new_layers({samples: provenance, path: provenance}) as (below, layer):
        _author_samples(below, samples, pairs, source_rig, target_rig)
        if path.is_file():
            layer.TransferContent(open_layer(path))
        author_pair_header(layer, _ROOT, len(pairs))
        asset = sublayer_asset(layer, samples, path)
        if asset not in list(layer.subLayerPaths):
            layer.subLayerPaths.append(asset)
        root = define_prim(layer, _ROOT, "Xform")
        root.SetInfo("kind", Kind.Tokens.component)
        apply_api(root, "FacePairsAPI")


@refusing_wrong_types
def read_pairs(path: Path) -> ExpressionPairs:
    """Read the composed pairs."""
    stage = open_pair_stage(
        path, _ROOT, api="FacePairsAPI", kind="pairs", command="usdface pairs propose"
    )
    root = stage.GetPrimAtPath(_ROOT)
    source, target = (stage.GetPrimAtPath(place) for place in (SOURCE_WEIGHTS, TARGET_CONTROLS))
    for place, prim in ((SOURCE_WEIGHTS, source), (TARGET_CONTROLS, target)):
        if not prim or not prim.IsA(UsdSkel.Animation):
            raise InputError(f"{path} <{place}>: there is no such animation; propose pairs again")
    attributes = attribute_names(target)
    top = stage.GetPrimAtPath(_TARGET)
    times = _times(stage, source, target, attributes, path)
    left = controls_at(source, None, (), times, path)
    right = controls_at(target, top, attributes, times, path)
    source_rig, source_prim = _rig(stage, source, _SOURCE)
    target_rig, target_prim = _rig(stage, target, _TARGET)
    return ExpressionPairs(
        names=tuple(text_of(root, _NAME.name, time) for time in times),
        source_shapes=left.shapes,
        source=left.weights,
        target=right,
        source_rig=source_rig,
        source_prim=source_prim,
        target_rig=target_rig,
        target_prim=target_prim,
    )


@refusing_wrong_types
def keyed_above(path: Path) -> tuple[str, ...]:
    """Return the properties keyed in layers stronger than the proposals, which they hide."""
    samples = proposed_path(path).resolve()
    keyed: list[str] = []
    for layer in open_stage(path).GetLayerStack(includeSessionLayers=False):
        if Path(layer.realPath).resolve() != samples:
            keyed += map(str, sampled_properties(layer))
    return tuple(dict.fromkeys(keyed))


def _author_samples(
    layer: Sdf.Layer, path: Path, pairs: ExpressionPairs, source_rig: Rig | None, target_rig: Rig
) -> None:
    target = pairs.target
    author_pair_header(layer, _ROOT, len(pairs))
    root = Sdf.CreatePrimInLayer(layer, _ROOT)
    author_series(root, _NAME.name, Sdf.ValueTypeNames.String, pairs.names)
    for place, rig, animation in (
        (_SOURCE, source_rig, SOURCE_WEIGHTS),
        (_TARGET, target_rig, TARGET_CONTROLS),
    ):
        if rig is None:
            continue
        define_reference(layer, str(place), rig, path)
        convert_to_our_units(layer, str(place), rig)
        point_skeletons_at(layer, str(place), rig, animation)
    author_animation(layer, SOURCE_WEIGHTS, shape_controls(pairs.source_shapes, pairs.source))
    author_animation(layer, TARGET_CONTROLS, target)
    if target.attributes:
        prim = layer.GetPrimAtPath(TARGET_CONTROLS)
        names = list(target.attributes)
        author_uniform(prim, NAMES, Sdf.ValueTypeNames.StringArray, names)
        places = author_attribute_specs(layer, _TARGET, target_rig, names)
        set_attribute_samples(layer, places, target, 1)


def _times(
    stage: Usd.Stage, source: Usd.Prim, target: Usd.Prim, attributes: tuple[str, ...], path: Path
) -> list[int]:
    """Return the time codes of the pairs, at which both sides must have keys."""
    top, of_source, of_target = stage.GetPrimAtPath(_TARGET), _sampled(source), _sampled(target)
    for name in attributes:
        attribute = control_attribute(top, name, path)
        spline = attribute.GetSpline().GetKnots() if attribute.HasSpline() else ()
        of_target |= {round(time) for time in (*attribute.GetTimeSamples(), *spline)}
    times = sorted(of_source | of_target)
    if not times:
        raise InputError(f"{path}: holds no pair; key both faces at time code 1, 2, ...")
    for time in times:
        if time not in of_source & of_target:
            side, animation = ("source", source) if time in of_target else ("target", target)
            raise InputError(
                f"{path} <{animation.GetPath()}>: pair {time} has no {side} side: nothing is keyed "
                f"at time code {time}; key the {side} there, or remove the pair"
            )
    return times


def _sampled(animation: Usd.Prim) -> set[int]:
    skel = UsdSkel.Animation(animation)
    attributes = (
        skel.GetBlendShapeWeightsAttr(),
        skel.GetRotationsAttr(),
        skel.GetTranslationsAttr(),
        skel.GetScalesAttr(),
    )
    return {round(time) for attribute in attributes for time in attribute.GetTimeSamples()}


def _rig(stage: Usd.Stage, animation: Usd.Prim, place: Sdf.Path) -> tuple[Path | None, str]:
    """Return file and SkelRoot of the rig at a place, perhaps missing; None without a rig."""
    try:
        return rig_of(stage, animation)
    except InputError:
        top = stage.GetPrimAtPath(place)
        missing = missing_reference(top) if top else None
        return (None, "") if missing is None else (Path(missing[0]), missing[1])


def merge_pairs(old: ExpressionPairs, new: ExpressionPairs) -> ExpressionPairs:
    """Return old pairs at their time codes, followed by new ones with other names."""
    added = [i for i, name in enumerate(new.names) if name not in old.names]
    for what, of_old, of_new in (
        ("source's shapes", old.source_shapes, new.source_shapes),
        ("target's shapes", old.target.shapes, new.target.shapes),
        ("target's joints", old.target.joints, new.target.joints),
        ("target's attributes", old.target.attributes, new.target.attributes),
    ):
        if of_old != of_new:
            raise InputError(
                f"the {what} are not those of the pairs that are there; choose another --out"
            )
    more = new.rows(np.array(added, dtype=np.int64))
    return replace(
        new,
        names=(*old.names, *more.names),
        source=np.concatenate([old.source, more.source]),
        target=old.target.mapped(lambda *both: np.concatenate(both), more.target),
    )
