"""Specs of performances: train, map, join."""

from pathlib import Path
from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from usdface.core.sidecars import weights_path
from usdface.specs.base import Drive, MovedRigSpec, Name, NeverWith, OnlyWith, Positional, Spec
from usdface.specs.paths import (
    FilePath,
    Frames,
    ImageOut,
    LayerOut,
    PrimPath,
    ReadPath,
    Reads,
    Several,
)


class TrainSpec(MovedRigSpec):
    """Train the mapping from marker positions to the weights of a rig.

    `auto` cross-validates face_map, ridge, rbf and d06 on the references and keeps face_map, unless
    another has a significantly smaller error. The table of scores is stored in the mapping
    (`usdface describe`).
    """

    example = "usdface train hero.references.usda --out hero.mapping.usdc"
    module = "performance.train"
    cores = 2
    memory_mib = 8192
    never_with: ClassVar[NeverWith] = {"all_pairs": ("tuned_only",)}

    step: Literal["train"] = "train"
    references: Annotated[FilePath, Reads(), Positional()]
    """The tuned references asset."""
    out: LayerOut
    """The mapping to write."""
    method: Name = "auto"
    """Regression method: `auto`, `face_map`, `d06`, `ridge`, `rbf`, `multiquadric`, `kernel_cca`
    or `hybrid`."""
    dimensions: Annotated[tuple[Annotated[int, Field(ge=1, le=1000)], ...], Several] = ()
    """Numbers of principal components among which cross-validation chooses. Default: by method;
    `d06` has the 4 of the paper, `face_map` the first 50 with variance, others compare 8 to 40."""
    widths: Annotated[tuple[Annotated[float, Field(gt=0.0, le=1000.0)], ...], Several] = ()
    """Widths of Gaussian kernels among which cross-validation chooses: multiples of the distance to
    the nearest reference (`d06`, `rbf`) or of the median distance (`kernel_cca`, `hybrid`).
    Default: by method; 2 for `d06`, for which the paper gives no value."""
    picture: ImageOut | None = None
    """Picture to write of the eigen-space: the takes and the references along the first three
    principal components, and the share of variance of each component (.jpg, .png or .exr)."""
    tuned_only: bool = False
    """Train on tuned pairs only, however few they are. Default: if at least 8 pairs are tuned."""
    all_pairs: bool = False
    """Train on proposals as well, even if 8 or more pairs are tuned."""


class MapSpec(Spec):
    """Solve the BlendShape weights of a rig for every frame of a take.

    Writes the performance NAME.usda, the layer to open, and NAME.weights.usdc, which holds only the
    animation and the overs that bind the rig to it. The rig is referenced and does not change.

    With --baseline the blendshape equation is solved instead (Deng et al. 2006, eq. 7): from the
    rig and the take alone, without references or a mapping.
    """

    example = (
        "usdface map kitchen.clean.take.usda --mapping hero.mapping.usdc --rig hero.usd "
        "--out kitchen.hero.usda"
    )
    module = "performance.map"
    makes = "performance"
    sidecars = (weights_path,)
    only_with: ClassVar[OnlyWith] = {
        "cutoff": ("temporal", ("whole", "causal")),
        "lag": ("temporal", ("causal",)),
        "bands": ("temporal", ("bands",)),
        "unlimited": ("baseline", ()),
        "placement": ("baseline", ()),
    }
    never_with: ClassVar[NeverWith] = dict.fromkeys(("alpha", "temporal", "drive"), ("baseline",))

    step: Literal["map"] = "map"
    take: Annotated[FilePath, Reads(), Positional()]
    """The cleaned take."""
    mapping: ReadPath | None = None
    """The trained mapping; needed unless --baseline is given."""
    rig: ReadPath
    """The rig of the character."""
    out: LayerOut
    """The performance to write."""
    baseline: bool = False
    """Solve by least squares on the displacements of the rig's shapes at the markers, within the
    rig's ranges: the baseline of sheets and reports."""
    unlimited: bool = False
    """With --baseline: plain least squares over all markers, as printed in the paper. Weights leave
    the rig's ranges."""
    placement: ReadPath | None = None
    """With --baseline: placement of the markers on the rig, from `usdface place`. Default: the
    markers are placed automatically."""
    prim: PrimPath | None = None
    """Prim path of the rig in the performance. Default: the name of the rig's default prim."""
    rig_prim: PrimPath | None = None
    """Face in the rig's file, if it holds several."""
    frames: Frames | None = None
    """Frames to map, as FIRST-LAST. Default: all. The result of a frame does not depend on this
    range."""
    drive: Drive = ()
    """Joint or Xform of the rig that the take's head motion or gaze drives, as PART=NAME, where
    PART is `head`, `left_eye` or `right_eye`. May be given once per part. Written to
    NAME.head.usdc, above the weights."""
    alpha: ReadPath | None = None
    """Share of the multiquadric in a `hybrid` mapping over time: .csv (frame, alpha), or .usd with
    a time-sampled float `face:mapping:alpha` on any prim."""
    chunk: Annotated[int, Field(ge=1)] | None = None
    """Frames per weights file; the files are played as value clips. Default: one layer, up to 1
    GB."""
    temporal: Literal["none", "whole", "causal", "bands"] = "none"
    """Smooth the weights over time, within the rig's ranges: `whole` uses all frames, `causal`
    earlier frames and --lag later ones (for streaming), `bands` the published filter bank."""
    cutoff: Annotated[float, Field(gt=0)] | None = None
    """Frequency in Hz at which --temporal halves the amplitude; lower is smoother. Below 12 Hz
    blinks lose height. At most half the take's rate. Default: 20, or 0.4 times the rate if that is
    less."""
    lag: Annotated[int, Field(ge=0, le=32)] = 2
    """Frames of delay of the `causal` mode."""
    bands: Annotated[int, Field(ge=1, le=4)] = 1
    """Octaves that --temporal bands removes, from half the take's rate downwards. At 60 frames per
    second a second octave weakens blinks."""

    @model_validator(mode="after")
    def _mapping_or_baseline(self) -> Self:
        if self.baseline == (self.mapping is not None):
            raise ValueError("give --mapping, or --baseline for the blendshape equation; not both")
        return self


class JoinSpec(MovedRigSpec):
    """Join performances of consecutive frame ranges into one.

    The parts must follow on one another and have the same take, rig and mapping; they may be given
    in any order. The result equals the performance mapped in one run, value for value.
    """

    example = "usdface join parts/kitchen.1.usda parts/kitchen.2.usda --out kitchen.hero.usda"
    module = "performance.join"
    makes = "performance"
    sidecars = (weights_path,)

    step: Literal["join"] = "join"
    parts: Annotated[tuple[Path, ...], Field(min_length=1), Reads(), Positional()]
    """Performances, each of a range of frames (`usdface map --frames`)."""
    out: LayerOut
    """The performance to write."""
    clips: Literal["auto", "always", "never"] = "auto"
    """`always` plays the parts where they are, as value clips; `never` merges them into one layer;
    `auto` merges up to 1 GB."""
