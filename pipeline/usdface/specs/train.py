"""What `usdface train` is told."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from usdface.specs.base import FilePath, LayerOut, Name, Positional, Reads, Spec


class TrainSpec(Spec):
    """Learn the mapping from markers to the rig's weights.

    `auto` tries every method on references it has not seen and keeps the best; the table of what
    was tried is kept in the mapping (`usdface describe`).
    """

    example: ClassVar[str] = "usdface train hero.references.usda --out hero.mapping.usdc"

    step: Literal["train"] = "train"
    references: Annotated[FilePath, Reads(), Positional()]
    """The references asset, tuned."""
    out: LayerOut
    """The mapping to write."""
    method: Name = "auto"
    """The regression, or `auto`."""
    dimensions: Annotated[int, Field(ge=1, le=1000)] | None = None
    """Principal components to keep; chosen by cross-validation by default."""
    tuned_only: bool = False
    """Leave pairs out that nobody has tuned; by default proposals are learned from as well."""
