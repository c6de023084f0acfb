"""Writing of takes: a text layer to open, and a binary sublayer with the samples."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Kind, Sdf, UsdGeom, UsdMedia, Vt

from usdface.core.arrays import FloatArray, frame_blocks
from usdface.core.assets import Markers, Take
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.core.sidecars import samples_path
from usdface.usdio.authoring import (
    apply_api,
    author_gaps,
    author_series,
    author_timing,
    author_uniform,
    author_weights,
    define_prim,
)
from usdface.usdio.layers import FRAMES_IN_MEMORY, new_layer, new_layers, open_layer, relative_path
from usdface.usdio.point_extents import PointExtents
from usdface.usdio.units import MM_PER_STAGE_UNIT, author_units

_ROOT = Sdf.Path("/Take")
MARKERS = _ROOT.AppendChild("Markers")
HEAD_MOTION = _ROOT.AppendChild("HeadMotion")
SOURCE = _ROOT.AppendChild("Source")
AUDIO = _ROOT.AppendChild("Audio")
VISIBLE = "primvars:face:visible"
MARKER_CONFIDENCE = "primvars:face:confidence"
MARKER_WIDTH_MM = 3.0
"""Size of a marker in viewers: a common one of facial markers."""


def write_take(path: Path, take: Take, *, over: Path | None = None, provenance: Provenance) -> None:
    """Write a take.

    Parameters
    ----------
    path : Path
        The layer to open; samples are in a separate layer unless it is ``.usdc``.
    over : Path, optional
        The take from which this one is made; it becomes a weaker sublayer.
    """
    samples = samples_path(path)
    sublayers = [] if over is None else [relative_path(over, path)]
    if samples != path:
        sublayers = [relative_path(samples, path), *sublayers]
    with new_layers(dict.fromkeys((samples, path), provenance)) as layers:
        below, layer = layers[0], layers[-1]
        _author(below, take)
        if samples != path:
            _author_header(layer, take)
        _author_take_api(layer, take, path)
        layer.subLayerPaths = sublayers


def _author_take_api(layer: Sdf.Layer, take: Take, path: Path) -> None:
    """Write the attributes of the root prim."""
    prim = layer.GetPrimAtPath(_ROOT)
    apply_api(prim, "FaceTakeAPI")
    prim.SetInfo("kind", Kind.Tokens.component)
    kinds = Sdf.ValueTypeNames
    token, string, double = kinds.Token, kinds.String, kinds.Double
    author_uniform(prim, "face:take", string, take.name)
    for name, kind, value in (
        ("face:performer", string, take.performer),
        ("face:session", string, take.session),
        ("face:timecode:start", string, take.timecode_start),
        ("face:emotion", token, take.emotion),
    ):
        if value:
            author_uniform(prim, name, kind, value)
    if take.warnings is not None:
        author_uniform(prim, "face:doubts", kinds.StringArray, list(take.warnings))
    if take.events:
        labels = [event.label for event in take.events]
        author_uniform(prim, "face:events:labels", kinds.StringArray, labels)
        times = [Sdf.TimeCode(event.frame) for event in take.events]
        author_uniform(prim, "face:events:times", kinds.TimeCodeArray, times)
    if take.video is not None:
        asset = Sdf.AssetPath(relative_path(take.video.file, path))
        Sdf.AttributeSpec(prim, "face:video:file", kinds.Asset).default = asset
        if take.video.rate is not None:
            author_uniform(prim, "face:video:rate", double, float(take.video.rate))
        author_uniform(prim, "face:video:offset", double, take.video.offset)
        author_uniform(prim, "face:video:drift", double, take.video.drift)
    if take.audio is not None:
        _author_audio(layer, take.audio, take.first_frame, path)


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
        _author_head_motion(layer, take.head_motion, take.first_frame)
    if take.source is not None:
        prim = define_prim(layer, SOURCE, "SkelAnimation")
        author_gaps(prim, take.source.gaps)
        source = take.source
        author_weights(prim, source.names, source.values, first=source.first_frame)


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
    # Setting samples on the layer is three times as fast as through the stage.
    writers = _ChangeWriter(visible.path), _ChangeWriter(confidence.path)
    for block in frame_blocks(len(frames), frames=FRAMES_IN_MEMORY):
        numbers = frames[block].tolist()
        positions = markers.positions[block] / np.float32(MM_PER_STAGE_UNIT)
        for index, frame in enumerate(numbers):
            layer.SetTimeSample(points.path, frame, Vt.Vec3fArray.FromNumpy(positions[index]))
        extents.author(layer, numbers, positions)
        writers[0].append(layer, numbers, markers.visible[block], Vt.BoolArray)
        writers[1].append(layer, numbers, markers.confidence[block], Vt.FloatArray)
        if len(frames) > FRAMES_IN_MEMORY:
            layer.Save()  # frees the memory of samples in a binary layer


class _ChangeWriter:
    """Writes a value where it changes, and in the frame before, against interpolation."""

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
            previous = values[index - 1] if index else self._last
            if previous is not None and self._written != before:
                self._set(layer, before, previous, kind)
            self._set(layer, frames[index], values[index], kind)
        if len(frames):
            self._last, self._frame = values[-1].copy(), frames[-1]

    def _set(self, layer: Sdf.Layer, frame: int, value: np.ndarray, kind: Any) -> None:
        layer.SetTimeSample(self._path, frame, kind.FromNumpy(np.ascontiguousarray(value)))
        self._written = frame


def _author_head_motion(layer: Sdf.Layer, motion: FloatArray, first: int) -> None:
    prim = define_prim(layer, HEAD_MOTION, "Xform")
    author_uniform(prim, "xformOpOrder", Sdf.ValueTypeNames.TokenArray, ["xformOp:transform"])
    rows = motion.transpose(0, 2, 1).copy()
    rows[:, 3, :3] /= MM_PER_STAGE_UNIT
    matrices = Vt.Matrix4dArray.FromNumpy(rows)
    author_series(prim, "xformOp:transform", Sdf.ValueTypeNames.Matrix4d, matrices, first=first)


def _author_audio(layer: Sdf.Layer, audio: Path, first_frame: int, path: Path) -> None:
    prim = define_prim(layer, AUDIO, "SpatialAudio")
    asset = Sdf.AssetPath(relative_path(audio, path))
    author_uniform(prim, "filePath", Sdf.ValueTypeNames.Asset, asset)
    author_uniform(prim, "auralMode", Sdf.ValueTypeNames.Token, UsdMedia.Tokens.nonSpatial)
    start = Sdf.TimeCode(first_frame)
    author_uniform(prim, "startTime", Sdf.ValueTypeNames.TimeCode, start)


@dataclass(frozen=True)
class VideoSync:
    """Clock of a video: ``take_time = offset + (1 + drift * 1e-6) * video_time``."""

    offset: float
    """[s]"""
    drift: float
    """[ppm]"""
    confidence: float
    """[0-1]"""


def write_video_sync(path: Path, sync: VideoSync) -> None:
    """Write the video's clock into the root layer of a take.

    The layer is replaced by a copy with these attributes.
    """
    layer = open_layer(path)
    if not layer.defaultPrim:
        raise InputError(f"{path}: names no default prim, so it is no take; ingest the capture")
    root = Sdf.Path.absoluteRootPath.AppendPath(layer.defaultPrim)
    with new_layer(path) as changed:
        changed.TransferContent(layer)
        # An over, if a take made over another has no opinion on its root.
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
