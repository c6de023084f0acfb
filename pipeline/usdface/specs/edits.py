"""Specs of edits and publishing: edit, edits-import, bake, package."""

from pathlib import Path
from typing import Annotated, ClassVar, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from usdface.core.sidecars import edits_path
from usdface.specs.base import (
    FilePath,
    Frames,
    LayerOut,
    Name,
    Positional,
    PrimPath,
    ReadPath,
    Reads,
    Spec,
    WritePath,
)

_Change = Annotated[float, Field(ge=-10.0, le=10.0)]


class EditSpec(Spec):
    """Change shapes of a performance over some frames, in a layer that mapping never touches.

    What is added moves with the solve beneath; what is overridden does not. Edits fold into those
    made before: the last one wins where it is at full strength, and blends in its fades. They are
    kept in NAME.edits.usda beside the performance, above its weights.
    """

    example: ClassVar[str] = (
        "usdface edit kitchen.hero.usda --shape jawOpen --add 0.1 --frames 120-160 --fade 8"
    )
    module: ClassVar[str] = "edits.edit"

    step: Literal["edit"] = "edit"
    performance: Annotated[FilePath, Reads(alone=True), Positional()]
    """The performance to edit."""
    shape: Annotated[tuple[Name, ...], Field(min_length=1)]
    """Shapes to change."""
    add: _Change | None = None
    """Add this to the solved weight."""
    override: _Change | None = None
    """Take this instead of the solved weight."""
    clear: bool = False
    """Take edits out: the solve shows again."""
    frames: Frames | None = None
    """Change these frames only, as FIRST-LAST; all by default."""
    fade: Annotated[int, Field(ge=0, le=100_000)] = 0
    """Frames before and after over which the change eases in and out."""
    prim: PrimPath | None = None
    """The face, where the layer holds several: its prim, or one above it alone."""

    @model_validator(mode="after")
    def _one_change(self) -> Self:
        given = [self.add is not None, self.override is not None, self.clear]
        if sum(given) != 1:
            raise ValueError("give one of --add, --override and --clear")
        if self.fade and self.frames is None:
            raise ValueError("a fade needs --frames: over the whole performance nothing fades")
        return self

    def outputs(self) -> tuple[Path, ...]:
        """Return the layer that holds the edits."""
        return (edits_path(self.performance),)


class EditsImportSpec(Spec):
    """Take an animation that was changed in another tool as edits: its difference to the solve.

    Shapes are matched by name, frames by number. At the frames that the file has, the performance
    then shows what the file shows; elsewhere edits stay as they are.
    """

    example: ClassVar[str] = "usdface edits import kitchen.hero.usda --changed kitchen.animator.usd"
    module: ClassVar[str] = "edits.import_"

    step: Literal["edits-import"] = "edits-import"
    performance: Annotated[FilePath, Reads(alone=True), Positional()]
    """The performance to edit."""
    changed: ReadPath
    """.usd with an animation, .csv or .json (a `frame` column, then one per shape)."""
    least: Annotated[float, Field(gt=0.0, le=1.0)] = 0.002
    """Differences smaller than this are rounding, not edits."""
    prim: PrimPath | None = None
    """The face, where the layer holds several: its prim, or one above it alone."""

    def outputs(self) -> tuple[Path, ...]:
        """Return the layer that holds the edits."""
        return (edits_path(self.performance),)


class BakeSpec(Spec):
    """Compose solve and edits into the weights that are published.

    Writes one layer with the animation and the overs that point the rig's skeletons at it: any
    tool that reads UsdSkel plays it, whether it knows of edits or not. The performance and its
    edits stay as they are.
    """

    example: ClassVar[str] = "usdface bake kitchen.hero.usda --out kitchen.hero.published.usdc"
    module: ClassVar[str] = "edits.bake"

    step: Literal["bake"] = "bake"
    performance: Annotated[FilePath, Reads(), Positional()]
    """The performance, with or without edits."""
    out: LayerOut
    """The layer to publish."""
    tolerance: Annotated[float, Field(gt=0.0)] | None = None
    """Keep only the keys that lines between them need to stay this close; all frames by default."""
    unit: Literal["weight", "mm"] = "weight"
    """What the tolerance is measured in: weights, or how far the face's surface moves."""
    limit: bool = False
    """Keep edited weights within the rig's ranges; solved ones are."""
    prim: PrimPath | None = None
    """The face, where the layer holds several: its prim, or one above it alone."""


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
    module: ClassVar[str] = "edits.package"

    step: Literal["package"] = "package"
    performance: Annotated[FilePath, Reads(), Positional()]
    """The performance, with or without edits."""
    out: Annotated[WritePath, AfterValidator(_usdz)]
    """The package to write."""
    prim: PrimPath | None = None
    """The face, where the layer holds several: its prim, or one above it alone."""
