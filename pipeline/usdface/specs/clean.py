"""What `usdface clean` is told."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from usdface.specs.base import FilePath, ImageOut, LayerOut, Name, Positional, Reads, Spec


class CleanSpec(Spec):
    """Take head motion out, mend labels, fill gaps, remove noise.

    The head's motion is kept as HeadMotion. The result is a stronger layer over the take, which
    stays as it is. Repaired samples have a lower confidence.
    """

    example: ClassVar[str] = "usdface clean kitchen.take.usda --out kitchen.clean.take.usda"

    step: Literal["clean"] = "clean"
    take: Annotated[FilePath, Reads(), Positional()]
    """The take to clean."""
    out: LayerOut
    """The cleaned take."""
    rigid: tuple[Name, ...] = ()
    """Markers that move with the skull alone; the take's own, or found, by default."""
    neutral: int | None = None
    """Frame number of the neutral face; the take's own by default."""
    max_gap: Annotated[int, Field(ge=0)] | None = None
    """Longest gap to fill, in frames; 2 seconds by default. Longer ones keep confidence 0."""
    relabel: bool = True
    """Mend swapped labels and mistracked markers."""
    report: ImageOut | None = None
    """A picture of what was repaired, marker by marker over time."""
    smooth: bool = True
    """Remove measured noise; blinks keep their height."""
