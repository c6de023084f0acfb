"""What `usdface make-shapes` is told."""

from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from usdface.specs.base import ImageOut, LayerOut, Name, ReadPath
from usdface.specs.deform import SurfaceSpec

ShapeFrame = Annotated[
    str, Field(pattern=r"^-?\d+(=.+)?$", max_length=200, examples=["120", "120=smile"])
]


class MakeShapesSpec(SurfaceSpec):
    """Make a rig of a mesh that has none: chosen frames of a take become BlendShapes.

    The rig is a new asset that references the mesh: its own file stays as it is. `select`, `train`
    and `map` take the rig as any other.
    """

    example: ClassVar[str] = (
        "usdface make-shapes kitchen.clean.take.usda --mesh scan.usdc "
        "--binding scan.binding.usda --count 8 --out scan.rig.usda"
    )

    step: Literal["make-shapes"] = "make-shapes"
    out: LayerOut
    """The rig."""
    count: Annotated[int, Field(ge=1, le=1000)] = 8
    """How many frames to choose where none are given: those that differ most."""
    shape_frames: tuple[ShapeFrame, ...] = ()
    """Frames to make shapes of, as FRAME or FRAME=NAME,..."""
    names: ReadPath | None = None
    """Frames to make shapes of, from a .csv with the columns frame and name."""
    references: ReadPath | None = None
    """Make shapes of the pairs of a references asset that are of this take, named by viseme or
    emotion where the pairs have one."""
    name: Name = "Face"
    """Name of the rig's top prim."""
    least_mm: Annotated[float, Field(ge=0.0, le=10.0)] = 0.02
    """Points that a shape moves less are left out of it, in millimetres."""
    picture: ImageOut | None = None
    """Draw the shapes (.jpg, .png or .exr)."""

    @model_validator(mode="after")
    def _one_way_to_choose(self) -> Self:
        ways = [bool(self.shape_frames), self.names is not None, self.references is not None]
        if sum(ways) > 1:
            raise ValueError("frames are chosen by one of --shape-frames, --names and --references")
        return self
