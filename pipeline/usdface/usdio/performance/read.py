"""Reading of performances: solve, edits and rig."""

import hashlib
from collections.abc import Mapping, Sequence
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from statistics import NormalDist

import numpy as np
from pxr import Sdf, Usd, UsdSkel

from usdface.core.arrays import BoolArray, Float32Array, FloatArray, IntArray
from usdface.core.assets import Performance, SolveBasis, WeightsClip
from usdface.core.errors import InputError, as_input_error
from usdface.core.rates import exact_rate, label_alike, shift_timecode, span_of_samples
from usdface.core.rig_logic import Combination
from usdface.core.text import first_few, repeated
from usdface.usdio.authoring import (
    names_in,
    read_array_samples,
    read_gaps,
    stated_spec,
    text_of,
    value_of,
)
from usdface.usdio.layers import open_stage, refusing_wrong_types
from usdface.usdio.performance.edits import ShapeEdit, edited_weights, read_edits
from usdface.usdio.performance.weights_layer import (
    ANIMATION,
    CHANGED_SHAPES,
    COVERAGE,
    MOTION_SCALE,
    NEUTRAL_FRAME,
    PAIR_COUNTS,
    RESIDUAL,
    SHAPELESS_REGIONS,
    SOLVE_UNCERTAINTY,
    STILL_REGIONS,
    UNMATCHED,
    UNMATCHED_SHARES,
    UNSEEN_REGIONS,
    SolveFigures,
    WeightsHeader,
)
from usdface.usdio.rig.reference import combinations_of, rig_of, rig_path_of

_CONFIDENCE_RANGE = (0.001, 0.9999)
"""Limits of the confidence of earlier versions: at 0 and 1 the uncertainty would be infinite or 0.
"""

_TIME_ROUNDING = 1e-6
"""[frames] Rounding of time codes by layer offsets."""

_VERSION_STEPS = 5000
"""Steps of a weight of 1 that make different versions: the resolution of a report."""


class PerformanceReader:
    """A performance on disk, whose frames are read on demand.

    Parameters
    ----------
    path : Path
        Any USD file of one face with animated weights.
    animation : Sdf.Path, optional
        The animation, if a file has several for one face.
    prim : str, optional
        The face, or a prim above it, if a file has several.
    """

    @refusing_wrong_types
    def __init__(
        self, path: Path, *, animation: Sdf.Path | None = None, prim: str | None = None
    ) -> None:
        self.path = path
        self.stage = open_stage(path)
        self.animation = (
            _find_animation(self.stage, path, prim)
            if animation is None
            else self.stage.GetPrimAtPath(animation)
        )
        weights = UsdSkel.Animation(self.animation)
        self.names = names_in(weights.GetBlendShapesAttr())
        if twice := repeated(self.names):
            raise InputError(
                f"{path} <{self.animation.GetPath()}>: blendShapes names {first_few(twice)} twice, "
                "so that their weights are ambiguous; name each shape once"
            )
        self._weights = weights.GetBlendShapeWeightsAttr()
        self.first_frame, self.last_frame = span_of_samples(
            f"{path} <{self._weights.GetPath()}>", self._weights.GetTimeSamples()
        )

    @property
    def rate(self) -> Fraction:
        """Frames per second."""
        where = f"{self.path}: timeCodesPerSecond"
        return exact_rate(self.stage.GetTimeCodesPerSecond(), where=where)

    @property
    def frames(self) -> IntArray:
        """Frame numbers, one per sample."""
        return np.arange(self.first_frame, self.last_frame + 1, dtype=np.int64)

    @property
    def files(self) -> tuple[Path, ...]:
        """Layers of the weights, the strongest first: in a shot, those of the performance."""
        stack = self._weights.GetPropertyStack(Usd.TimeCode.EarliestTime())
        return tuple(Path(each.layer.realPath) for each in stack if each.layer.realPath)

    @property
    def _offset(self) -> Sdf.LayerOffset:
        """From the times of the weights' layer to those of the stage."""
        stack = self._weights.GetPropertyStackWithLayerOffsets(Usd.TimeCode.EarliestTime())
        sampled = (offset for spec, offset in stack if spec.HasInfo("timeSamples"))
        return next(sampled, Sdf.LayerOffset())

    @property
    def time_shift(self) -> str:
        """Text on how offsets and rates of layers above move the weights; empty if they do not."""
        if (moved := self._offset).IsIdentity():
            return ""
        scaled = "" if moved.scale == 1 else f" and scales their times by {moved.scale:g}"
        return f"by {moved.offset:+g} frames{scaled}"

    @property
    def timecode_fits(self) -> bool:
        """Whether labels of the capture's timecode count at the stage's rate, too."""
        captured = self.stage.GetTimeCodesPerSecond() / abs(self._offset.scale)
        return label_alike(exact_rate(captured, where=f"{self.path}: layer offset"), self.rate)

    def take_frames_at(self, frames: IntArray) -> IntArray:
        """Return the take's frames, those of the weights' layer, at frames of the stage."""
        times = (frames - self._offset.offset) / self._offset.scale
        if (np.abs(times - np.rint(times)) > _TIME_ROUNDING).any():
            raise InputError(
                f"{self.path}: a layer moves its weights {self.time_shift}, so that its frames lie "
                "between those of the take; move them by whole frames, or edit the performance"
            )
        return np.asarray(np.rint(times), np.int64)

    @property
    def keyed_frames(self) -> frozenset[int]:
        """Frames with a sample of the solve, which is interpolated between them."""
        times = np.round(self._weights.GetTimeSamples())
        return frozenset(times[~self.between_frames].astype(int).tolist())

    @property
    def between_frames(self) -> BoolArray:
        """(samples,): which lie between frames, as of a capture in a stage of fewer frames."""
        times = np.array(self._weights.GetTimeSamples())
        return np.asarray(np.abs(times - np.round(times)) > _TIME_ROUNDING)

    @property
    @refusing_wrong_types
    def regions(self) -> tuple[str, ...]:
        """Names of the regions of uncertainty, coverage and residual."""
        return names_in(self.animation.GetAttribute("face:residual:regions"))

    @property
    @refusing_wrong_types
    def neutral_frame(self) -> int | None:
        """Frame of the performer's neutral face in the take; None if unknown."""
        found = stated_spec(self.animation, NEUTRAL_FRAME)
        return None if found is None else round(found[1] * int(found[0].default))

    @property
    @refusing_wrong_types
    def basis(self) -> SolveBasis | None:
        """Training data of the mapping; None if unknown."""
        counts = value_of(self.animation, PAIR_COUNTS)
        if counts is None or len(counts) != 2:
            return None
        named = (STILL_REGIONS, UNSEEN_REGIONS, CHANGED_SHAPES, SHAPELESS_REGIONS)
        still, unseen, changed, shapeless = (
            names_in(self.animation.GetAttribute(name)) for name in named
        )
        given = value_of(self.animation, MOTION_SCALE)
        scale = 1.0 if given is None else float(given)
        if not 0 < scale < np.inf:
            raise InputError(f"{self.path}: {MOTION_SCALE} is {scale}, not positive; map again")
        return SolveBasis(int(counts[1]), int(counts[0]), still, unseen, changed, shapeless, scale)

    @cached_property
    def version(self) -> str:
        """Digest of the edited weights of all frames."""
        steps = np.round(self.edited() * _VERSION_STEPS).astype("<i4")
        named = hashlib.sha256("\n".join(self.names).encode("utf-8"))
        named.update(f"\n{self.first_frame}\n".encode())
        named.update(np.ascontiguousarray(steps).tobytes())
        return named.hexdigest()[:12]

    @property
    def timecode_start(self) -> str:
        """SMPTE timecode of the first frame; empty if unknown, or if it does not fit the rate."""
        return text_of(self.animation, "face:timecode:start") if self.timecode_fits else ""

    def timecode_at(self, frame: int) -> str:
        """Return the SMPTE timecode of a frame; empty if unknown."""
        with as_input_error(f"{self.path}: face:timecode:start", of=InputError):
            return shift_timecode(self.timecode_start, frame - self.first_frame, self.rate)

    @cached_property
    @refusing_wrong_types
    def edits(self) -> dict[str, ShapeEdit]:
        """Edits by shape, over all frames of the performance."""
        return read_edits(self.animation, self.frames)

    @cached_property
    @refusing_wrong_types
    def combinations(self) -> tuple[Combination, ...]:
        """Combinations of the rig; none without a rig in the stage."""
        return combinations_of(self.stage, self.animation, self.path)

    @property
    def header(self) -> WeightsHeader:
        """The header of a weights layer of the performance."""
        rig_path, path = rig_path_of(self.stage, self.animation), self.animation.GetPath()
        return WeightsHeader(
            rig_path=rig_path,
            shape_names=self.names,
            rate=self.rate,
            first_frame=self.first_frame,
            last_frame=self.last_frame,
            regions=self.regions,
            timecode_start=self.timecode_start,
            name=path.name if path.GetParentPath() == Sdf.Path(rig_path) else ANIMATION,
            neutral_frame=self.neutral_frame,
            basis=self.basis,
            unmatched=names_in(self.animation.GetAttribute(UNMATCHED)),
            unmatched_shares=tuple(value_of(self.animation, UNMATCHED_SHARES) or ()),
            gaps=read_gaps(self.animation),
        )

    def rig(self) -> tuple[Path, str]:
        """Return the file and the SkelRoot of the rig that the performance drives."""
        return rig_of(self.stage, self.animation)

    @refusing_wrong_types
    def solved(self, first: int | None = None, last: int | None = None) -> Float32Array:
        """Return the weights as they were solved, (frames, shapes) float32."""
        remedy = "map again" if self.animation.HasAPI("FaceSolveAPI") else "export the file again"
        frames = self._between(first, last)
        return read_array_samples(
            self.path, self._weights, frames, self.names, kind=np.float32, remedy=remedy
        )

    def _between(self, first: int | None, last: int | None) -> range:
        """Return the frames from one to another, inclusive; by default from or to an end."""
        start = self.first_frame if first is None else first
        return range(start, (self.last_frame if last is None else last) + 1)

    def edited(
        self,
        first: int | None = None,
        last: int | None = None,
        *,
        ranges: Mapping[str, Sequence[float]] | None = None,
    ) -> Float32Array:
        """Return the weights with edits, (frames, shapes) float32.

        `ranges`: to which edited frames are limited.
        """
        values = self.solved(first, last)
        if not self.edits:
            return values
        start = self._between(first, last).start - self.first_frame
        part = slice(start, start + len(values))
        edits = {name: edit.during(part) for name, edit in self.edits.items()}
        made = edited_weights(
            self.names, values, edits, ranges=ranges, combinations=self.combinations
        )
        return made.astype(np.float32)

    @refusing_wrong_types
    def series(self, name: str, first: int, last: int) -> FloatArray | None:
        """Return a figure of the animation at frames, (frames, regions) or (frames,), or None."""
        attribute = self.animation.GetAttribute(name)
        if not attribute or not attribute.GetNumTimeSamples():
            return None
        query = Usd.AttributeQuery(attribute)
        values = np.array(
            [np.array(query.Get(frame)) for frame in range(first, last + 1)], np.float64
        )
        if values.ndim > 1 and values.shape[1] not in (1, len(self.regions)):
            raise InputError(
                f"{self.path} <{attribute.GetPath()}>: {values.shape[1]} values a frame, "
                f"but {len(self.regions)} names in face:residual:regions; map again"
            )
        return values

    def _uncertainty_mm(self, first: int, last: int) -> FloatArray | None:
        """Return the uncertainty at frames: (frames, regions), or of the face alone (frames, 1).

        Layers of earlier versions have a confidence c, the probability of an error below 1 mm, that
        of a normal distribution with the standard deviation ``1 / Phi^-1((1 + c) / 2)``.
        """
        uncertainty = self.series(SOLVE_UNCERTAINTY, first, last)
        if uncertainty is not None:
            return uncertainty
        confidence = self.series("face:confidence", first, last)
        if confidence is None:
            return None
        inside = np.clip(confidence, *_CONFIDENCE_RANGE)
        quantile = NormalDist().inv_cdf
        return np.array([[1 / quantile((1 + each) / 2)] for each in inside.tolist()])

    def figures(self, first: int | None = None, last: int | None = None) -> SolveFigures:
        """Return the figures of the solve at frames, by default all.

        Layers of earlier versions, without coverage, have another quantity as residual: None.
        """
        first = self.first_frame if first is None else first
        last = self.last_frame if last is None else last
        coverage = self.series(COVERAGE, first, last)
        residual = None if coverage is None else self.series(RESIDUAL, first, last)
        return SolveFigures(self._uncertainty_mm(first, last), coverage, residual)


def _find_animation(stage: Usd.Stage, path: Path, prim: str | None) -> Usd.Prim:
    """Return the only animation with weights over time that a skeleton follows, below a prim."""
    top = Sdf.Path(prim or "/")
    found = animations_of_skeletons(stage, below=top)
    if not found:
        found = {
            str(each.GetPath()): each
            for each in stage.TraverseAll()  # a layer of weights alone has only overs above
            if each.GetPath().HasPrefix(top)
            and each.IsA(UsdSkel.Animation)
            and _has_weight_samples(each)
        }
    if not found:
        more = (
            f" at or below <{prim}>; check --prim"
            if prim
            else "; give a performance, or export one"
        )
        raise InputError(f"{path}: no active SkelAnimation with blendShapeWeights over time{more}")
    if len(found) > 1:
        raise InputError(
            f"{path}: {len(found)} animations with blendShapeWeights, {', '.join(found)}; "
            "open one face at a time (`edit`, `edits`, `bake` and `package` take --prim)"
        )
    return next(iter(found.values()))


def animations_of_skeletons(
    stage: Usd.Stage, *, below: Sdf.Path = Sdf.Path.absoluteRootPath
) -> dict[str, Usd.Prim]:
    """Return the animations with weights over time that skeletons of a stage follow, by path."""
    animations: dict[str, Usd.Prim] = {}
    for prim in stage.Traverse(Usd.TraverseInstanceProxies()):
        if prim.IsA(UsdSkel.Skeleton) and prim.GetPath().HasPrefix(below):
            source = UsdSkel.BindingAPI(prim).GetInheritedAnimationSource()
            if source and _has_weight_samples(source):
                animations[str(source.GetPath())] = source
    return animations


def read_solves(path: Path) -> list[PerformanceReader]:
    """Return readers of the solves that skeletons of a layer follow."""
    stage = open_stage(path)
    return [
        PerformanceReader(path, animation=animation.GetPath())
        for animation in animations_of_skeletons(stage).values()
        if animation.HasAPI("FaceSolveAPI")
    ]


def read_performance(path: Path) -> Performance:
    """Read a performance with edits."""
    return performance_of(PerformanceReader(path))


def performance_of(reader: PerformanceReader) -> Performance:
    """Return an open performance with edits."""
    rig_file, rig_prim = reader.rig()
    uncertainty_mm, coverage, residual_mm = reader.figures()
    return Performance(
        weights=WeightsClip(reader.names, reader.edited(), reader.first_frame, reader.rate),
        rig_file=rig_file,
        rig_prim=rig_prim,
        uncertainty_mm=uncertainty_mm,
        coverage=coverage,
        residual_mm=residual_mm,
        regions=reader.regions,
        basis=reader.basis,
        timecode_start=reader.timecode_start,
        neutral_frame=reader.neutral_frame,
    )


def _has_weight_samples(prim: Usd.Prim) -> bool:
    attribute = UsdSkel.Animation(prim).GetBlendShapeWeightsAttr()
    return prim.IsActive() and bool(attribute) and attribute.GetNumTimeSamples() > 0
