"""Writing of references: pair *i* at time code *i*, tuned and proposed weights in two layers.

Time samples of layers do not merge: the strongest layer with any determines all. So the tuned layer
has weights of *all* pairs, and ``face:reference:tuned`` marks those that a person set; the others
are copies of the proposals, and are updated with them.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from pxr import Kind, Sdf, Vt

from usdface.core.arrays import FloatArray, index_of
from usdface.core.assets import MotionSpace, References, Rig
from usdface.core.provenance import Provenance
from usdface.core.rig_logic import logic_of
from usdface.core.sidecars import proposed_path, samples_path, tuned_path
from usdface.core.trajectories import TRAJECTORY_SECONDS
from usdface.usdio.authoring import (
    apply_api,
    author_series,
    author_uniform,
    author_weights,
    define_prim,
    doubles,
)
from usdface.usdio.layers import new_layer, new_layers, relative_path
from usdface.usdio.point_extents import PointExtents
from usdface.usdio.references.pair_layers import author_pair_header
from usdface.usdio.references.read import (
    AUTHOR,
    DONE,
    EMOTION,
    FRAME_PATH,
    MARKERS_PATH,
    PLACEMENT,
    RATE,
    RIG,
    ROOT,
    SOURCE_PATH,
    TAKE,
    TRAJECTORY,
    TRAJECTORY_TIMES,
    TUNED,
    VISEME,
    WEIGHTS_PATH,
)
from usdface.usdio.references.weight_layers import TunedPair, read_tuned_pairs
from usdface.usdio.rig.reference import convert_to_our_units, define_reference, point_skeletons_at
from usdface.usdio.units import MM_PER_STAGE_UNIT

IMAGE = ROOT.AppendProperty("face:reference:image")
NEUTRAL = "face:markers:neutral"


def write_references(
    path: Path,
    references: References,
    rig: Rig,
    *,
    tuned: Sequence[TunedPair] = (),
    images: Sequence[Path | None] = (),
    provenance: Provenance,
) -> None:
    """Write a references asset with its proposals, and preserve tuned pairs.

    All layers are replaced together, the asset itself last.

    Parameters
    ----------
    path : Path
        The layer to open; its sublayers are a tuned and a proposed layer, and one with the arrays
        of markers and of their motion. Pairs of the tuned layer are preserved if `references` has
        them at the same time codes.
    tuned : sequence of TunedPair, optional
        Additional tuned pairs.
    images : sequence of Path or None, optional
        The picture of each pair.
    """
    tuned_file, proposed_file, samples = tuned_path(path), proposed_path(path), samples_path(path)
    here = list(zip(references.takes, references.frames.tolist(), strict=True))
    pairs = [
        each
        for each in _merge_tuned(tuned_file, tuned)
        if here[each.pair : each.pair + 1] == [(each.take, each.frame)]
    ]
    files = (proposed_file, samples, path)
    made: dict[Path, Provenance | None] = dict.fromkeys(files, provenance)
    if pairs or not tuned_file.is_file():
        made = {tuned_file: provenance if tuned else None} | made
    with new_layers(made) as layers:
        by_path = dict(zip(made, layers, strict=True))
        if tuned_file in by_path:
            _author_tuned_layer(by_path[tuned_file], references, pairs)
        _author_weights(by_path[proposed_file], references, references.weights)
        _author_frames(by_path[proposed_file], references)
        layer = by_path[path]
        for each in {samples, path}:
            author_pair_header(by_path[each], ROOT, len(references.frames))
        # The samples are above the tuned layer, which may have frames and takes of earlier pairs.
        sublayers = [each for each in (samples, tuned_file, proposed_file) if each != path]
        layer.subLayerPaths = [relative_path(each, path) for each in sublayers]
        _author_pairs(layer, references)
        _author_samples(by_path[samples], references)
        if any(images):
            named = ("" if image is None else relative_path(image, path) for image in images)
            root, assets = by_path[samples].GetPrimAtPath(ROOT), map(Sdf.AssetPath, named)
            author_series(root, IMAGE.name, Sdf.ValueTypeNames.Asset, assets)
        if references.placement is not None:
            placement = Sdf.AssetPath(relative_path(references.placement, path))
            root = layer.GetPrimAtPath(ROOT)
            author_uniform(root, PLACEMENT, Sdf.ValueTypeNames.Asset, placement)
        animation = define_prim(layer, WEIGHTS_PATH, "SkelAnimation")
        names = _written_names(references)
        author_uniform(animation, "blendShapes", Sdf.ValueTypeNames.TokenArray, names)
        define_reference(layer, str(RIG), rig, path)
        convert_to_our_units(layer, str(RIG), rig)
        point_skeletons_at(layer, str(RIG), rig, WEIGHTS_PATH)


def write_tuned_weights(
    references: References, pairs: list[TunedPair], *, layer_path: Path, provenance: Provenance
) -> None:
    """Add tuned pairs to the tuned layer, or replace them."""
    write_tuned_layer(
        references, _merge_tuned(layer_path, pairs), layer_path=layer_path, provenance=provenance
    )


def _merge_tuned(layer_path: Path, pairs: Sequence[TunedPair]) -> list[TunedPair]:
    together = {each.pair: each for each in (*read_tuned_pairs(layer_path), *pairs)}
    return [together[pair] for pair in sorted(together)]


def write_tuned_layer(
    references: References, pairs: list[TunedPair], *, layer_path: Path, provenance: Provenance
) -> None:
    """Write the tuned layer, in which these pairs are tuned, and the others are proposals.

    Parameters
    ----------
    references : References
        Its weights are the proposals.
    layer_path : Path
        The tuned layer, see `core.sidecars.tuned_path`.
    """
    with new_layer(layer_path, provenance) as layer:
        _author_tuned_layer(layer, references, pairs)


def _author_tuned_layer(layer: Sdf.Layer, references: References, pairs: list[TunedPair]) -> None:
    if not pairs:
        author_pair_header(layer, ROOT, len(references.frames))
        return
    weights = references.weights.copy()
    column = index_of(references.shape_names)
    for each in pairs:
        for name, value in each.weights.items():
            if name in column:
                weights[each.pair, column[name]] = value
    _author_weights(layer, references, weights)
    done = {each.pair: each.done for each in pairs}
    _author_frames(layer, references)
    over, kinds, every = layer.GetPrimAtPath(ROOT), Sdf.ValueTypeNames, range(len(weights))
    author_series(over, TUNED.name, kinds.Bool, (pair in done for pair in every))
    author_series(over, DONE.name, kinds.Bool, (done.get(pair, False) for pair in every))
    authors = {each.pair: each.author for each in pairs}
    if any(authors.values()):
        author_series(over, AUTHOR.name, kinds.Token, (authors.get(pair, "") for pair in every))


def _author_frames(layer: Sdf.Layer, references: References) -> None:
    """Write the frame and the take of each pair, which identify the selection of a layer."""
    over = Sdf.CreatePrimInLayer(layer, ROOT)
    author_series(over, FRAME_PATH.name, Sdf.ValueTypeNames.Int, references.frames.tolist())
    author_series(over, TAKE.name, Sdf.ValueTypeNames.Token, references.takes)


def _author_weights(layer: Sdf.Layer, references: References, weights: FloatArray) -> None:
    author_pair_header(layer, ROOT, len(references.frames))
    logic = logic_of(references.shape_names, references.combinations)
    if logic is not None:
        weights = logic.complete(weights, references.shape_names)
    animation = Sdf.CreatePrimInLayer(layer, WEIGHTS_PATH)
    author_weights(animation, _written_names(references), weights)


def _written_names(references: References) -> list[str]:
    return [*references.shape_names, *(each.shape for each in references.combinations)]


def _author_pairs(layer: Sdf.Layer, references: References) -> None:
    root = define_prim(layer, ROOT, "Xform")
    root.SetInfo("kind", Kind.Tokens.assembly)
    apply_api(root, "FaceReferencesAPI")
    for name, text in (
        ("face:performer", references.performer),
        ("face:session", references.session),
        ("face:neutralTake", references.neutral_take),
    ):
        if text:
            author_uniform(root, name, Sdf.ValueTypeNames.String, text)
    if references.rate:
        author_uniform(root, RATE, Sdf.ValueTypeNames.Double, references.rate)
    points = define_prim(layer, MARKERS_PATH, "Points")
    apply_api(points, "FaceMarkersAPI")
    for name, kind, value in (
        ("face:markers:names", Sdf.ValueTypeNames.TokenArray, list(references.marker_names)),
        ("face:markers:rigid", Sdf.ValueTypeNames.TokenArray, list(references.rigid)),
        ("face:markers:space", Sdf.ValueTypeNames.Token, "stabilized"),
    ):
        author_uniform(points, name, kind, value)


def _author_samples(layer: Sdf.Layer, references: References) -> None:
    """Write the frames, labels and markers of all pairs, in one file, so that they match."""
    root = Sdf.CreatePrimInLayer(layer, ROOT)
    if references.motion is not None:
        _author_motion(root, references.motion)
    _author_frames(layer, references)
    for path, labels in ((VISEME, references.visemes), (EMOTION, references.emotions)):
        if any(labels):
            author_series(root, path.name, Sdf.ValueTypeNames.Token, labels)
    points = Sdf.CreatePrimInLayer(layer, MARKERS_PATH)
    neutral = doubles(references.neutral / MM_PER_STAGE_UNIT)
    author_uniform(points, NEUTRAL, Sdf.ValueTypeNames.DoubleArray, neutral)
    extents = PointExtents(points, len(references.marker_names), 0.3)
    stage_points = (references.markers / MM_PER_STAGE_UNIT).astype(np.float32)
    extents.author(layer, range(1, len(references.frames) + 1), stage_points)
    rows = map(Vt.Vec3fArray.FromNumpy, stage_points)
    author_series(points, "points", Sdf.ValueTypeNames.Point3fArray, rows)
    if references.trajectories is not None:
        _author_trajectories(root, references.trajectories)
    if references.source is None:
        return
    animation = define_prim(layer, SOURCE_PATH, "SkelAnimation")
    author_weights(animation, references.source_names, references.source)


def _author_trajectories(root: Sdf.PrimSpec, trajectories: FloatArray) -> None:
    kinds = Sdf.ValueTypeNames
    author_uniform(root, TRAJECTORY_TIMES, kinds.DoubleArray, doubles(TRAJECTORY_SECONDS))
    moved = (trajectories / MM_PER_STAGE_UNIT).astype(np.float32)
    rows = (Vt.Vec3fArray.FromNumpy(each.reshape(-1, 3)) for each in moved)
    author_series(root, TRAJECTORY.name, kinds.Vector3fArray, rows)


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
    if len(motion.sample_starts) > 1:
        starts = Sdf.AttributeSpec(root, "face:motion:sampleStarts", Sdf.ValueTypeNames.IntArray)
        starts.default = Vt.IntArray(motion.sample_starts)
