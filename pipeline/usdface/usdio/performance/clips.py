"""Weights in several layers, played as one by USD's value clips.

A value clip holds its last sample until the next clip begins, which motion blur would show at
seams. So the frames on both sides of every seam are also in another layer, the active clip between
them.
"""

import contextlib
import itertools
import re
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from pxr import Sdf, Usd, Vt

from usdface.core.arrays import Float32Array, FloatArray
from usdface.core.assets import Rig
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.core.rates import shift_timecode
from usdface.core.replacing import replacing
from usdface.usdio.authoring import prim_paths_in
from usdface.usdio.layers import new_layer, open_layer, open_stage, relative_path
from usdface.usdio.performance.weights_layer import (
    FIGURES,
    NO_FIGURES,
    WEIGHTS,
    SolveFigures,
    WeightsHeader,
    author_header,
    writing_weights,
)

CLIP_SET = "parts"


@dataclass(frozen=True)
class ClipPart:
    """A layer with some frames of a performance's weights."""

    file: Path
    first_frame: int
    last_frame: int
    """`first_frame`, `last_frame`: Inclusive."""
    animation: str
    """Path of the animation prim in it."""


class PartsWriter:
    """Appends solved frames to consecutive parts; made by `writing_parts`."""

    def __init__(
        self,
        path: Path,
        header: WeightsHeader,
        rig: Rig,
        part_frames: int,
        provenance: Provenance | None,
        opened: contextlib.ExitStack,
    ) -> None:
        self._path, self._header, self._rig = path, header, rig
        self._part_frames, self._provenance = part_frames, provenance
        self._open = opened
        self._start(header.first_frame)
        self.parts: list[ClipPart] = []
        self.next_frame = header.first_frame

    def append(
        self, weights: FloatArray | Float32Array, figures: SolveFigures = NO_FIGURES
    ) -> None:
        """Append frames: (frames, shapes)."""
        done = 0
        while done < len(weights):
            if self.next_frame > self._part.last_frame:
                self.close()
                self._start(self.next_frame)
            count = min(len(weights) - done, self._part.last_frame - self.next_frame + 1)
            part = slice(done, done + count)
            self._writer.append(weights[part], figures.rows(part))
            done += count
            self.next_frame += count

    def close(self) -> None:
        """Complete the open part."""
        self._open.close()
        self.parts.append(self._part)

    def _start(self, first: int) -> None:
        header = self._header
        last = min(first + self._part_frames - 1, header.last_frame)
        file = part_path(self._path, first, last, self._provenance)
        self._part = ClipPart(file, first, last, str(header.animation))
        start = shift_timecode(header.timecode_start, first - header.first_frame, header.rate)
        own = replace(header, first_frame=first, last_frame=last, timecode_start=start)
        self._writer = self._open.enter_context(
            writing_weights(file, own, self._rig, provenance=self._provenance)
        )


@contextlib.contextmanager
def writing_parts(
    path: Path,
    header: WeightsHeader,
    rig: Rig,
    *,
    part_frames: int,
    provenance: Provenance | None = None,
) -> Iterator[PartsWriter]:
    """Write weights as parts of `part_frames` frames, and at `path` the layer that plays them."""
    with contextlib.ExitStack() as opened:  # discards the open part after an exception
        writer = PartsWriter(path, header, rig, part_frames, provenance, opened)
        yield writer
        writer.close()
    write_clips(path, header, rig, writer.parts, provenance=provenance)


def part_path(path: Path, first: int, last: int, provenance: Provenance | None) -> Path:
    """Return the name of a part of a weights layer.

    It depends on the provenance, so that a new mapping does not replace parts of an old one.
    """
    digest = (provenance or Provenance()).digest
    return path.with_name(f"{path.stem}.{first}-{last}.{digest}{path.suffix}")


def clear_parts(path: Path) -> None:
    """Remove parts that a weights layer does not play any more."""
    played = clip_files(path)
    stem, suffix = re.escape(path.stem), re.escape(path.suffix)
    ours = re.compile(rf"{stem}\.(-?\d+--?\d+|seams)\.[0-9a-f]{{8}}{suffix}")
    for each in path.parent.iterdir():
        if ours.fullmatch(each.name) and each not in played:
            each.unlink(missing_ok=True)


def clip_files(path: Path) -> set[Path]:
    """Return the clips and manifests that a layer, if it exists, uses of those named after it."""
    if not path.is_file():
        return set()
    layer = open_layer(path)
    prims = map(layer.GetPrimAtPath, prim_paths_in(layer))
    sets = [each for prim in prims for each in dict(prim.GetInfo("clips") or {}).values()]
    clips = [asset for each in sets for asset in each.get("assetPaths", ())]
    manifests = [each["manifestAssetPath"] for each in sets if "manifestAssetPath" in each]
    files = {path.parent / Path(asset.path).name for asset in (*clips, *manifests)}
    return {file for file in files if file.name.startswith(f"{path.stem}.")}


def author_clips(
    prim: Sdf.PrimSpec,
    clip_set: str,
    files: Sequence[Path],
    manifest: Path,
    *,
    active: Sequence[tuple[int, int]],
    ends: tuple[int, int],
    path: Path,
) -> None:
    """Write value clips of a prim, in which it has the same path.

    Parameters
    ----------
    active : sequence of tuple of int
        Time codes from which a file is played, and its index.
    ends : tuple of int
        First and last time code, the same in the clips.
    path : Path
        Final path of the layer.
    """
    assets = [Sdf.AssetPath(relative_path(file, path)) for file in files]
    clips = {
        "primPath": str(prim.path),
        "assetPaths": Sdf.AssetPathArray(assets),
        "manifestAssetPath": Sdf.AssetPath(relative_path(manifest, path)),
        "active": Vt.Vec2dArray(list(active)),
        "times": Vt.Vec2dArray([(end, end) for end in ends]),
    }
    prim.SetInfo("clips", {clip_set: clips})


def write_clips(
    path: Path,
    header: WeightsHeader,
    rig: Rig,
    parts: Sequence[ClipPart],
    *,
    provenance: Provenance | None = None,
) -> None:
    """Write a weights layer that plays consecutive parts as value clips."""
    parts = [own for part in parts for own in _playable_parts(part, path, provenance)]
    digest = (provenance or Provenance()).digest
    seams = path.with_name(f"{path.stem}.seams.{digest}{path.suffix}")
    with new_layer(seams, provenance) as layer:
        author_header(layer, header, rig)
        for before, after in itertools.pairwise(parts):
            _copy_sample(layer, header, before, before.last_frame)
            _copy_sample(layer, header, after, after.first_frame)
    with new_layer(path, provenance) as layer:
        prim = author_header(layer, header, rig)
        active = []
        for index, part in enumerate(parts, start=1):
            is_last = index == len(parts)
            if part.first_frame < part.last_frame or is_last:
                active.append((part.first_frame, index))
            if not is_last:
                active.append((part.last_frame, 0))
        files = [seams, *(part.file for part in parts)]
        ends = (header.first_frame, header.last_frame)
        author_clips(prim, CLIP_SET, files, seams, active=active, ends=ends, path=path)


def _playable_parts(part: ClipPart, path: Path, provenance: Provenance | None) -> list[ClipPart]:
    """Return the layers to play for a part: itself, or copies of its parts.

    USD does not support nested clips. Copies, since the part's layers are removed when it is mapped
    again.
    """
    inner = _inner_parts(part)
    if inner == [part]:
        return inner
    own = []
    for each in inner:
        file = part_path(path, each.first_frame, each.last_frame, provenance)
        with replacing(file) as temporary:
            shutil.copyfile(each.file, temporary)
        own.append(replace(each, file=file))
    return own


def _inner_parts(part: ClipPart) -> list[ClipPart]:
    """Return the parts that a part plays as clips, or the part itself."""
    stage = open_stage(part.file)
    clips = Usd.ClipsAPI(stage.GetPrimAtPath(part.animation))
    parts = []
    for asset in list(clips.GetClipAssetPaths(CLIP_SET) or ())[1:]:  # the first has the seams
        file = part.file.parent / asset.path
        inner = open_layer(file)
        first, last = round(inner.startTimeCode), round(inner.endTimeCode)
        parts.append(ClipPart(file, first, last, str(clips.GetClipPrimPath(CLIP_SET))))
    return parts or [part]


def _copy_sample(layer: Sdf.Layer, header: WeightsHeader, part: ClipPart, frame: int) -> None:
    source = open_layer(part.file)
    for name in (WEIGHTS, *FIGURES):
        value = source.QueryTimeSample(Sdf.Path(part.animation).AppendProperty(name), frame)
        if value is not None:
            layer.SetTimeSample(header.animation.AppendProperty(name), frame, value)
        elif name == WEIGHTS:
            raise InputError(f"{part.file} frame {frame}: has no weights; map that part again")
