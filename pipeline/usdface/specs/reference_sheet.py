"""What `usdface references sheet` is told."""

from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from usdface.specs.base import FilePath, Frames, ImageOut, Positional, Reads, Spec


class ReferenceSheetSpec(Spec):
    """Draw the references for an animator to work from, on a screen or on paper.

    Each pair: the video frame, the markers and the rig at its present weights, with viseme,
    emotion, frame and the strongest weights.
    """

    example: ClassVar[str] = (
        "usdface references sheet hero.references.usda --takes kitchen.clean.take.usda "
        "--paper --out hero.references.jpg"
    )

    step: Literal["references-sheet"] = "references-sheet"
    references: Annotated[FilePath, Reads(), Positional()]
    """The references asset."""
    takes: Annotated[tuple[Path, ...], Reads()] = ()
    """The takes it was selected from: without them there is no video and no timecode."""
    out: ImageOut
    """The picture: .jpg, .png or .exr."""
    pairs: Frames | None = None
    """Show these pairs only, as FIRST-LAST; a page of paper holds some 24."""
    paper: bool = False
    """Dark on white, to be printed, with room to write."""
    tile: Annotated[int, Field(ge=64, le=2048)] = 280
    """Height of a picture in pixels."""
    quality: Literal["draft", "final"] = "final"
    """Draft leaves out soft shadows and occlusion."""
