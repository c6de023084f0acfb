"""What `usdface warp` is told."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from usdface.specs.base import (
    FilePath,
    ImageOut,
    LayerOut,
    Positional,
    ReadPath,
    Reads,
    Spec,
)


class WarpSpec(Spec):
    """Put a target's own sequences into its retargeted performance, smoothly.

    Every control is warped: weights, joints and attributes. Outside the sequences and their blends
    the performance stays as it was, to the last bit.
    """

    example: ClassVar[str] = (
        "usdface warp kitchen.dog.usda --matches kitchen.matches.usda "
        "--out kitchen.warped.usda --curves kitchen.warp.jpg"
    )

    step: Literal["warp"] = "warp"
    performance: Annotated[FilePath, Reads(), Positional()]
    """The target's performance."""
    matches: ReadPath
    """Where the take holds sequences: what `usdface find-sequences` wrote."""
    out: LayerOut
    """The performance to write."""
    weight: Annotated[float, Field(gt=0.0, le=1e9)] = 20.0
    """How firmly the sequences' keys are asked for. With 1, as published, quick changes are half
    the performance's own; with 1000 they are the sequence's alone."""
    blend: Annotated[int, Field(ge=0, le=10_000)] = 12
    """Frames on each side over which the performance passes into a sequence."""
    timing: Literal["own", "fit"] = "own"
    """Play a sequence as long as it was made, from where it was found; or stretch it to fit."""
    outside: Literal["exact", "published"] = "exact"
    """Keep what is outside to the last bit; or by soft constraints of weight 1, as published."""
    curves: ImageOut | None = None
    """Draw the controls that change most, before and after."""
