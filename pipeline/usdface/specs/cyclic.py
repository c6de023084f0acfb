"""What `usdface cyclic` is told."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from usdface.specs.base import (
    FilePath,
    Frames,
    Name,
    Positional,
    ReadPath,
    Reads,
    Spec,
)
from usdface.specs.measured import MeasuredOut

METHODS = ("auto", "rbf", "kernel_cca", "hybrid", "ridge", "positions")


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
    out: MeasuredOut = ()
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
