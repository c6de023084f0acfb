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
from usdface.specs.camera import CameraName

SheetLayout = Literal["comparison", "worst", "strip", "characters"]
FramePick = Literal["expression", "residual", "confidence", "jump", "even"]


class SheetSpec(Spec):
    """Draw a contact sheet to judge a performance by.

    Layouts: `comparison` (video, markers, the equation-solving baseline of Deng et al. 2006, eq. 7,
    the performance, and how far it lies from the baseline or the truth), `worst` (frames to look
    at first), `strip` (the whole shot at a glance), `characters` (several from one source).
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
    """The picture: .jpg, .png or .exr; further pages are NAME.2.jpg and so on."""
    layout: SheetLayout = "comparison"
    """What stands side by side."""
    also: tuple[ReadPath, ...] = ()
    """More performances of the same take, on this or other rigs, each a column."""
    pick: FramePick | None = None
    """How frames are chosen: strongest expressions and the worst, by residual, by confidence, by
    jumps between frames, or evenly; by layout if not said."""
    rows: Annotated[int, Field(ge=1, le=10_000)] | None = None
    """How many frames to show: 12, for a strip 48."""
    page_rows: Annotated[int, Field(ge=1, le=400)] = 100
    """Rows on one page."""
    frames: Frames | None = None
    """Choose from these frames only, as FIRST-LAST."""
    against: ReadPath | None = None
    """What the weights should have been (.csv, .json or .usd): errors are measured against it."""
    phones: ReadPath | None = None
    """What is said when (`usdface phones`): rows are labelled with phone and viseme."""
    tile: Annotated[int, Field(ge=64, le=2048)] | None = None
    """Height of a picture in pixels: 320, for a strip 192."""
    quality: Literal["draft", "final"] = "final"
    """Draft leaves out soft shadows and occlusion."""
    baseline: bool = True
    """Show the equation-solving baseline, where the layout has it."""
    difference: bool = True
    """Show where the performance differs from truth or baseline, where the layout has it."""
    camera: CameraName = "auto"
    """What the face is drawn by: `auto` frames it; a prim path is a camera of the stage."""
    camera_stage: ReadPath | None = None
    """The stage that holds the camera, a shot say; the performance's own by default."""
    view: Annotated[str, Field(min_length=1, max_length=200)] | None = None
    """View of the OpenColorIO configuration ($OCIO, else the built-in one) to show renders by, as
    VIEW or DISPLAY/VIEW; plain sRGB by default."""
