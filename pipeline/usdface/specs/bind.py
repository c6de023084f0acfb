"""What `usdface bind` is told."""

from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from usdface.specs.base import (
    FilePath,
    ImageOut,
    LayerOut,
    Positional,
    PrimPath,
    Reads,
    Spec,
)

Landmark = Annotated[str, Field(pattern=r"^[^=]+=\d+$", max_length=300, examples=["nose_tip=1203"])]


def corrected_path(binding: Path) -> Path:
    """Return the layer of a binding that holds what people corrected."""
    return binding.with_name(f"{binding.stem}.corrected.usda")


def proposed_path(binding: Path) -> Path:
    """Return the layer of a binding that holds the proposal."""
    return binding.with_name(f"{binding.stem}.proposed.usda")


class BindSpec(Spec):
    """Find where a take's markers sit on a mesh, which needs no shapes and no rig.

    The layer it writes shows the mesh with a ball at each marker. Move a ball, or name another
    face or point, in the corrected layer beside it or in a stronger one: binding again keeps that.
    """

    example: ClassVar[str] = (
        "usdface bind kitchen.clean.take.usda scan.usdc --out scan.binding.usda "
        "--landmarks nose_tip=3437,chin=60,brow_L3=9445 --picture scan.binding.jpg"
    )

    step: Literal["bind"] = "bind"
    take: Annotated[FilePath, Reads(), Positional()]
    """The cleaned take."""
    mesh: Annotated[FilePath, Reads(), Positional()]
    """The face: any USD file with a mesh."""
    out: LayerOut
    """The binding to open and to correct."""
    landmarks: tuple[Landmark, ...] = ()
    """Markers whose point on the mesh is known, as NAME=POINT,...; three or more that are not on a
    line, unless the mesh has shapes to compare the motion with."""
    mesh_prim: PrimPath | None = None
    """The mesh in its file, where it holds several."""
    picture: ImageOut | None = None
    """Draw the markers on the mesh, named, the doubtful ones marked (.jpg, .png or .exr)."""
    quality: Literal["draft", "final"] = "final"
    """Draft leaves soft shadows and occlusion out of the picture."""
