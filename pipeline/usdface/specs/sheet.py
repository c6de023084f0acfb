"""What `usdface sheet` is told."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from usdface.specs.base import (
    FilePath,
    Frames,
    ImageOut,
    Positional,
    ReadPath,
    Reads,
    Spec,
)


class SheetSpec(Spec):
    """Draw a contact sheet to judge a performance by.

    Each row: the video frame, the markers, the equation-solving baseline (Deng et al. 2006, eq. 7)
    and the performance, with frame, timecode and error.
    """

    example: ClassVar[str] = (
        "usdface sheet kitchen.hero.usda --take kitchen.clean.take.usda --out kitchen.sheet.jpg"
    )

    step: Literal["sheet"] = "sheet"
    performance: Annotated[FilePath, Reads(), Positional()]
    """The performance to show."""
    take: ReadPath
    """The cleaned take it was mapped from."""
    out: ImageOut
    """The picture: .jpg, .png or .exr."""
    rows: Annotated[int, Field(ge=1, le=400)] = 12
    """How many frames to show."""
    frames: Frames | None = None
    """Choose from these frames only, as FIRST-LAST."""
    against: ReadPath | None = None
    """What the weights should have been (.csv, .json or .usd): errors are measured against it."""
    tile: Annotated[int, Field(ge=64, le=2048)] = 320
    """Height of a picture in pixels."""
    quality: Literal["draft", "final"] = "final"
    """Draft leaves out soft shadows and occlusion."""
    baseline: bool = True
    """Show the equation-solving baseline."""
