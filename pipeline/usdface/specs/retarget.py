"""What `usdface retarget` is told."""

from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, field_validator, model_validator

from usdface.specs.base import (
    FilePath,
    Frames,
    LayerOut,
    Positional,
    PrimPath,
    ReadPath,
    Reads,
    Spec,
)


class RetargetSpec(Spec):
    """Let one performance drive any number of other characters.

    Each gets a performance of its own: weights, joints and attributes alike, over its rig, which is
    referenced and never written. --retargeting and --out are given once for each target.
    """

    example: ClassVar[str] = (
        "usdface retarget kitchen.take.usda --retargeting human_dog.retarget.usdc "
        "--out kitchen.dog.usda"
    )

    step: Literal["retarget"] = "retarget"
    source: Annotated[FilePath, Reads(), Positional()]
    """Source weights: a take that carries them (Live Link), or a performance."""
    retargeting: Annotated[tuple[FilePath, ...], Field(min_length=1), Reads()]
    """What `usdface train-retarget` wrote, one for each target."""
    out: Annotated[tuple[LayerOut, ...], Field(min_length=1)]
    """The performances to open, one for each target."""
    rig: Annotated[tuple[FilePath, ...], Reads()] = ()
    """The targets, where they are no longer where they were at training."""
    prim: PrimPath | None = None
    """Where the rig is put in its performance; its own default prim's name by default."""
    alpha: ReadPath | None = None
    """Share of the multiquadric in a hybrid over time: .csv (frame, alpha), or .usd with a
    time-sampled float `face:mapping:alpha` on any prim."""
    frames: Frames | None = None
    """Retarget these frames only, as FIRST-LAST."""

    @field_validator("retargeting", "out", "rig", mode="before")
    @classmethod
    def _one_or_several(cls, given: Any) -> Any:
        return (given,) if isinstance(given, str | Path) else given

    @model_validator(mode="after")
    def _one_of_each(self) -> Self:
        if len(self.out) != len(self.retargeting) or len(self.rig) not in (0, len(self.out)):
            raise ValueError(
                f"{len(self.retargeting)} retargetings, {len(self.out)} outputs and "
                f"{len(self.rig)} rigs; give one of each for every target, or no rig at all"
            )
        return self
