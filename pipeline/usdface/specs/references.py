"""What `usdface select` and `usdface references import` are told."""

from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from usdface.specs.base import (
    FilePath,
    Frames,
    LayerOut,
    Positional,
    PrimPath,
    ReadPath,
    Reads,
    Spec,
)


def tuned_path(references: Path) -> Path:
    """Return the layer of a references asset that holds what people tuned."""
    return references.with_name(f"{references.stem}.tuned.usda")


def proposed_path(references: Path) -> Path:
    """Return the layer of a references asset that holds proposals."""
    return references.with_name(f"{references.stem}.proposed.usda")


class SelectSpec(Spec):
    """Choose the frames an animator should tune, and propose weights for them.

    Frames are chosen so that few of them span what the performer does. Tuned pairs of an earlier
    selection are kept, at the time codes they have.
    """

    example: ClassVar[str] = (
        "usdface select kitchen.clean.take.usda --rig hero.usd --count 60 "
        "--out hero.references.usda"
    )

    step: Literal["select"] = "select"
    takes: Annotated[tuple[Path, ...], Field(min_length=1), Reads(), Positional()]
    """Cleaned takes of one performer."""
    rig: ReadPath
    """The character."""
    out: LayerOut
    """The references asset: pair i at time code i."""
    count: Annotated[int, Field(ge=2, le=10_000)] = 100
    """How many pairs there shall be."""
    method: Literal["design"] = "design"
    """How frames are chosen: `design` spans the motion with few frames."""
    frames: Frames | None = None
    """Choose from these frames only, as FIRST-LAST."""
    prim: PrimPath | None = None
    """The face in the rig's file, where it holds several."""


class ReferencesImportSpec(Spec):
    """Bring tuned weights into a references asset.

    Weights are matched to the rig by name and to the pairs by frame. A shape the file does not
    name keeps its weight. Proposals are never changed; what was tuned before is replaced only
    where the file has the frame.
    """

    example: ClassVar[str] = "usdface references import hero.references.usda --weights tuned.csv"

    step: Literal["references-import"] = "references-import"
    references: Annotated[FilePath, Reads(alone=True), Positional()]
    """The references asset that `usdface select` wrote."""
    weights: ReadPath
    """.csv or .json (a `frame` column, then one per shape), or .usd with an animation: at the
    takes' frames, or at the pairs' time codes (--at pairs)."""
    at: Literal["frames", "pairs"] = "frames"
    """What the file's frame numbers mean."""

    def outputs(self) -> tuple[Path, ...]:
        """Return the layer that holds what people tuned."""
        return (tuned_path(self.references),)

    def changes(self) -> tuple[Path, ...]:
        """Return that layer, and the asset that composes it."""
        return (*self.outputs(), self.references)


class ReferencesFromEditsSpec(Spec):
    """Turn frames that an animator corrected into tuned pairs, so that training learns from them.

    Frames are chosen where edits are at full strength, not in their fades, and different from one
    another. The pairs of the references that the mapping was trained on stay as they are.
    """

    example: ClassVar[str] = (
        "usdface references from-edits kitchen.hero.usda --references hero.references.usda "
        "--out hero.v2.references.usda"
    )

    step: Literal["references-from-edits"] = "references-from-edits"
    performances: Annotated[tuple[Path, ...], Field(min_length=1), Reads(), Positional()]
    """Edited performances; each knows the take and the mapping it was made from."""
    references: ReadPath
    """The references to add to."""
    out: LayerOut
    """The references asset to write."""
    count: Annotated[int, Field(ge=1, le=10_000)] = 20
    """How many frames of each performance are taken at most."""
