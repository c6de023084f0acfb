"""What `usdface make-sequence` and `usdface find-sequences` are told."""

from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, field_validator, model_validator

from usdface.specs.base import (
    FilePath,
    Frames,
    LayerOut,
    Name,
    Positional,
    ReadPath,
    Reads,
    Spec,
)


class MakeSequenceSpec(Spec):
    """Tie a stretch of a source's motion to what the target does in its place.

    The two may differ in length and timing; only what they mean must be the same.
    """

    example: ClassVar[str] = (
        "usdface make-sequence --source surprise.take.usda --source-frames 120-190 "
        "--target dog_surprise.usda --label surprise --out surprise.sequence.usda"
    )

    step: Literal["make-sequence"] = "make-sequence"
    source: ReadPath
    """A take with source weights, or a performance of the source."""
    target: ReadPath
    """An animation of the target, as an animator made it."""
    out: LayerOut
    """The sequence to write."""
    label: Name
    """The emotion."""
    source_frames: Frames | None = None
    """The stretch of the source, as FIRST-LAST; all of it by default."""
    target_frames: Frames | None = None
    """The stretch of the target, as FIRST-LAST; all of it by default."""
    attributes: tuple[Name, ...] = ()
    """Float attributes of the target that the sequence holds, as PRIM.ATTRIBUTE."""


class FindSequencesSpec(Spec):
    """Find where a source performance holds emotional sequences.

    By similarity (the default), a place counts when it is nearer than half of what the best face
    held still would reach; no threshold to tune. The result is a list to look through: deactivate
    a match, or move it, before warping.
    """

    example: ClassVar[str] = (
        "usdface find-sequences kitchen.take.usda --sequence surprise.sequence.usda "
        "--out kitchen.matches.usda"
    )

    step: Literal["find-sequences"] = "find-sequences"
    source: Annotated[FilePath, Reads(), Positional()]
    """A take with source weights, or a performance of the source."""
    sequence: Annotated[tuple[FilePath, ...], Field(min_length=1), Reads()]
    """A sequence to look for; may be given several times."""
    out: LayerOut
    """The list of places to write."""
    by: Literal["similarity", "threshold", "label"] = "similarity"
    """similarity; threshold, as published; or label: the nearest place of each sequence whose
    emotion is the take's, however near, for the label vouches that it is there."""
    threshold: Annotated[float, Field(gt=0.0)] | None = None
    """Mean difference that is allowed, in weights, whatever the sequence's length and channels."""
    label: Name | None = None
    """Look only for sequences of this emotion; with --by label, instead of the take's own."""
    shapes: tuple[Name, ...] = ()
    """Compare these source shapes only; * stands for anything."""
    frames: Frames | None = None
    """Look in these frames only, as FIRST-LAST."""

    @field_validator("sequence", mode="before")
    @classmethod
    def _one_or_several(cls, given: Any) -> Any:
        return (given,) if isinstance(given, str | Path) else given

    @model_validator(mode="after")
    def _threshold_where_it_counts(self) -> Self:
        if (self.by == "threshold") != (self.threshold is not None):
            raise ValueError("--by threshold and --threshold go together; give both or neither")
        return self
