"""What `usdface join` is told."""

from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from usdface.specs.base import LayerOut, Positional, Reads, Spec


class JoinSpec(Spec):
    """Make one performance of parts that were mapped apart, as a farm does.

    The parts must follow on one another and be of the same take, rig and mapping; they may be given
    in any order. What is joined equals the performance mapped in one go, value for value.
    """

    example: ClassVar[str] = (
        "usdface join parts/kitchen.1.usda parts/kitchen.2.usda --out kitchen.hero.usda"
    )

    step: Literal["join"] = "join"
    parts: Annotated[tuple[Path, ...], Field(min_length=1), Reads(), Positional()]
    """Performances, each of some of the frames."""
    out: LayerOut
    """The performance to open."""
    clips: Literal["auto", "always", "never"] = "auto"
    """Whether the parts stay where they are and are played as value clips, or are merged into one
    layer; `auto` merges up to 1 GB."""
