"""What `usdface align` is told."""

from pathlib import Path
from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from usdface.specs.base import FilePath, ImageOut, Positional, Reads, Spec

LONGEST_SHIFT = 86400.0
"""A day, as timecode has."""


class AlignSpec(Spec):
    """Find where the video lies in the take: shift and clock drift, with a confidence.

    From the sound recorded with the capture and the camera's own; or from timecode, where both
    carry it, checked against the sound. A doubtful result is refused, with the reason and a
    picture of the evidence. The take is changed in place: only what it says of the video.
    """

    example: ClassVar[str] = "usdface align kitchen.take.usda"

    step: Literal["align"] = "align"
    take: Annotated[FilePath, Reads(), Positional()]
    """The take, with a video and the capture's sound (`usdface ingest --video --audio`)."""
    offset: Annotated[float, Field(ge=-LONGEST_SHIFT, le=LONGEST_SHIFT)] | None = None
    """Set the shift by hand: seconds of the take at which the video starts (negative: before)."""
    drift: Annotated[float, Field(ge=-2000.0, le=2000.0)] | None = None
    """With --offset: parts per million by which the camera's clock is slow; 0 by default."""
    by: Literal["auto", "sound", "timecode"] = "auto"
    """What to believe; timecode where both have it and the sound does not contradict, else
    sound."""
    picture: ImageOut | None = None
    """Where the evidence is drawn; beside the take by default."""

    @model_validator(mode="after")
    def _drift_needs_offset(self) -> Self:
        if self.drift is not None and self.offset is None:
            raise ValueError("drift is given without an offset; give --offset too")
        if self.offset is not None and self.by != "auto":
            raise ValueError("offset sets the shift by hand, so --by has nothing to choose")
        return self

    def picture_path(self) -> Path:
        """Return where the picture goes."""
        return self.picture or self.take.with_name(f"{self.take.stem}.align.png")

    def outputs(self) -> tuple[Path, ...]:
        """Return the picture: it is drawn last, and tells that the take has been aligned."""
        return (self.picture_path(),)

    def changes(self) -> tuple[Path, ...]:
        """Return the picture, and the take."""
        return (*self.outputs(), self.take)
