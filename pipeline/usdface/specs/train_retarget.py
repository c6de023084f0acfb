"""What `usdface train-retarget` is told."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from usdface.specs.base import FilePath, LayerOut, Name, Positional, ReadPath, Reads, Spec


class TrainRetargetSpec(Spec):
    """Learn from expression pairs how a source's weights drive a target.

    `auto` sends expressions to the target and back by every method and keeps the one that returns
    them best; the table of what was tried is kept (`usdface describe`).
    """

    example: ClassVar[str] = (
        "usdface train-retarget human_dog.pairs.usda --out human_dog.retarget.usdc"
    )

    step: Literal["train-retarget"] = "train-retarget"
    pairs: Annotated[FilePath, Reads(), Positional()]
    """The pairs asset."""
    out: LayerOut
    """The retargeting to write."""
    method: Name = "auto"
    """auto, rbf, kernel_cca, hybrid, additive or ridge."""
    source: ReadPath | None = None
    """A performance of the source: methods are compared on it rather than on mixtures of pairs."""
    alpha: Annotated[float, Field(ge=0.0, le=1.0)] | None = None
    """Share of the multiquadric in the hybrid; chosen with the method by default. `retarget` takes
    one that is keyed over time."""
