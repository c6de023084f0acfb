"""Spec of the tuning page: tune."""

from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from usdface.specs.base import Positional, Spec
from usdface.specs.paths import FilePath, Reads


class TuneSpec(Spec):
    """Tune the weights of reference pairs on a page in your browser.

    Prints a link that works on this machine only, and serves the page until interrupted (Ctrl+C).
    Every change is stored on disk immediately, and in the tuned layer after a short pause. One
    person can tune at a time.
    """

    example: ClassVar[str] = "usdface tune hero.references.usda"

    section: ClassVar[str] = "references"

    step: Literal["tune"] = "tune"
    references: Annotated[FilePath, Reads(alone=True), Positional()]
    """The references asset written by `usdface select`."""
    takes: Annotated[tuple[Path, ...], Reads()] = ()
    """Takes whose video is shown, if they have moved since `usdface select`."""
    port: Annotated[int, Field(ge=0, le=65535)] = 0
    """Port of the page. Default: one derived from the asset's path."""
    take_over: bool = False
    """Take over the lock from another person; their saved changes are kept."""
    browser: bool = True
    """Open the page in the browser."""
