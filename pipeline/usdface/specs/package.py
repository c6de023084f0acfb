"""What `usdface package` is told."""

from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import AfterValidator

from usdface.specs.base import FilePath, Positional, PrimPath, Reads, Spec, WritePath


def _usdz(path: Path) -> Path:
    if path.suffix.lower() != ".usdz":
        raise ValueError("a package is written, so the name must end in .usdz")
    return path


class PackageSpec(Spec):
    """Pack a performance for review: rig, textures and edited weights in one .usdz.

    It needs nothing beside it and opens in any viewer of USD. It is a copy to look at; what is
    published stays the layers.
    """

    example: ClassVar[str] = "usdface package kitchen.hero.usda --out kitchen.review.usdz"

    step: Literal["package"] = "package"
    performance: Annotated[FilePath, Reads(), Positional()]
    """The performance, with or without edits."""
    out: Annotated[WritePath, AfterValidator(_usdz)]
    """The package to write."""
    prim: PrimPath | None = None
    """The face, where the layer holds several: its prim, or one above it alone."""
