"""What `usdface tune` is told."""

from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from usdface.specs.base import FilePath, Positional, Reads, Spec


class TuneSpec(Spec):
    """Set the weights of reference pairs on a page in your browser.

    Prints a link to this machine alone and serves the page until it is interrupted (Ctrl+C).
    Every change is on disk at once, and in the tuning layer as soon as the hand rests. One person
    tunes at a time.
    """

    example: ClassVar[str] = "usdface tune hero.references.usda"

    step: Literal["tune"] = "tune"
    references: Annotated[FilePath, Reads(alone=True), Positional()]
    """The references asset that `usdface select` wrote."""
    takes: Annotated[tuple[Path, ...], Reads()] = ()
    """Takes whose video is shown, where they are not where `usdface select` read them."""
    port: Annotated[int, Field(ge=0, le=65535)] = 0
    """Port of the page; one that belongs to the asset by default."""
    take_over: bool = False
    """Take the right to tune from whoever has it; what was saved there is kept."""
    browser: bool = True
    """Open the page in the browser."""
