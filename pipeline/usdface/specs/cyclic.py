"""What `usdface cyclic` is told."""

from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import AfterValidator, Field, field_validator

from usdface.specs.base import (
    IMAGE_SUFFIXES,
    FilePath,
    Frames,
    Name,
    Positional,
    ReadPath,
    Reads,
    Spec,
    Writes,
)

METHODS = ("auto", "rbf", "kernel_cca", "hybrid", "ridge", "positions")


def _told(paths: tuple[Path, ...]) -> tuple[Path, ...]:
    for path in paths:
        if path.suffix.lower() not in (".json", *IMAGE_SUFFIXES):
            raise ValueError(
                f"{path}: figures are written as .json, curves as {', '.join(IMAGE_SUFFIXES)}"
            )
    return paths


class CyclicSpec(Spec):
    """Measure retargeting without knowing the truth: source to target and back, in mm per frame.

    Every method is trained on the pairs in both directions; `positions` matches positions of the
    two surfaces by non-negative least squares and needs no pairs.
    """

    example: ClassVar[str] = (
        "usdface cyclic human_dog.pairs.usda --source kitchen.take.usda "
        "--out kitchen.cyclic.json --out kitchen.cyclic.jpg"
    )

    step: Literal["cyclic"] = "cyclic"
    pairs: Annotated[FilePath, Reads(), Positional()]
    """The pairs asset."""
    source: ReadPath
    """Source weights: a take that carries them (Live Link), or a performance."""
    out: Annotated[tuple[FilePath, ...], AfterValidator(_told), Writes()] = ()
    """Where to write: .json for the figures, .png or .jpg for the curves; may be given twice."""
    methods: tuple[Name, ...] = METHODS
    """What to compare."""
    truth: ReadPath | None = None
    """What the target should do, where it is known: weights as .usd, .csv or .json; then the direct
    error is measured as well."""
    frames: Frames | None = None
    """Measure these frames only, as FIRST-LAST."""
    every: Annotated[int, Field(ge=1)] = 1
    """Measure every n-th frame."""

    @field_validator("out", mode="before")
    @classmethod
    def _one_or_several(cls, given: Any) -> Any:
        return (given,) if isinstance(given, str | Path) else given
