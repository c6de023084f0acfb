"""Specs of references: select, import, from-edits, coverage, sheet."""

from pathlib import Path
from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from usdface.specs.base import (
    FilePath,
    Frames,
    ImageOut,
    LayerOut,
    Name,
    Positional,
    PrimPath,
    ReadPath,
    Reads,
    Spec,
)


def tuned_path(references: Path) -> Path:
    """Return the layer of a references asset that holds what people tuned."""
    return references.with_name(f"{references.stem}.tuned.usda")


def proposed_references_path(references: Path) -> Path:
    """Return the layer of a references asset that holds proposals."""
    return references.with_name(f"{references.stem}.proposed.usda")


def lock_path(references: Path) -> Path:
    """Return the file that says who tunes a references asset now."""
    return references.with_name(f"{references.stem}.tuned.lock")


def journal_path(references: Path) -> Path:
    """Return the file of changes that are not yet in the tuned layer."""
    return references.with_name(f"{references.stem}.tuned.journal")


class SelectSpec(Spec):
    """Choose the frames an animator should tune, and propose weights for them.

    Frames are chosen so that few of them span what the performer does, lids as well as jaw; the
    most telling come first. Tuned pairs of an earlier selection are kept, at the time codes they
    have. A picture beside the result shows how well the pairs cover the takes, and where not.
    """

    example: ClassVar[str] = (
        "usdface select kitchen.clean.take.usda --rig hero.usd --count 60 "
        "--out hero.references.usda"
    )
    module: ClassVar[str] = "references.select"

    step: Literal["select"] = "select"
    takes: Annotated[tuple[Path, ...], Field(min_length=1), Reads(), Positional()]
    """Cleaned takes of one performer."""
    rig: ReadPath
    """The character."""
    out: LayerOut
    """The references asset: pair i at time code i."""
    count: Annotated[int, Field(ge=2, le=10_000)] = 100
    """How many pairs there shall be."""
    method: Literal["viseme", "design", "both", "active"] = "both"
    """How frames are chosen: `viseme`, one for each viseme and emotion, and extremes; `design`,
    what spans the motion with few frames; `both`, visemes where phones are given, then design;
    `active`, what would help a mapping most next, given the pairs tuned so far."""
    phones: Annotated[tuple[Path, ...], Reads()] = ()
    """What is said when (`usdface phones`, or a TextGrid of another aligner), on the takes' clock:
    one file for each take, in their order."""
    emotions: tuple[Name, ...] = ()
    """The emotion of each take, in their order, where the takes do not say it themselves."""
    extremes: Annotated[int, Field(ge=0, le=1000)] = 10
    """With visemes: how many extreme frames of each emotion are added."""
    mapping: ReadPath | None = None
    """With `active`: the mapping that was trained on the pairs tuned so far. It proposes the
    weights as well."""
    picture: ImageOut | None = None
    """Where the coverage is drawn; beside the references by default."""
    frames: Frames | None = None
    """Choose from these frames only, as FIRST-LAST."""
    images: bool = True
    """Keep the video frame of each pair as a picture beside the references, where a take has
    video. Without, those of an earlier selection are removed too."""
    prim: PrimPath | None = None
    """The face in the rig's file, where it holds several."""

    @model_validator(mode="after")
    def _lists_go_with_takes(self) -> Self:
        for name in ("phones", "emotions"):
            given = len(getattr(self, name))
            if given not in (0, len(self.takes)):
                raise ValueError(
                    f"{given} {name} for {len(self.takes)} takes; give one for each, in order"
                )
        if self.method == "viseme" and not self.phones:
            raise ValueError(
                "visemes need to be known: give --phones (make them with `usdface phones AUDIO "
                "--transcript TEXT`), or choose --method design"
            )
        if self.method == "active" and self.mapping is None:
            raise ValueError(
                "active asks what would help a mapping: give the --mapping trained on the pairs "
                "tuned so far"
            )
        return self

    def picture_path(self) -> Path:
        """Return where the coverage is drawn."""
        return self.picture or self.out.with_name(f"{self.out.stem}.coverage.png")


class ReferencesImportSpec(Spec):
    """Bring tuned weights into a references asset.

    Weights are matched to the rig by name and to the pairs by frame. A shape the file does not
    name keeps its weight. Proposals are never changed; what was tuned before is replaced only
    where the file has the frame.
    """

    example: ClassVar[str] = "usdface references import hero.references.usda --weights tuned.csv"
    module: ClassVar[str] = "references.import_"

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
    in_place: ClassVar[bool] = True
    module: ClassVar[str] = "references.from_edits"

    step: Literal["references-from-edits"] = "references-from-edits"
    performances: Annotated[tuple[Path, ...], Field(min_length=1), Reads(), Positional()]
    """Edited performances; each knows the take and the mapping it was made from."""
    references: ReadPath
    """The references to add to."""
    out: LayerOut
    """The references asset to write."""
    count: Annotated[int, Field(ge=1, le=10_000)] = 20
    """How many frames of each performance are taken at most."""


class ReferencesCoverageSpec(Spec):
    """Measure how well references span takes, those they were chosen from or new ones.

    Says what share of every frame's motion the pairs determine, part by part, where the holes are,
    and which further frames would bring how much. The picture shows it over time.
    """

    example: ClassVar[str] = (
        "usdface references coverage hero.references.usda kitchen.clean.take.usda "
        "--out kitchen.coverage.png"
    )
    module: ClassVar[str] = "references.coverage"

    step: Literal["references-coverage"] = "references-coverage"
    references: Annotated[FilePath, Reads(), Positional()]
    """The references asset."""
    takes: Annotated[tuple[Path, ...], Field(min_length=1), Reads(), Positional()]
    """Cleaned takes of the same performer."""
    out: ImageOut
    """The picture: .jpg, .png or .exr."""
    tuned_only: bool = False
    """Count only pairs that a person has tuned: what training on them today would know."""


class ReferenceSheetSpec(Spec):
    """Draw the references for an animator to work from, on a screen or on paper.

    Each pair: the video frame, the markers and the rig at its present weights, with viseme,
    emotion, frame and the strongest weights.
    """

    example: ClassVar[str] = (
        "usdface references sheet hero.references.usda --takes kitchen.clean.take.usda "
        "--paper --out hero.references.jpg"
    )
    module: ClassVar[str] = "references.sheet"

    step: Literal["references-sheet"] = "references-sheet"
    references: Annotated[FilePath, Reads(), Positional()]
    """The references asset."""
    takes: Annotated[tuple[Path, ...], Reads()] = ()
    """The takes it was selected from: without them there is no video and no timecode."""
    out: ImageOut
    """The picture: .jpg, .png or .exr."""
    pairs: Frames | None = None
    """Show these pairs only, as FIRST-LAST; a page of paper holds some 24."""
    paper: bool = False
    """Dark on white, to be printed, with room to write."""
    tile: Annotated[int, Field(ge=64, le=2048)] = 280
    """Height of a picture in pixels."""
    quality: Literal["draft", "final"] = "final"
    """Draft leaves out soft shadows and occlusion."""
