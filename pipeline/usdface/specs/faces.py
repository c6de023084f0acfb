"""What `usdface faces` is told."""

from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from usdface.specs.base import Frames, ImageOut, Positional, Reads, Spec


class FacesSpec(Spec):
    """Draw performances of several characters side by side, at the same frames.

    For retargeting and warping: the source, its targets, before and after. Faces are drawn as USD
    poses them, shapes and joints together; the frames are those that differ most.
    """

    example: ClassVar[str] = (
        "usdface faces kitchen.human.usda kitchen.dog.usda kitchen.warped.usda "
        "--out kitchen.faces.jpg"
    )

    step: Literal["faces"] = "faces"
    performances: Annotated[tuple[Path, ...], Field(min_length=1), Reads(), Positional()]
    """Performances, each a column."""
    out: ImageOut
    """The sheet to write."""
    rows: Annotated[int, Field(ge=1, le=100)] = 6
    """How many frames."""
    frames: Frames | None = None
    """Choose from these frames only, as FIRST-LAST."""
    tile: Annotated[int, Field(ge=64, le=2048)] = 320
    """Height of a face [pixels]."""
    yaw: Annotated[float, Field(ge=-90.0, le=90.0)] = 20.0
    """How far the faces are seen from the side [degrees]."""
    quality: Literal["final", "draft"] = "final"
    """How carefully faces are drawn."""
