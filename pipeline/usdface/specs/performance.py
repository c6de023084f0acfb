"""Specs of performances: train, map, join."""

from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from usdface.specs.base import (
    Device,
    FilePath,
    Frames,
    LayerOut,
    Name,
    Positional,
    PrimPath,
    ReadPath,
    Reads,
    Spec,
)


class TrainSpec(Spec):
    """Learn the mapping from markers to the rig's weights.

    `auto` tries every method on references it has not seen and keeps the best; the table of what
    was tried is kept in the mapping (`usdface describe`).
    """

    example: ClassVar[str] = "usdface train hero.references.usda --out hero.mapping.usdc"
    module: ClassVar[str] = "performance.train"

    step: Literal["train"] = "train"
    references: Annotated[FilePath, Reads(), Positional()]
    """The references asset, tuned."""
    out: LayerOut
    """The mapping to write."""
    method: Name = "auto"
    """The regression, or `auto`."""
    dimensions: Annotated[int, Field(ge=1, le=1000)] | None = None
    """Principal components to keep; chosen by cross-validation by default."""
    tuned_only: bool = False
    """Leave pairs out that nobody has tuned; by default proposals are learned from as well."""


class MapSpec(Spec):
    """Turn a cleaned take into BlendShape weights on a rig.

    Writes NAME.usda to open, and NAME.weights.usdc, which holds only the animation and the overs
    that point the rig at it. The rig is referenced, never written.
    """

    example: ClassVar[str] = (
        "usdface map kitchen.clean.take.usda --mapping hero.mapping.usdc --rig hero.usd "
        "--out kitchen.hero.usda"
    )
    module: ClassVar[str] = "performance.map"

    step: Literal["map"] = "map"
    take: Annotated[FilePath, Reads(), Positional()]
    """The cleaned take."""
    mapping: ReadPath
    """The trained mapping."""
    rig: ReadPath
    """The character."""
    out: LayerOut
    """The performance to open."""
    prim: PrimPath | None = None
    """Where the rig is put in the performance; its own default prim's name by default."""
    rig_prim: PrimPath | None = None
    """The face in the rig's file, where it holds several."""
    frames: Frames | None = None
    """Map these frames only, as FIRST-LAST; what a frame becomes does not depend on it."""
    alpha: ReadPath | None = None
    """Share of the multiquadric in a hybrid over time: .csv (frame, alpha), or .usd with a
    time-sampled float `face:mapping:alpha` on any prim."""
    chunk: Annotated[int, Field(ge=1)] | None = None
    """Write the weights in parts of this many frames, played as value clips; by default in one
    layer up to 1 GB."""
    temporal: Literal["none", "whole", "causal", "bands"] = "none"
    """Smooth weights over time within their ranges: every frame by those before and after it
    (`whole`), as for streaming by those before it and `--lag` after (`causal`), or as published by
    a filter bank (`bands`)."""
    cutoff: Annotated[float, Field(gt=0)] | None = None
    """Hz: motion of this frequency is halved by `--temporal`; lower is calmer, below 12 blinks
    lose. At most half the take's rate; by default 20, or 0.4 of the rate where that is less."""
    lag: Annotated[int, Field(ge=0, le=32)] = 2
    """Frames that the causal mode is behind."""
    bands: Annotated[int, Field(ge=1, le=4)] = 1
    """Octaves, from half the rate downwards, that `--temporal bands` leaves out; at 60 frames per
    second a second one costs blinks."""
    device: Device = "cpu"
    """Where weights are predicted, and smoothed by `--temporal whole`: `cpu`, a graphics card as
    `cuda` or `cuda:1` (by torch or cupy, where installed), or `torch`, which is torch on the
    processor. Weights agree to a millionth."""


class JoinSpec(Spec):
    """Make one performance of parts that were mapped apart, as a farm does.

    The parts must follow on one another and be of the same take, rig and mapping; they may be given
    in any order. What is joined equals the performance mapped in one go, value for value.
    """

    example: ClassVar[str] = (
        "usdface join parts/kitchen.1.usda parts/kitchen.2.usda --out kitchen.hero.usda"
    )
    module: ClassVar[str] = "performance.join"

    step: Literal["join"] = "join"
    parts: Annotated[tuple[Path, ...], Field(min_length=1), Reads(), Positional()]
    """Performances, each of some of the frames."""
    out: LayerOut
    """The performance to open."""
    clips: Literal["auto", "always", "never"] = "auto"
    """Whether the parts stay where they are and are played as value clips, or are merged into one
    layer; `auto` merges up to 1 GB."""
