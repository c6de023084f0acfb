"""A layer of weights over time: a SkelAnimation, and overs that bind a rig's skeletons to it."""

import contextlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import NamedTuple

import numpy as np
from pxr import Sdf, Usd, Vt

from usdface.core.arrays import Float32Array, FloatArray, IntArray, RealArray, index_of
from usdface.core.assets import Rig, SolveBasis
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.core.rig_logic import Combination, logic_of
from usdface.numerics.motion.key_reduction import sparse_rows
from usdface.usdio.authoring import (
    apply_api,
    author_gaps,
    author_timing,
    author_uniform,
    define_prim,
    top_path,
)
from usdface.usdio.layers import (
    FRAMES_IN_MEMORY,
    VALUES_IN_MEMORY,
    author_provenance,
    new_layer,
    open_stage,
    save_layer,
)
from usdface.usdio.rig.read import faces_below
from usdface.usdio.rig.reference import point_skeletons_at
from usdface.usdio.units import author_units

ANIMATION = "FaceSolve"
"""Name of the animation prim, a child of the referenced rig."""
VARIANT_SET = "take"

WEIGHTS = "blendShapeWeights"
SOLVE_UNCERTAINTY = "face:uncertainty"
COVERAGE = "face:coverage"
RESIDUAL = "face:residual"
FIGURES = (SOLVE_UNCERTAINTY, COVERAGE, RESIDUAL)
"""Sampled with the weights, per region."""

PAIR_COUNTS = "face:solve:references"
STILL_REGIONS = "face:solve:stillRegions"
UNSEEN_REGIONS = "face:solve:unseenRegions"
CHANGED_SHAPES = "face:solve:changedShapes"
SHAPELESS_REGIONS = "face:solve:shapelessRegions"
MOTION_SCALE = "face:solve:motionScale"
NEUTRAL_FRAME = "face:solve:neutralFrame"
UNMATCHED = "face:source:unmatched"
UNMATCHED_SHARES = "face:source:unmatchedShares"

COPY_FRAMES = 4096
"""Frames whose samples are in memory at once when they are copied."""

SAMPLE_TOLERANCE_MM = 0.01
"""Error of `FIGURES` up to which samples are left out, as USD interpolates linearly and a sample
takes as long as a frame of weights. Weights are all written."""

COVERAGE_TOLERANCE = 0.002
"""The same of coverage, which has no unit."""


class SolveFigures(NamedTuple):
    """Figures of a solve by frame, (frames, regions) float arrays, in the order of `FIGURES`."""

    uncertainty_mm: FloatArray | None = None
    coverage: FloatArray | None = None
    """[0-1]"""
    residual_mm: FloatArray | None = None

    def rows(self, rows: slice) -> "SolveFigures":
        """Return the figures of some frames."""
        return SolveFigures(*(None if each is None else each[rows] for each in self))


NO_FIGURES = SolveFigures()


@dataclass(frozen=True)
class WeightsHeader:
    """Contents of a weights layer without its samples."""

    rig_path: str
    """Prim path of the rig in the performance."""
    shape_names: tuple[str, ...]
    """Order of the weights."""
    rate: Fraction
    """Frames per second."""
    first_frame: int
    last_frame: int
    """`first_frame`, `last_frame`: Inclusive."""
    regions: tuple[str, ...] = ()
    """Names of the regions of `FIGURES`."""
    timecode_start: str = ""
    """SMPTE timecode of the first frame, empty if unknown."""
    name: str = ANIMATION
    """Of the animation prim."""
    neutral_frame: int | None = None
    """Frame of the performer's neutral face in the take."""
    basis: SolveBasis | None = None
    """Training data of the mapping."""
    unmatched: tuple[str, ...] = ()
    """Shapes that move in the source of a retargeting and drive nothing."""
    unmatched_shares: tuple[float, ...] = ()
    """Of each, in the motion of the source's face [0-1]; empty if a person chose the pairs."""
    gaps: tuple[tuple[int, int], ...] = ()
    """First and last frame of stretches of a retargeting's source without a capture."""
    zeroed_shapes: tuple[str, ...] = ()
    """Shapes written at 0, as joints have the same effect."""
    combinations: tuple[Combination, ...] = ()
    """Written after the shapes that drive them."""

    @property
    def written_names(self) -> tuple[str, ...]:
        """Order of the samples."""
        driven = [each.shape for each in self.combinations]
        return (*(name for name in self.shape_names if name not in driven), *driven)

    @property
    def animation(self) -> Sdf.Path:
        """Path of the animation prim."""
        return Sdf.Path(self.rig_path).AppendChild(self.name)

    @property
    def frame_count(self) -> int:
        """Number of frames, first and last included."""
        return self.last_frame - self.first_frame + 1


class WeightsWriter:
    """Appends solved frames to a weights layer; made by `writing_weights`.

    Parameters
    ----------
    path : Path
        Final path of the layer, for messages.
    layer : Sdf.Layer
        With its header, from `author_header`.
    """

    def __init__(self, path: Path, layer: Sdf.Layer, header: WeightsHeader) -> None:
        self._path = path
        self._layer = layer
        self._weights = header.animation.AppendProperty(WEIGHTS)
        self._figures = [header.animation.AppendProperty(name) for name in FIGURES]
        self._save_frames = min(
            FRAMES_IN_MEMORY, VALUES_IN_MEMORY // max(len(header.written_names), 1) + 1
        )
        self._unsaved = 0
        self._header = header
        names = index_of(header.shape_names)
        self._zeroed = [names[name] for name in header.zeroed_shapes if name in names]
        self._logic = logic_of(header.shape_names, header.combinations)
        self.next_frame = header.first_frame

    def append(
        self,
        weights: FloatArray | Float32Array,
        figures: SolveFigures = NO_FIGURES,
        *,
        keys: IntArray | None = None,
    ) -> None:
        """Append frames.

        Parameters
        ----------
        weights : (frames, shapes) float array
            Of the first shapes of the header; the others are 0.
        keys : (keys,) int array, optional
            Rows whose weights are written; by default all.
        """
        wanted = np.full(len(weights), keys is None)
        if keys is not None:
            wanted[keys] = True
        rest = len(self._header.shape_names) - weights.shape[1]
        for start in range(0, len(weights), self._save_frames):
            part = slice(start, start + self._save_frames)
            rows: RealArray = np.pad(weights[part], ((0, 0), (0, rest)))
            rows[:, self._zeroed] = 0.0
            if self._logic is not None:
                rows = self._logic.complete(rows, self._header.shape_names)
            self._append_block(
                np.ascontiguousarray(rows, dtype=np.float32),
                [
                    (
                        path,
                        np.ascontiguousarray(values[part], dtype=np.float32),
                        COVERAGE_TOLERANCE if path.name == COVERAGE else SAMPLE_TOLERANCE_MM,
                    )
                    for path, values in zip(self._figures, figures, strict=True)
                    if values is not None
                ],
                np.flatnonzero(wanted[part]),
            )

    def _append_block(
        self,
        rows: Float32Array,
        figures: list[tuple[Sdf.Path, Float32Array, float]],
        keys: IntArray,
    ) -> None:
        # Writing samples dominates the time of mapping with a fast regression: names are looked up
        # once, and change notices are blocked.
        write, array, first = self._layer.SetTimeSample, Vt.FloatArray.FromNumpy, self.next_frame
        with Sdf.ChangeBlock():
            for index in keys.tolist():
                write(self._weights, first + index, array(rows[index]))
            for path, values, tolerance in figures:
                for index in sparse_rows(values, tolerance).tolist():
                    write(path, first + index, array(values[index]))
        self._count(len(rows))

    def copy(
        self,
        animation: Usd.Prim,
        first: int,
        last: int,
        *,
        copied_to: Callable[[int], None] = lambda frame: None,
    ) -> None:
        """Append the samples of frames of an animation of the same shapes.

        `copied_to`: called with the last frame of every block.
        """
        write, block = self._layer.SetTimeSample, min(self._save_frames, COPY_FRAMES)
        copied = []
        for path in (self._weights, *self._figures):
            attribute = animation.GetAttribute(path.name)
            if attribute:  # USD searches all times for every interval
                times = np.array(attribute.GetTimeSamples())
                copied.append((path, Usd.AttributeQuery(attribute), times))
        for start in range(first, last + 1, block):
            stop = min(start + block, last + 1)
            with Sdf.ChangeBlock():
                for path, query, sampled in copied:
                    inside = sampled[slice(*np.searchsorted(sampled, (start, stop)))].tolist()
                    values = [query.Get(time) for time in inside]
                    if path == self._weights:
                        self._check_samples(animation, values, stop - start)
                    for time, value in zip(inside, values, strict=True):
                        write(path, time, value)
            self._count(stop - start)
            copied_to(stop - 1)

    def _check_samples(self, animation: Usd.Prim, values: list[Vt.FloatArray], frames: int) -> None:
        sizes = set(map(len, values))
        shapes = len(self._header.written_names)
        if len(values) != frames or sizes != {shapes}:
            raise InputError(
                f"<{animation.GetPath()}> from frame {self.next_frame}: {len(values)} samples of "
                f"{', '.join(map(str, sorted(sizes)))} weights where {frames} of {shapes} "
                "are needed; map that part again"
            )

    def _count(self, frames: int) -> None:
        self.next_frame += frames
        self._unsaved += frames
        if self._unsaved >= self._save_frames:
            save_layer(self._layer, self._path)  # frees the memory of samples in a binary layer
            self._unsaved = 0


@contextlib.contextmanager
def writing_weights(
    path: Path, header: WeightsHeader, rig: Rig, *, provenance: Provenance | None = None
) -> Iterator[WeightsWriter]:
    """Write a weights layer frame by frame, which replaces the file if the block succeeds.

    `InputError` if the file cannot be written, or the rig's skeletons cannot be pointed at the
    animation; `ValueError` if other frames were appended than those of the header.
    """
    with new_layer(path) as layer:
        # By way of text, so that the order of tokens is deterministic.
        written, parsed = Sdf.Layer.CreateAnonymous(), Sdf.Layer.CreateAnonymous()
        author_header(written, header, rig)
        author_provenance(written, provenance)
        parsed.ImportFromString(written.ExportToString())
        layer.TransferContent(parsed)
        writer = WeightsWriter(path, layer, header)
        yield writer
        if writer.next_frame != header.last_frame + 1:
            raise ValueError(
                f"{path}: {writer.next_frame - header.first_frame} frames were appended where "
                f"{header.frame_count} were announced"
            )


def animation_name(rig: Rig) -> str:
    """Return the name of a rig's animation prim.

    Faces of one file have one parent prim, below which their animations need different names.
    """
    path = Sdf.Path(rig.prim)
    if path.pathElementCount == 1:
        return ANIMATION
    top = top_path(path)
    stage = open_stage(rig.file)
    if len(faces_below(stage.GetPrimAtPath(top))) < 2:
        return ANIMATION
    return "_".join([ANIMATION, *str(path.MakeRelativePath(top)).split("/")])


def make_header(
    rig: Rig,
    *,
    shape_names: tuple[str, ...],
    rate: Fraction,
    first_frame: int,
    last_frame: int,
    rig_path: str | None = None,
    regions: tuple[str, ...] = (),
    timecode_start: str = "",
) -> WeightsHeader:
    """Return the header of weights that drive a rig; other fields as in `WeightsHeader`.

    `rig`: determines the name of the animation prim, and the default of `rig_path`.
    """
    return WeightsHeader(
        rig_path=rig_path or str(top_path(rig.prim)),
        shape_names=shape_names,
        rate=rate,
        first_frame=first_frame,
        last_frame=last_frame,
        regions=regions,
        timecode_start=timecode_start,
        name=animation_name(rig),
        combinations=rig.combinations,
    )


def append_rig_shapes(names: Iterable[str], rig: Rig) -> tuple[str, ...]:
    """Return shapes, followed by all others of the rig.

    Importers that match shapes by order (Maya's) need all of them.
    """
    return tuple(dict.fromkeys((*names, *rig.shapes)))


def author_layer_metadata(layer: Sdf.Layer, header: WeightsHeader, rig: Rig) -> None:
    """Set units, timing and the default prim of a layer of a performance."""
    author_units(layer, like=rig.file)
    author_timing(layer, rate=header.rate, first=header.first_frame, last=header.last_frame)
    layer.defaultPrim = top_path(header.rig_path).name


def author_header(layer: Sdf.Layer, header: WeightsHeader, rig: Rig) -> Sdf.PrimSpec:
    """Write all of a weights layer but its samples; return the animation prim."""
    author_layer_metadata(layer, header, rig)
    prim = define_prim(layer, header.animation, "SkelAnimation")
    apply_api(prim, "FaceSolveAPI")
    tokens = Sdf.ValueTypeNames.TokenArray
    author_uniform(prim, "blendShapes", tokens, list(header.written_names))
    Sdf.AttributeSpec(prim, WEIGHTS, Sdf.ValueTypeNames.FloatArray)
    if header.regions:
        for name in FIGURES:
            Sdf.AttributeSpec(prim, name, Sdf.ValueTypeNames.FloatArray)
        author_uniform(prim, "face:residual:regions", tokens, list(header.regions))
    if header.neutral_frame is not None:
        author_uniform(prim, NEUTRAL_FRAME, Sdf.ValueTypeNames.Int, header.neutral_frame)
    if header.basis is not None:
        counts = Vt.IntArray([header.basis.tuned, header.basis.pairs])
        author_uniform(prim, PAIR_COUNTS, Sdf.ValueTypeNames.IntArray, counts)
        author_uniform(prim, STILL_REGIONS, tokens, list(header.basis.still_regions))
        author_uniform(prim, UNSEEN_REGIONS, tokens, list(header.basis.regions_without_markers))
        author_uniform(prim, CHANGED_SHAPES, tokens, list(header.basis.changed_shapes))
        if header.basis.regions_without_shapes:
            shapeless = list(header.basis.regions_without_shapes)
            author_uniform(prim, SHAPELESS_REGIONS, tokens, shapeless)
        author_uniform(prim, MOTION_SCALE, Sdf.ValueTypeNames.Double, header.basis.motion_scale)
    if header.unmatched:
        author_uniform(prim, UNMATCHED, tokens, list(header.unmatched))
    if header.unmatched_shares:
        shares = Vt.FloatArray(header.unmatched_shares)
        author_uniform(prim, UNMATCHED_SHARES, Sdf.ValueTypeNames.FloatArray, shares)
    author_gaps(prim, header.gaps)
    if header.timecode_start:
        text = Sdf.ValueTypeNames.String
        author_uniform(prim, "face:timecode:start", text, header.timecode_start)
    point_skeletons_at(layer, header.rig_path, rig, header.animation)
    return prim
