"""What `usdface edit` and `usdface edits import` are told."""

from pathlib import Path
from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from usdface.layer_names import edits_path
from usdface.specs.base import FilePath, Frames, Name, Positional, PrimPath, ReadPath, Reads, Spec

Change = Annotated[float, Field(ge=-10.0, le=10.0)]


class EditSpec(Spec):
    """Change shapes of a performance over some frames, in a layer that mapping never touches.

    What is added moves with the solve beneath; what is overridden does not. Edits fold into those
    made before: the last one wins where it is at full strength, and blends in its fades. They are
    kept in NAME.edits.usda beside the performance, above its weights.
    """

    example: ClassVar[str] = (
        "usdface edit kitchen.hero.usda --shape jawOpen --add 0.1 --frames 120-160 --fade 8"
    )

    step: Literal["edit"] = "edit"
    performance: Annotated[FilePath, Reads(alone=True), Positional()]
    """The performance to edit."""
    shape: Annotated[tuple[Name, ...], Field(min_length=1)]
    """Shapes to change."""
    add: Change | None = None
    """Add this to the solved weight."""
    override: Change | None = None
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
