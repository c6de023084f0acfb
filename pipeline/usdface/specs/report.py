"""What `usdface report` is told."""

from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import AfterValidator, Field

from usdface.specs.base import FilePath, Frames, Positional, ReadPath, Reads, Spec, WritePath
from usdface.specs.camera import CameraName

PAGE_SUFFIXES = (".html", ".htm")


def _page(path: Path) -> Path:
    if path.suffix.lower() not in PAGE_SUFFIXES:
        raise ValueError(f"a page is written, so the name must end in {', '.join(PAGE_SUFFIXES)}")
    return path


class ReportSpec(Spec):
    """Make one HTML file to judge a performance by; it opens from disk, without a network.

    The face turns and plays in the page, in step with the video; curves of every shape, where the
    result is doubtful, what was repaired and where all of it came from.
    """

    example: ClassVar[str] = (
        "usdface report kitchen.hero.usda --take kitchen.clean.take.usda --out kitchen.html"
    )

    step: Literal["report"] = "report"
    performance: Annotated[FilePath, Reads(), Positional()]
    """The performance to show."""
    take: ReadPath
    """The cleaned take it was mapped from."""
    out: Annotated[WritePath, AfterValidator(_page)]
    """The page: .html."""
    frames: Frames | None = None
    """Show these frames only, as FIRST-LAST."""
    against: ReadPath | None = None
    """What the weights should have been (.csv, .json or .usd): the page tells the errors."""
    phones: ReadPath | None = None
    """What is said when in this take (`usdface phones`): the page tells phone and viseme."""
    sheet: ReadPath | None = None
    """A contact sheet to put into the page (.jpg or .png)."""
    references: ReadPath | None = None
    """References to tell the coverage of; those that the mapping was trained on by default, where
    they are still there."""
    baseline: bool = True
    """Draw the equation-solving baseline's curves too."""
    camera: CameraName = "auto"
    """What the face is first seen by: `auto` frames it; a prim path is a camera of the stage."""
    camera_stage: ReadPath | None = None
    """The stage that holds the camera, a shot say; the performance's own by default."""
    height: Annotated[int, Field(ge=120, le=1080)] = 360
    """Height of the video in the page, in pixels."""
    worst: Annotated[int, Field(ge=1, le=100)] = 12
    """How many frames to look at first are listed."""
