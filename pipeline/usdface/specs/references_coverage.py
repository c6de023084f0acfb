"""What `usdface references coverage` is told."""

from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from usdface.specs.base import FilePath, ImageOut, Positional, Reads, Spec


class ReferencesCoverageSpec(Spec):
    """Measure how well references span takes, those they were chosen from or new ones.

    Says what share of every frame's motion the pairs determine, part by part, where the holes are,
    and which further frames would bring how much. The picture shows it over time.
    """

    example: ClassVar[str] = (
        "usdface references coverage hero.references.usda kitchen.clean.take.usda "
        "--out kitchen.coverage.png"
    )

    step: Literal["references-coverage"] = "references-coverage"
    references: Annotated[FilePath, Reads(), Positional()]
    """The references asset."""
    takes: Annotated[tuple[Path, ...], Field(min_length=1), Reads(), Positional()]
    """Cleaned takes of the same performer."""
    out: ImageOut
    """The picture: .jpg, .png or .exr."""
    tuned_only: bool = False
    """Count only pairs that a person has tuned: what training on them today would know."""
