"""Performances: a layer to open, and a weights layer beneath it that is written as it is solved."""

import contextlib
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

import numpy as np
from pxr import Sdf, Usd, UsdSkel, Vt

from usdface.assets import FloatArray, Performance, Rig, WeightsClip
from usdface.errors import InputError
from usdface.provenance import Provenance
from usdface.rates import exact_rate
from usdface.usdio.authoring import apply_api, author_uniform, define_prim
from usdface.usdio.layers import (
    FRAMES_IN_MEMORY,
    author_timing,
    author_units,
    new_layer,
    open_layer,
    open_stage,
    relative_path,
    save_layer,
)
from usdface.usdio.rig_reference import (
    default_place,
    define_reference,
    point_skeletons_at,
    rig_of,
)

ANIMATION = "FaceSolve"
"""Name of the animation prim, a child of the referenced rig."""


def weights_path(path: Path) -> Path:
    """Return where the weights of a performance go: NAME.weights.usdc beside NAME.usda."""
    return path.with_name(f"{path.stem}.weights.usdc")


class WeightsWriter:
    """Appends solved frames to a weights layer; made by `writing_performance`."""

    def __init__(self, path: Path, layer: Sdf.Layer, animation: Sdf.Path, first_frame: int) -> None:
        self._path = path
        self._layer = layer
        self._weights = animation.AppendProperty("blendShapeWeights")
        self._confidence = animation.AppendProperty("face:confidence")
        self._residual = animation.AppendProperty("face:residual")
        self._unsaved = 0
        self.next_frame = first_frame

    def append(
        self,
        weights: FloatArray,
        *,
        confidence: FloatArray | None = None,
        residual_mm: FloatArray | None = None,
    ) -> None:
        """Append frames: (frames, shapes), and if known (frames,) and (frames, regions)."""
        rows = np.ascontiguousarray(weights, dtype=np.float32)
        residual = (
            None if residual_mm is None else np.ascontiguousarray(residual_mm, dtype=np.float32)
        )
        for index, row in enumerate(rows):
            frame = self.next_frame + index
            self._layer.SetTimeSample(self._weights, frame, Vt.FloatArray.FromNumpy(row))
            if confidence is not None:
                self._layer.SetTimeSample(self._confidence, frame, float(confidence[index]))
            if residual is not None:
                value = Vt.FloatArray.FromNumpy(residual[index])
                self._layer.SetTimeSample(self._residual, frame, value)
        self.next_frame += len(rows)
        self._unsaved += len(rows)
        if self._unsaved >= FRAMES_IN_MEMORY:
            # A saved binary layer reads its samples back from disk when asked.
            save_layer(self._layer, self._path)
            self._unsaved = 0


@contextlib.contextmanager
def writing_performance(
    path: Path,
    rig: Rig,
    *,
    shape_names: tuple[str, ...],
    rate: Fraction,
    first_frame: int,
    last_frame: int,
    place: str | None = None,
    regions: tuple[str, ...] = (),
    timecode_start: str = "",
    provenance: Provenance | None = None,
) -> Iterator[WeightsWriter]:
    """Write a performance frame by frame; the files appear when the block ends without error.

    Parameters
    ----------
    path : Path
        The layer to open. If it exists, what others put into it (edits, further sublayers) stays.
    rig : Rig
    shape_names : tuple of str
        Order of the weights that will be appended.
    rate : Fraction
    first_frame, last_frame : int
        Inclusive.
    place : str, optional
        Prim path of the rig in the performance; its own top prim's by default.
    regions : tuple of str
        Names of the residual's regions.
    timecode_start : str
    provenance : Provenance, optional

    Raises
    ------
    InputError
        If the files cannot be written; what was there is then left as it was.
    """
    place = place or default_place(rig)
    animation = Sdf.Path(place).AppendChild(ANIMATION)
    weights_file = weights_path(path)
    # The top layer is held from the start: nobody else can write this performance meanwhile.
    with new_layer(path, provenance) as top:
        with new_layer(weights_file, provenance) as layer:
            author_units(layer)
            author_timing(layer, rate=rate, first=first_frame, last=last_frame)
            layer.defaultPrim = Sdf.Path(place).GetPrefixes()[0].name
            prim = define_prim(layer, animation, "SkelAnimation")
            apply_api(prim, "FaceSolveAPI")
            author_uniform(prim, "blendShapes", Sdf.ValueTypeNames.TokenArray, list(shape_names))
            Sdf.AttributeSpec(prim, "blendShapeWeights", Sdf.ValueTypeNames.FloatArray)
            Sdf.AttributeSpec(prim, "face:confidence", Sdf.ValueTypeNames.Float)
            if regions:
                Sdf.AttributeSpec(prim, "face:residual", Sdf.ValueTypeNames.FloatArray)
                author_uniform(
                    prim, "face:residual:regions", Sdf.ValueTypeNames.TokenArray, list(regions)
                )
            if timecode_start:
                author_uniform(
                    prim, "face:timecode:start", Sdf.ValueTypeNames.String, timecode_start
                )
            point_skeletons_at(layer, place, rig, animation)
            writer = WeightsWriter(weights_file, layer, animation, first_frame)
            yield writer
            if writer.next_frame != last_frame + 1:
                raise ValueError(
                    f"{path}: {writer.next_frame - first_frame} frames were appended where "
                    f"{last_frame - first_frame + 1} were announced"
                )
        if path.is_file():
            top.TransferContent(open_layer(path))
        author_units(top)
        author_timing(top, rate=rate, first=first_frame, last=last_frame)
        top.defaultPrim = Sdf.Path(place).GetPrefixes()[0].name
        define_reference(top, place, rig, path)
        weights_asset = relative_path(weights_file, path)
        if weights_asset not in list(top.subLayerPaths):
            top.subLayerPaths.append(weights_asset)


def find_animation(stage: Usd.Stage, path: Path) -> Usd.Prim:
    """Return the one animation with weights over time that a skeleton of the stage follows.

    Raises
    ------
    InputError
        If there is none, or more than one.
    """
    found: dict[str, Usd.Prim] = {}
    for prim in stage.Traverse():
        if prim.IsA(UsdSkel.Skeleton):
            source = UsdSkel.BindingAPI(prim).GetInheritedAnimationSource()
            if source and _weight_samples(source):
                found[str(source.GetPath())] = source
    if not found:
        found = {
            str(prim.GetPath()): prim
            for prim in stage.Traverse()
            if prim.IsA(UsdSkel.Animation) and _weight_samples(prim)
        }
    if not found:
        raise InputError(f"{path}: no SkelAnimation with blendShapeWeights over time")
    if len(found) > 1:
        raise InputError(
            f"{path}: {len(found)} animations with blendShapeWeights, {', '.join(found)}; "
            "open one face at a time"
        )
    return next(iter(found.values()))


def read_weights(path: Path) -> WeightsClip:
    """Read the animated weights of any USD file that holds one face.

    Raises
    ------
    InputError
        If there is no such animation, or a sample does not fit the names.
    """
    stage = open_stage(path)
    return _read_clip(stage, find_animation(stage, path), path)


def read_performance(path: Path) -> Performance:
    """Read a performance and what it says of its rig and its trust.

    Raises
    ------
    InputError
        If the file is no performance, or the rig it refers to is gone.
    """
    stage = open_stage(path)
    prim = find_animation(stage, path)
    clip = _read_clip(stage, prim, path)
    rig_file, rig_prim = rig_of(stage, prim)
    frames = range(clip.first_frame, clip.first_frame + len(clip.values))
    regions = prim.GetAttribute("face:residual:regions")
    timecode = prim.GetAttribute("face:timecode:start")
    return Performance(
        weights=clip,
        rig_file=rig_file,
        rig_prim=rig_prim,
        confidence=_read_series(prim, "face:confidence", frames),
        residual_mm=_read_series(prim, "face:residual", frames),
        regions=tuple(map(str, regions.Get() or ())) if regions else (),
        timecode_start=str(timecode.Get() or "") if timecode else "",
    )


def _weight_samples(prim: Usd.Prim) -> bool:
    attribute = UsdSkel.Animation(prim).GetBlendShapeWeightsAttr()
    return bool(attribute) and attribute.GetNumTimeSamples() > 0


def _read_clip(stage: Usd.Stage, prim: Usd.Prim, path: Path) -> WeightsClip:
    animation = UsdSkel.Animation(prim)
    names = tuple(map(str, animation.GetBlendShapesAttr().Get() or ()))
    attribute = animation.GetBlendShapeWeightsAttr()
    times = attribute.GetTimeSamples()
    first, last = round(times[0]), round(times[-1])
    values = np.empty((last - first + 1, len(names)), dtype=np.float32)
    for index, frame in enumerate(range(first, last + 1)):
        row = attribute.Get(frame)
        if row is None or len(row) != len(names) or not np.isfinite(np.asarray(row)).all():
            raise InputError(
                f"{path} <{attribute.GetPath()}> time code {frame}: needs {len(names)} finite "
                f"weights, one per shape, got {0 if row is None else len(row)}; map again"
            )
        values[index] = np.asarray(row)
    rate = stage.GetTimeCodesPerSecond()
    where = f"{path}: timeCodesPerSecond"
    return WeightsClip(names, values, first, exact_rate(rate, where=where))


def _read_series(prim: Usd.Prim, name: str, frames: range) -> FloatArray | None:
    attribute = prim.GetAttribute(name)
    if not attribute or not attribute.GetNumTimeSamples():
        return None
    return np.array([np.array(attribute.Get(frame)) for frame in frames], dtype=np.float64)
