"""References: pair *i* at time code *i*; what people tuned and what was proposed in two layers.

Time samples do not merge from layer to layer: the strongest layer that has any wins at every time
code. So the tuned layer, once it exists, holds weights of *every* pair, and says by
``face:reference:tuned`` which of them a person set; the others are copies of the proposals and are
renewed with them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pxr import Kind, Sdf, Usd, UsdGeom, UsdSkel, Vt

from usdface.core.arrays import FloatArray, IntArray
from usdface.core.assets import MotionSpace, References, Rig
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.usdio.authoring import apply_api, author_uniform, define_prim, doubles
from usdface.usdio.layers import (
    MM_PER_STAGE_UNIT,
    new_layer,
    new_layers,
    open_layer,
    relative_path,
)
from usdface.usdio.references.pair_layers import author_pair_header, open_pair_stage
from usdface.usdio.rig.reference import (
    define_reference,
    point_skeletons_at,
    rig_of,
    turn_to_our_units,
)
from usdface.usdio.wrong_types import refusing_wrong_types

ROOT = Sdf.Path("/References")
_MARKERS = ROOT.AppendChild("Markers")
RIG = ROOT.AppendChild("Rig")
WEIGHTS = ROOT.AppendChild("Weights")
WEIGHTS_ATTRIBUTE = WEIGHTS.AppendProperty("blendShapeWeights")
FRAME = ROOT.AppendProperty("face:reference:frame")
TAKE = ROOT.AppendProperty("face:reference:take")
TUNED = ROOT.AppendProperty("face:reference:tuned")
DONE = ROOT.AppendProperty("face:reference:done")
VISEME = ROOT.AppendProperty("face:reference:viseme")
EMOTION = ROOT.AppendProperty("face:reference:emotion")
IMAGE = ROOT.AppendProperty("face:reference:image")

NEUTRAL = "face:markers:neutral"


@dataclass(frozen=True)
class TunedPair:
    """Weights that a person set for one frame of a take, by shape name.

    `done` says that the person has finished with the pair, not only touched it.
    """

    pair: int
    take: str
    frame: int
    weights: dict[str, float]
    done: bool = True


def write_references(
    path: Path,
    references: References,
    rig: Rig,
    *,
    tuned_path: Path,
    proposed_path: Path,
    tuned: Sequence[TunedPair] = (),
    images: Sequence[Path | None] = (),
    provenance: Provenance | None = None,
) -> None:
    """Write a references asset and its proposals; what people tuned stays.

    The layers are all whole before the first of them takes its place; the asset itself is last.

    Parameters
    ----------
    path, tuned_path, proposed_path : Path
        The layer to open, and the two beneath it. The tuned layer's tuned pairs are kept as they
        are where they are among `references`, at the time codes they have.
    references : References
    rig : Rig
    tuned : sequence of TunedPair, optional
        Pairs that are tuned from now on, besides those kept.
    images : sequence of Path or None, optional
        The picture of each pair; named as seen from `path`, so that the folder can move.
    provenance : Provenance, optional
    """
    here = list(zip(references.takes, references.frames.tolist(), strict=True))
    pairs = [
        each
        for each in _tuned_before_and_now(tuned_path, tuned)
        if here[each.pair : each.pair + 1] == [(each.take, each.frame)]
    ]
    made = {proposed_path: provenance, path: provenance}
    if pairs or not tuned_path.is_file():
        made = {tuned_path: provenance if tuned else None} | made
    with new_layers(made) as layers:
        *beneath, proposed, layer = layers
        for each in beneath:
            _author_tuned_layer(each, references, pairs)
        _author_weights(proposed, references, references.weights)
        author_pair_header(layer, ROOT, len(references.frames))
        layer.subLayerPaths = [relative_path(each, path) for each in (tuned_path, proposed_path)]
        _author_pairs(layer, references)
        _author_images(layer, images, path)
        animation = define_prim(layer, WEIGHTS, "SkelAnimation")
        names = list(references.shape_names)
        author_uniform(animation, "blendShapes", Sdf.ValueTypeNames.TokenArray, names)
        define_reference(layer, str(RIG), rig, path)
        turn_to_our_units(layer, str(RIG), rig)
        point_skeletons_at(layer, str(RIG), rig, WEIGHTS)


@refusing_wrong_types
def read_tuned_pairs(tuned_path: Path) -> list[TunedPair]:
    """Return what people tuned, as the tuned layer alone says it; empty without the layer."""
    if not tuned_path.is_file():
        return []
    layer = open_layer(tuned_path)
    prim = layer.GetPrimAtPath(WEIGHTS)
    if prim is None or "blendShapes" not in prim.attributes:
        return []
    names = [str(name) for name in prim.attributes["blendShapes"].default or ()]
    found = []
    for time in layer.ListTimeSamplesForPath(TUNED):
        if not layer.QueryTimeSample(TUNED, time):
            continue
        weights = layer.QueryTimeSample(WEIGHTS_ATTRIBUTE, time)
        if weights is None or len(weights) != len(names):
            raise InputError(
                f"{tuned_path} <{WEIGHTS_ATTRIBUTE}> time code {time:g}: "
                f"{0 if weights is None else len(weights)} weights for {len(names)} shapes; "
                "restore the layer from its last version"
            )
        found.append(
            TunedPair(
                pair=round(time) - 1,
                take=str(layer.QueryTimeSample(TAKE, time)),
                frame=int(layer.QueryTimeSample(FRAME, time)),
                weights=dict(zip(names, np.array(weights, np.float64).tolist(), strict=True)),
                done=layer.QueryTimeSample(DONE, time) is not False,
            )
        )
    return found


def write_tuned_weights(
    references: References,
    pairs: list[TunedPair],
    *,
    tuned_path: Path,
    provenance: Provenance | None = None,
) -> None:
    """Add tuned pairs to the tuned layer; pairs tuned before stay unless they are given again."""
    write_tuned_layer(
        references,
        _tuned_before_and_now(tuned_path, pairs),
        tuned_path=tuned_path,
        provenance=provenance,
    )


def _tuned_before_and_now(tuned_path: Path, pairs: Sequence[TunedPair]) -> list[TunedPair]:
    together = {each.pair: each for each in (*read_tuned_pairs(tuned_path), *pairs)}
    return [together[pair] for pair in sorted(together)]


def write_tuned_layer(
    references: References,
    pairs: list[TunedPair],
    *,
    tuned_path: Path,
    provenance: Provenance | None = None,
) -> None:
    """Write the tuned layer anew: exactly these pairs are tuned, the others are proposals.

    Parameters
    ----------
    references : References
        Its weights are the proposals.
    pairs : list of TunedPair
    tuned_path : Path
    provenance : Provenance, optional
    """
    with new_layer(tuned_path, provenance) as layer:
        _author_tuned_layer(layer, references, pairs)


def _author_tuned_layer(layer: Sdf.Layer, references: References, pairs: list[TunedPair]) -> None:
    if not pairs:
        author_pair_header(layer, ROOT, len(references.frames))
        return
    weights = references.weights.copy()
    column = {name: index for index, name in enumerate(references.shape_names)}
    for each in pairs:
        for name, value in each.weights.items():
            if name in column:
                weights[each.pair, column[name]] = value
    _author_weights(layer, references, weights)
    done = {each.pair: each.done for each in pairs}
    over = Sdf.CreatePrimInLayer(layer, ROOT)
    Sdf.AttributeSpec(over, FRAME.name, Sdf.ValueTypeNames.Int)
    Sdf.AttributeSpec(over, TAKE.name, Sdf.ValueTypeNames.Token)
    Sdf.AttributeSpec(over, TUNED.name, Sdf.ValueTypeNames.Bool)
    Sdf.AttributeSpec(over, DONE.name, Sdf.ValueTypeNames.Bool)
    for pair in range(len(references.frames)):
        layer.SetTimeSample(FRAME, pair + 1, int(references.frames[pair]))
        layer.SetTimeSample(TAKE, pair + 1, references.takes[pair])
        layer.SetTimeSample(TUNED, pair + 1, pair in done)
        layer.SetTimeSample(DONE, pair + 1, done.get(pair, False))


def _author_weights(layer: Sdf.Layer, references: References, weights: FloatArray) -> None:
    author_pair_header(layer, ROOT, len(references.frames))
    over = Sdf.CreatePrimInLayer(layer, WEIGHTS)
    names = list(references.shape_names)
    author_uniform(over, "blendShapes", Sdf.ValueTypeNames.TokenArray, names)
    Sdf.AttributeSpec(over, WEIGHTS_ATTRIBUTE.name, Sdf.ValueTypeNames.FloatArray)
    for pair, row in enumerate(np.ascontiguousarray(weights, dtype=np.float32)):
        layer.SetTimeSample(WEIGHTS_ATTRIBUTE, pair + 1, Vt.FloatArray.FromNumpy(row))


def _author_pairs(layer: Sdf.Layer, references: References) -> None:
    root = define_prim(layer, ROOT, "Xform")
    root.SetInfo("kind", Kind.Tokens.assembly)
    apply_api(root, "FaceReferencesAPI")
    Sdf.AttributeSpec(root, FRAME.name, Sdf.ValueTypeNames.Int)
    Sdf.AttributeSpec(root, TAKE.name, Sdf.ValueTypeNames.Token)
    if references.motion is not None:
        _author_motion(root, references.motion)
    points = define_prim(layer, _MARKERS, "Points")
    apply_api(points, "FaceMarkersAPI")
    for name, kind, value in (
        ("face:markers:names", Sdf.ValueTypeNames.TokenArray, list(references.marker_names)),
        ("face:markers:rigid", Sdf.ValueTypeNames.TokenArray, list(references.rigid)),
        ("face:markers:space", Sdf.ValueTypeNames.Token, "stabilized"),
    ):
        author_uniform(points, name, kind, value)
    neutral = doubles(references.neutral / MM_PER_STAGE_UNIT)
    author_uniform(points, NEUTRAL, Sdf.ValueTypeNames.DoubleArray, neutral)
    widths = Sdf.AttributeSpec(points, "widths", Sdf.ValueTypeNames.FloatArray)
    widths.default = [0.3]
    widths.SetInfo("interpolation", UsdGeom.Tokens.constant)
    placed = Sdf.AttributeSpec(points, "points", Sdf.ValueTypeNames.Point3fArray)
    stage_points = (references.markers / MM_PER_STAGE_UNIT).astype(np.float32)
    flat = stage_points.reshape(-1, 3)
    extent = Sdf.AttributeSpec(points, "extent", Sdf.ValueTypeNames.Float3Array)
    extent.default = Vt.Vec3fArray.FromNumpy(np.stack([flat.min(0), flat.max(0)]))
    for pair in range(len(references.frames)):
        layer.SetTimeSample(FRAME, pair + 1, int(references.frames[pair]))
        layer.SetTimeSample(TAKE, pair + 1, references.takes[pair])
        layer.SetTimeSample(placed.path, pair + 1, Vt.Vec3fArray.FromNumpy(stage_points[pair]))
    for path, labels in ((VISEME, references.visemes), (EMOTION, references.emotions)):
        if any(labels):
            Sdf.AttributeSpec(root, path.name, Sdf.ValueTypeNames.Token)
            for pair, label in enumerate(labels):
                layer.SetTimeSample(path, pair + 1, label)


def _author_images(layer: Sdf.Layer, images: Sequence[Path | None], path: Path) -> None:
    if not any(images):
        return
    Sdf.AttributeSpec(layer.GetPrimAtPath(ROOT), IMAGE.name, Sdf.ValueTypeNames.Asset)
    for pair, image in enumerate(images):
        named = "" if image is None else relative_path(image, path)
        layer.SetTimeSample(IMAGE, pair + 1, Sdf.AssetPath(named))


def _author_motion(root: Sdf.PrimSpec, motion: MotionSpace) -> None:
    kind = Sdf.ValueTypeNames.DoubleArray
    for name, value in (
        ("face:motion:mean", motion.mean / MM_PER_STAGE_UNIT),
        ("face:motion:components", motion.components),
        ("face:motion:variances", motion.variances / MM_PER_STAGE_UNIT**2),
        ("face:motion:sample", motion.sample / MM_PER_STAGE_UNIT),
    ):
        Sdf.AttributeSpec(root, name, kind).default = doubles(value)
    total = Sdf.AttributeSpec(root, "face:motion:totalVariance", Sdf.ValueTypeNames.Double)
    total.default = motion.total_variance / MM_PER_STAGE_UNIT**2


@refusing_wrong_types
def read_references(path: Path) -> References:
    """Read a references asset as it composes: tuned weights where there are any, else proposals.

    Raises
    ------
    InputError
        If the file is no references asset, or its parts do not fit together.
    """
    stage = open_pair_stage(
        path, ROOT, api="FaceReferencesAPI", kind="references", command="usdface select"
    )
    root = stage.GetPrimAtPath(ROOT)
    points = UsdGeom.Points(stage.GetPrimAtPath(_MARKERS))
    animation = UsdSkel.Animation(stage.GetPrimAtPath(WEIGHTS))
    if not points or not animation:
        raise InputError(f"{path}: </References/Markers> or </References/Weights> is missing")
    pairs = range(1, round(stage.GetEndTimeCode()) + 1)
    marker_names = tuple(map(str, points.GetPrim().GetAttribute("face:markers:names").Get()))
    shape_names = tuple(map(str, animation.GetBlendShapesAttr().Get()))
    weights = _stack(path, animation.GetBlendShapeWeightsAttr(), pairs, len(shape_names), "weights")
    markers = _stack(path, points.GetPointsAttr(), pairs, len(marker_names), "points")
    frames = root.GetAttribute(FRAME.name)
    takes = root.GetAttribute(TAKE.name)
    tuned = root.GetAttribute(TUNED.name)
    neutral = np.array(
        points.GetPrim().GetAttribute("face:markers:neutral").Get(), dtype=np.float64
    )
    rig_file, rig_prim = rig_of(stage, animation.GetPrim())
    take_of = tuple(str(takes.Get(pair)) for pair in pairs)
    frame_of = np.array([frames.Get(pair) for pair in pairs], dtype=np.int64)
    _check_tuning(stage, take_of, frame_of)
    return References(
        marker_names=marker_names,
        shape_names=shape_names,
        markers=markers * MM_PER_STAGE_UNIT,
        weights=weights,
        frames=frame_of,
        takes=take_of,
        tuned=np.array([bool(tuned.Get(pair)) for pair in pairs]),
        rigid=tuple(map(str, points.GetPrim().GetAttribute("face:markers:rigid").Get() or ())),
        neutral=neutral.reshape(-1, 3) * MM_PER_STAGE_UNIT,
        rig_file=rig_file,
        rig_prim=rig_prim,
        motion=_read_motion(root),
        visemes=_labels(root, VISEME, pairs),
        emotions=_labels(root, EMOTION, pairs),
    )


def _labels(root: Usd.Prim, path: Sdf.Path, pairs: range) -> tuple[str, ...]:
    attribute = root.GetAttribute(path.name)
    return tuple(str(attribute.Get(pair) or "") for pair in pairs) if attribute else ()


def _check_tuning(stage: Usd.Stage, takes: tuple[str, ...], frames: IntArray) -> None:
    """Refuse weights that were tuned for other frames than those the asset has there now."""
    for layer in stage.GetLayerStack(includeSessionLayers=False)[1:]:
        for time in layer.ListTimeSamplesForPath(TUNED):
            pair = round(time) - 1
            if not layer.QueryTimeSample(TUNED, time):
                continue
            take, frame = (layer.QueryTimeSample(path, time) for path in (TAKE, FRAME))
            here = (takes[pair], int(frames[pair])) if 0 <= pair < len(takes) else None
            if here != (str(take), frame):
                is_now = "no pair" if here is None else f"frame {here[1]} of {here[0]}"
                raise InputError(
                    f"{layer.realPath} time code {time:g}: was tuned for frame {frame} of {take}, "
                    f"and the asset has {is_now} there: it is the tuning of an older selection. "
                    "Select again with --out of this asset, which keeps what is tuned, or put the "
                    "asset's own tuning layer back"
                )


def _stack(path: Path, attribute: Usd.Attribute, pairs: range, count: int, what: str) -> FloatArray:
    held = attribute.GetNumTimeSamples()
    if len(pairs) > held:  # a damaged end would else be counted up to, pair by pair
        raise InputError(
            f"{path}: its end time code says {len(pairs)} pairs, and <{attribute.GetPath()}> holds "
            f"{held}; restore the layer or select again"
        )
    rows = []
    for pair in pairs:
        value = attribute.Get(pair)
        if value is None or len(value) != count or not np.isfinite(np.asarray(value)).all():
            got = "none" if value is None else f"{len(value)}"
            raise InputError(
                f"{path} <{attribute.GetPath()}> time code {pair}: {got} {what} where {count} "
                "finite ones are needed; restore the layer or select again"
            )
        rows.append(np.array(value, dtype=np.float64))
    return np.array(rows)


def _read_motion(root: Usd.Prim) -> MotionSpace | None:
    def get(name: str) -> FloatArray:
        return np.array(root.GetAttribute(name).Get() or [], dtype=np.float64)

    mean, variances = get("face:motion:mean"), get("face:motion:variances")
    if not len(mean) or not len(variances):
        return None
    return MotionSpace(
        mean=mean * MM_PER_STAGE_UNIT,
        components=get("face:motion:components").reshape(len(variances), len(mean)),
        variances=variances * MM_PER_STAGE_UNIT**2,
        total_variance=float(root.GetAttribute("face:motion:totalVariance").Get())
        * MM_PER_STAGE_UNIT**2,
        sample=get("face:motion:sample").reshape(-1, len(variances)) * MM_PER_STAGE_UNIT,
    )
