"""Write a take: a readable layer to open, and its samples in a binary one beside it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Gf, Kind, Sdf, UsdGeom, UsdMedia, Vt

from usdface.core.assets import Markers, Take
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.core.sidecars import samples_path
from usdface.usdio.authoring import (
    PointExtents,
    apply_api,
    author_timing,
    author_uniform,
    author_unseen,
    define_prim,
)
from usdface.usdio.layers import FRAMES_IN_MEMORY, new_layer, new_layers, open_layer, relative_path
from usdface.usdio.units import MM_PER_STAGE_UNIT, author_units

_ROOT = Sdf.Path("/Take")
MARKERS = _ROOT.AppendChild("Markers")
HEAD_MOTION = _ROOT.AppendChild("HeadMotion")
SOURCE = _ROOT.AppendChild("Source")
AUDIO = _ROOT.AppendChild("Audio")
VISIBLE = "primvars:face:visible"
MARKER_CONFIDENCE = "primvars:face:confidence"
MARKER_WIDTH_MM = 3.0
"""How large a viewer draws a marker: a common size of facial markers."""


def write_take(
    path: Path, take: Take, *, over: Path | None = None, provenance: Provenance | None = None
) -> None:
    """Write a take.

    Parameters
    ----------
    path : Path
        The layer to open; samples go beside it unless it is ``.usdc``.
    over : Path, optional
        A take this one is made from: it stays as it is, and the new layer, stronger, sits on it.
    """
    samples = samples_path(path)
    beneath = [] if over is None else [relative_path(over, path)]
    if samples != path:
        beneath = [relative_path(samples, path), *beneath]
    # Both are whole, and nobody else writes either, before one takes its place.
    with new_layers(dict.fromkeys((samples, path), provenance)) as layers:
        below, layer = layers[0], layers[-1]
        _author(below, take)
        if samples != path:
            _author_header(layer, take)
        _author_take_api(layer, take, path)
        layer.subLayerPaths = beneath


def _author_take_api(layer: Sdf.Layer, take: Take, path: Path) -> None:
    """Write what the root prim says of a take."""
    prim = layer.GetPrimAtPath(_ROOT)
    apply_api(prim, "FaceTakeAPI")
    prim.SetInfo("kind", Kind.Tokens.component)
    token, string, double = (
        Sdf.ValueTypeNames.Token,
        Sdf.ValueTypeNames.String,
        Sdf.ValueTypeNames.Double,
    )
    author_uniform(prim, "face:take", string, take.name)
    for name, kind, value in (
        ("face:performer", string, take.performer),
        ("face:session", string, take.session),
        ("face:timecode:start", string, take.timecode_start),
        ("face:emotion", token, take.emotion),
    ):
        if value:
            author_uniform(prim, name, kind, value)
    if take.doubts is not None:
        author_uniform(prim, "face:doubts", Sdf.ValueTypeNames.StringArray, list(take.doubts))
    if take.events:
        labels = [event.label for event in take.events]
        author_uniform(prim, "face:events:labels", Sdf.ValueTypeNames.StringArray, labels)
        times = [Sdf.TimeCode(event.frame) for event in take.events]
        author_uniform(prim, "face:events:times", Sdf.ValueTypeNames.TimeCodeArray, times)
    if take.video is not None:
        asset = Sdf.AssetPath(relative_path(take.video.file, path))
        Sdf.AttributeSpec(prim, "face:video:file", Sdf.ValueTypeNames.Asset).default = asset
        if take.video.rate is not None:
            author_uniform(prim, "face:video:rate", double, float(take.video.rate))
        author_uniform(prim, "face:video:offset", double, take.video.offset)
        author_uniform(prim, "face:video:drift", double, take.video.drift)
    if take.audio is not None:
        _author_audio(layer, take, path)


def _author_header(layer: Sdf.Layer, take: Take) -> None:
    author_units(layer)
    last = take.first_frame + max(take.frame_count - 1, 0)
    author_timing(layer, rate=take.rate, first=take.first_frame, last=last)
    layer.defaultPrim = _ROOT.name
    define_prim(layer, _ROOT, "Xform")


def _author(layer: Sdf.Layer, take: Take) -> None:
    _author_header(layer, take)
    frames = take.frames
    if take.markers is not None:
        _author_markers(layer, take.markers, frames)
    if take.head_motion is not None:
        _author_head_motion(layer, take.head_motion, frames)
    if take.source is not None:
        prim = define_prim(layer, SOURCE, "SkelAnimation")
        author_uniform(prim, "blendShapes", Sdf.ValueTypeNames.TokenArray, list(take.source.names))
        author_unseen(prim, take.source.unseen)
        weights = Sdf.AttributeSpec(prim, "blendShapeWeights", Sdf.ValueTypeNames.FloatArray)
        for offset, row in enumerate(np.ascontiguousarray(take.source.values, np.float32)):
            layer.SetTimeSample(
                weights.path, take.source.first_frame + offset, Vt.FloatArray.FromNumpy(row)
            )


def _author_markers(layer: Sdf.Layer, markers: Markers, frames: np.ndarray) -> None:
    prim = define_prim(layer, MARKERS, "Points")
    apply_api(prim, "FaceMarkersAPI")
    token, tokens = Sdf.ValueTypeNames.Token, Sdf.ValueTypeNames.TokenArray
    author_uniform(prim, "face:markers:names", tokens, list(markers.names))
    author_uniform(prim, "face:markers:rigid", tokens, list(markers.rigid))
    author_uniform(prim, "face:markers:space", token, markers.space)
    author_uniform(prim, "face:markers:neutralFrame", Sdf.ValueTypeNames.Int, markers.neutral_frame)
    if markers.anchor:
        author_uniform(prim, "face:markers:anchor", token, markers.anchor)
    count = len(markers.names)
    Sdf.AttributeSpec(prim, "ids", Sdf.ValueTypeNames.Int64Array).default = list(range(count))
    extents = PointExtents(prim, count, MARKER_WIDTH_MM / MM_PER_STAGE_UNIT)
    points = Sdf.AttributeSpec(prim, "points", Sdf.ValueTypeNames.Point3fArray)
    visible = Sdf.AttributeSpec(prim, VISIBLE, Sdf.ValueTypeNames.BoolArray)
    confidence = Sdf.AttributeSpec(prim, MARKER_CONFIDENCE, Sdf.ValueTypeNames.FloatArray)
    for primvar in (visible, confidence):
        primvar.SetInfo("interpolation", UsdGeom.Tokens.vertex)
    # Setting samples on the layer itself is three times faster than through the stage.
    writers = _ChangeWriter(visible.path), _ChangeWriter(confidence.path)
    for start in range(0, len(frames), FRAMES_IN_MEMORY):
        lot = slice(start, start + FRAMES_IN_MEMORY)
        numbers = frames[lot].tolist()
        placed = markers.positions[lot] / np.float32(MM_PER_STAGE_UNIT)
        for index, frame in enumerate(numbers):
            layer.SetTimeSample(points.path, frame, Vt.Vec3fArray.FromNumpy(placed[index]))
        extents.author(layer, numbers, placed)
        writers[0].append(layer, numbers, markers.visible[lot], Vt.BoolArray)
        writers[1].append(layer, numbers, markers.confidence[lot], Vt.FloatArray)
        if len(frames) > FRAMES_IN_MEMORY:
            # A saved binary layer reads its samples back from disk when asked.
            layer.Save()


class _ChangeWriter:
    """Writes a value only where it changes: most frames see what the frame before saw.

    The frame before a change is written too, or readers would interpolate towards the change.
    """

    def __init__(self, path: Sdf.Path) -> None:
        self._path = path
        self._last: np.ndarray | None = None
        self._frame = 0
        self._written = -1

    def append(self, layer: Sdf.Layer, frames: list[int], values: np.ndarray, kind: Any) -> None:
        """Write the samples of the next frames."""
        changed = np.ones(len(frames), bool)
        changed[1:] = (values[1:] != values[:-1]).any(axis=1)
        if self._last is not None and len(frames):
            changed[0] = bool((values[0] != self._last).any())
        for index in np.flatnonzero(changed).tolist():
            before = frames[index - 1] if index else self._frame
            held = values[index - 1] if index else self._last
            if held is not None and self._written != before:
                self._set(layer, before, held, kind)
            self._set(layer, frames[index], values[index], kind)
        if len(frames):
            self._last, self._frame = values[-1].copy(), frames[-1]

    def _set(self, layer: Sdf.Layer, frame: int, value: np.ndarray, kind: Any) -> None:
        layer.SetTimeSample(self._path, frame, kind.FromNumpy(np.ascontiguousarray(value)))
        self._written = frame


def _author_head_motion(layer: Sdf.Layer, motion: np.ndarray, frames: np.ndarray) -> None:
    prim = define_prim(layer, HEAD_MOTION, "Xform")
    author_uniform(prim, "xformOpOrder", Sdf.ValueTypeNames.TokenArray, ["xformOp:transform"])
    transform = Sdf.AttributeSpec(prim, "xformOp:transform", Sdf.ValueTypeNames.Matrix4d)
    rows = motion.transpose(0, 2, 1).copy()
    rows[:, 3, :3] /= MM_PER_STAGE_UNIT
    for index, frame in enumerate(frames.tolist()):
        layer.SetTimeSample(transform.path, frame, Gf.Matrix4d(rows[index].tolist()))


def _author_audio(layer: Sdf.Layer, take: Take, path: Path) -> None:
    if take.audio is None:
        return
    prim = define_prim(layer, AUDIO, "SpatialAudio")
    asset = Sdf.AssetPath(relative_path(take.audio, path))
    author_uniform(prim, "filePath", Sdf.ValueTypeNames.Asset, asset)
    author_uniform(prim, "auralMode", Sdf.ValueTypeNames.Token, UsdMedia.Tokens.nonSpatial)
    start = Sdf.TimeCode(take.first_frame)  # the capture's own sound starts with it
    author_uniform(prim, "startTime", Sdf.ValueTypeNames.TimeCode, start)


@dataclass(frozen=True)
class VideoSync:
    """How a video lies in its take: ``take_time = offset + (1 + drift * 1e-6) * video_time``."""

    offset: float
    """[s]"""
    drift: float
    """[ppm]"""
    confidence: float
    """[0-1]"""


def write_video_sync(path: Path, sync: VideoSync) -> None:
    """Write the video's place in time into the root layer of a take.

    The layer is copied, changed and put in the place of the old one at once: whoever reads sees
    the one or the other. Its other opinions, its sublayers and what it says of its making stay.
    """
    layer = open_layer(path)
    if not layer.defaultPrim:
        raise InputError(f"{path}: names no default prim, so it is no take; ingest the capture")
    root = Sdf.Path.absoluteRootPath.AppendPath(layer.defaultPrim)
    with new_layer(path) as changed:
        changed.TransferContent(layer)
        # A take made over another may say nothing of its root yet: then this is an over.
        prim = Sdf.CreatePrimInLayer(changed, root)
        for name, value in (
            ("face:video:offset", sync.offset),
            ("face:video:drift", sync.drift),
            ("face:sync:confidence", sync.confidence),
        ):
            attribute = prim.attributes.get(name)
            if attribute is None:
                kind = Sdf.ValueTypeNames.Double
                attribute = Sdf.AttributeSpec(prim, name, kind, Sdf.VariabilityUniform)
            attribute.default = float(value)
